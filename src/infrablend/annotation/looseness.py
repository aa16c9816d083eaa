"""Enlarges the boxes of inserted objects: hand-drawn boxes leave a margin, boxes of rendered objects do not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from infrablend.core.boxes import clip_boxes
from infrablend.core.dataset import TIGHT_BOX, TIGHT_OBB, ImageRecord, Instance
from infrablend.core.mesh import FloatArray

Factors = float | Mapping[str, float]
"""Factor on width and height of boxes: one for all classes, or one per class (1 for classes that are not listed)."""

_LEAST_PX = 1e-9  # shorter movements are rounding errors


def loosen_inserted(images: Sequence[ImageRecord], factors: Factors) -> tuple[list[ImageRecord], int]:
    """Enlarge the boxes of inserted objects within the frame; masks and original labels stay unchanged.

    The exact boxes are kept in `Instance.extra`, see `TIGHT_BOX`.

    Args:
        images: Images with known sizes; others stay unchanged.
        factors: Factors of at least 1 on width and height of the boxes.

    Returns:
        The images, and the number of boxes that were enlarged.
    """
    loose = [loosen_image(image, factors) for image in images]
    return [image for image, _ in loose], sum(count for _, count in loose)


def loosen_image(image: ImageRecord, factors: Factors) -> tuple[ImageRecord, int]:
    """Enlarge the boxes of the inserted objects of one image, see `loosen_inserted`."""
    instances, count = [], 0
    for one in image.instances:
        factor = factors.get(one.category, 1.0) if isinstance(factors, Mapping) else factors
        if one.inserted and factor > 1 and image.size_wh is not None:
            one, count = _loosened(one, factor, image.size_wh), count + 1
        instances.append(one)
    return replace(image, instances=tuple(instances)), count


def loosened_text(count: int, factors: Factors) -> str:
    """Return a sentence for a dataset's card on how many boxes were enlarged, and by how much."""
    if isinstance(factors, Mapping):
        by = ", ".join(f"{k} {v:g}" for k, v in factors.items())
    else:
        by = f"the factor {factors:g}"
    return (
        f"The boxes of {count} inserted objects were enlarged by {by}, up to the border of the picture, because "
        "hand-drawn boxes have a margin."
    )


def is_loosened(instance: Instance) -> bool:
    """Return whether the box of the object has been enlarged already."""
    return TIGHT_BOX in instance.extra


def _loosened(one: Instance, factor: float, size_wh: tuple[int, int]) -> Instance:
    x0, y0, x1, y1 = one.box_xyxy.tolist()
    margin = np.array([x0 - x1, y0 - y1, x1 - x0, y1 - y0]) * (factor - 1) / 2
    exact: dict[str, list[float]] = {TIGHT_BOX: [x0, y0, x1 - x0, y1 - y0]}
    corners = one.corners_xy
    if corners is not None:
        exact[TIGHT_OBB] = corners.reshape(-1).tolist()
        corners = loosen_rectangle(corners, factor, size_wh)
    box = clip_boxes(one.box_xyxy + margin, size_wh)
    return replace(one, box_xyxy=box, corners_xy=corners, extra={**one.extra, **exact})


def loosen_rectangle(corners_xy: FloatArray, factor: float, size_wh: tuple[int, int]) -> FloatArray:
    """Return a rectangle (4, 2) enlarged about its centre, with the same orientation.

    A side that would leave the frame moves outwards only as far as the frame allows.
    """
    corners = corners_xy.copy()
    size = np.array(size_wh, np.float64)
    for k in range(4):
        # The side from corner k to the next one moves away from the opposite side.
        side, opposite = [k, (k + 1) % 4], [(k + 3) % 4, (k + 2) % 4]
        shift = (corners_xy[side] - corners_xy[opposite]) * (factor - 1) / 2
        room = np.where(shift > 0, size - corners[side], corners[side])
        moves = np.abs(shift) > _LEAST_PX
        part = float((room[moves] / np.abs(shift[moves])).min(initial=1.0))
        corners[side] += max(part, 0.0) * shift
    inside = bool(((corners_xy >= 0) & (corners_xy <= size)).all())
    # Rounding may leave a corner just outside.
    return np.clip(corners, 0.0, size) if inside else corners
