"""COCO's matching of detections and labels, once per image for all thresholds and size ranges together.

A detection is matched to the label of its class with the largest overlap among those that no detection with a higher
score has taken. It is neutral, neither a hit nor a false positive, if it only matches a label to ignore (a region, or
an object outside the size range), or if it matches none and is itself outside the size range.

Boxes, oriented boxes and masks overlap by their intersection over their union.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as _coco

from infrablend.core.boxes import box_areas, shared_areas
from infrablend.core.rng import stream
from infrablend.detection.detections import Detections, FloatArray, Task
from infrablend.detection.truth import Case, Truth, long_sides

IOUS: FloatArray = np.linspace(0.5, 0.95, 10)
SIZE_BINS = {
    "all": (0.0, float("inf")),
    "<8": (0.0, 8.0),
    "8-16": (8.0, 16.0),
    "16-32": (16.0, 32.0),
    "32-64": (32.0, 64.0),
    "64-128": (64.0, 128.0),
    ">=128": (128.0, float("inf")),
}
"""Half-open ranges of the longer side, px. HIT-UAV's people are 10 to 30 px, its cars 20 to 80 px."""

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ClassMatches:
    """Detections of one class on all images, highest score first, and their matches.

    Axes: a size ranges (0 is all, then the bins), t thresholds, n detections, i images.

    Attributes:
        scores: (n,) scores.
        images: (n,) int32 index of the image of each detection.
        right: (a, t, n) whether the detection matches an object that counts.
        neutral: (a, t, n) whether the detection is neither a hit nor a false positive.
        objects: (a, i) int32 number of objects that count.
    """

    scores: FloatArray
    images: NDArray[np.int32]
    right: BoolArray
    neutral: BoolArray
    objects: NDArray[np.int32]


def match_all(
    case: Case,
    bins: Mapping[str, tuple[float, float]] = SIZE_BINS,
    sizes_px: Sequence[tuple[FloatArray, FloatArray]] | None = None,
    ious: FloatArray = IOUS,
) -> tuple[ClassMatches, ...]:
    """Match the detections of every class on every image, in each range of sizes.

    Args:
        case: Labels and detections.
        bins: Half-open ranges of sizes, px.
        sizes_px: Sizes of the labels and of the detections on each image; their longer sides by default.
        ious: (t,) thresholds of the overlap, ascending.
    """
    ranges = np.array(list(bins.values()), np.float64)
    classes = range(len(case.classes))
    a = len(ranges)
    t = len(ious)
    objects = np.zeros((len(classes), a, len(case.labels)), np.int32)
    none = np.zeros((a, t, 0), np.bool_)
    gathered = [[(np.zeros(0), np.zeros(0, np.int32), none, none)] for _ in classes]
    for number, (truth, found) in enumerate(zip(case.labels, case.found, strict=True)):
        of_labels, of_found = (long_sides(truth), long_sides(found)) if sizes_px is None else sizes_px[number]
        away = truth.ignore[None] | _outside(of_labels, ranges)  # (a, g)
        for c in classes:
            labels = np.flatnonzero((truth.classes == c) | (truth.classes == -1))
            objects[c, :, number] = (~away[:, labels]).sum(axis=1)
            its = np.flatnonzero(found.classes == c)
            of = found.take(its)
            if not len(of):
                continue
            part = _part(truth, labels)
            taken, neutral = match_image(overlaps(of, part, case.task), away[:, labels], part.ignore, ious)
            neutral |= ~taken & _outside(of_found[its], ranges)[:, None]
            gathered[c].append((of.scores, np.full(len(of), number, np.int32), taken, neutral))
    result = []
    for c in classes:
        scores, images, right, neutral = (np.concatenate(x, axis=-1) for x in zip(*gathered[c], strict=True))
        order = np.argsort(-scores, kind="stable")
        result.append(ClassMatches(scores[order], images[order], right[..., order], neutral[..., order], objects[c]))
    return tuple(result)


def _outside(sizes_px: FloatArray, ranges: FloatArray) -> BoolArray:
    return np.asarray((sizes_px < ranges[:, :1]) | (sizes_px >= ranges[:, 1:]))


def match_image(
    overlap: FloatArray, away: BoolArray, region: BoolArray, ious: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """Match one image's detections of one class.

    Args:
        overlap: (n, g) overlaps, with detections in descending order of score.
        away: (a, g) labels that do not count in a size range.
        region: (g,) labels that any number of detections may match.
        ious: (t,) thresholds of the overlap, ascending.

    Returns:
        The (a, t, n) `right` and (a, t, n) `neutral` of `ClassMatches`.
    """
    n, g = overlap.shape
    a = len(away)
    t = len(ious)
    right = np.zeros((a, t, n), np.bool_)
    neutral = np.zeros((a, t, n), np.bool_)
    if not n or not g:
        return right, neutral
    least = np.minimum(ious, 1 - 1e-10)
    taken = np.zeros((a, t, g), np.bool_)
    at_a, at_t = np.arange(a)[:, None], np.arange(t)[None]
    for d in np.flatnonzero(overlap.max(axis=1) >= least[0]):
        near = np.flatnonzero(overlap[d] >= least[0])[::-1]  # backwards: of equal overlaps COCO takes the last
        value = overlap[d, near]
        free = (~taken[:, :, near] | region[near]) & (value >= least[:, None])
        # A label that counts takes precedence over one that does not, whatever their overlaps.
        rank = np.where(free, value + 2.0 * ~away[:, None, near], -1.0)
        best = rank.argmax(axis=2)
        hit = rank[at_a, at_t, best] > 0
        label = near[best]
        counts = hit & ~away[at_a, label]
        right[:, :, d] = counts
        neutral[:, :, d] = hit & ~counts
        taken[at_a, at_t, label] |= hit
    return right, neutral


def _part(truth: Truth, which: NDArray[np.intp]) -> Truth:
    return replace(
        truth,
        boxes_xyxy=truth.boxes_xyxy[which],
        classes=truth.classes[which],
        ignore=truth.ignore[which],
        corners_xy=None if truth.corners_xy is None else truth.corners_xy[which],
        masks=None if truth.masks is None else tuple(truth.masks[int(k)] for k in which),
    )


def overlaps(found: Detections, truth: Truth, task: Task) -> FloatArray:
    """Return the (n, g) intersection over union; for regions to ignore, the share of the detection inside."""
    if not len(found) or not len(truth.boxes_xyxy):
        return np.zeros((len(found), len(truth.boxes_xyxy)))
    if task == "segment":
        assert found.masks is not None and truth.masks is not None
        d = [m.to_coco() for m in found.masks]
        g = [m.to_coco() for m in truth.masks]
        return np.asarray(_coco.iou(d, g, truth.ignore.astype(np.uint8).tolist()), np.float64)
    if task == "obb":
        assert found.corners_xy is not None and truth.corners_xy is not None
        both = quad_intersections(found.corners_xy, truth.corners_xy)
        of_found = polygon_areas(found.corners_xy)
        of_truth = polygon_areas(truth.corners_xy)
    else:
        both = shared_areas(found.boxes_xyxy, truth.boxes_xyxy)
        of_found = box_areas(found.boxes_xyxy)
        of_truth = box_areas(truth.boxes_xyxy)
    whole = np.where(truth.ignore[None], of_found[:, None], of_found[:, None] + of_truth[None] - both)
    return np.asarray(np.divide(both, whole, out=np.zeros_like(both), where=whole > 0))


def polygon_areas(polygons: FloatArray) -> FloatArray:
    """Return the (n,) areas of convex polygons (n, k, 2), clockwise."""
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
        polygon = a[rows]
        other = b[columns]
        for k in range(4):
            polygon = _clip_by_line(polygon, other[:, k], other[:, (k + 1) % 4])
        area[rows, columns] = polygon_areas(polygon)
    return area


def _clip_by_line(polygons: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the parts (n, k + 1, 2) of convex polygons (n, k, 2) right of one line each; unused corners repeat."""
    edge = (end - start)[:, None]
    off = polygons - start[:, None]
    side = edge[..., 0] * off[..., 1] - edge[..., 1] * off[..., 0]
    following = np.roll(polygons, -1, axis=1)
    side_after = np.roll(side, -1, axis=1)
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


LEVEL = 0.95


def draw_images(groups: Sequence[str], draws: int, seed: int) -> NDArray[np.int32]:
    """Return the (draws, i) number of times each image is drawn.

    Each draw takes as many groups as there are, with all their images.
    """
    names, number = np.unique(np.array(groups, dtype=np.str_), return_inverse=True)
    rng = stream(seed, "bootstrap", draws, len(names))
    drawn = rng.integers(0, len(names), (draws, len(names)))
    counts = np.zeros((draws, len(names)), np.int32)
    np.add.at(counts, (np.arange(draws)[:, None], drawn), 1)
    return np.asarray(counts[:, number], np.int32)


def has_several_groups(images: NDArray[np.bool_], groups: Sequence[str]) -> bool:
    """Whether the images chosen by (i,) are of two groups at least: drawing from one gives the same again and again."""
    return len({groups[k] for k in np.flatnonzero(images).tolist()}) > 1


def interval(values: FloatArray) -> list[float] | None:
    """Return the ends of the middle 95 % of drawn values without NaN; None if no value is left."""
    known = values[~np.isnan(values)]
    if not len(known):
        return None
    low, high = np.quantile(known, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return [float(low), float(high)]
