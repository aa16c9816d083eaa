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
from infrablend.errors import Problem
from infrablend.formats.box_checks import OVERHANG_PX, check_box, is_near, overhang_px
from infrablend.formats.hit_uav.forms import Form
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


@dataclass(slots=True)
class FormData:
    """Everything that one form states."""

    form: Form
    pictures: dict[str, FormPicture] = field(default_factory=dict)
    categories: list[Category] = field(default_factory=list)
    extra: dict[str, Any] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    files_read: int = 0

    def add(self, where: str, code: str, found: str, expected: str = "", todo: str = "") -> None:
        """Record an error: the item is skipped."""
        self.problems.append(Problem(where, code, found, expected, todo))

    def warn(self, where: str, code: str, found: str, expected: str = "", todo: str = "") -> None:
        """Record a warning: the item is kept."""
        self.problems.append(Problem(where, code, found, expected, todo, severity="warning"))


def relative_to(root: Path, path: Path) -> str:
    """Return `path` below `root`, with forward slashes."""
    return path.relative_to(root).as_posix()


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
        item.box, problem = check_box(item.raw, size_wh, item.where)
        if problem is not None:
            data.problems.append(problem)
        return item.box is not None
    if not is_near(values):
        data.add(item.where, "box-not-finite", f"bbox {bbox!r}"[:120], "finite numbers", "correct the annotation")
        return False
    if values[2] <= 0 or values[3] <= 0:
        data.add(
            item.where, "box-empty", f"bbox {bbox!r}"[:120], "a width and height above 0", "correct the annotation"
        )
        return False
    item.obb = values
    return True


def set_corners(data: FormData, items: list[FormObject], owners: list[FormPicture]) -> None:
    """Compute the corners of all oriented boxes at once, and drop boxes outside their frames."""
    turned = [(i, o) for i, o in zip(items, owners, strict=True) if i.obb is not None]
    if turned:
        corners = corners_of_cxcywha(np.array([i.obb for i, _ in turned], np.float64))
        low, high = corners.min(axis=1), corners.max(axis=1)
        for k, (item, owner) in enumerate(turned):
            if owner.size_wh is None:
                item.corners = corners[k]
                continue
            w, h = owner.size_wh
            inside = low[k, 0] >= 0 and low[k, 1] >= 0 and high[k, 0] <= w and high[k, 1] <= h
            if not inside:
                if low[k, 0] >= w or low[k, 1] >= h or high[k, 0] <= 0 or high[k, 1] <= 0:
                    found = f"oriented box {list(item.obb or ())} outside the frame"
                    data.add(item.where, "box-outside", found, f"a box inside {w}x{h} px", "correct the annotation")
                    continue
                over = overhang_px(corners[k], owner.size_wh)
                if over > OVERHANG_PX:
                    found = f"oriented box reaches {over:.3g} px out of the frame, kept"
                    data.warn(item.where, "box-overhang", found, f"at most {OVERHANG_PX} px outside {w}x{h} px")
            item.corners = corners[k]
    for item, owner in zip(items, owners, strict=True):
        if item.box is not None or item.corners is not None:
            owner.objects.append(item)
