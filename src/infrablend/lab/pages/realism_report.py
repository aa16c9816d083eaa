"""Report of a comparison of inserted and real objects: sheets of crops, plots, tables and an HTML page."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from infrablend.core.rng import stream
from infrablend.lab.realism.class_comparison import ClassComparison
from infrablend.lab.realism.contrasts import QUANTILES
from infrablend.lab.realism.features import FEATURES, MEASURES, Measured
from infrablend.report.figures import compact, interval, png_bytes
from infrablend.report.page import render_page
from infrablend.report.preview import FAINT, INK, PAPER

ZOOM = 4
ON_A_SHEET = 24
COLUMNS = 4
_GAP = 8
_CAPTION = 16
_REAL, _INSERTED = "#3b6ea5", "#d1495b"
Contrasts = Mapping[str, Mapping[str, Any]]
"""What `lab.realism.contrasts.compare_contrasts` returns: time of day to real, inserted, checks."""

QUANTILE_HEAD = ["", "objects", *(f"{q} %" for q in QUANTILES), "SCR, 1 %", "5 %", "median"]
CHECK_HEAD = ["", "real", "inserted", "found", "required", "holds"]
_CHECKS = {
    "slope_high": "slope of the 95 % quantile",
    "slope_middle": "slope of the middle",
    "change_p1": "largest change, 1 % quantile",
    "change_p5": "largest change, 5 % quantile",
    "signed_p25": "contrast, lower quartile",
    "signed_p50": "contrast, median",
    "signed_p75": "contrast, upper quartile",
}
_QUANTITIES = {
    "signed": "contrast",
    "change": "largest change",
    "ground_level": "ground, level above the picture's median",
    "ground_clutter": "ground, standard deviation",
}
_SCORES = ("auc_boosting", "floor_logistic", "floor_boosting", "hard_paste_logistic", "chain_off_logistic")
AS_WRITTEN = (
    "Contrast is measured in a box: a wider one shows less of it, one around what is visible more. Where a run draws "
    "the boxes of inserted objects as people do (`labels.fit`, `labels.loosen`, `labels.loosen_px`), this is the "
    "contrast in those. The number of objects that are large enough to be measured changes, too."
)
LOOSENESS_HEAD = ["", "real", "boxes", "inserted", "boxes", "real against inserted", "boxes"]
SLOPE_HEAD = ["", "95 % quantile", "95 % interval", "objects", "middle", "95 % interval", "objects"]


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
    side = 48 * ZOOM
    width, height = 2 * side + 3 * _GAP, side + _CAPTION + _GAP
    columns = min(COLUMNS, len(rows))
    sheet = Image.new("RGB", (columns * width, -(-len(rows) // columns) * height + _GAP), PAPER)
    pen = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(11)
    for k, (real, inserted, score) in enumerate(rows):
        x, y = k % columns * width + _GAP, k // columns * height + _GAP
        for n, m in enumerate((real, inserted)):
            sheet.paste(Image.fromarray(m.patch).resize((side, side), Image.Resampling.NEAREST), (x + n * side, y))
        pen.text((x, y + side + 1), f"real {real.key.rsplit('/')[-1]}"[:32], fill=FAINT, font=font)
        pen.text((x + side, y + side + 1), f"inserted, log odds {score:+.1f}", fill=INK, font=font)
    data = io.BytesIO()
    sheet.save(data, "PNG", compress_level=6)
    return data.getvalue()


# ---- the page


def html_report(facts: Mapping[str, Any], comparisons: Sequence[ClassComparison], sheets: Sequence[CropSheet]) -> str:
    """Return the HTML page; the same facts give the same bytes."""
    return render_page(
        "realism",
        __package__,
        title="Realism",
        recipe=facts["run"]["recipe"],
        seed=facts["run"]["seed"],
        time_of_day=facts["time_of_day"],
        rows=[[category, *score_cells(f, *_SCORES)] for category, f in facts["classes"].items()],
        sections=[
            _class_section(v, [s for s in sheets if s.name.startswith(v.category.lower() + "_")]) for v in comparisons
        ],
    )


def score_cells(f: Mapping[str, Any], *further: str) -> list[str]:
    """Return number of pairs, AUC and interval of the logistic classifier, and further figures of a class."""
    return [str(f["n"]), compact(f["auc_logistic"]), interval(f["ci"]), *(compact(f.get(key)) for key in further)]


def _class_section(v: ClassComparison, sheets: Sequence[CropSheet]) -> dict[str, Any]:
    f = v.facts
    populations = {**f["medians"], **{s: a["medians"] for s, a in v.ablation.items()}}
    return {
        "category": v.category,
        "facts": f,
        "left_out": "; ".join(
            f"{name} {', '.join(f'{reason} {n}' for reason, n in reasons.items()) or 'none'}"
            for name, reasons in f["left_out"].items()
        ),
        "crop_rows": _crop_rows(f),
        "slope_head": SLOPE_HEAD,
        "slope_rows": slope_rows(f["contrast"]),
        "quantile_head": QUANTILE_HEAD,
        "quantile_rows": quantile_rows(f["contrast"]),
        "looseness_head": LOOSENESS_HEAD,
        "looseness_rows": [["factor", *looseness_cells(f["box_looseness"])]],
        "check_head": CHECK_HEAD,
        "check_rows": check_rows(f["contrast"]),
        "as_written": AS_WRITTEN.replace("`", ""),
        "as_written_rows": check_rows(f.get("contrast_as_written", {})),
        "cue_rows": [
            [
                t["feature"],
                compact(t["auc"]),
                t["inserted_is"],
                *(" / ".join(map(compact, t[side])) for side in ("real", "inserted")),
                t["weight"],
            ]
            for t in f["separating_features"]
        ],
        "ablation_rows": [[step, *score_cells(a, "auc_boosting")] for step, a in v.ablation.items()],
        "median_head": ["", *populations],
        "median_rows": [[name, *(compact(m[name]) for m in populations.values())] for name in (*FEATURES, *MEASURES)],
        "plots": _plots(v),
        "sheets": sheets,
    }


def _crop_rows(f: Mapping[str, Any]) -> list[list[str]]:
    """Return a row for the network and each distance, or the reason why it was skipped."""
    kinds = (
        (f["cnn"], "small network, AUC", "auc", "floor"),
        (f["kid"], "KID", "inserted", "real_halves"),
        (f["mmd_dct"], "MMD on cosine frequencies", "inserted", "real_halves"),
    )
    return [
        [name, f"skipped: {found['skipped']}", "-"]
        if "skipped" in found
        else [name, _mean_sd(found[inserted]), _mean_sd(found.get(floor))]
        for found, name, inserted, floor in kinds
    ]


def _mean_sd(value: Any) -> str:
    return f"{value[0]:.4f} ± {value[1]:.4f}" if isinstance(value, list) else compact(value)


def _plots(v: ClassComparison) -> bytes:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 13), dpi=80, layout="constrained")
    axes = figure.subplots(5, 4).ravel()
    real, inserted = [r for r, _ in v.pairs], [i for _, i in v.pairs]
    columns = [
        (name, [m.features[k] for m in real], [m.features[k] for m in inserted]) for k, name in enumerate(FEATURES)
    ]
    columns += [
        (name, [m.measures[k] for m in real], [m.measures[k] for m in inserted])
        for k, name in enumerate(MEASURES)
        if name in ("p95_minus_ring", "centre_minus_ring", "edge_width_px", "height_px")
    ]
    titles = [*(name for name, _, _ in columns), "levels in boxes, share", "longer side by altitude label, px"]
    for axis, title in zip((*axes[: len(columns)], *axes[18:]), titles, strict=True):
        axis.set_title(title, fontsize=9)
        axis.tick_params(labelsize=7)
    for axis, (_, a, b) in zip(axes, columns, strict=False):
        a, b = [x for x in a if not np.isnan(x)], [x for x in b if not np.isnan(x)]
        if not a or not b:
            continue
        low, high = np.percentile([*a, *b], [1, 99])
        bins = np.linspace(low, max(float(high), float(low) + 1e-6), 31)
        axis.hist(np.clip(a, bins[0], bins[-1]), bins, color=_REAL, alpha=0.55, label="real")
        axis.hist(np.clip(b, bins[0], bins[-1]), bins, color=_INSERTED, alpha=0.55, label="inserted")
    for name, colour in (("real", _REAL), ("inserted", _INSERTED)):
        counts = np.array(v.facts["all_sizes"][name]["level_histogram"], np.float64)
        axes[18].step(np.arange(64) * 4 + 2, counts / max(counts.sum(), 1), color=colour, where="mid", label=name)
        sizes = {float(a): s[f"{name}_long_side_px"] for a, s in v.facts["size_by_altitude"].items()}
        known = {a: s for a, s in sizes.items() if s is not None}
        axes[19].plot([*known], [*known.values()], "o-", color=colour, label=name)
    axes[0].legend(fontsize=8)
    return png_bytes(figure)


def slope_rows(contrasts: Contrasts, prefix: str = "") -> list[list[str]]:
    """Return one row of slopes per time of day and population; none where no image has enough objects."""
    slopes = {
        _label(prefix, side, time): [sides[side]["slope"][level] for level in ("high", "middle")]
        for time, sides in contrasts.items()
        for side in ("real", "inserted")
    }
    return [[label, *(cell for s in of for cell in _slope_cells(s))] for label, of in slopes.items() if any(of)]


def quantile_rows(contrasts: Contrasts, prefix: str = "") -> list[list[str]]:
    """Return rows of quantiles per time of day and population: of contrast, and of the ground around the objects."""
    rows = []
    for time, sides in contrasts.items():
        for key, name in _QUANTITIES.items():
            for side in ("real", "inserted"):
                found = sides[side]
                scr = [compact(found["scr"].get(f"p{q}")) for q in (1, 5, 50)] if key == "change" else [""] * 3
                values = [found[key].get(f"p{q}") for q in QUANTILES]
                quantiles = ["-" if v is None else f"{v:.0f}" for v in values]
                rows.append([f"{_label(prefix, side, time)}: {name}", f"{found['n']:,}", *quantiles, *scr])
    return rows


def check_rows(contrasts: Contrasts, prefix: str = "") -> list[list[str]]:
    """Return one row per check: the figures, what is required, and whether it holds."""
    rows = []
    for time, sides in contrasts.items():
        for name, check in sides["checks"].items():
            found = compact(check["found"])
            if "ci" in check:
                found = f"{check['found']:+.3f} ({interval(check['ci'], signed=True)})"
            holds = {True: "yes", False: "no", None: "-"}[check["holds"]]  # none where there are too few objects
            cells = [compact(check["real"]), compact(check["inserted"]), found, _required(name, check["limit"]), holds]
            rows.append([f"{_label(prefix, time=time)}: {_CHECKS[name]}", *cells])
    return rows


def looseness_cells(boxes: Mapping[str, Any]) -> list[str]:
    """Return the factors of real and inserted boxes, and of real against inserted ones, each with its number."""
    cells = []
    for key in ("real", "inserted", "real_against_inserted"):
        found = boxes[key]
        if found is None:
            cells += ["-", "-"]
            continue
        ends = f"{found['ci'][0]:.2f} to {found['ci'][1]:.2f}"
        cells += [f"{found['factor']:.2f} ({ends}), {found['margin_px']:.1f} px", f"{found['n']:,}"]
    return cells


def _label(prefix: str, side: str = "", time: str = "") -> str:
    words = [prefix, side, "" if time == "unknown" else f"by {time}"]
    return " ".join(w for w in words if w).strip() or "all"


def _slope_cells(slope: Mapping[str, Any] | None) -> list[str]:
    if slope is None:
        return ["-", "-", "0"]
    return [f"{slope['slope']:.2f}", f"{slope['ci'][0]:.2f} to {slope['ci'][1]:.2f}", f"{slope['objects']:,}"]


def _required(name: str, limit: float | Sequence[float]) -> str:
    if name.startswith("slope"):
        return f"difference within {limit}"
    if isinstance(limit, Sequence):
        return f"ratio {limit[0]} to {limit[1]}"
    return f"ratio of at least {limit}"
