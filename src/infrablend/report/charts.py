"""Charts in one style, alone or as panels: curves, histograms, bars, matrices, and estimates with intervals.

The same figures give the same bytes, as PNG or SVG. Matplotlib is loaded when the first chart is drawn.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Distinguishable for colour-blind readers.
BLUE = "#0072b2"
ORANGE = "#d55e00"
INK = "#1b1b1b"
FAINT = "#9a9a9a"
LIGHT = "#c9c9c9"
COLOURS = (BLUE, ORANGE, "#009e73", "#cc79a7", "#e69f00", "#56b4e9", INK, FAINT)


def png_bytes(figure: Figure) -> bytes:
    """Return a chart as a PNG file."""
    out = io.BytesIO()
    figure.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()


def svg_bytes(figure: Figure) -> bytes:
    """Return a chart as an SVG file, without dates and random ids."""
    from matplotlib import rc_context

    out = io.BytesIO()
    with rc_context({"svg.hashsalt": "infrablend", "svg.fonttype": "none", "path.simplify": True}):
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return out.getvalue()


def plot_text(text: str) -> str:
    """Return a text from data for a chart, where dollars would start a formula."""
    return text.replace("$", r"\$")


def panels(rows: int, columns: int, size_in: tuple[float, float], **options: Any) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels, row by row; `options` are those of `Figure.subplots`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_in, layout="constrained")
    axes = list(figure.subplots(rows, columns, squeeze=False, **options).flat)
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes


def pair_of_panels(names: Sequence[str], row_in: float) -> tuple[Figure, list[Axes], range]:
    """Return a figure, two panels that share a row per name, and the places of the rows, the first one on top."""
    figure, axes = panels(1, 2, (9, 1.0 + row_in * len(names)), sharey=True)
    rows = range(len(names))[::-1]
    axes[0].set_yticks(rows, [plot_text(n) for n in names], fontsize=8)
    return figure, axes, rows


def legend(ax: Axes, **options: Any) -> None:
    """Add the legend of a panel, if it has anything to name."""
    if ax.get_legend_handles_labels()[1]:
        ax.legend(**{"frameon": False, "fontsize": 8, **options})


def legend_above(figure: Figure, ax: Axes) -> None:
    """Name what a panel shows above the whole figure."""
    figure.legend(*ax.get_legend_handles_labels(), frameon=False, fontsize=8, loc="outside upper right", ncols=2)


def curves(ax: Axes, x: ArrayLike, lines: Mapping[str, ArrayLike], **style: Any) -> None:
    """Draw curves over the same places, each with its name and colour; unknown values, NaN, leave gaps."""
    for (name, y), colour in zip(lines.items(), cycle(COLOURS), strict=False):
        ax.plot(x, y, **{"color": colour, "lw": 1.4, "label": plot_text(name), **style})


def estimate(ax: Axes, value: float | None, interval: Sequence[float | None] | None, at: float, **style: Any) -> None:
    """Draw a value as a dot in the row `at`, with its interval as a line if that is known; nothing if it is unknown."""
    if value is None:
        return
    ax.plot(value, at, **{"color": BLUE, "marker": "o", "ms": 5, "ls": "", **style})
    if interval:
        ax.plot(np.array(interval, np.float64), [at, at], color=style.get("color", BLUE), lw=1.6)


def histogram(ax: Axes, values: Mapping[Any, Sequence[float]], bins: int = 30) -> None:
    """Draw the distributions of populations over the same bins; values beyond 1 and 99 % are in the last ones."""
    low, high = np.percentile(np.concatenate([*values.values()]), [1, 99])
    edges = np.linspace(low, max(high, low + 1e-6), bins + 1).tolist()
    for (name, of), colour in zip(values.items(), cycle(COLOURS), strict=False):
        ax.hist(np.clip(of, edges[0], edges[-1]), edges, color=colour, alpha=0.55, label=plot_text(name))


def stacked_bars(ax: Axes, names: Sequence[str], counts: Mapping[str, Sequence[int]]) -> None:
    """Draw a bar per name, from the top, of the numbers of each part, such as a split."""
    left = np.zeros(len(names))
    for (part, of), colour in zip(counts.items(), cycle(COLOURS), strict=False):
        ax.barh(range(len(names)), of, left=left, label=plot_text(part), color=colour)
        left += of
    ax.set_yticks(range(len(names)), [plot_text(n) for n in names])
    ax.invert_yaxis()


def matrix(
    ax: Axes,
    shares: NDArray[np.float64],
    texts: Sequence[str],
    rows: Sequence[str],
    columns: Sequence[str],
) -> None:
    """Draw cells that are the darker, the larger their (rows, columns) share from 0 to 1; `texts` go row by row."""
    ax.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for ((row, column), share), text in zip(np.ndenumerate(shares), texts, strict=True):
        ax.text(column, row, text, ha="center", va="center", fontsize=8, color="white" if share > 0.5 else INK)
    ax.set_xticks(range(len(columns)), [plot_text(c) for c in columns], rotation=45, ha="right", fontsize=9)
    ax.set_yticks(range(len(rows)), [plot_text(r) for r in rows], fontsize=9)
