"""Report of a comparison of inserted and real objects: sheets of crops, plots, tables and an HTML page."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from infrablend.annotation.measured_looseness import BoxFigures, FiguresAgainst
from infrablend.compositing.object_contrast import SlopeFigures
from infrablend.core.rng import stream
from infrablend.lab.realism.class_comparison import QUANTILES, ClassComparison
from infrablend.lab.realism.features import FEATURES, MEASURES, Measured
from infrablend.lab.realism.realism_record import (
    ClassFacts,
    Medians,
    Quantity,
    RealismRecord,
    ScoreName,
    SeparatingFeature,
    Side,
    StepScores,
    TimeContrast,
)
from infrablend.report.charts import COLOURS, curves, histogram, legend, panels, png_bytes
from infrablend.report.figures import compact, interval
from infrablend.report.page import Table, render_page
from infrablend.report.preview import FAINT, INK, grid, strip, to_rgb

ZOOM = 4
ON_A_SHEET = 24
COLUMNS = 4
_CAPTION_PX = 16
SIDES: Final[tuple[Side, ...]] = ("real", "inserted")
LEVELS = ("high", "middle")
_CHECKS = {
    "slope_high": "slope of the 95 % quantile",
    "slope_middle": "slope of the middle",
    "change_p1": "largest change, 1 % quantile",
    "change_p5": "largest change, 5 % quantile",
    "signed_p25": "contrast, lower quartile",
    "signed_p50": "contrast, median",
    "signed_p75": "contrast, upper quartile",
}
_QUANTITIES: Final[Mapping[Quantity, str]] = {
    "signed": "contrast",
    "change": "largest change",
    "ground_level": "ground, level above the picture's median",
    "ground_clutter": "ground, standard deviation",
}
_SCORES: Final[Mapping[ScoreName, str]] = {
    "auc_boosting": "boosting",
    "floor_logistic": "floor",
    "floor_boosting": "floor, boosting",
    "hard_paste_logistic": "hard paste",
    "chain_off_logistic": "chain off",
}
_PLOTTED = ("p95_minus_ring", "centre_minus_ring", "edge_width_px", "height_px")
AS_WRITTEN = (
    "Contrast is measured in a box: a wider one shows less of it, one around what is visible more. Where a run draws "
    "the boxes of inserted objects as people do (`labels.fit`, `labels.loosen`, `labels.loosen_px`), this is the "
    "contrast in those. The number of objects that are large enough to be measured changes, too."
)


@dataclass(frozen=True)
class CropSheet:
    """A sheet of pairs of crops: file name without suffix, class and choice of the objects, and the PNG file."""

    name: str
    title: str
    png: bytes


_CHOICES = (("most_obvious", "most obvious"), ("least_obvious", "least obvious"), ("random", "random"))


def sheets_of(comparison: ClassComparison, name: str) -> list[CropSheet]:
    """Draw inserted objects, each beside the most similar real one: the most obvious, the least obvious, and random.

    Every crop shows 48 px of the image, enlarged four times; larger objects are scaled down first.

    Args:
        comparison: Comparison of the objects of one class.
        name: First part of the file names; no other class has it.
    """
    if comparison.logistic is None:
        return []
    real, inserted = [r for r, _ in comparison.pairs], [i for _, i in comparison.pairs]
    scores = comparison.logistic.predictions[len(real) :]
    order = np.argsort(-scores, kind="stable")
    drawn = stream(0, "sheet", comparison.category).permutation(len(inserted))
    nearest = _nearest(real, inserted)
    sheets = []
    for (what, title), chosen in zip(_CHOICES, (order, order[::-1], drawn), strict=True):
        rows = [(real[nearest[k]], inserted[k], float(scores[k])) for k in chosen[:ON_A_SHEET]]
        sheets.append(CropSheet(f"{name}_{what}", f"{comparison.category}: {title}", _sheet(rows)))
    return sheets


def _nearest(real: Sequence[Measured], inserted: Sequence[Measured]) -> NDArray[np.int64]:
    a, b = (np.array([m.features for m in objects], np.float64) for objects in (real, inserted))
    scale = np.where(a.std(axis=0) > 0, a.std(axis=0), 1)
    a, b = a / scale, b / scale
    squared = (a**2).sum(axis=1)[None] - 2 * b @ a.T
    return np.asarray(np.argmin(squared, axis=1), np.int64)


def _sheet(rows: Sequence[tuple[Measured, Measured, float]]) -> bytes:
    cells = []
    for real, inserted, score in rows:
        crops = np.repeat(np.repeat(np.hstack([real.patch, inserted.patch]), ZOOM, axis=0), ZOOM, axis=1)
        width = crops.shape[1] // 2
        of_real = strip(width, _CAPTION_PX, f"real {real.key.rsplit('/')[-1]}", 11, FAINT)
        of_inserted = strip(width, _CAPTION_PX, f"inserted, log odds {score:+.1f}", 11, INK)
        cells.append(np.vstack([to_rgb(crops), np.hstack([of_real, of_inserted])]))
    data = io.BytesIO()
    Image.fromarray(grid(cells, min(COLUMNS, len(cells)))).save(data, "PNG")
    return data.getvalue()


# ---- the page


def html_report(facts: RealismRecord, comparisons: Sequence[ClassComparison], sheets: Sequence[CropSheet]) -> str:
    """Return the HTML page; the same facts give the same bytes."""
    return render_page(
        "realism",
        __package__,
        title="Realism",
        facts=facts,
        scores=score_table("class", facts["classes"], _SCORES),
        as_written=AS_WRITTEN.replace("`", ""),
        sections=[
            _class_section(v, [s for s in sheets if s.name.startswith(v.category.lower() + "_")]) for v in comparisons
        ],
    )


def score_table(head: str, rows: Mapping[str, ClassFacts], scores: Mapping[ScoreName, str]) -> Table:
    """Return number of pairs, AUC and interval of the logistic classifier, and further figures of classes."""
    return Table(
        [head, "pairs", "logistic", "95 %", *scores.values()],
        [
            [name, str(f["n"]), compact(f["auc_logistic"]), interval(f["ci"]), *(compact(f.get(key)) for key in scores)]
            for name, f in rows.items()
        ],
    )


def _class_section(v: ClassComparison, sheets: Sequence[CropSheet]) -> dict[str, object]:
    """Return what the template shows of a class."""
    f = v.facts
    contrasts = [("", time, sides) for time, sides in f["contrast"].items()]
    as_written = [("", time, sides) for time, sides in f.get("contrast_as_written", {}).items()]
    return {
        "category": v.category,
        "facts": f,
        "left_out": "; ".join(
            f"{name} {', '.join(f'{reason} {n}' for reason, n in reasons.items()) or 'none'}"
            for name, reasons in f["left_out"].items()
        ),
        "crops": _crop_table(f),
        "slopes": slope_table(contrasts),
        "quantiles": quantile_table(contrasts),
        "looseness": looseness_table({"factor": f["box_looseness"]}),
        "checks": check_table(contrasts),
        "checks_as_written": check_table(as_written),
        "cues": _cue_table(f["separating_features"]),
        "steps": _step_table(v.ablation),
        "medians": _median_table({**f["medians"], **{step: a["medians"] for step, a in v.ablation.items()}}),
        "plots": _plots(v),
        "sheets": sheets,
    }


def _step_table(steps: Mapping[str, StepScores]) -> Table:
    rows = []
    for step, a in steps.items():
        rows.append([step, str(a["n"]), compact(a["auc_logistic"]), interval(a["ci"]), compact(a["auc_boosting"])])
    return Table(["up to", "pairs", "logistic", "95 %", "boosting"], rows)


def _crop_table(f: ClassFacts) -> Table:
    """Return a row for the network and each distance, or the reason why it was skipped."""
    network = f["cnn"]
    rows = [_crop_row("small network, AUC", network.get("skipped"), network.get("auc"), network.get("floor"))]
    for name, found in (("KID", f["kid"]), ("MMD on cosine frequencies", f["mmd_dct"])):
        rows.append(_crop_row(name, found.get("skipped"), found.get("inserted"), found.get("real_halves")))
    return Table(["", "inserted", "floor"], rows)


def _crop_row(name: str, skipped: str | None, *values: float | Sequence[float] | None) -> list[str]:
    return [name, *map(_mean_sd, values)] if skipped is None else [name, f"skipped: {skipped}", "-"]


def _mean_sd(value: float | Sequence[float] | None) -> str:
    return f"{value[0]:.4f} ± {value[1]:.4f}" if isinstance(value, Sequence) else compact(value)


def _cue_table(features: Sequence[SeparatingFeature]) -> Table:
    rows = []
    for t in features:
        quartiles = [" / ".join(map(compact, t[side])) for side in SIDES]
        rows.append([t["feature"], compact(t["auc"]), t["inserted_is"], *quartiles, str(t["weight"])])
    return Table(["feature", "alone", "inserted is", "real 25/50/75 %", "inserted 25/50/75 %", "weight"], rows)


def _median_table(populations: Mapping[str, Medians]) -> Table:
    rows = [[name, *(compact(m[name]) for m in populations.values())] for name in (*FEATURES, *MEASURES)]
    return Table(["", *populations], rows)


def _plots(v: ClassComparison) -> bytes:
    figure, axes = panels(5, 4, (13, 13))
    *of_features, of_levels, of_sizes = axes
    for ax, (name, real, inserted) in zip(of_features, _measured(v), strict=False):
        ax.set_title(name)
        known = {side: [x for x in of if not np.isnan(x)] for side, of in zip(SIDES, (real, inserted), strict=True)}
        if all(known.values()):
            histogram(ax, known)
    of_levels.set_title("levels in boxes, share")
    of_sizes.set_title("longer side by altitude label, px")
    for side, colour in zip(SIDES, COLOURS, strict=False):
        counts = np.array(v.facts["all_sizes"][side]["level_histogram"], np.float64)
        curves(
            of_levels, np.arange(64) * 4 + 2, {side: counts / max(counts.sum(), 1)}, color=colour, drawstyle="steps-mid"
        )
        sizes = {float(a): s[f"{side}_long_side_px"] for a, s in v.facts["size_by_altitude"].items()}
        known_px = {a: px for a, px in sizes.items() if px is not None}
        curves(of_sizes, [*known_px], {side: [*known_px.values()]}, color=colour, marker="o")
    for ax in axes:
        ax.tick_params(labelsize=7)
        ax.title.set_fontsize(9)
    legend(axes[0])
    return png_bytes(figure)


def _measured(v: ClassComparison) -> Iterator[tuple[str, list[float], list[float]]]:
    """Yield the name of each plotted feature and measure, and its values of the real and inserted objects."""
    for k, name in enumerate(FEATURES):
        yield name, [r.features[k] for r, _ in v.pairs], [i.features[k] for _, i in v.pairs]
    for k, name in enumerate(MEASURES):
        if name in _PLOTTED:
            yield name, [r.measures[k] for r, _ in v.pairs], [i.measures[k] for _, i in v.pairs]


# ---- tables of contrast

TimedContrasts = Sequence[tuple[str, str, TimeContrast]]
"""Class, or "" where there is only one, time of day, and the contrast of both populations."""


def slope_table(contrasts: TimedContrasts) -> Table:
    """Return one row of slopes per class, time of day and population; none where no image has enough objects."""
    rows = []
    for category, time, sides in contrasts:
        for side in SIDES:
            high, middle = (sides[side]["slope"][level] for level in LEVELS)
            if high or middle:
                rows.append([_label(category, side, time), *_slope_cells(high), *_slope_cells(middle)])
    return Table(["", "95 % quantile", "95 % interval", "objects", "middle", "95 % interval", "objects"], rows)


def _slope_cells(slope: SlopeFigures | None) -> list[str]:
    if slope is None:
        return ["-", "-", "0"]
    return [f"{slope['slope']:.2f}", f"{slope['ci'][0]:.2f} to {slope['ci'][1]:.2f}", f"{slope['objects']:,}"]


def quantile_table(contrasts: TimedContrasts) -> Table:
    """Return rows of quantiles per class, time and population: of contrast, and of the ground around the objects."""
    rows = []
    for category, time, sides in contrasts:
        for key, name in _QUANTITIES.items():
            for side in SIDES:
                found = sides[side]
                scr = [compact(found["scr"].get(f"p{q}")) for q in (1, 5, 50)] if key == "change" else [""] * 3
                values = [found[key].get(f"p{q}") for q in QUANTILES]
                quantiles = ["-" if v is None else f"{v:.0f}" for v in values]
                rows.append([f"{_label(category, side, time)}: {name}", f"{found['n']:,}", *quantiles, *scr])
    return Table(["", "objects", *(f"{q} %" for q in QUANTILES), "SCR, 1 %", "5 %", "median"], rows)


def check_table(contrasts: TimedContrasts) -> Table:
    """Return one row per check: the figures, what is required, and whether it holds."""
    rows = []
    for category, time, sides in contrasts:
        for name, check in sides["checks"].items():
            found = compact(check["found"])
            if "ci" in check:
                found = f"{check['found']:+.3f} ({interval(check['ci'], signed=True)})"
            holds = {True: "yes", False: "no", None: "-"}[check["holds"]]  # none where there are too few objects
            figures = [compact(check["real"]), compact(check["inserted"]), found]
            label = f"{_label(category, time=time)}: {_CHECKS[name]}"
            rows.append([label, *figures, _required(name, check["limit"]), holds])
    return Table(["", "real", "inserted", "found", "required", "holds"], rows)


def looseness_table(rows: Mapping[str, Mapping[str, BoxFigures | FiguresAgainst | None]]) -> Table:
    """Return the factors of real and inserted boxes, and of real against inserted ones, each with its number."""
    keys = (*SIDES, "real_against_inserted")
    cells = [[name, *(cell for key in keys for cell in _factor_cells(boxes[key]))] for name, boxes in rows.items()]
    return Table(["", "real", "boxes", "inserted", "boxes", "real against inserted", "boxes"], cells)


def _factor_cells(found: BoxFigures | FiguresAgainst | None) -> list[str]:
    if found is None:
        return ["-", "-"]
    ends = f"{found['ci'][0]:.2f} to {found['ci'][1]:.2f}"
    return [f"{found['factor']:.2f} ({ends}), {found['margin_px']:.1f} px", f"{found['n']:,}"]


def _label(prefix: str, side: str = "", time: str = "") -> str:
    words = [prefix, side, "" if time == "unknown" else f"by {time}"]
    return " ".join(w for w in words if w).strip() or "all"


def _required(name: str, limit: float | Sequence[float]) -> str:
    if name.startswith("slope"):
        return f"difference within {limit}"
    if isinstance(limit, Sequence):
        return f"ratio {limit[0]} to {limit[1]}"
    return f"ratio of at least {limit}"
