"""Charts of a run whose parts lead to frames, for the template to draw: histograms, a map of positions and shares."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from infrablend.core.frame_row import FrameRow
from infrablend.report.figures import compact
from infrablend.report.run_facts import Filters

BINS = 12
MAP_WH = (8, 6)
# Values that spread over more than this factor are shown in bins of growing width.
_WIDE = 8.0
_GROWING = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)


@dataclass(frozen=True)
class Part:
    """A bar of a chart, a cell of a map, or a row of shares: some of the frames of a run.

    Attributes:
        label: Which ones, in words.
        text: Their number, or another value, as shown.
        share: The value as a share of the largest one.
        link: Anchor of the list of these frames; empty without frames.
    """

    label: str
    text: str
    share: float
    link: str = ""


@dataclass(frozen=True)
class Chart:
    """A histogram, or a map of cells, row by row.

    Attributes:
        title: Quantity and unit.
        summary: Its most important numbers in words.
        parts: Bars or cells.
        ticks: Numbers between the bars, empty where there is no room for one.
        columns: Number of columns of a map; 0 for a histogram.
    """

    title: str
    summary: str
    parts: Sequence[Part]
    ticks: Sequence[str] = ()
    columns: int = 0


def histogram(
    values: Iterable[tuple[float | None, int]],
    title: str,
    filters: Filters,
    unit: str = "",
    noun: str = "objects",
    edges: Sequence[float] | None = None,
) -> Chart | None:
    """Return the histogram of a quantity; None if it is nowhere known.

    Args:
        values: Value of each object or frame, None where it is not known, and the number of the frame.
        title: Name of the quantity.
        filters: Lists of frames; each bar adds one.
        unit: Unit behind numbers, such as ` px`.
        noun: What has the values, in the plural.
        edges: Ends of the bins; round numbers by default.
    """
    known = sorted((v, k) for v, k in values if v is not None and math.isfinite(v))
    if not known:
        return None
    numbers = [v for v, _ in known]
    edges = edges or bin_edges(numbers[0], numbers[-1])
    found = [(f"{compact(low)} to {compact(high)}{unit}", list[int]()) for low, high in pairwise(edges)]
    for v, k in known:
        found[min(max(bisect_right(edges, v) - 1, 0), len(found) - 1)][1].append(k)
    # Numbers side by side must not touch.
    every = 1 if len(edges) <= 10 else 2
    ticks = [compact(e) if n % every == 0 else "" for n, e in enumerate(edges)]
    quantiles = (numbers[min(len(numbers) - 1, int(q * len(numbers)))] for q in (0.05, 0.5, 0.95))
    low, half, high = (compact(float(f"{q:.3g}")) for q in quantiles)
    summary = f"{_counted(len(numbers), noun)}; median {half}{unit}, 5 to 95 %: {low} to {high}{unit}"
    return Chart(title, summary, frame_counts(found, title, filters, noun), ticks)


def bin_edges(low: float, high: float) -> list[float]:
    """Return round numbers from below `low` to above `high`, at most `BINS` + 2 of them."""
    if low > 0 and high / low > _WIDE:
        exponents = range(math.floor(math.log10(low)), math.floor(math.log10(high)) + 2)
        steps = _GROWING if high / low < 100 else (1.0, 2.0, 5.0) if high / low < 10_000 else (1.0,)
        edges = [float(f"{m * 10.0**e:.6g}") for e in exponents for m in steps]
        first = max(n for n, e in enumerate(edges) if e <= low)
        last = next(n for n, e in enumerate(edges) if e > high)
        if last - first <= 2 * BINS:
            return edges[first : last + 1]
    span = max(high - low, abs(low) * 1e-3, 1e-6)
    power = 10.0 ** math.floor(math.log10(span / BINS))
    step = next(m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0, 20.0) if m * power * BINS >= span)
    start = math.floor(low / step)
    count = max(1, math.floor(high / step) - start + 1)
    return [float(f"{(start + n) * step:.12g}") for n in range(count + 1)]


def position_map(frames: Sequence[FrameRow], filters: Filters) -> Chart | None:
    """Return a map of the frame that counts the centres of the inserted objects; None without any."""
    columns, rows = MAP_WH
    cells: list[list[int]] = [[] for _ in range(columns * rows)]
    for k, frame in enumerate(frames):
        for i in frame.inserts:
            x0, y0, x1, y1 = i.box_xyxy
            column = min(max(int((x0 + x1) / 2 / frame.size_wh[0] * columns), 0), columns - 1)
            row = min(max(int((y0 + y1) / 2 / frame.size_wh[1] * rows), 0), rows - 1)
            cells[row * columns + column].append(k)
    if not any(cells):
        return None
    found = [
        (f"row {n // columns + 1} of {rows} from the top, column {n % columns + 1} of {columns} from the left", cell)
        for n, cell in enumerate(cells)
    ]
    parts = frame_counts(found, "Position", filters, "objects")
    summary = f"centres of the boxes; {sum(not c for c in cells)} of {len(cells)} cells are empty"
    return Chart("Position in the frame", summary, parts, columns=columns)


def frame_counts(found: Iterable[tuple[str, Sequence[int]]], what: str, filters: Filters, noun: str = "") -> list[Part]:
    """Return a part for each label and its frames, which may be listed several times; `noun` counts them in words."""
    counted = list(found)
    most = max((len(frames) for _, frames in counted), default=0) or 1
    parts = []
    for label, frames in counted:
        words = f"{label}: {_counted(len(frames), noun)}" if noun else label
        link = filters.add(f"{what}: {label}", frames)
        parts.append(Part(words, str(len(frames)), len(frames) / most, link))
    return parts


def _counted(count: int, plural: str) -> str:
    return f"{count} {plural if count != 1 else plural.removesuffix('s')}"
