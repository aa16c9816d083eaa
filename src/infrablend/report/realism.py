"""A comparison of inserted and real objects, for people: sheets of crops, plots, an HTML page that stands alone."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from infrablend.core.rng import stream
from infrablend.realism.features import FEATURES, MEASURES, Measured
from infrablend.realism.verdict import ClassVerdict
from infrablend.report.preview import FAINT, INK, PAPER

ZOOM = 4
ON_A_SHEET = 24
COLUMNS = 4
_GAP = 8
_CAPTION = 16
_REAL, _INSERTED = "#3b6ea5", "#d1495b"


@dataclass(frozen=True)
class CropSheet:
    """A picture of pairs of crops: file name without suffix, what it shows, the PNG."""

    name: str
    title: str
    png: bytes


def sheets_of(verdict: ClassVerdict) -> list[CropSheet]:
    """Inserted objects, each beside the real one most like it: those told most easily, least easily, and at random.

    Every crop is 48 px of the picture (a larger object is scaled down), each pixel four times enlarged.
    """
    if verdict.logistic is None:
        return []
    real, inserted = [r for r, _ in verdict.pairs], [i for _, i in verdict.pairs]
    scores = verdict.logistic.predictions[len(real) :]
    order = np.argsort(-scores, kind="stable")
    drawn = stream(0, "sheet", verdict.category).permutation(len(inserted))
    nearest = _nearest(real, inserted)
    name = verdict.category.lower()
    sheets = []
    for what, title, chosen in (
        ("told", "told most easily", order),
        ("passed", "told least easily", order[::-1]),
        ("random", "drawn at random", drawn),
    ):
        rows = [(real[nearest[k]], inserted[k], float(scores[k])) for k in chosen[:ON_A_SHEET]]
        sheets.append(CropSheet(f"{name}_{what}", f"{verdict.category}: {title}", _sheet(rows)))
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


def html_report(facts: Mapping[str, Any], verdicts: Sequence[ClassVerdict], sheets: Sequence[CropSheet]) -> str:
    """The page; the same facts give the same bytes."""
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8><title>Realism</title><style>",
        "body{font:15px/1.5 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#1d2026}",
        "table{border-collapse:collapse;margin:1em 0}",
        "td,th{padding:.2em .7em;text-align:right;border-bottom:1px solid #ddd}",
        "td:first-child,th:first-child{text-align:left}img{max-width:100%}.bad{color:#b00020}.good{color:#1b7f3b}",
        "details{margin:.6em 0}</style><h1>Inserted and real objects compared</h1>",
        f"<p>Recipe {_e(facts['run']['recipe'])}, seed {facts['run']['seed']},",
        f" time of day: {_e(facts['time_of_day'])}.",
        " 0.5 means that a classifier cannot tell inserted objects from real ones, 1 that it always can. The floor is",
        " what it reaches on real objects pasted elsewhere, the hard paste what it reaches on flat silhouettes.</p>",
        _table(
            ["class", "pairs", "logistic", "95 %", "boosting", "floor", "floor, boosting", "hard paste", "chain off"],
            [
                [
                    c,
                    f["n"],
                    _n(f["auc_logistic"]),
                    _span(f["ci"]),
                    _n(f["auc_boosting"]),
                    _n(f["floor_logistic"]),
                    _n(f["floor_boosting"]),
                    _n(f["hard_paste_logistic"]),
                    _n(f.get("chain_off_logistic")),
                ]
                for c, f in facts["classes"].items()
            ],
        ),
    ]
    for v in verdicts:
        parts += _class_section(v, [s for s in sheets if s.name.startswith(v.category.lower() + "_")])
    return "\n".join(parts) + "\n</html>\n"


def _class_section(v: ClassVerdict, sheets: Sequence[CropSheet]) -> list[str]:
    f = v.facts
    parts = [f"<h2>{_e(v.category)}</h2>"]
    if f["valid"]:
        parts.append("<p class=good>The figures count: both controls behave as they must.</p>")
    else:
        parts.append(f"<p class=bad>The figures do not count: {_e('; '.join(f['invalid_because']))}.</p>")
    left = "; ".join(
        f"{name} {_e(', '.join(f'{k} {n}' for k, n in reasons.items()) or 'none')}"
        for name, reasons in f["left_out"].items()
    )
    parts.append(f"<p>{f['n_real']} real and {f['n_inserted']} inserted objects measured. Left out: {left}.</p>")
    parts += ["<h3>On the crops themselves</h3>", _table(["", "inserted", "floor"], _crop_rows(f))]
    if f["tells"]:
        parts += [
            "<h3>What gives the inserted ones away</h3>",
            _table(
                ["feature", "alone", "inserted is", "real 25/50/75 %", "inserted 25/50/75 %", "weight"],
                [
                    [
                        t["feature"],
                        _n(t["auc"]),
                        t["inserted_is"],
                        _three(t["real"]),
                        _three(t["inserted"]),
                        t["weight"],
                    ]
                    for t in f["tells"]
                ],
            ),
        ]
    if v.ablation:
        parts += [
            "<h3>Steps of the sensor chain</h3>",
            _table(
                ["up to", "pairs", "logistic", "95 %", "boosting"],
                [
                    [step, a["n"], _n(a["auc_logistic"]), _span(a["ci"]), _n(a["auc_boosting"])]
                    for step, a in v.ablation.items()
                ],
            ),
        ]
    populations = {**f["medians"], **{s: a["medians"] for s, a in v.ablation.items()}}
    parts += [
        "<h3>Medians</h3>",
        _table(
            ["", *populations],
            [[name, *(_n(m[name]) for m in populations.values())] for name in (*FEATURES, *MEASURES)],
        ),
        "<h3>Distributions</h3>",
        _image(_plots(v), f"{v.category}: distributions"),
        "<h3>Side by side</h3><p>Left the real object that is most alike, right the inserted one.</p>",
    ]
    parts += [f"<details><summary>{_e(s.title)}</summary>{_image(s.png, s.title)}</details>" for s in sheets]
    return parts


def _crop_rows(f: Mapping[str, Any]) -> list[list[str]]:
    """Network and distances; where one was skipped, why."""
    rows = []
    for key, name, inserted, floor in (
        ("cnn", "small network, AUC", "auc", "floor"),
        ("kid", "KID", "inserted", "real_halves"),
        ("mmd_dct", "MMD on cosine frequencies", "inserted", "real_halves"),
    ):
        found = f[key]
        if "skipped" in found:
            rows.append([name, f"skipped: {found['skipped']}", "-"])
        else:
            rows.append([name, _mean_sd(found[inserted]), _mean_sd(found.get(floor))])
    return rows


def _mean_sd(value: Any) -> str:
    return f"{value[0]:.4f} ± {value[1]:.4f}" if isinstance(value, list) else _n(value)


def _plots(v: ClassVerdict) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 13), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
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
    for axis, (name, a, b) in zip(axes, columns, strict=False):
        a, b = [x for x in a if not np.isnan(x)], [x for x in b if not np.isnan(x)]
        axis.set_title(name, fontsize=9)
        axis.tick_params(labelsize=7)
        if not a or not b:
            continue
        low, high = np.percentile([*a, *b], [1, 99])
        bins = np.linspace(low, max(float(high), float(low) + 1e-6), 31)
        axis.hist(np.clip(a, bins[0], bins[-1]), bins, color=_REAL, alpha=0.55, label="real")
        axis.hist(np.clip(b, bins[0], bins[-1]), bins, color=_INSERTED, alpha=0.55, label="inserted")
    axis = axes[18]
    axis.set_title("levels in boxes, share", fontsize=9)
    axis.tick_params(labelsize=7)
    for name, colour in (("real", _REAL), ("inserted", _INSERTED)):
        counts = np.array(v.facts["all_sizes"][name]["level_histogram"], np.float64)
        axis.step(np.arange(64) * 4 + 2, counts / max(counts.sum(), 1), color=colour, where="mid", label=name)
    axis = axes[19]
    axis.set_title("longer side by altitude label, px", fontsize=9)
    axis.tick_params(labelsize=7)
    for name, colour in (("real", _REAL), ("inserted", _INSERTED)):
        sizes = [(float(a), s[f"{name}_long_side_px"]) for a, s in v.facts["size_by_altitude"].items()]
        known = [(a, s) for a, s in sizes if s is not None]
        axis.plot([a for a, _ in known], [s for _, s in known], "o-", color=colour, label=name)
    axes[0].legend(fontsize=8)
    data = io.BytesIO()
    figure.savefig(data, format="png", metadata={"Software": None})
    return data.getvalue()


def _image(png: bytes, title: str) -> str:
    return f'<img alt="{_e(title)}" src="data:image/png;base64,{base64.b64encode(png).decode("ascii")}">'


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    lines = ["<table><tr>" + "".join(f"<th>{_e(h)}</th>" for h in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{_e(c)}</td>" for c in row) + "</tr>" for row in rows]
    return "\n".join([*lines, "</table>"])


def _e(value: Any) -> str:
    return html.escape(str(value))


def _n(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}" if abs(value) >= 100 else f"{value:.3f}".rstrip("0").rstrip(".")


def _span(interval: Sequence[float] | None) -> str:
    return "-" if interval is None else f"{interval[0]:.3f} to {interval[1]:.3f}"


def _three(values: Sequence[float]) -> str:
    return " / ".join(_n(v) for v in values)
