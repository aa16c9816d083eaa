"""Charts of a results page, as SVG: the same results give the same bytes. No pictures of data."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from infrablend.lab.evaluation.evaluation_record import Curves
from infrablend.lab.experiments.result_record import ComparisonFigures, ExperimentRecord, TableRow
from infrablend.lab.pages.experiment_page import METRICS, class_order
from infrablend.report.charts import (
    BLUE,
    FAINT,
    INK,
    ORANGE,
    curves,
    estimate,
    legend,
    legend_above,
    pair_of_panels,
    panels,
    plot_text,
    svg_bytes,
)

COLUMNS = 4  # panels of curves beside each other
_SHOWN = ("map50", "map50_95")


CHARTS = ("bars", "differences", "pr")
"""Names of all charts of a page."""


def draw_plots(facts: ExperimentRecord) -> list[tuple[str, str, bytes]]:
    """Return (name, title, SVG) of every chart that there are figures for."""
    rows = [(t["title"], r) for t in facts["tables"] for r in t["rows"] if r["ours"] is not None]
    found = {n: e["curves"] for n, e in facts["evaluations"].items() if e.get("curves")}
    charts: tuple[tuple[str, str, Callable[[Any], bytes], Any], ...] = (
        ("bars", "Ours with 95 % intervals, the paper's figures as crosses", _bars, rows),
        ("differences", "Paired differences with 95 % intervals", _forest, facts["comparisons"]),
        ("pr", "Precision over recall at IoU 0.5", _curves, found),
    )
    return [(name, title, draw(figures)) for name, title, draw, figures in charts if figures]


def _bars(rows: Sequence[tuple[str, TableRow]]) -> bytes:
    several = len({t for t, _ in rows}) > 1
    names = [f"{r['evaluation']}: {r['title']}" if several else r["title"] for _, r in rows]
    figure, axes, places = pair_of_panels(names, 0.34)
    for ax, metric in zip(axes, _SHOWN, strict=True):
        for at, (_, r) in zip(places, rows, strict=True):
            ours: Mapping[str, Any] = r["ours"] or {}
            ci = (ours.get("ci") or {}).get(metric)
            paper = r["paper"][metric]
            if ours[metric] is not None:
                ax.barh(at, ours[metric], height=0.6, color=BLUE, alpha=0.75)
            if ci:
                ax.plot(ci, [at, at], color=INK, lw=1.4)
            if paper is not None:
                ax.plot(paper, at, marker="x", color=ORANGE, ms=7, mew=1.8, ls="")
        ax.set(xlim=(0, 1.02), xlabel=METRICS[metric])
    if any(r["paper"][metric] is not None for _, r in rows for metric in _SHOWN):
        axes[1].plot([], [], marker="x", color=ORANGE, ls="", mew=1.8, label="paper")
        axes[1].barh([], [], color=BLUE, alpha=0.75, label="ours")
        legend_above(figure, axes[1])
    return svg_bytes(figure)


def _forest(comparisons: Mapping[str, ComparisonFigures]) -> bytes:
    rows = [
        (f"{c['title']}, {name}", c["classes"][name])
        for c in comparisons.values()
        for name in sorted(c["classes"], key=class_order)
    ]
    figure, axes, places = pair_of_panels([name for name, _ in rows], 0.3)
    for ax, metric in zip(axes, _SHOWN, strict=True):
        ax.axvline(0, color=FAINT, lw=0.8)
        for at, (_, of) in zip(places, rows, strict=True):
            if (d := of.get(metric)) is not None:
                estimate(ax, d["difference"], d.get("ci"), at)
        ax.set(xlabel=f"difference of {METRICS[metric]}")
        ax.locator_params(axis="x", nbins=5)
    return svg_bytes(figure)


def _curves(found: Mapping[str, Curves]) -> bytes:
    columns = min(len(found), COLUMNS)
    rows = math.ceil(len(found) / columns)
    figure, axes = panels(rows, columns, (3.4 * columns, 3.2 * rows))
    for ax in axes[len(found) :]:
        ax.remove()
    for ax, (name, of) in zip(axes, found.items(), strict=False):
        curves(ax, of["recall"], dict(sorted(of["precision"].items())))
        ax.set(title=plot_text(name), xlabel="recall", ylabel="precision", xlim=(0, 1), ylim=(0, 1.02))
        legend(ax, fontsize=7, loc="lower left")
    return svg_bytes(figure)
