"""Exact labels: boxes of the projected bodies, clipped to the frame and to the visible samples of the id pass."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import (
    box_of_points,
    clip_triangles_to_rect,
    convex_hull,
    corners_of_box,
    smallest_rectangle_inside,
)
from infrablend.core.camera import CameraSpec
from infrablend.core.mesh import FloatArray, IntArray

# An object below this visible share, or with fewer visible pixels, gets no label, because nobody could annotate it.
MIN_VISIBILITY = 0.25
MIN_PIXELS = 6.0
# From this visible share on, an object counts as unhidden; its box is that of its geometry, to sub-pixel precision.
UNHIDDEN = 0.97


@dataclass(frozen=True, eq=False)
class VisibleSamples:
    """Samples of the id pass that show one object.

    Attributes:
        mask: Whether each sample shows the object, cropped to the area where it can appear.
        offset_xy: Column and row of the first sample of the crop.
        oversample: Samples per pixel and direction.
    """

    mask: NDArray[np.bool_]
    offset_xy: tuple[int, int]
    oversample: int


@dataclass(frozen=True, eq=False)
class Label:
    """One object of a frame, labelled or dropped.

    Attributes:
        category: Class of the object.
        box_xyxy: (4,) half-open float pixels, inside the frame; None if the object has no label.
        corners_xy: (4, 2) corners of the oriented box, or None.
        visibility: Visible pixels divided by the pixels there would be without occluders and frame edges.
        truncated: Whether the frame cuts the object.
        dropped: Reason for having no label: "hidden", "small" or "outside"; "" for a labelled object.
        outline_xy: (N, 2) convex outline of what the box is around, clockwise; None if the object has no label.
    """

    category: str
    box_xyxy: FloatArray | None
    corners_xy: FloatArray | None
    visibility: float
    truncated: bool
    dropped: str = ""
    outline_xy: FloatArray | None = None


def silhouette_area_px(
    xy: FloatArray, triangles: IntArray, size_wh: tuple[int, int], oversample: int = 4
) -> tuple[float, float]:
    """Return the area in pixels of the union of projected triangles: in total, and inside the frame."""
    low = np.floor(xy.min(axis=0)).astype(int) - 1
    size = np.ceil(xy.max(axis=0)).astype(int) + 2 - low
    mask = np.zeros((int(size[1]) * oversample, int(size[0]) * oversample), np.uint8)
    # Fixed point with 4 fractional bits; OpenCV has pixel centres at integers, hence the half sample.
    points = np.round(((xy - low) * oversample - 0.5) * 16).astype(np.int32)
    for t in points[triangles]:
        cv2.fillConvexPoly(mask, t, 1, lineType=cv2.LINE_8, shift=4)
    x0, y0 = np.maximum(-low, 0) * oversample
    x1, y1 = np.maximum(np.array(size_wh) - low, 0) * oversample
    return float(mask.sum()) / oversample**2, float(mask[y0:y1, x0:x1].sum()) / oversample**2


def label_object(
    category: str,
    camera: CameraSpec,
    vertices_m: FloatArray,
    triangles: IntArray,
    visible: VisibleSamples,
    upright: bool,
) -> Label:
    """Return the label of one object.

    `vertices_m` are (V, 3) in the world; `upright` aligns the oriented box with the image axes, as HIT-UAV does for
    people.
    """
    w, h = camera.size_wh
    xy, depth = camera.project(vertices_m)
    if not (depth > 0.1).all():
        return Label(category, None, None, 0.0, True, "outside")
    low, high = xy.min(axis=0), xy.max(axis=0)
    truncated = bool((low < 0).any() or high[0] > w or high[1] > h)
    points = clip_triangles_to_rect(xy[triangles], np.array([0.0, 0.0, w, h])) if truncated else xy
    if not len(points):
        return Label(category, None, None, 0.0, True, "outside")
    area, framed = silhouette_area_px(xy, triangles, (w, h))
    shown = float(visible.mask.sum()) / visible.oversample**2
    visibility = min(shown / max(area, 1e-9), 1.0)
    if shown < MIN_PIXELS or visibility < MIN_VISIBILITY:
        reason = "outside" if framed < MIN_VISIBILITY * area else "small" if framed < MIN_PIXELS else "hidden"
        return Label(category, None, None, visibility, truncated, reason)
    if shown < UNHIDDEN * framed - 0.5:
        # Something is in front of it: the samples of the id pass bound the box, to one sample.
        points = _points_within(points, visible)
    box = box_of_points(points)
    if (box[2:] - box[:2] < 1).any():
        return Label(category, None, None, visibility, truncated, "small")
    corners = corners_of_box(box) if upright else smallest_rectangle_inside(points, (w, h))
    return Label(category, box, corners, visibility, truncated, outline_xy=convex_hull(points))


def _points_within(points_xy: FloatArray, visible: VisibleSamples) -> FloatArray:
    """Return the outline points of the visible samples, clipped to the box of the projected geometry."""
    i, j = np.nonzero(visible.mask)
    corners = np.concatenate([np.stack([j + dj, i + di], axis=1) for dj in (0, 1) for di in (0, 1)])
    outline = convex_hull((corners + visible.offset_xy) / visible.oversample)
    box = box_of_points(points_xy)
    return np.clip(outline, box[:2], box[2:])
