"""The page of results on realism: figures of several comparisons side by side, without any pictures of data.

`realism.json` collects the figures of every comparison that was added, by class and time of day. The page and its
charts follow from it alone: the same JSON gives the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from infrablend.compositing.object_contrast import MIN_COMPARED
from infrablend.core.dataset import known_class
from infrablend.core.files import read_object, write_bytes, write_json, write_text
from infrablend.core.output_checks import require_replaceable
from infrablend.lab.pages.experiment_charts import FAINT, svg_bytes
from infrablend.lab.pages.realism_report import (
    AS_WRITTEN,
    CHECK_HEAD,
    LOOSENESS_HEAD,
    QUANTILE_HEAD,
    SLOPE_HEAD,
    Contrasts,
    check_rows,
    looseness_cells,
    quantile_rows,
    score_cells,
    slope_rows,
)
from infrablend.lab.realism.contrasts import MAX_QUARTILE_DIFFERENCE, MAX_SLOPE_DIFFERENCE, MIN_LEAST_RATIO
from infrablend.report.figures import markdown_table, plot_text

STEM = "realism"
TITLE = "Realism: inserted and real objects side by side"
# InfraBlend's own documentation; links are left out of pages written elsewhere.
_DOCUMENTS = (("Definitions", "explanation/realism.md"), ("how to run it", "how_to/measure_realism.md"))
_REAL, _INSERTED = "#1b1b1b", "#d55e00"
# Figures of a class that the page keeps from a comparison's report.
_KEPT = (
    "n", "n_real", "n_inserted", "auc_logistic", "ci", "auc_boosting", "auc_boosting_ci",
    "floor_n", "floor_logistic", "floor_ci", "floor_boosting", "hard_paste_n", "hard_paste_logistic",
    "chain_off_logistic", "chain_off_boosting", "valid", "invalid_because", "mmd_dct", "box_looseness",
)  # fmt: skip
_SCORES = ("auc_boosting", "floor_logistic", "hard_paste_logistic", "chain_off_logistic")
_TIMES = ("night", "day", "dusk", "dawn", "all", "unknown")


def add_to_page(facts: Mapping[str, Any], out: Path) -> Path:
    """Add a comparison's figures to `realism.json` in a folder, and write its page and charts again.

    Figures of the same class and time of day are replaced, others are kept.

    Args:
        facts: Content of the comparison's own `realism.json`.
        out: Folder of the page; created if it is missing.

    Returns:
        Path of the page, `realism.md`.

    Raises:
        OutputError: The folder cannot be written, or has files of these names that are not such a page.
    """
    collected = read_object(out / f"{STEM}.json") or {}
    ours = collected.get("page") == STEM
    for name in (f"{STEM}.json", f"{STEM}.md"):
        require_replaceable(out / name, "page on realism", ours=ours)
    classes = dict(collected["classes"]) if ours else {}
    for category, of_class in facts["classes"].items():
        name = known_class(category) or category.casefold()
        classes[name] = _merged(classes.get(name, {}), of_class, facts)
    page = json.loads(json.dumps({"page": STEM, "version": 1, "classes": classes}, sort_keys=True))
    charts = [(f"{STEM}_{name}.svg", title, svg) for name, title, svg in _charts(page["classes"])]
    for name, _, svg in charts:
        write_bytes(out / name, svg)
    write_json(out / f"{STEM}.json", page)
    links = [f"[{name}](../{path})" for name, path in _DOCUMENTS if (out.parent / path).is_file()]
    return write_text(out / f"{STEM}.md", page_text(page, [(name, title) for name, title, _ in charts], links))


def _merged(earlier: Mapping[str, Any], of_class: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return a class's figures with those of one comparison added.

    The classifiers' figures of one time of day are also those of the class: by night if known, else of all pictures.
    """
    kept = {k: of_class[k] for k in _KEPT if k in of_class}
    scores = {**earlier.get("by_time", {}), facts["time_of_day"]: {**kept, "run": facts["run"]}}
    of_times = {t: {**sides, "run": facts["run"]} for t, sides in of_class["contrast"].items()}
    first = next(t for t in ("night", "all", "day") if t in scores)
    headline = {k: v for k, v in scores[first].items() if k != "run"}
    return {
        **headline,
        "time_of_day": first,
        "by_time": scores,
        "contrast": {**earlier.get("contrast", {}), **of_times},
        "contrast_as_written": {
            # A run with exact boxes has none; figures of an earlier run do not stay beside it.
            **{t: c for t, c in earlier.get("contrast_as_written", {}).items() if t not in of_times},
            **of_class.get("contrast_as_written", {}),
        },
    }


def page_text(page: Mapping[str, Any], charts: Sequence[tuple[str, str]] = (), links: Sequence[str] = ()) -> str:
    """Return the page as Markdown.

    Args:
        page: Content of the collected `realism.json`.
        charts: File name and title of each chart.
        links: Links to documents on the method.
    """
    classes = page["classes"]
    contrasts = _timed(classes, "contrast")
    scores = _timed(classes, "by_time")
    as_written = _rows(check_rows, classes, "contrast_as_written")
    not_valid = [f"* {name}: {'; '.join(f['invalid_because'])}." for name, f in scores if not f["valid"]]
    blocks = [
        f"# {TITLE}",
        "`infrablend realism --page` writes this page from measurements of saved pictures and boxes alone, with the "
        "same code for real and inserted objects." + (f" {', '.join(links)}." if links else ""),
        "## Sources",
        markdown_table(
            ["", "recipe", "seed", "frames", "backgrounds", "real objects"],
            [[name, *_source_cells(sides["run"])] for name, sides in contrasts],
        ),
        "## Limits",
        f"Slopes of inserted objects within {MAX_SLOPE_DIFFERENCE} of the real ones; 1 % and 5 % quantiles of the "
        f"largest change at least {MIN_LEAST_RATIO} of the real ones; for objects that are alone in their images, and "
        f"so have no slope, quartiles of contrast within {100 * MAX_QUARTILE_DIFFERENCE:.0f} %. In brackets the 95 % "
        f"interval over resampled images. No verdict below {MIN_COMPARED} objects.",
        markdown_table(CHECK_HEAD, _rows(check_rows, classes, "contrast")),
        *(["### In boxes as written", AS_WRITTEN, markdown_table(CHECK_HEAD, as_written)] if as_written else []),
        "## Slope within images",
        "How far an object's level follows the median of the ring around its box: 1 if it does, 0 if objects look the "
        "same everywhere in a picture. Only unclipped levels count, in images with at least three such objects.",
        markdown_table(SLOPE_HEAD, _rows(slope_rows, classes, "contrast")),
        "## Contrast",
        "8-bit levels against the median of the ring; SCR is the largest change over the ring's standard deviation "
        "+ 1.",
        markdown_table(QUANTILE_HEAD, _rows(quantile_rows, classes, "contrast")),
        *(f"![{title}]({name})" for name, title in charts),
        "## Boxes",
        "Factor from the visible extent of an object (beyond half of its contrast) to its box, in width and height: "
        "median and 95 % interval over resampled images. The last columns compare drawn boxes with the exact ones of "
        "inserted objects of the same extent, which cancels the bias of the measure.",
        markdown_table(LOOSENESS_HEAD, [[name, *looseness_cells(f["box_looseness"])] for name, f in scores]),
        "## Classifiers",
        "AUC of classifiers that separate inserted from real objects of similar size; 0.5 is chance. The floor is the "
        "AUC of real objects pasted elsewhere, the hard paste that of flat silhouettes.",
        markdown_table(
            ["", "pairs", "logistic", "95 %", "boosting", "floor", "hard paste", "chain off", "valid"],
            [[name, *score_cells(f, *_SCORES), "yes" if f["valid"] else "no"] for name, f in scores],
        ),
        *(["Figures of the classifiers that are not valid:\n\n" + "\n".join(not_valid)] if not_valid else []),
        f"All figures: [{STEM}.json]({STEM}.json).",
    ]
    return "\n\n".join(blocks) + "\n"


def _by_time(of_times: Mapping[str, Any]) -> dict[str, Any]:
    return {t: of_times[t] for t in _TIMES if t in of_times}


def _timed(classes: Mapping[str, Any], key: str) -> list[tuple[str, Mapping[str, Any]]]:
    """Return the figures of each class and time of day, with the name of both."""
    return [
        (category if time in ("unknown", "all") else f"{category} by {time}", figures)
        for category, of_class in classes.items()
        for time, figures in _by_time(of_class[key]).items()
    ]


def _rows(make: Callable[[Contrasts, str], list[list[str]]], classes: Mapping[str, Any], key: str) -> list[list[str]]:
    return [row for name, of_class in classes.items() for row in make(_by_time(of_class.get(key, {})), name)]


def _source_cells(run: Mapping[str, Any]) -> list[str]:
    backgrounds = f"{run['backgrounds']} ({', '.join(run['splits'])})"
    real = f"{run['real']} ({', '.join(run['real_splits'])})"
    return [f"`{run['recipe']}`", str(run["seed"]), f"{run['frames']:,}", backgrounds, real]


# ---- charts


def _charts(classes: Mapping[str, Any]) -> list[tuple[str, str, bytes]]:
    """Return (name, title, SVG) of every chart that there are figures for."""
    rows = _timed(classes, "contrast")
    charts = []
    if any(any(s["real"]["slope"].values()) for _, s in rows):
        charts.append(("slopes", "Slope within images, with 95 % intervals: real and inserted", _slopes(rows)))
    if rows:
        charts.append(("contrast", "Contrast: median, quartiles, and 5 to 95 %; crosses: 1 %", _quantiles(rows)))
    return charts


def _slopes(rows: Sequence[tuple[str, Mapping[str, Any]]]) -> bytes:
    figure, axes = _panels(rows)
    titles = {"high": "95 % quantile of the box", "middle": "middle of the box"}
    for ax, (level, title) in zip(axes, titles.items(), strict=True):
        ax.axvline(0, color=FAINT, lw=0.8)
        for at, (_, sides) in enumerate(rows):
            for side, colour, shift in (("real", _REAL, -0.14), ("inserted", _INSERTED, 0.14)):
                if slope := sides[side]["slope"][level]:
                    ax.plot(slope["ci"], [at + shift] * 2, color=colour, lw=1.6)
                    ax.plot(slope["slope"], at + shift, marker="o", color=colour, ms=5)
        ax.set(title=title, xlabel="slope over the ring")
    return svg_bytes(figure)


def _quantiles(rows: Sequence[tuple[str, Mapping[str, Any]]]) -> bytes:
    figure, axes = _panels(rows)
    titles = {"signed": "contrast", "change": "largest change"}
    for ax, (key, title) in zip(axes, titles.items(), strict=True):
        ax.axvline(0, color=FAINT, lw=0.8)
        for at, (_, sides) in enumerate(rows):
            for side, colour, shift in (("real", _REAL, -0.16), ("inserted", _INSERTED, 0.16)):
                if q := sides[side][key]:
                    y = at + shift
                    ax.plot([q["p5"], q["p95"]], [y, y], color=colour, lw=1.0)
                    ax.plot([q["p25"], q["p75"]], [y, y], color=colour, lw=4.0, alpha=0.6, solid_capstyle="butt")
                    ax.plot(q["p50"], y, marker="o", color=colour, ms=5)
                    ax.plot(q["p1"], y, marker="x", color=colour, ms=4, ls="")
        ax.set(title=title, xlabel="8-bit levels against the ring")
    return svg_bytes(figure)


def _panels(rows: Sequence[tuple[str, Any]]) -> tuple[Figure, Any]:
    """Return a figure with two panels that share a row per class and time, and a legend."""
    figure = Figure(figsize=(9, 1.5 + 0.5 * len(rows)), layout="constrained")
    axes: Any = figure.subplots(1, 2, sharey=True)
    axes[0].set_yticks(range(len(rows)), [plot_text(name) for name, _ in rows], fontsize=8)
    axes[0].set_ylim(len(rows) - 0.5, -0.5)
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    for name, colour in (("real", _REAL), ("inserted", _INSERTED)):
        axes[1].plot([], [], marker="o", color=colour, label=name)
    figure.legend(*axes[1].get_legend_handles_labels(), frameon=False, fontsize=8, loc="outside upper right", ncols=2)
    return figure, axes
