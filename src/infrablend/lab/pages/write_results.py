"""Writing a results page: Markdown, JSON, charts as SVG, and the index of the folder."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

from infrablend.core.files import load_json, read_object, read_regular, write_bytes, write_json, write_text
from infrablend.core.output_checks import require_no_foreign
from infrablend.lab.evaluation.evaluation_record import Curves
from infrablend.lab.experiments.recall_cells import compared_cells
from infrablend.lab.experiments.result_record import (
    ComparisonFigures,
    DetectabilityFigures,
    ExperimentRecord,
    TableRow,
)
from infrablend.lab.pages.experiment_page import (
    INDEX_FILE,
    METRICS,
    PAGE_MARK,
    UNFINISHED_END,
    class_order,
    page_name,
    page_text,
    paper_and_ours,
    run_state,
)
from infrablend.pipeline.flights.detectability_figures import LEAST_COMPARED
from infrablend.report.charts import (
    BLUE,
    COLOURS,
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
from infrablend.report.page import Table, markdown_page

# Figures of the charts that the JSON does not keep.
_NOT_KEPT = ("curves", "confusion")
INTRO = (
    "Each page is written by `infrablend experiment`, never by hand, and that includes negative and unfinished results."
)
_HOW_TO = Path("how_to/experiments.md")
_REALISM = "realism.md"


def require_own_pages(out: Path, experiment: str, scale: str) -> None:
    """Check that the files of an experiment's page in a folder, if there are any, are pages of InfraBlend.

    Raises:
        OutputError: Somebody else wrote one.
    """
    first = page_name(experiment, scale)
    index = out / INDEX_FILE
    foreign = [p for stem in (first, f"{first}{UNFINISHED_END}") for p in _foreign(out, stem)]
    foreign += [index] if os.path.lexists(index) and not _says(index, INTRO) else []
    require_no_foreign(foreign, out, "the results", "a page that InfraBlend wrote", "--results")


def _foreign(out: Path, stem: str) -> list[Path]:
    """Return the files in the place of a page that are not InfraBlend's; charts are, if their record is."""
    record = out / f"{stem}.json"
    page = out / f"{stem}.md"
    own = (read_object(record) or {}).keys() >= {"experiment", "scale", "status"}
    foreign = [] if own else [record, *(out / f"{stem}_{name}.svg" for name in CHARTS)]
    foreign += [] if own and _says(page, PAGE_MARK) else [page]
    return [p for p in foreign if os.path.lexists(p)]


def _says(path: Path, words: str) -> bool:
    try:
        return words in read_regular(path).decode("utf-8", "replace")
    except OSError:
        return False


def write_page(facts: ExperimentRecord, out: Path) -> Path:
    """Write `<name>.md`, `<name>.json`, charts `<name>_*.svg` and the index to a folder; return the path of the page.

    An unfinished run does not replace a complete page: its files are named `<name>-unfinished`.

    Raises:
        OutputError: The folder cannot be written.
    """
    # In the order of the JSON, so that the page follows from the JSON alone.
    facts = json.loads(json.dumps(facts, sort_keys=True))
    stem = page_name(facts["experiment"], facts["scale"])
    is_complete = facts["status"] == "complete"
    if not is_complete and (read_object(out / f"{stem}.json") or {}).get("status") == "complete":
        stem += UNFINISHED_END
    plots = [(f"{stem}_{name}.svg", title, svg) for name, title, svg in draw_plots(facts)]
    for name, _, svg in plots:
        write_bytes(out / name, svg)
    for old in {f"{stem}_{name}.svg" for name in CHARTS} - {name for name, _, _ in plots}:
        (out / old).unlink(missing_ok=True)  # of an earlier run with more figures
    evaluations = {n: {k: v for k, v in e.items() if k not in _NOT_KEPT} for n, e in facts["evaluations"].items()}
    write_json(out / f"{stem}.json", {**facts, "evaluations": evaluations})
    unfinished = f"{stem}{UNFINISHED_END}"
    if is_complete and read_object(out / f"{unfinished}.json"):  # of a run that this one has completed
        for old in (f"{unfinished}.json", f"{unfinished}.md", *(f"{unfinished}_{c}.svg" for c in CHARTS)):
            (out / old).unlink(missing_ok=True)
    page = write_text(out / f"{stem}.md", page_text(facts, [(name, title) for name, title, _ in plots], stem))
    write_text(out / INDEX_FILE, index_text(out))
    return page


def index_text(out: Path) -> str:
    """Return the page that lists all results in a folder, as Markdown."""
    rows = []
    for path in sorted(out.glob("*.json")):
        try:
            rows.append(_row(load_json(path), path.stem))
        except (OSError, ValueError, KeyError, TypeError):
            continue  # not one of ours
    intro = INTRO
    if (out.parent / _HOW_TO).is_file():  # InfraBlend's own documentation
        intro += f" How to run the experiments: [experiments](../{_HOW_TO.as_posix()})."
    if (out / _REALISM).is_file():
        intro += f" `infrablend realism` writes the page on [inserted and real objects side by side]({_REALISM})."
    head = ["Experiment", "Scale", "Status", "First row, mAP50: paper → ours", "Conclusions that hold"]
    return markdown_page(["# Results", intro, Table(head, rows).markdown() if rows else "No results yet."])


def _row(facts: ExperimentRecord, stem: str) -> list[str]:
    verdicts = [c["holds"] for c in facts["checks"] if c["holds"] is not None]
    rows = [r for table in facts["tables"] for r in table["rows"]]
    first = next((r for r in rows if r["ours"]), rows[0] if rows else None)
    return [
        f"[{facts['title']}]({stem}.md)",
        facts["scale"],
        run_state(facts),
        f"{first['title']}: {paper_and_ours(first['paper']['map50'], (first['ours'] or {}).get('map50'), '.3f')}"
        if first
        else "-",
        f"{verdicts.count(True)} of {len(verdicts)}" if verdicts else "-",
    ]


COLUMNS = 4  # panels of curves beside each other
_SHOWN = ("map50", "map50_95")


CHARTS = ("bars", "differences", "pr", "recall")
"""Names of all charts of a page."""


def draw_plots(facts: ExperimentRecord) -> list[tuple[str, str, bytes]]:
    """Return (name, title, SVG) of every chart that there are figures for."""
    rows = [(t["title"], r) for t in facts["tables"] for r in t["rows"] if r["ours"] is not None]
    found = {n: e["curves"] for n, e in facts["evaluations"].items() if e.get("curves")}
    by_class: dict[str, list[DetectabilityFigures]] = {}
    for of in facts.get("detectabilities", {}).values():
        if of["compared"]:
            by_class.setdefault(of["category"], []).append(of)
    charts: tuple[tuple[str, str, Callable[[Any], bytes], Any], ...] = (
        ("bars", "Ours with 95 % intervals, the paper's figures as crosses", _bars, rows),
        ("differences", "Paired differences with 95 % intervals", _forest, facts["comparisons"]),
        ("pr", "Precision over recall at IoU 0.5", _curves, found),
        ("recall", "Actual over predicted recall, a point per condition with 40 real objects", _recall, by_class),
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


def _recall(by_class: Mapping[str, Sequence[DetectabilityFigures]]) -> bytes:
    figure, axes = panels(1, len(by_class), (3.8 * len(by_class), 4.2))
    for ax, (category, measured) in zip(axes, by_class.items(), strict=True):
        ax.plot([0, 1], [0, 1], color=FAINT, lw=0.8)
        for of, colour in zip(measured, cycle(COLOURS), strict=False):
            cells: list[Any] = list(compared_cells(of["cells"], LEAST_COMPARED))
            for c in cells:
                ax.plot([c["low"], c["high"]], [c["actual"]] * 2, color=colour, lw=0.5, alpha=0.4)
                ax.plot([c["predicted"]] * 2, [c["actual_low"], c["actual_high"]], color=colour, lw=0.5, alpha=0.4)
            places = [c["predicted"] for c in cells], [c["actual"] for c in cells]
            ax.plot(*places, "o", color=colour, ms=3.5, label=plot_text(of["title"]))
        ax.set(title=plot_text(category), xlabel="predicted", ylabel="actual", xlim=(0, 1), ylim=(0, 1), aspect="equal")
        legend(ax, fontsize=7, loc="upper left")
    return svg_bytes(figure)
