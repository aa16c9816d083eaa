"""A map of a flight, drawn without a network: how often ground was photographed, footprints, and what was found."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.ground_position import Ellipse
from infrablend.core.mesh import FloatArray
from infrablend.report.charts import COLOURS, FAINT, INK, legend_above, panels, plot_text, svg_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Cells along the longer side of the map, in which pictures are counted.
_CELLS = 400
# Share of the picture's side that the scale bar takes up at most.
_BAR = 0.3


def photographed(
    footprints: Sequence[FloatArray], low: FloatArray, cell_m: float, shape_hw: tuple[int, int]
) -> NDArray[np.int32]:
    """Return (h, w) how many footprints cover the middle of each cell; the first row is in the south.

    Args:
        footprints: (k, 2) corners of each, metres east and north.
        low: (2,) south-western corner of the cells.
        cell_m: Side of a cell.
        shape_hw: Number of cells.
    """
    counts = np.zeros(shape_hw, np.int32)
    fraction = 8
    for corners in footprints:
        seen = np.zeros(shape_hw, np.uint8)
        # OpenCV has the middle of the first cell at 0.
        points = np.round(((corners - low) / cell_m - 0.5) * 2**fraction).astype(np.int32)
        cv2.fillPoly(seen, [points], 1, shift=fraction)
        counts += seen
    return counts


def draw_flight(
    footprints: Sequence[FloatArray], found: Mapping[str, Sequence[tuple[FloatArray, Ellipse]]], title: str
) -> bytes:
    """Return a map as an SVG file, north up, with a scale bar.

    Args:
        footprints: (k, 2) corners of the ground in each picture, metres east and north.
        found: By class, the (2,) place of each detection and its ellipse.
        title: What the map shows.
    """
    from matplotlib.collections import EllipseCollection, PolyCollection

    everything = [(place, e.major_m) for places in found.values() for place, e in places]
    reach = [place + e * sign for place, e in everything for sign in (-1, 1)]
    corners = np.concatenate([*footprints, *(r[None] for r in reach)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.02 * float((high - low).max())
    low, high = low - margin, high + margin
    cell_m = float((high - low).max()) / _CELLS
    width, height = np.ceil((high - low) / cell_m).astype(int).tolist()
    counts = photographed(footprints, low, cell_m, (height, width))
    figure, (ax,) = panels(1, 1, (8.0, min(10.0, max(4.0, 1.0 + 5.8 * height / width))))
    extent = (low[0], low[0] + width * cell_m, low[1], low[1] + height * cell_m)
    shown = ax.imshow(np.where(counts, counts, np.nan), extent=extent, origin="lower", cmap="Blues", vmin=0,
                      interpolation="nearest")  # fmt: skip
    figure.colorbar(shown, ax=ax, shrink=0.6, label="pictures that show the ground")
    ax.add_collection(PolyCollection(list(footprints), facecolors="none", edgecolors=FAINT, linewidths=0.5))
    for (name, places), colour in zip(found.items(), cycle(COLOURS[1:]), strict=False):
        xy = np.array([place for place, _ in places])
        axes = np.array([(2 * e.major_m, 2 * e.minor_m, 90.0 - e.azimuth_deg) for _, e in places]).T
        ax.scatter(xy[:, 0], xy[:, 1], s=12, color=colour, label=f"{plot_text(name)} ({len(places)})", zorder=3)
        ax.add_collection(
            EllipseCollection(*axes, units="xy", offsets=xy, transOffset=ax.transData, facecolors="none",
                              edgecolors=colour, linewidths=0.6)
        )  # fmt: skip
    ax.set_aspect("equal")
    ax.set_xlim(extent[:2])
    ax.set_ylim(extent[2:])
    ax.set_title(plot_text(title), fontsize=10, loc="left")
    ax.set_xlabel("m east")
    ax.set_ylabel("m north")
    _add_scale_and_north(ax, extent)
    legend_above(figure, ax)
    return svg_bytes(figure)


def draw_cells(middles_m: FloatArray, values: FloatArray, cell_m: float, name: str, title: str) -> bytes:
    """Return a map of values between 0 and 1 by cell as an SVG file, north up, with a scale bar; NaN is left blank.

    Args:
        middles_m: (n, 2) middles of the cells, metres east and north, on a grid.
        values: (n,) values.
        cell_m: Side of a cell.
        name: What the values are.
        title: What the map shows.
    """
    low = middles_m.min(axis=0) - cell_m / 2
    columns, rows = np.rint((middles_m - low) / cell_m - 0.5).astype(int).T
    grid = np.full((rows.max() + 1, columns.max() + 1), np.nan)
    grid[rows, columns] = values
    height, width = grid.shape
    figure, (ax,) = panels(1, 1, (8.0, min(10.0, max(4.0, 1.2 + 7.0 * height / width))))
    extent = (low[0], low[0] + width * cell_m, low[1], low[1] + height * cell_m)
    shown = ax.imshow(grid, extent=extent, origin="lower", cmap="RdYlGn", vmin=0, vmax=1, interpolation="nearest")
    figure.colorbar(shown, ax=ax, shrink=0.6, label=name)
    ax.set_aspect("equal")
    ax.set_title(plot_text(title), fontsize=10, loc="left")
    ax.set_xlabel("m east")
    ax.set_ylabel("m north")
    _add_scale_and_north(ax, extent)
    return svg_bytes(figure)


def round_length_m(most_m: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20, 50 ... metres that is not longer."""
    power = 10.0 ** math.floor(math.log10(most_m))
    return max(f * power for f in (1.0, 2.0, 5.0) if f * power <= most_m * (1 + 1e-9))


def _add_scale_and_north(ax: Axes, extent: tuple[float, float, float, float]) -> None:
    """Draw a scale bar at the lower left and an arrow to the north at the upper right."""
    west, east, south, north = extent
    length = round_length_m(_BAR * (east - west))
    x, y = west + 0.03 * (east - west), south + 0.03 * (north - south)
    ax.plot([x, x + length], [y, y], color=INK, lw=3, solid_capstyle="butt")
    ax.annotate(f"{length:g} m", (x, y), (0, 4), textcoords="offset points", fontsize=8)
    arrow = {"arrowstyle": "-|>", "color": INK}
    ax.annotate("N", (0.97, 0.98), (0.97, 0.90), "axes fraction", "axes fraction", arrow, fontsize=9, ha="center")
