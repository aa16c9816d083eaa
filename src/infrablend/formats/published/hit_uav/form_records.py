"""What one form of HIT-UAV states about pictures and objects, before it is united with the other forms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import corners_of_cxcywha
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Split
from infrablend.formats.box_checks import OVERHANG_PX, is_near, overhang_px
from infrablend.formats.pictures.listing import PictureFolder, check_name
from infrablend.formats.published.hit_uav.forms import Form
from infrablend.formats.records import Findings
from infrablend.formats.values import to_floats, to_size


@dataclass(slots=True)
class FormPicture:
    """One picture as one form describes it."""

    stem: str
    name: str
    path: Path | None
    split: Split
    size_wh: tuple[int, int] | None
    where: str
    capture: Capture = field(default_factory=Capture)
    source_id: int | None = None
    extra: dict[str, object] = field(default_factory=dict)
    objects: list[FormObject] = field(default_factory=list)


@dataclass(slots=True)
class FormObject:
    """One object as one form describes it: `raw` is the box in the file, `box` the box after clipping."""

    where: str
    category: str
    picture: FormPicture
    raw: tuple[float, ...] | None = None
    box: NDArray[np.float64] | None = None
    obb: tuple[float, ...] | None = None
    corners: NDArray[np.float64] | None = None
    truncated: bool | None = None
    difficult: bool | None = None
    inserted: bool = False
    source_id: int | None = None
    extra: dict[str, object] = field(default_factory=dict)

    def bounds(self) -> NDArray[np.float64]:
        """Return the axis-aligned bounds as this form states them, unclipped."""
        if self.corners is not None:
            return np.concatenate([self.corners.min(axis=0), self.corners.max(axis=0)])
        return np.array(self.raw, np.float64)


@dataclass(kw_only=True)
class FormData(Findings):
    """Everything that one form states; `counts` has its `files`."""

    form: Form
    pictures: dict[str, FormPicture] = field(default_factory=dict)
    categories: list[Category] = field(default_factory=list)
    extra: dict[str, object] = field(default_factory=dict)

    def find_picture(
        self, listing: PictureFolder, name: object, size: tuple[object, object], split: Split, where: str
    ) -> FormPicture | None:
        """Return a picture of a name, whose file may be missing; None, with a problem, if the name cannot be used."""
        path = None
        found = str(name)
        fault = check_name(name, where)
        if fault is None:
            found, path, fault = listing.find(found, where)
        if fault is not None:
            self.problems.append(fault)
            return None
        size_wh = to_size(*size)
        if size_wh is None:
            self.warn(where, "image-size-unknown", f"size {size[0]!r} x {size[1]!r}", "width and height in px")
        return FormPicture(found.rpartition(".")[0] or found, found, path, split, size_wh, where)

    def set_geometry(self, item: FormObject, fields: Sequence[str], written: object) -> None:
        """Check and store the numbers of one annotation, whose fields have these names; faulty ones are reported."""
        values = to_floats(written, len(fields))
        said = f"bbox {written!r}"[:120]
        todo = "correct the annotation"
        if values is None:
            self.add(item.where, "box-malformed", said, f"[{', '.join(fields)}]", todo)
        elif len(fields) == 4:
            x, y, x1, y1 = values
            item.raw = values if "xmax" in fields else (x, y, x + x1, y + y1)
            item.box = self.box(item.raw, item.picture.size_wh, item.where)
        elif not is_near(values):
            self.add(item.where, "box-not-finite", said, "finite numbers", todo)
        elif values[2] <= 0 or values[3] <= 0:
            self.add(item.where, "box-empty", said, "a width and height above 0", todo)
        else:
            item.obb = values

    def enter_objects(self, items: Iterable[FormObject]) -> None:
        """Give objects to their pictures: all with a box that can be used, oriented ones with their corners."""
        listed = list(items)
        turned = [i for i in listed if i.obb is not None]
        boxes = np.array([i.obb for i in turned], np.float64).reshape(-1, 5)
        for item, corners in zip(turned, corners_of_cxcywha(boxes), strict=True):
            if self._is_in_frame(item, corners):
                item.corners = corners
        for item in listed:
            if item.box is not None or item.corners is not None:
                item.picture.objects.append(item)

    def _is_in_frame(self, item: FormObject, corners: NDArray[np.float64]) -> bool:
        """Return whether a part of an oriented box is in its frame; report one that is outside or overhangs."""
        if item.picture.size_wh is None:
            return True
        w, h = item.picture.size_wh
        over = overhang_px(corners, (w, h))
        low, high = corners.min(axis=0), corners.max(axis=0)
        if over > 0 and (low[0] >= w or low[1] >= h or high[0] <= 0 or high[1] <= 0):
            found = f"oriented box {list(item.obb or ())} outside the frame"
            self.add(item.where, "box-outside", found, f"a box inside {w}x{h} px", "correct the annotation")
            return False
        if over > OVERHANG_PX:
            found = f"oriented box reaches {over:.3g} px out of the frame, kept"
            self.warn(item.where, "box-overhang", found, f"at most {OVERHANG_PX} px outside {w}x{h} px")
        return True
