"""The page of results on realism: figures of several comparisons side by side, without any pictures of data.

`realism.json` collects the figures of every comparison that was added, by class and time of day. The page and its
charts follow from it alone: the same JSON gives the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from infrablend.compositing.object_contrast import MIN_COMPARED
from infrablend.core.dataset import known_class
from infrablend.core.files import read_object, write_bytes, write_json, write_text
from infrablend.core.output_checks import require_replaceable
from infrablend.lab.pages.realism_report import (
    AS_WRITTEN,
    LEVELS,
    SIDES,
    TimedContrasts,
    check_table,
    looseness_table,
    quantile_table,
    score_table,
    slope_table,
)
from infrablend.lab.realism.class_comparison import MAX_QUARTILE_DIFFERENCE, MAX_SLOPE_DIFFERENCE, MIN_LEAST_RATIO
from infrablend.lab.realism.realism_record import (
    ClassFacts,
    CollectedClass,
    ComparedRun,
    Quantity,
    RealismRecord,
    ScoreName,
)
from infrablend.report.charts import BLUE, FAINT, ORANGE, estimate, legend_above, pair_of_panels, svg_bytes
from infrablend.report.page import Table, bullets, markdown_page

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STEM = "realism"
TITLE = "Realism: inserted and real objects side by side"
# InfraBlend's own documentation; links are left out of pages written elsewhere.
_DOCUMENTS = (("Definitions", "explanation/realism.md"), ("how to run it", "how_to/measure_realism.md"))
# Figures of a class that the page keeps from a comparison's report.
_KEPT = (
    "n", "n_real", "n_inserted", "auc_logistic", "ci", "auc_boosting", "auc_boosting_ci",
    "floor_n", "floor_logistic", "floor_ci", "floor_boosting", "hard_paste_n", "hard_paste_logistic",
    "chain_off_logistic", "chain_off_boosting", "valid", "invalid_because", "mmd_dct", "box_looseness",
)  # fmt: skip
_SCORES: Final[Mapping[ScoreName, str]] = {
    "auc_boosting": "boosting",
    "floor_logistic": "floor",
    "hard_paste_logistic": "hard paste",
    "chain_off_logistic": "chain off",
}
_QUANTITIES: Final[Mapping[Quantity, str]] = {"signed": "contrast", "change": "largest change"}
_COLOURS = {"real": BLUE, "inserted": ORANGE}
_SHIFTS = {"real": 0.15, "inserted": -0.15}  # within a row
_TIMES = ("night", "day", "dusk", "dawn", "all", "unknown")


def add_to_page(facts: RealismRecord, out: Path) -> Path:
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
        classes[name] = _merged(classes.get(name), of_class, facts)
    page = json.loads(json.dumps({"page": STEM, "version": 1, "classes": classes}, sort_keys=True))
    charts = [(f"{STEM}_{name}.svg", title, svg) for name, title, svg in draw_charts(page["classes"])]
    for name, _, svg in charts:
        write_bytes(out / name, svg)
    write_json(out / f"{STEM}.json", page)
    links = [f"[{name}](../{path})" for name, path in _DOCUMENTS if (out.parent / path).is_file()]
    return write_text(
        out / f"{STEM}.md", page_text(page["classes"], [(name, title) for name, title, _ in charts], links)
    )


def _merged(earlier: CollectedClass | None, of_class: ClassFacts, facts: RealismRecord) -> dict[str, object]:
    """Return a class's figures with those of one comparison added.

    The classifiers' figures of one time of day are also those of the class: by night if known, else of all pictures.
    """
    kept = {k: v for k, v in of_class.items() if k in _KEPT}
    written = of_class.get("contrast_as_written", {})
    scores: dict[str, Mapping[str, object]] = {facts["time_of_day"]: {**kept, "run": facts["run"]}}
    contrasts: dict[str, object] = {t: {**sides, "run": facts["run"]} for t, sides in of_class["contrast"].items()}
    as_written: dict[str, object] = {**written}
    if earlier is not None:
        # A run with exact boxes has no boxes as written; those of an earlier run do not stay beside it.
        as_written = {**{t: c for t, c in earlier["contrast_as_written"].items() if t not in contrasts}, **written}
        scores = {**earlier["by_time"], **scores}
        contrasts = {**earlier["contrast"], **contrasts}
    first = next(t for t in ("night", "all", "day") if t in scores)
    return {
        **{k: v for k, v in scores[first].items() if k != "run"},
        "time_of_day": first,
        "by_time": scores,
        "contrast": contrasts,
        "contrast_as_written": as_written,
    }


def page_text(
    classes: Mapping[str, CollectedClass], charts: Sequence[tuple[str, str]] = (), links: Sequence[str] = ()
) -> str:
    """Return the page as Markdown.

    Args:
        classes: Classes of the collected `realism.json`.
        charts: File name and title of each chart.
        links: Links to documents on the method.
    """
    contrasts = _contrasts(classes)
    as_written = check_table(_contrasts(classes, "contrast_as_written"))
    scores = {_label(c, t): of["by_time"][t] for c, of in classes.items() for t in _times(of["by_time"])}
    verdicts = score_table("", scores, _SCORES)
    not_valid = [f"{name}: {'; '.join(f['invalid_because'])}." for name, f in scores.items() if not f["valid"]]
    blocks = [
        f"# {TITLE}",
        "`infrablend realism --page` writes this page from measurements of saved pictures and boxes alone, with the "
        "same code for real and inserted objects." + (f" {', '.join(links)}." if links else ""),
        "## Sources",
        Table(
            ["", "recipe", "seed", "frames", "backgrounds", "real objects"],
            [[_label(category, time), *_source_cells(sides["run"])] for category, time, sides in contrasts],
        ).markdown(),
        "## Limits",
        f"Slopes of inserted objects within {MAX_SLOPE_DIFFERENCE} of the real ones; 1 % and 5 % quantiles of the "
        f"largest change at least {MIN_LEAST_RATIO} of the real ones; for objects that are alone in their images, and "
        f"so have no slope, quartiles of contrast within {100 * MAX_QUARTILE_DIFFERENCE:.0f} %. In brackets the 95 % "
        f"interval over resampled images. No verdict below {MIN_COMPARED} objects.",
        check_table(contrasts).markdown(),
        *(["### In boxes as written", AS_WRITTEN, as_written.markdown()] if as_written.rows else []),
        "## Slope within images",
        "How far an object's level follows the median of the ring around its box: 1 if it does, 0 if objects look the "
        "same everywhere in a picture. Only unclipped levels count, in images with at least three such objects.",
        slope_table(contrasts).markdown(),
        "## Contrast",
        "8-bit levels against the median of the ring; SCR is the largest change over the ring's standard deviation "
        "+ 1.",
        quantile_table(contrasts).markdown(),
        *(f"![{title}]({name})" for name, title in charts),
        "## Boxes",
        "Factor from the visible extent of an object (beyond half of its contrast) to its box, in width and height: "
        "median and 95 % interval over resampled images. The last columns compare drawn boxes with the exact ones of "
        "inserted objects of the same extent, which cancels the bias of the measure.",
        looseness_table({name: f["box_looseness"] for name, f in scores.items()}).markdown(),
        "## Classifiers",
        "AUC of classifiers that separate inserted from real objects of similar size; 0.5 is chance. The floor is the "
        "AUC of real objects pasted elsewhere, the hard paste that of flat silhouettes.",
        Table(
            [*verdicts.head, "valid"],
            [[*row, "yes" if scores[row[0]]["valid"] else "no"] for row in verdicts.rows],
        ).markdown(),
        f"Figures of the classifiers that are not valid:\n\n{bullets(not_valid)}" if not_valid else "",
        f"All figures: [{STEM}.json]({STEM}.json).",
    ]
    return markdown_page(blocks)


def _times(of_times: Mapping[str, object]) -> list[str]:
    return [t for t in _TIMES if t in of_times]


def _label(category: str, time: str) -> str:
    return category if time in ("unknown", "all") else f"{category} by {time}"


def _contrasts(
    classes: Mapping[str, CollectedClass], key: Literal["contrast", "contrast_as_written"] = "contrast"
) -> TimedContrasts:
    return [(category, time, of[key][time]) for category, of in classes.items() for time in _times(of.get(key, {}))]


def _source_cells(run: ComparedRun) -> list[str]:
    backgrounds = f"{run['backgrounds']} ({', '.join(run['splits'])})"
    real = f"{run['real']} ({', '.join(run['real_splits'])})"
    return [f"`{run['recipe']}`", str(run["seed"]), f"{run['frames']:,}", backgrounds, real]


# ---- charts


def draw_charts(classes: Mapping[str, CollectedClass]) -> list[tuple[str, str, bytes]]:
    """Return (name, title, SVG) of every chart that there are figures for."""
    rows = _contrasts(classes)
    charts = []
    if any(any(sides["real"]["slope"].values()) for _, _, sides in rows):
        charts.append(("slopes", "Slope within images, with 95 % intervals: real and inserted", _slopes(rows)))
    if rows:
        charts.append(("contrast", "Contrast: median, quartiles, and 5 to 95 %; crosses: 1 %", _quantiles(rows)))
    return charts


def _slopes(rows: TimedContrasts) -> bytes:
    figure, axes, places = _panels(rows, "slope over the ring")
    for ax, level, title in zip(axes, LEVELS, ("95 % quantile of the box", "middle of the box"), strict=True):
        ax.set_title(title)
        for at, (_, _, sides) in zip(places, rows, strict=True):
            for side in SIDES:
                if slope := sides[side]["slope"][level]:
                    estimate(ax, slope["slope"], slope["ci"], at + _SHIFTS[side], color=_COLOURS[side])
    return svg_bytes(figure)


def _quantiles(rows: TimedContrasts) -> bytes:
    figure, axes, places = _panels(rows, "8-bit levels against the ring")
    for ax, (key, title) in zip(axes, _QUANTITIES.items(), strict=True):
        ax.set_title(title)
        for at, (_, _, sides) in zip(places, rows, strict=True):
            for side in SIDES:
                if q := sides[side][key]:
                    y = at + _SHIFTS[side]
                    colour = _COLOURS[side]
                    estimate(ax, q["p50"], (q["p5"], q["p95"]), y, color=colour)
                    ax.plot([q["p25"], q["p75"]], [y, y], color=colour, lw=4.0, alpha=0.6, solid_capstyle="butt")
                    ax.plot(q["p1"], y, marker="x", color=colour, ms=4, ls="")
    return svg_bytes(figure)


def _panels(rows: TimedContrasts, quantity: str) -> tuple[Figure, list[Axes], range]:
    figure, axes, places = pair_of_panels([_label(category, time) for category, time, _ in rows], 0.5)
    for ax in axes:
        ax.axvline(0, color=FAINT, lw=0.8)
        ax.set_xlabel(quantity)
    for side in SIDES:
        axes[1].plot([], [], marker="o", color=_COLOURS[side], label=side)
    legend_above(figure, axes[1])
    return figure, axes, places
