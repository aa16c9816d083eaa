"""Check the boxes of annotation files against their frame, and describe oriented boxes by five numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_of_points, corners_of_cxcywha, cxcywha_of_corners, polygon_area
from infrablend.errors import Problem

# Oriented boxes may overhang the frame by this much without a warning: HIT-UAV's own reach 0.5 px.
OVERHANG_PX = 0.5


def is_near(numbers: Sequence[float]) -> bool:
    """Return whether pixel coordinates are finite and below 1e6; larger ones overflow in products and casts."""
    return all(math.isfinite(v) and abs(v) <= 1e6 for v in numbers)


def check_box(
    xyxy: Sequence[float], size_wh: tuple[int, int] | None, where: str
) -> tuple[NDArray[np.float64] | None, Problem | None]:
    """Check one axis-aligned box against its frame.

    Returns:
        The box, unchanged or clipped to the frame, or None if it has to be dropped; and the problem, if any:
        `box-not-finite`, `box-empty`, `box-outside` (errors, dropped), `box-clipped` (warning, kept).
    """
    x0, y0, x1, y1 = xyxy
    if not is_near(xyxy):
        expected = "finite numbers of pixels"
        return None, Problem(where, "box-not-finite", f"box {_show(xyxy)}", expected, "correct the annotation")
    if x1 <= x0 or y1 <= y0:
        found = f"box {_show(xyxy)} of size {x1 - x0:g}x{y1 - y0:g}"
        return None, Problem(where, "box-empty", found, "a width and height above 0", "correct the annotation")
    if size_wh is None:
        return np.array((x0, y0, x1, y1), np.float64), None
    w, h = size_wh
    if x0 >= 0 and y0 >= 0 and x1 <= w and y1 <= h:
        return np.array((x0, y0, x1, y1), np.float64), None
    if x0 >= w or y0 >= h or x1 <= 0 or y1 <= 0:
        found = f"box {_show(xyxy)} outside the frame"
        return None, Problem(where, "box-outside", found, f"a box inside {w}x{h} px", "correct the annotation")
    box = np.array((max(x0, 0.0), max(y0, 0.0), min(x1, float(w)), min(y1, float(h))), np.float64)
    found = f"box {_show(xyxy)} reaches out of the frame, clipped to {_show(box.tolist())}"
    return box, Problem(where, "box-clipped", found, f"a box inside {w}x{h} px", severity="warning")


def snap(value: float, size: int, tolerance: float = 1e-6) -> float:
    """Return `value`, or the frame's edge (0 or `size`) if it is outside by less than `tolerance`, due to rounding."""
    if -tolerance < value < 0:
        return 0.0
    return float(size) if size < value < size + tolerance else value


def snap_edges(xyxy: Sequence[float], size_wh: tuple[int, int] | None) -> Sequence[float]:
    """Return the edges of a box, each moved by `snap` onto the edge of a frame of known size."""
    return xyxy if size_wh is None else [snap(v, size_wh[k % 2]) for k, v in enumerate(xyxy)]


def edges_of_xywh(xywh: Sequence[float], size_wh: tuple[int, int] | None) -> tuple[float, float, float, float]:
    """Return the edges of a box `x, y, width, height`; `snap` moves those that the sums put outside."""
    x, y, w, h = xywh
    _, _, x1, y1 = snap_edges((x, y, x + w, y + h), size_wh)
    return x, y, x1, y1


def edges_of_shares(cxcywh: Sequence[float], size_wh: tuple[int, int]) -> tuple[float, float, float, float]:
    """Return the edges, px, of a box `cx, cy, width, height` in shares of the frame."""
    cx, cy, w, h = (v * size_wh[k % 2] for k, v in enumerate(cxcywh))
    return cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2


def turned_box(
    cxcywha: Sequence[float], size_wh: tuple[int, int] | None
) -> tuple[NDArray[np.float64], tuple[float, ...]]:
    """Return the clockwise corners of an oriented box, and its edges, cut to the frame if they overhang a little.

    A negative width or height mirrors the box.
    """
    corners = clockwise_corners(corners_of_cxcywha(np.array([cxcywha], np.float64))[0])
    edges = tuple(float(v) for v in box_of_points(corners))
    if size_wh is not None and 0 < overhang_px(corners, size_wh) <= OVERHANG_PX:
        edges = tuple(min(max(v, 0.0), float(size_wh[k % 2])) for k, v in enumerate(edges))
    return corners, edges


def clockwise_corners(corners_xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return four corners clockwise on screen, from the first one on; some tools write them the other way round."""
    if is_near(corners_xy.reshape(-1).tolist()) and polygon_area(corners_xy) < 0:
        return corners_xy[[0, 3, 2, 1]]
    return corners_xy


def _show(numbers: Sequence[float]) -> str:
    return "[" + ", ".join(f"{v:g}" for v in numbers) + "]"


def overhang_px(points_xy: NDArray[np.float64], size_wh: tuple[int, int]) -> float:
    """Return the distance of the outermost of (n, 2) points from the frame; 0 if all are inside."""
    out = np.maximum(-points_xy, points_xy - np.array(size_wh, np.float64))
    return float(max(out.max(), 0.0))


def obb_from_corners(corners_xy: NDArray[np.float64]) -> tuple[float, float, float, float, float]:
    """Return `cx, cy, w, h, angle` of four corners in clockwise order on screen; angle in radians, in [0, pi).

    A box turned by pi is the same box: its corners come back in the same order, starting at the opposite one.
    """
    cx, cy, w, h, angle = (float(v) for v in cxcywha_of_corners(corners_xy))
    angle %= math.pi
    # A value just below 0 becomes one just below pi, which rounds to pi: that is 0.
    return cx, cy, w, h, 0.0 if math.pi - angle < 1e-12 else angle


def is_rectangle(corners_xy: NDArray[np.float64], obb: Sequence[float]) -> bool:
    """Return whether four corners are those of their `obb_from_corners`, to a thousandth of a pixel."""
    made = corners_of_cxcywha(np.array([obb], np.float64))[0]
    return min(float(np.abs(np.roll(made, k, axis=0) - corners_xy).max()) for k in (0, 2)) <= 1e-3
