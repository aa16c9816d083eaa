"""Overlap of detections and labels: boxes, oriented boxes, masks."""

from __future__ import annotations

from typing import Any

import numpy as np
from pycocotools import mask as _coco

from infrablend.evaluation.detections import Detections, FloatArray, Task
from infrablend.evaluation.truth import Truth


def overlaps(found: Detections, truth: Truth, task: Task) -> FloatArray:
    """Return the (n, g) intersection over union; for regions to ignore, the share of the detection inside."""
    if not len(found) or not len(truth.boxes_xyxy):
        return np.zeros((len(found), len(truth.boxes_xyxy)))
    if task == "segment":
        assert found.masks is not None and truth.masks is not None
        d, g = [m.to_coco() for m in found.masks], [m.to_coco() for m in truth.masks]
        return np.asarray(_coco.iou(d, g, truth.ignore.astype(np.uint8).tolist()), np.float64)
    if task == "obb":
        assert found.corners_xy is not None and truth.corners_xy is not None
        both = quad_intersections(found.corners_xy, truth.corners_xy)
        of_found, of_truth = quad_areas(found.corners_xy), quad_areas(truth.corners_xy)
    else:
        low = np.maximum(found.boxes_xyxy[:, None, :2], truth.boxes_xyxy[None, :, :2])
        high = np.minimum(found.boxes_xyxy[:, None, 2:], truth.boxes_xyxy[None, :, 2:])
        both = np.prod(np.maximum(high - low, 0.0), axis=-1)
        of_found, of_truth = _areas(found.boxes_xyxy), _areas(truth.boxes_xyxy)
    whole = np.where(truth.ignore[None], of_found[:, None], of_found[:, None] + of_truth[None] - both)
    return np.asarray(np.divide(both, whole, out=np.zeros_like(both), where=whole > 0))


def _areas(boxes_xyxy: FloatArray) -> FloatArray:
    return np.asarray(np.prod(np.maximum(boxes_xyxy[:, 2:] - boxes_xyxy[:, :2], 0.0), axis=-1))


def quad_areas(corners_xy: FloatArray) -> FloatArray:
    """Return the (n,) areas of convex quadrilaterals (n, 4, 2), clockwise."""
    return _shoelace(corners_xy)


def _shoelace(polygons: FloatArray) -> FloatArray:
    p = polygons - polygons[:, :1]
    q = np.roll(p, -1, axis=1)
    return np.asarray(np.maximum(0.5 * (p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]).sum(axis=1), 0.0))


def quad_intersections(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the exact (n, m) shared areas of convex quadrilaterals (n, 4, 2) and (m, 4, 2), both clockwise.

    Sutherland-Hodgman clipping of all pairs whose bounds meet, at once. `core.boxes.clip_convex` clips one pair of
    polygons and returns exactly the corners that remain, which labels need. Here an evaluation compares thousands of
    pairs and only needs areas, so polygons have a fixed number of corners, some repeated; pair by pair it takes 25
    times as long. A test holds both to the same areas within 1e-9.
    """
    meet = (a.min(axis=1)[:, None] < b.max(axis=1)[None]) & (a.max(axis=1)[:, None] > b.min(axis=1)[None])
    rows, columns = np.nonzero(meet.all(axis=-1))
    area = np.zeros((len(a), len(b)))
    if len(rows):
        polygon, other = a[rows], b[columns]
        for k in range(4):
            polygon = _clip_by_line(polygon, other[:, k], other[:, (k + 1) % 4])
        area[rows, columns] = _shoelace(polygon)
    return area


def _clip_by_line(polygons: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the parts (n, k + 1, 2) of convex polygons (n, k, 2) right of one line each; unused corners repeat."""
    edge = (end - start)[:, None]
    off = polygons - start[:, None]
    side = edge[..., 0] * off[..., 1] - edge[..., 1] * off[..., 0]
    following, side_after = np.roll(polygons, -1, axis=1), np.roll(side, -1, axis=1)
    crossing = side * side_after < 0
    share = np.divide(side, side - side_after, out=np.zeros_like(side), where=crossing)
    cut = polygons + share[..., None] * (following - polygons)
    n, k = side.shape
    # Each corner is followed by the point where the edge that leaves it crosses the line.
    points = np.stack([polygons, cut], axis=2).reshape(n, 2 * k, 2)
    used = np.stack([side >= 0, crossing], axis=2).reshape(n, 2 * k)
    order = np.argsort(~used, axis=1, kind="stable")[:, : k + 1]
    count = used.sum(axis=1)
    place = np.minimum(np.arange(k + 1)[None], np.maximum(count - 1, 0)[:, None])
    kept: Any = np.take_along_axis(order, place, axis=1)
    parts = np.take_along_axis(points, kept[..., None], axis=1)
    parts[count == 0] = 0.0
    return np.asarray(parts)
