"""Charts of a results page, as SVG: the same results give the same bytes. No pictures of data."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from infrablend.lab.pages.experiment_page import METRICS, class_order
from infrablend.report.figures import plot_text

# Distinguishable for colour-blind readers.
OURS = "#0072b2"
PAPER = "#d55e00"
FAINT = "#9a9a9a"
CURVES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#1b1b1b", "#9a9a9a")
COLUMNS = 4  # panels of curves beside each other


CHARTS = ("bars", "differences", "pr")
"""Names of all charts of a page."""


def draw_plots(facts: Mapping[str, Any]) -> list[tuple[str, str, bytes]]:
    """Return (name, title, SVG) of every chart that there are figures for."""
    rows = [(t["title"], r) for t in facts["tables"] for r in t["rows"] if r["ours"] is not None]
    curves = {n: e["curves"] for n, e in facts["evaluations"].items() if e.get("curves")}
    charts: tuple[tuple[str, str, Callable[[Any], bytes], Any], ...] = (
        ("bars", "Ours with 95 % intervals, the paper's figures as crosses", _bars, rows),
        ("differences", "Paired differences with 95 % intervals", _forest, facts["comparisons"]),
        ("pr", "Precision over recall at IoU 0.5", _curves, curves),
    )
    return [(name, title, draw(figures)) for name, title, draw, figures in charts if figures]


def svg_bytes(figure: Figure) -> bytes:
    """Return the figure as SVG, without dates and random ids."""
    out = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "infrablend", "svg.fonttype": "none", "path.simplify": True}):
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return out.getvalue()


def _bars(rows: Sequence[tuple[str, Mapping[str, Any]]]) -> bytes:
    several = len({t for t, _ in rows}) > 1
    names = [f"{r['evaluation']}: {r['title']}" if several else r["title"] for _, r in rows]
    figure, axes, y = _panels(names, 0.34)
    for ax, metric in zip(axes, ("map50", "map50_95"), strict=True):
        for at, (_, r) in zip(y, rows, strict=True):
            value = r["ours"][metric]
            ci = (r["ours"].get("ci") or {}).get(metric)
            if value is not None:
                ax.barh(at, value, height=0.6, color=OURS, alpha=0.75)
            if ci:
                ax.plot(ci, [at, at], color="#1b1b1b", lw=1.4)
            if r["paper"][metric] is not None:
                ax.plot(r["paper"][metric], at, marker="x", color=PAPER, ms=7, mew=1.8, ls="")
        ax.set(xlim=(0, 1.02), xlabel=METRICS[metric])
    if any(r["paper"][metric] is not None for _, r in rows for metric in ("map50", "map50_95")):
        axes[1].plot([], [], marker="x", color=PAPER, ls="", mew=1.8, label="paper")
        axes[1].barh([], [], color=OURS, alpha=0.75, label="ours")
        figure.legend(
            *axes[1].get_legend_handles_labels(), frameon=False, fontsize=8, loc="outside upper right", ncols=2
        )
    return svg_bytes(figure)


def _forest(comparisons: Mapping[str, Mapping[str, Any]]) -> bytes:
    rows = [
        (f"{c['title']}, {name}", c["classes"][name])
        for c in comparisons.values()
        for name in sorted(c["classes"], key=class_order)
    ]
    figure, axes, y = _panels([name for name, _ in rows], 0.3)
    for ax, metric in zip(axes, ("map50", "map50_95"), strict=True):
        ax.axvline(0, color=FAINT, lw=0.8)
        for at, (_, of) in zip(y, rows, strict=True):
            if (d := of.get(metric)) is not None:
                ax.plot(d["difference"], at, marker="o", color=OURS, ms=5, ls="")
                if d.get("ci"):
                    ax.plot(d["ci"], [at, at], color=OURS, lw=1.6)
        ax.set(xlabel=f"difference of {METRICS[metric]}")
        ax.locator_params(axis="x", nbins=5)
    return svg_bytes(figure)


def _panels(names: Sequence[str], row_height: float) -> tuple[Figure, Any, NDArray[np.int64]]:
    """Return a figure with two panels that share a row per name, and the places of the rows, first one on top."""
    figure = Figure(figsize=(9, 1.0 + row_height * len(names)), layout="constrained")
    axes: Any = figure.subplots(1, 2, sharey=True)
    y = np.arange(len(names))[::-1]
    axes[0].set_yticks(y, [plot_text(n) for n in names], fontsize=8)
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes, y


def _curves(curves: Mapping[str, Mapping[str, Any]]) -> bytes:
    columns = min(len(curves), COLUMNS)
    rows = math.ceil(len(curves) / columns)
    figure = Figure(figsize=(3.4 * columns, 3.2 * rows), layout="constrained")
    axes: Any = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax in axes[len(curves) :]:
        ax.remove()
    for ax, (name, of) in zip(axes, curves.items(), strict=False):
        for k, (category, precision) in enumerate(sorted(of["precision"].items())):
            ax.plot(of["recall"], precision, color=CURVES[k % len(CURVES)], lw=1.4, label=plot_text(category))
        ax.set(title=plot_text(name), xlabel="recall", ylabel="precision", xlim=(0, 1), ylim=(0, 1.02))
        ax.spines[["top", "right"]].set_visible(False)
        ax.legend(frameon=False, fontsize=7, loc="lower left")
    return svg_bytes(figure)
