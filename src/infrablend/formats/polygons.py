"""A mask as one polygon, for formats that know nothing else: parts and holes joined by bridges of zero width.

YOLO-seg holds one closed polygon per object. Ultralytics rasterises it by cutting the coordinates to integers and
calling `cv2.fillPoly`, which fills by the even-odd rule and always paints the outline. The polygon made here runs along
the outer edges of the mask's pixels, `INSET_PX` inside them: cut to integers its corners are the pixels themselves,
so the raster is the mask, and its bounding box is the mask's box to `INSET_PX`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_of_points
from infrablend.core.rle_masks import Mask
from infrablend.formats.box_checks import is_near, snap_edges

# Far above the loss by ten decimals and float32 (4e-5 px), far below anything visible.
INSET_PX = 0.01
# Ultralytics resamples polygons of 1,000 corners or more, which cuts bridges.
MAX_CORNERS = 990
# Number of parts and holes kept, largest first; the rest is noise of single pixels, counted in the raster difference.
MAX_RINGS = 64


@dataclass(frozen=True, eq=False)
class Outline:
    """A mask's polygon, (n, 2) float64 px, and the number of pixels by which its raster differs from the mask."""

    polygon_xy: NDArray[np.float64]
    raster_difference_px: int


def rasterise(polygon_xy: NDArray[np.float64], size_wh: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the (h, w) mask of a polygon (n, 2) in px, as rasterised by Ultralytics."""
    canvas = np.zeros((size_wh[1], size_wh[0]), np.uint8)
    cv2.fillPoly(canvas, [polygon_xy.astype(np.int32)], 1)
    return canvas.astype(np.bool_)


def ellipse(cxcywha: Sequence[float], size_wh: tuple[int, int]) -> tuple[tuple[float, ...], Mask | None]:
    """Return the edges of an ellipse in an oriented box, to 0.004 %, and its pixels in a frame; None without pixels.

    Raises:
        ValueError: It reaches far out of the frame.
    """
    if not is_near(cxcywha):
        raise ValueError("an ellipse without finite numbers")
    cx, cy, w, h, angle = cxcywha
    turn = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    cos = np.cos(angle)
    sin = np.sin(angle)
    x, y = w / 2 * np.cos(turn), h / 2 * np.sin(turn)
    ring = np.stack([cx + x * cos - y * sin, cy + x * sin + y * cos], axis=1)
    mask = Mask.from_rings([ring.ravel().tolist()], (size_wh[1], size_wh[0]))
    return tuple(snap_edges(box_of_points(ring).tolist(), size_wh)), mask if mask.area_px else None


def outline(mask: Mask) -> Outline:
    """Return one polygon for a mask with any number of parts and holes, with at most `MAX_CORNERS` corners if possible.

    An empty mask gives an empty polygon. Bridges between parts paint the pixels under them, and simplification to the
    limit moves edges: `raster_difference_px` counts both.
    """
    pixels = mask.to_array()
    if not pixels.any():
        return Outline(np.zeros((0, 2)), 0)
    rows, columns = np.flatnonzero(pixels.any(axis=1)), np.flatnonzero(pixels.any(axis=0))
    y0, x0 = int(rows[0]), int(columns[0])
    part = pixels[y0 : rows[-1] + 1, x0 : columns[-1] + 1].astype(np.uint8)
    contours, tree = cv2.findContours(part, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    polygon = np.zeros((0, 2))
    # First without any slanting edge: Ultralytics adds points on every edge before it cuts them to integers, and those
    # between two pixels' edges would fall into a third one.
    for tolerance_px in (None, 0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0):
        polygon = _join(contours, tree[0], tolerance_px, part)
        if len(polygon) <= MAX_CORNERS:
            break
    polygon = polygon + np.array([x0, y0], np.float64)
    # The bounding box of the polygon is known, so only this part of the frame can differ.
    raster = rasterise(polygon - np.array([x0, y0]), (part.shape[1], part.shape[0]))
    return Outline(polygon, int((raster != part.astype(np.bool_)).sum()))


def _join(
    contours: Sequence[NDArray[np.int32]],
    tree: NDArray[np.int32],
    tolerance_px: float | None,
    part: NDArray[np.uint8],
) -> NDArray[np.float64]:
    """Join all rings to one polygon: holes to the ring around them, then parts to the largest, nearest first.

    Without a tolerance, not even diagonal steps are cut short.
    """
    if tolerance_px is None:
        rings = [_edge_ring(_stepped(c[:, 0, :], part), True) for c in contours]
    else:
        rings = [_edge_ring(_simplified(c[:, 0, :], tolerance_px), False) for c in contours]
    largest = sorted(range(len(rings)), key=lambda k: (-len(contours[k]), k))[:MAX_RINGS]
    parts = []
    for k in largest:
        if tree[k][3] < 0:
            holes = [rings[j] for j in sorted(largest) if tree[j][3] == k]
            parts.append(_bridge([rings[k], *holes]))
    return _bridge(parts)


def _bridge(rings: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Join several rings to one by a minimum spanning tree of bridges between nearest corners, from the first."""
    best = {k: (*_nearest(rings[0], rings[k]), 0) for k in range(1, len(rings))}
    children: dict[tuple[int, int], list[tuple[int, int]]] = {}
    while best:
        k = min(best, key=lambda key: (best[key][0], key))
        _, i, j, parent = best.pop(k)
        children.setdefault((parent, i), []).append((k, j))
        for other, held in best.items():
            found = _nearest(rings[k], rings[other])
            if found[0] < held[0]:
                best[other] = (*found, k)

    def walk(k: int, start: int, closed: bool) -> list[tuple[float, float]]:
        """Go once around ring k from a corner and back to it, crossing every bridge on the way."""
        n = len(rings[k])
        points: list[tuple[float, float]] = []
        for i in [(start + s) % n for s in range(n)]:
            corner = (float(rings[k][i][0]), float(rings[k][i][1]))
            points.append(corner)
            for child, j in children.get((k, i), []):
                points += [*walk(child, j, True), corner]
        return points + points[:1] if closed else points

    return np.array(walk(0, 0, False))


def _nearest(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[float, int, int]:
    """Return the squared distance, index in a and index in b of the nearest pair of corners."""
    distance = ((a[:, None, :] - b[None, :, :]) ** 2).sum(axis=2)
    i, j = np.unravel_index(int(distance.argmin()), distance.shape)
    return float(distance[i, j]), int(i), int(j)


def _simplified(ring: NDArray[np.int32], tolerance_px: float) -> NDArray[np.int32]:
    if tolerance_px == 0.0 or len(ring) < 4:
        return ring
    return np.asarray(cv2.approxPolyDP(ring, tolerance_px, True)[:, 0, :])


def _stepped(ring: NDArray[np.int32], part: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Replace each diagonal step of a contour by two straight ones over the inner pixel, if the mask contains it."""
    pixels = [(int(x), int(y)) for x, y in ring[::-1]]
    walked: list[tuple[int, int]] = []
    for (x, y), (nx, ny) in zip(pixels, pixels[1:] + pixels[:1], strict=True):
        walked.append((x, y))
        if nx != x and ny != y:
            dx, dy = _COMPASS[(_COMPASS.index((nx - x, ny - y)) + 1) % 8]  # to the right hand, where the mask lies
            if part[y + dy, x + dx]:
                walked.append((x + dx, y + dy))
    return np.array(walked[::-1], np.int32)


def _edge_ring(ring: NDArray[np.int32], stairs: bool) -> NDArray[np.float64]:
    """Replace the pixels of one contour (n, 2) by points on their outer edges, `INSET_PX` inside.

    cv2 runs around parts counter-clockwise and around holes clockwise, both with the mask on the left; reversed, the
    mask lies on the right hand of every step and the outer edge on the left. A diagonal step cuts from the middle of
    one pixel's edge to the middle of the next one's, which keeps the area; with `stairs` it runs along both edges.
    """
    pixels = ring[::-1].astype(np.float64)
    if len(pixels) == 1:
        return _inside(np.repeat(pixels, 4, axis=0), np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]))
    # Signs alone: steps may be long after simplification.
    step = np.sign(np.roll(pixels, -1, axis=0) - pixels).astype(int)
    out = _EIGHTH[step[:, 1] + 1, step[:, 0] + 1]
    turn, number = np.unique(np.stack([np.roll(out, 1), out], axis=1), axis=0, return_inverse=True)
    sides = [_sides(eighth_in, eighth_out, stairs) for eighth_in, eighth_out in turn.tolist()]
    count = np.array([len(s) for s in sides])
    begin = (np.cumsum(count) - count)[number]
    count = count[number]
    along = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    side = np.array([xy for s in sides for xy in s])[np.repeat(begin, count) + along]
    pixel = np.repeat(pixels, count, axis=0)
    points = np.concatenate([pixel, _inside(pixel, side)], axis=1)
    bends = _bends(np.roll(points, 1, axis=0).T, points.T, np.roll(points, -1, axis=0).T)
    return np.asarray((points[bends] if bends.any() else points)[:, 2:])


_COMPASS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))  # clockwise on screen
# Number of a step on the compass, by its row and column, from -1.
_EIGHTH = np.array([[5, 6, 7], [4, -1, 0], [3, 2, 1]])


@lru_cache
def _sides(eighth_in: int, eighth_out: int, stairs: bool) -> Sequence[tuple[int, int]]:
    """Return the sides and corners of a pixel along its outer edge, between two steps of a contour, clockwise.

    Steps are numbers on the compass.
    """
    diagonal_in = eighth_in % 2
    diagonal_out = eighth_out % 2
    turn = (eighth_out - eighth_in + 3) % 8 - 3  # eighths to the right, -3 to 4; a reversal goes around the outside
    # A diagonal step is a left turn along the edges of its two pixels: it ends an eighth to the left of itself and
    # begins an eighth to the right.
    side = (eighth_in - diagonal_in - 2) % 8
    quarters = (turn + diagonal_in + diagonal_out) // 2
    if quarters < 0:  # an inner corner
        return [_COMPASS[(side - 1) % 8]]
    if stairs:  # from the corner shared with the pixel before to the one shared with the next
        return [_COMPASS[(side + e) % 8] for e in range(-diagonal_in, 2 * quarters + 1 + diagonal_out)]
    # Corners of the pixel stay where the contour really turns; on a slanting line they would be teeth.
    with_corners = turn >= 3 or not (diagonal_in or diagonal_out)
    return [_COMPASS[(side + e) % 8] for e in range(0, 2 * quarters + 1, 1 if with_corners else 2)]


def _inside(pixels: NDArray[np.float64], sides: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
    """Return the points of pixels (N, 2) nearest to a side or corner, `INSET_PX` inside; the centre where side is 0."""
    return np.asarray(pixels + 0.5 + (0.5 - INSET_PX) * sides)


def _bends(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mark where the contour turns at b: False if b is on the way from a to c, as a point and as a pixel.

    All are (4, N): column and row of the pixel, x and y of the point.
    """
    pixel = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
    exact = (b[2] - a[2]) * (c[3] - b[3]) - (b[3] - a[3]) * (c[2] - b[2])
    onward = (b[2] - a[2]) * (c[2] - b[2]) + (b[3] - a[3]) * (c[3] - b[3])
    return np.asarray((pixel != 0) | (np.abs(exact) > 1e-9) | (onward < 0))
