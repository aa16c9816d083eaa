"""Labels of objects that structures of the background hide in part: visible share, both boxes, `occluded`."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.annotation.labels import ObbMode, heading_in_image, oriented_box
from infrablend.core.boxes import box_of_points, convex_hull
from infrablend.core.dataset import Instance
from infrablend.core.masks import row_corners
from infrablend.core.mesh import FloatArray
from infrablend.core.placed import PlacedObject

BoxMode = Literal["visible", "amodal"]
_DIGITS = 9


def label_occluded(
    label: Instance, placed: PlacedObject, share: float, written: BoxMode = "visible", obb: ObbMode = "min_area"
) -> Instance:
    """Return the label of a partly hidden object.

    `extra` gets `occluded`, `amodal_box` (as if nothing were in front) and `visible_box` (around the visible pixels).

    Args:
        label: Label with the mask of the visible part, and with boxes and `visibility` as if nothing were in front.
        placed: The object.
        share: Share of the object's pixels that is visible.
        written: Box that `box_xyxy` and `corners_xy` describe.
        obb: Kind of oriented box.
    """
    assert label.mask is not None and label.visibility is not None
    hull = _visible_hull(label.mask.to_array(), label.box_xyxy)
    boxes = {"amodal": label.box_xyxy, "visible": box_of_points(hull)}
    extra = {
        **label.extra,
        "occluded": True,
        **{f"{name}_box": [round(float(v), _DIGITS) for v in box] for name, box in boxes.items()},
    }
    label = replace(label, visibility=round(label.visibility * share, _DIGITS), extra=extra)
    if written == "amodal":
        return label
    direction = heading_in_image(placed) if obb == "heading" else None
    corners, _ = oriented_box(hull, bool(label.truncated), direction, placed.camera.size_wh)
    return replace(label, box_xyxy=boxes["visible"], corners_xy=corners)


def _visible_hull(mask: NDArray[np.bool_], box_xyxy: FloatArray) -> FloatArray:
    points = np.clip(row_corners(mask), box_xyxy[:2], box_xyxy[2:])
    return convex_hull(np.unique(points, axis=0))
