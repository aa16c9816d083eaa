"""What one form of HIT-UAV states about pictures and objects, before it is united with the other forms."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import corners_of_cxcywha
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Split
from infrablend.formats.box_checks import OVERHANG_PX, is_near, overhang_px
from infrablend.formats.published.hit_uav.forms import Form
from infrablend.formats.records import Findings
from infrablend.formats.values import to_floats


@dataclass(slots=True)
class FormObject:
    """One object as one form describes it: `raw` is the box in the file, `box` the box after clipping."""

    where: str
    category: str
    raw: tuple[float, ...] | None = None
    box: NDArray[np.float64] | None = None
    obb: tuple[float, ...] | None = None
    corners: NDArray[np.float64] | None = None
    truncated: bool | None = None
    difficult: bool | None = None
    inserted: bool = False
    source_id: int | None = None
    extra: dict[str, Any] = field(default_factory=dict)

    def bounds(self) -> NDArray[np.float64]:
        """Return the axis-aligned bounds as this form states them, unclipped."""
        if self.corners is not None:
            return np.concatenate([self.corners.min(axis=0), self.corners.max(axis=0)])
        return np.array(self.raw, np.float64)


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
    extra: dict[str, Any] = field(default_factory=dict)
    objects: list[FormObject] = field(default_factory=list)


@dataclass(kw_only=True)
class FormData(Findings):
    """Everything that one form states; `counts` has its `files`."""

    form: Form
    pictures: dict[str, FormPicture] = field(default_factory=dict)
    categories: list[Category] = field(default_factory=list)
    extra: dict[str, Any] = field(default_factory=dict)


def set_geometry(
    data: FormData, item: FormObject, bbox: object, rotated: bool, size_wh: tuple[int, int] | None
) -> bool:
    """Check and store the numbers of one annotation; return False if the annotation has to be dropped."""
    values = to_floats(bbox, 5 if rotated else 4)
    if values is None:
        expected = "[cx, cy, w, h, angle]" if rotated else "[x, y, w, h]"
        data.add(item.where, "box-malformed", f"bbox {bbox!r}"[:120], expected, "correct the annotation")
        return False
    if not rotated:
        x, y, w, h = values
        item.raw = (x, y, x + w, y + h)
        item.box = data.box(item.raw, size_wh, item.where)
        return item.box is not None
    if not is_near(values):
        data.add(item.where, "box-not-finite", f"bbox {bbox!r}"[:120], "finite numbers", "correct the annotation")
        return False
    if values[2] <= 0 or values[3] <= 0:
        expected = "a width and height above 0"
        data.add(item.where, "box-empty", f"bbox {bbox!r}"[:120], expected, "correct the annotation")
        return False
    item.obb = values
    return True


def set_corners(data: FormData, items: list[FormObject], owners: list[FormPicture]) -> None:
    """Compute the corners of all oriented boxes at once, and drop boxes outside their frames."""
    turned = [(i, o) for i, o in zip(items, owners, strict=True) if i.obb is not None]
    boxes = np.array([i.obb for i, _ in turned], np.float64).reshape(-1, 5)
    for (item, owner), corners in zip(turned, corners_of_cxcywha(boxes), strict=True):
        if owner.size_wh is not None and not _is_in_frame(data, item, corners, owner.size_wh):
            continue
        item.corners = corners
    for item, owner in zip(items, owners, strict=True):
        if item.box is not None or item.corners is not None:
            owner.objects.append(item)


def _is_in_frame(data: FormData, item: FormObject, corners: NDArray[np.float64], size_wh: tuple[int, int]) -> bool:
    """Return whether a part of an oriented box is in its frame; report one that is outside or overhangs."""
    over = overhang_px(corners, size_wh)
    if over == 0:
        return True
    (w, h), low, high = size_wh, corners.min(axis=0), corners.max(axis=0)
    if low[0] >= w or low[1] >= h or high[0] <= 0 or high[1] <= 0:
        found = f"oriented box {list(item.obb or ())} outside the frame"
        data.add(item.where, "box-outside", found, f"a box inside {w}x{h} px", "correct the annotation")
        return False
    if over > OVERHANG_PX:
        found = f"oriented box reaches {over:.3g} px out of the frame, kept"
        data.warn(item.where, "box-overhang", found, f"at most {OVERHANG_PX} px outside {w}x{h} px")
    return True
