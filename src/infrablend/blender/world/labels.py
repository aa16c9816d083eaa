"""Exact labels: boxes of the projected bodies, cut to the frame and to what the id pass shows of them."""

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

# An object below this visible share, or with fewer visible pixels, gets no label: nobody could annotate it.
MIN_VISIBILITY = 0.25
MIN_PIXELS = 6.0
# From this share on an object counts as unhidden, and its box is that of its geometry, to sub-pixel precision.
UNHIDDEN = 0.97


@dataclass(frozen=True, eq=False)
class Label:
    """One object of a frame.

    Attributes:
        category: Its class.
        box_xyxy: (4,) half-open float pixels, inside the frame; None if it has no label.
        corners_xy: (4, 2) corners of the oriented box, or None.
        visibility: Visible pixels over pixels if nothing were in front and the frame had no edge.
        truncated: Cut by the frame.
        dropped: Why it has no label: "hidden", "small", "outside" or "".
    """

    category: str
    box_xyxy: FloatArray | None
    corners_xy: FloatArray | None
    visibility: float
    truncated: bool
    dropped: str = ""


def silhouette_area_px(
    xy: FloatArray, triangles: IntArray, size_wh: tuple[int, int], oversample: int = 4
) -> tuple[float, float]:
    """Area in pixels of the union of projected triangles: all of it, and its part inside the frame."""
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
    visible: NDArray[np.bool_],
    visible_offset_xy: tuple[int, int],
    oversample: int,
    upright: bool,
) -> Label:
    """The label of one object.

    Args:
        category: Its class.
        camera: Of the frame.
        vertices_m: (V, 3) in the world.
        triangles: (T, 3).
        visible: Samples of the id pass that show the object, cropped to where it can be.
        visible_offset_xy: Column and row of the crop's first sample.
        oversample: Samples per pixel and direction of the id pass.
        upright: Give the oriented box the axes of the picture, as HIT-UAV does for people.
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
    shown = float(visible.sum()) / oversample**2
    visibility = min(shown / max(area, 1e-9), 1.0)
    if shown < MIN_PIXELS or visibility < MIN_VISIBILITY:
        reason = "outside" if framed < MIN_VISIBILITY * area else "small" if framed < MIN_PIXELS else "hidden"
        return Label(category, None, None, visibility, truncated, reason)
    if shown < UNHIDDEN * framed - 0.5:
        # Something stands before it: what the id pass shows bounds the box, to one sample.
        points = _points_within(points, visible, visible_offset_xy, oversample)
    box = box_of_points(points)
    if (box[2:] - box[:2] < 1).any():
        return Label(category, None, None, visibility, truncated, "small")
    corners = corners_of_box(box) if upright else smallest_rectangle_inside(points, (w, h))
    return Label(category, box, corners, visibility, truncated)


def _points_within(
    points_xy: FloatArray, visible: NDArray[np.bool_], offset_xy: tuple[int, int], oversample: int
) -> FloatArray:
    """Outline points of the visible samples, none of them beyond the projected geometry."""
    i, j = np.nonzero(visible)
    corners = np.concatenate([np.stack([j + dj, i + di], axis=1) for dj in (0, 1) for di in (0, 1)])
    outline = convex_hull((corners + offset_xy) / oversample)
    box = box_of_points(points_xy)
    return np.clip(outline, box[:2], box[2:])
