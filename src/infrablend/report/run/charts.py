"""Charts of a run as numbers that a template draws: histograms, a map of positions and shares."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from infrablend.report.figures import compact
from infrablend.report.run.run_facts import Filters, FrameFacts

BINS = 12
MAP_WH = (8, 6)
WIDTH, HEIGHT = 420, 190
_LEFT = 16
_RIGHT = 16
_TOP = 20
_BOTTOM = 24
# Values that spread over more than this factor are shown in bins of growing width.
_WIDE = 8.0
_GROWING = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)


@dataclass(frozen=True)
class Bar:
    """A bar of a chart, or a cell of a map: its place, and the count, words and anchor of the frames behind it.

    `share` is the count as a share of the largest one; `link` is empty without frames.
    """

    x: float
    y: float
    width: float
    height: float
    count: int
    label: str
    link: str
    share: float


@dataclass(frozen=True)
class Chart:
    """A chart of bars, or a map of cells.

    Attributes:
        title: Quantity and unit.
        summary: Its most important numbers in words.
        ticks: Numbers below the axis, (place, text).
        kind: `bars` or `map`.
    """

    title: str
    summary: str
    size_wh: tuple[float, float]
    bars: tuple[Bar, ...]
    ticks: tuple[tuple[float, str], ...] = ()
    kind: str = "bars"


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
    known = [(v, k) for v, k in values if v is not None and math.isfinite(v)]
    if not known:
        return None
    numbers = sorted(v for v, _ in known)
    edges = edges or bin_edges(numbers[0], numbers[-1])
    found: list[list[int]] = [[] for _ in edges[1:]]
    for v, k in known:
        found[min(max(bisect_right(edges, v) - 1, 0), len(found) - 1)].append(k)
    most = max(len(f) for f in found)
    step = (WIDTH - _LEFT - _RIGHT) / len(found)
    room = HEIGHT - _TOP - _BOTTOM
    bars = []
    for n, frames in enumerate(found):
        label = f"{compact(edges[n])} to {compact(edges[n + 1])}{unit}"
        height = room * len(frames) / most
        name = f"{title}: {label}"
        bars.append(
            Bar(
                round(_LEFT + n * step + 1, 2), round(HEIGHT - _BOTTOM - height, 2), round(step - 2, 2),
                round(height, 2), len(frames), f"{label}: {_counted(len(frames), noun)}", filters.add(name, frames),
                round(len(frames) / most, 3),
            )
        )  # fmt: skip
    # Numbers side by side must not touch.
    every = 1 if len(edges) <= 10 else 2
    ticks = tuple((round(_LEFT + n * step, 2), compact(e)) for n, e in enumerate(edges) if n % every == 0)
    quantiles = (numbers[min(len(numbers) - 1, int(q * len(numbers)))] for q in (0.05, 0.5, 0.95))
    low, half, high = (compact(float(f"{q:.3g}")) for q in quantiles)
    summary = f"{_counted(len(numbers), noun)}; median {half}{unit}, 5 to 95 %: {low} to {high}{unit}"
    return Chart(title, summary, (WIDTH, HEIGHT), tuple(bars), ticks)


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


def position_map(frames: Sequence[FrameFacts], filters: Filters) -> Chart | None:
    """Return a map of the frame that counts the centres of the inserted objects; None without any."""
    columns, rows = MAP_WH
    cells: list[list[int]] = [[] for _ in range(columns * rows)]
    for k, frame in enumerate(frames):
        for i in frame.inserts:
            x0, y0, x1, y1 = i.box_xyxy
            column = min(max(int((x0 + x1) / 2 / frame.size_wh[0] * columns), 0), columns - 1)
            row = min(max(int((y0 + y1) / 2 / frame.size_wh[1] * rows), 0), rows - 1)
            cells[row * columns + column].append(k)
    if not (most := max(len(c) for c in cells)):
        return None
    width, height = WIDTH / columns, 46.0
    bars = []
    for n, found in enumerate(cells):
        row, column = divmod(n, columns)
        place = f"row {row + 1} of {rows} from the top, column {column + 1} of {columns} from the left"
        link = filters.add(f"Position: {place}", found)
        bars.append(
            Bar(
                round(column * width + 1, 2), row * height + 1, round(width - 2, 2), height - 2, len(found),
                f"{place}: {_counted(len(found), 'objects')}", link, round(len(found) / most, 3),
            )
        )  # fmt: skip
    summary = f"centres of the boxes; {sum(not c for c in cells)} of {len(cells)} cells are empty"
    return Chart("Position in the frame", summary, (WIDTH, rows * height), tuple(bars), kind="map")


@dataclass(frozen=True)
class Share:
    """One row of a chart of shares: label, count, anchor of its frames, and share of the largest one in percent."""

    label: str
    count: Any
    link: str
    percent: float


def shares(counts: Sequence[tuple[str, float, str, str]]) -> list[Share]:
    """Return the rows of a chart of shares from (label, value, text, link)."""
    most = max((value for _, value, _, _ in counts), default=0) or 1
    return [Share(label, text, link, round(100 * value / most, 1)) for label, value, text, link in counts]


def _counted(count: int, plural: str) -> str:
    return f"{count} {plural if count != 1 else plural.removesuffix('s')}"
