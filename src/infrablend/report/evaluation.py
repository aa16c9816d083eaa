"""An evaluation for people: plots of precision, confusion and strata, and an HTML page that stands alone."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

COLUMNS = ("images", "instances", "p", "r", "map50", "map50_95")
HEAD = ("class", "images", "instances", "P", "R", "mAP50", "mAP50-95")
_COLOURS = ("#1b1b1b", "#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#9a9a9a")
STRATA = {
    "size": "longer side, px",
    "pitch": "pitch, degrees below the horizon",
    "altitude": "altitude, m",
    "time": "time of day",
}


def table_rows(classes: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """The paper's table as text: class, images, instances, P, R, mAP50, mAP50-95."""
    return [[name, *(show(row[c]) for c in COLUMNS)] for name, row in classes.items()]


def show(value: float | None) -> str:
    """Three decimals, as the paper prints; whole numbers as such; `-` for what is not known."""
    return "-" if value is None else str(value) if isinstance(value, int) else f"{value:.3f}"


def span(ci: Mapping[str, Sequence[float] | None] | None, measure: str) -> str:
    """`0.871 to 0.912`, or `-`."""
    ends = None if ci is None else ci[measure]
    return "-" if ends is None else f"{ends[0]:.3f} to {ends[1]:.3f}"


# -- plots


def draw_plots(facts: Mapping[str, Any]) -> dict[str, bytes]:
    """PNG files by name; the same facts give the same bytes."""
    plots = {"pr.png": _pr(facts), "confusion.png": _confusion(facts)}
    for kind, title in STRATA.items():
        if len(facts["strata"].get(kind, {})) > 1:
            plots[f"{kind}.png"] = _stratum(facts, kind, title)
    return plots


def _figure(width: float, height: float) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    axis.spines[["top", "right"]].set_visible(False)
    return figure, axis


def _png(figure: Any) -> bytes:
    data = io.BytesIO()
    figure.savefig(data, format="png", metadata={"Software": None})
    return data.getvalue()


def _pr(facts: Mapping[str, Any]) -> bytes:
    figure, axis = _figure(6.4, 4.8)
    for k, (name, precision) in enumerate(facts["curves"]["precision"].items()):
        ap = facts["classes"][name]["map50"]
        axis.plot(
            facts["curves"]["recall"], precision, color=_COLOURS[(k + 1) % len(_COLOURS)], lw=1.8,
            label=f"{name} {show(ap)}",
        )  # fmt: skip
        point = facts["classes"][name]
        if point["p"] is not None:
            axis.plot([point["r"]], [point["p"]], "o", color=_COLOURS[(k + 1) % len(_COLOURS)], ms=5)
    axis.set(xlim=(0, 1.01), ylim=(0, 1.02), xlabel="recall", ylabel="precision")
    axis.set_title("Precision by recall at IoU 0.5; dots at the confidence of best mean F1", fontsize=10)
    axis.legend(frameon=False, fontsize=9, loc="best", title="class, AP50", title_fontsize=9)
    return _png(figure)


def _confusion(facts: Mapping[str, Any]) -> bytes:
    names = facts["confusion"]["classes"]
    matrix = np.array(facts["confusion"]["found_by_labelled"], np.float64)
    share = matrix / np.maximum(matrix.sum(axis=0, keepdims=True), 1)
    side = 2.2 + 0.75 * len(names)
    figure, axis = _figure(side + 1, side)
    axis.imshow(share, cmap="Blues", vmin=0, vmax=1)
    for row in range(len(names)):
        for column in range(len(names)):
            if row == column == len(names) - 1:
                continue  # background found as background has no number
            dark = share[row, column] > 0.5
            axis.text(column, row, f"{int(matrix[row, column])}\n{share[row, column]:.2f}", ha="center", va="center",
                      fontsize=8, color="white" if dark else "#1b1b1b")  # fmt: skip
    axis.set_xticks(range(len(names)), names, rotation=45, ha="right", fontsize=9)
    axis.set_yticks(range(len(names)), names, fontsize=9)
    axis.set(xlabel="labelled", ylabel="found")
    axis.set_title(f"Counts and shares of the column, confidence {facts['confidence']:.3f}", fontsize=10)
    return _png(figure)


def _stratum(facts: Mapping[str, Any], kind: str, title: str) -> bytes:
    figure, axis = _figure(6.8, 4.2)
    strata = facts["strata"][kind]
    bins = list(strata)
    names = [n for n in facts["classes"] if facts["classes"][n]["instances"]]
    for k, name in enumerate(names):
        rows = [strata[b]["classes"][name] for b in bins]
        x = np.arange(len(bins)) + (k - (len(names) - 1) / 2) * 0.12
        known = [n for n, row in enumerate(rows) if row["map50_95"] is not None]
        y = np.array([rows[n]["map50_95"] for n in known])
        ends = [rows[n]["ci"]["map50_95"] if rows[n]["ci"] else None for n in known]
        error = np.array([[max(v - e[0], 0), max(e[1] - v, 0)] if e else [0, 0] for v, e in zip(y, ends, strict=True)])
        axis.errorbar(x[known], y, yerr=error.T if len(error) else None, fmt="o-", ms=4, lw=1.1, capsize=2,
                      color=_COLOURS[k % len(_COLOURS)], label=name)  # fmt: skip
    axis.set_xticks(range(len(bins)), [f"{b}\n{strata[b]['classes']['all']['instances']}" for b in bins], fontsize=8)
    axis.set(ylim=(0, 1.02), xlabel=f"{title}; objects below", ylabel="mAP50-95")
    axis.legend(frameon=False, fontsize=8, ncols=3)
    return _png(figure)


# -- the page


def evaluation_page(facts: Mapping[str, Any], plots: Mapping[str, bytes]) -> str:
    """The page, with what `draw_plots` gave; the same facts give the same bytes."""
    data, settings, detector = facts["dataset"], facts["settings"], facts["detector"]
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8><title>Evaluation</title><style>",
        "body{font:15px/1.5 system-ui,sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;color:#1d2026}",
        "table{border-collapse:collapse;margin:1em 0}",
        "td,th{padding:.2em .7em;text-align:right;border-bottom:1px solid #ddd}",
        "td:first-child,th:first-child{text-align:left}img{max-width:100%}</style>",
        f"<h1>{_e(detector.get('weights', 'Detections'))} on {_e(data['name'])}, {_e(data['split'])}</h1>",
        f"<p>{data['images']} images, task {_e(facts['task'])}. P and R at confidence {facts['confidence']:.3f}, where",
        " the mean F1 of the classes is best. mAP by pycocotools, at most 300 findings an image. Intervals:",
        f" {100 * settings['level']:.0f} % of {settings['bootstrap']} draws of {settings['groups']} groups",
        f" ({_e(settings['group'])}).</p>",
        _table(
            [*HEAD, "mAP50, interval", "mAP50-95, interval"],
            [
                [*row, span(facts["classes"][row[0]]["ci"], "map50"), span(facts["classes"][row[0]]["ci"], "map50_95")]
                for row in table_rows(facts["classes"])
            ],
        ),
    ]
    if facts["ultralytics"]:
        parts += [
            "<h2>The same findings, judged by Ultralytics' code</h2>",
            _table(HEAD, table_rows(facts["ultralytics"])),
        ]
    else:
        parts.append("<p>Ultralytics is not installed here: its own figures are missing.</p>")
    if facts["paired"]:
        parts += _paired(facts["paired"])
    parts += ["<h2>Curves</h2>", _image(plots["pr.png"], "precision by recall")]
    parts += ["<h2>What is taken for what</h2>", _image(plots["confusion.png"], "confusion matrix")]
    for kind, title in STRATA.items():
        strata = facts["strata"].get(kind, {})
        if strata:
            parts += [f"<h2>By {_e(title)}</h2>", _stratum_table(strata, facts["classes"])]
        if f"{kind}.png" in plots:
            parts.append(_image(plots[f"{kind}.png"], title))
    # What could not be read, an error each, is in one warning together.
    notes = [p["found"] for p in facts["problems"] if p["severity"] == "warning"]
    if notes:
        parts += ["<h2>To know</h2><ul>", *(f"<li>{_e(n)}</li>" for n in notes), "</ul>"]
    told = {k: v for k, v in detector.items() if k != "classes"}
    parts += ["<h2>How it was made</h2>", _table(["", ""], [[k, v] for k, v in {**told, **settings}.items()])]
    return "\n".join(parts) + "\n</html>\n"


def _paired(facts: Mapping[str, Any]) -> list[str]:
    rows = []
    for name, of in facts["classes"].items():
        for measure, title in (("map50", "mAP50"), ("map50_95", "mAP50-95")):
            d = of[measure]
            if d is not None:
                ends = "-" if d["ci"] is None else f"{d['ci'][0]:+.3f} to {d['ci'][1]:+.3f}"
                rows.append([name, title, show(d["ours"]), show(d["theirs"]), f"{d['difference']:+.3f}", ends,
                             show(d["same_sign"])])  # fmt: skip
    return [
        f"<h2>Against {_e(facts['against']['name'])}, on the same images</h2>",
        _table(["class", "", "this", "other", "difference", "interval", "same sign"], rows),
    ]


def _stratum_table(strata: Mapping[str, Any], classes: Mapping[str, Any]) -> str:
    rows = []
    for name, stratum in strata.items():
        for c in classes:
            row = stratum["classes"][c]
            if row["instances"]:
                rows.append([name, c, row["images"], row["instances"], show(row["map50"]), show(row["map50_95"]),
                             span(row["ci"], "map50_95")])  # fmt: skip
    return _table(["", "class", "images", "instances", "mAP50", "mAP50-95", "interval"], rows)


def _image(png: bytes, title: str) -> str:
    return f'<img alt="{_e(title)}" src="data:image/png;base64,{base64.b64encode(png).decode("ascii")}">'


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    lines = ["<table><tr>" + "".join(f"<th>{_e(h)}</th>" for h in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{_e(c)}</td>" for c in row) + "</tr>" for row in rows]
    return "\n".join([*lines, "</table>"])


def _e(value: Any) -> str:
    return html.escape(str(value))
