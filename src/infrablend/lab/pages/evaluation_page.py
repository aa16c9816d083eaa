"""The report of an evaluation: plots of precision, confusion and strata, and a self-contained HTML page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from infrablend.lab.evaluation.track_scores import MEASURES as TRACK_MEASURES
from infrablend.report.figures import decimals, interval, plot_text, png_bytes
from infrablend.report.page import render_page

COLUMNS = ("images", "instances", "p", "r", "map50", "map50_95")
HEAD = ("class", "images", "instances", "P", "R", "mAP50", "mAP50-95")
_COLOURS = ("#1b1b1b", "#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#9a9a9a")
FOUND_HEAD = ("image", "class", "box, px", "rank", "score", "IoU")
TRACK_HEAD = ("class", "sequences", "tracks", "found", "HOTA", "DetA", "AssA", "MOTA", "IDF1", "switches")
TARGET_HEAD = ("class", "objects", "AP10", "found", "named", "others called")
STRATA = {
    "size": "longer side, px",
    "body": "longer side of the body, px",
    "pitch": "pitch, degrees below the horizon",
    "altitude": "altitude, m",
    "time": "time of day",
}


def table_rows(classes: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """Return the paper's table as text: class, images, instances, P, R, mAP50, mAP50-95."""
    return [[name, *(decimals(row[c]) for c in COLUMNS)] for name, row in classes.items()]


def class_interval(ci: Mapping[str, Sequence[float] | None] | None, measure: str) -> str:
    """Return a measure's interval as text, or `-` where a class has none."""
    return interval(None if ci is None else ci[measure])


def found_rows(listed: Mapping[str, Any]) -> list[list[str]]:
    """Return the list of objects found and missed among the first detections as text; missed ones have no rank."""
    rows = []
    for o in listed["objects"]:
        box = ", ".join(f"{v:g}" for v in o["box"])
        hit = [str(o["rank"]), decimals(o["score"]), f"{o['iou']:.2f}"] if o["rank"] else ["missed", "", ""]
        rows.append([o["image"], o["class"], box, *hit])
    return rows


def found_title(listed: Mapping[str, Any]) -> str:
    """Return how many objects are among the first detections, in words."""
    among = f"the {listed['detections']} detections with the highest scores"
    return f"{listed['found']} of {len(listed['objects'])} objects are among {among} (IoU at least {listed['iou']:g})"


def as_one_text(row: Mapping[str, Any]) -> str:
    """Return the AP of all classes taken as one, in words, from the row `all`."""
    return f"All classes as one: AP50 {decimals(row['as_one50'])}, AP50-95 {decimals(row['as_one50_95'])}"


def target_title(targets: Mapping[str, Any]) -> str:
    """Return what counts as found, in words."""
    return f"Objects found by any class (IoU at least {targets['iou']:g}, confidence {decimals(targets['confidence'])})"


def target_rows(metrics: Mapping[str, Any]) -> list[list[str]]:
    """Return AP at IoU 0.1, numbers of objects found and named, and what those of other names are called, as text."""
    rows = []
    for name, of in metrics["targets"]["classes"].items():
        others = {n: k for n, k in of["called"].items() if n != name} if name != "all" else {}
        called = ", ".join(f"{n} {k}" for n, k in others.items())
        if of["objects"]:
            ap = decimals(metrics["classes"][name].get("map10"))
            rows.append([name, decimals(of["objects"]), ap, decimals(of["found"]), decimals(of["named"]), called])
    return rows


def kind_rows(targets: Mapping[str, Any]) -> list[list[str]]:
    """Return numbers of objects, and the share of them found, by size and visible share as text."""
    named = {"size": "px", "visibility": "visible"}
    return [
        [f"{name} {named[kind]}", decimals(of["objects"]), decimals(of["found"] / of["objects"])]
        for kind, ranges in targets.get("by", {}).items()
        for name, of in ranges.items()
    ]


def track_title(tracks: Mapping[str, Any]) -> str:
    """Return what was tracked, and with what, in words."""
    counts = tracks["counts"]
    where = f"{counts['pictures']} pictures of {counts['sequences']} sequences"
    return f"Tracks by {tracks['tracker']['tracker_type']} in {where}"


def track_rows(tracks: Mapping[str, Any], *, measures: Sequence[str] = ()) -> list[list[str]]:
    """Return the figures of tracks by class as text, and the intervals of some measures."""
    keys = ("sequences", "tracks", "found", *TRACK_MEASURES)
    return [
        [name, *(decimals(row[k]) for k in keys), *(class_interval(row["ci"], m) for m in measures)]
        for name, row in tracks["classes"].items()
    ]


def alarm_title(alarms: Mapping[str, Any]) -> str:
    """Return what false alarms are counted on, in words."""
    return f"False alarms a picture on {alarms['pictures']} pictures without objects of these classes"


def alarm_table(alarms: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Return head and rows of the false alarms a picture by class: at the confidence of P and R, and at each recall."""
    levels = list(alarms["classes"]["all"]["at_recall"])
    rows = [
        [name, decimals(of["per_picture"]), *(decimals(at and at["per_picture"]) for at in of["at_recall"].values())]
        for name, of in alarms["classes"].items()
    ]
    return ["class", "as P and R", *(f"recall {level}" for level in levels)], rows


# -- plots


def draw_plots(facts: Mapping[str, Any]) -> dict[str, bytes]:
    """Return PNG files by name; the same facts give the same bytes."""
    plots = {"pr.png": _pr(facts), "confusion.png": _confusion(facts)}
    for kind, title in STRATA.items():
        if len(facts["strata"].get(kind, {})) > 1:
            plots[f"{kind}.png"] = _stratum(facts, kind, title)
    return plots


def _figure(width: float, height: float) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=100, layout="constrained")
    axis = figure.subplots()
    axis.spines[["top", "right"]].set_visible(False)
    return figure, axis


def _pr(facts: Mapping[str, Any]) -> bytes:
    figure, axis = _figure(6.4, 4.8)
    for k, (name, precision) in enumerate(facts["curves"]["precision"].items()):
        point = facts["classes"][name]
        colour = _COLOURS[(k + 1) % len(_COLOURS)]
        label = f"{plot_text(name)} {decimals(point['map50'])}"
        axis.plot(facts["curves"]["recall"], precision, color=colour, lw=1.8, label=label)
        if point["p"] is not None:
            axis.plot([point["r"]], [point["p"]], "o", color=colour, ms=5)
    axis.set(xlim=(0, 1.01), ylim=(0, 1.02), xlabel="recall", ylabel="precision")
    axis.set_title("Precision by recall at IoU 0.5; dots at the confidence of best mean F1", fontsize=10)
    axis.legend(frameon=False, fontsize=9, loc="best", title="class, AP50", title_fontsize=9)
    return png_bytes(figure)


def _confusion(facts: Mapping[str, Any]) -> bytes:
    names = [plot_text(n) for n in facts["confusion"]["classes"]]
    matrix = np.array(facts["confusion"]["found_by_labelled"], np.float64)
    share = matrix / np.maximum(matrix.sum(axis=0, keepdims=True), 1)
    side = 2.2 + 0.75 * len(names)
    figure, axis = _figure(side + 1, side)
    axis.imshow(share, cmap="Blues", vmin=0, vmax=1)
    for row, column in list(np.ndindex(share.shape))[:-1]:  # background found as background has no number
        text = f"{int(matrix[row, column])}\n{share[row, column]:.2f}"
        colour = _COLOURS[0]
        if share[row, column] > 0.5:
            colour = "white"
        axis.text(column, row, text, ha="center", va="center", fontsize=8, color=colour)
    axis.set_xticks(range(len(names)), names, rotation=45, ha="right", fontsize=9)
    axis.set_yticks(range(len(names)), names, fontsize=9)
    axis.set(xlabel="labelled", ylabel="found")
    axis.set_title(f"Counts and shares of the column, confidence {facts['confidence']:.3f}", fontsize=10)
    return png_bytes(figure)


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
                      color=_COLOURS[k % len(_COLOURS)], label=plot_text(name))  # fmt: skip
    axis.set_xticks(
        range(len(bins)), [f"{plot_text(b)}\n{strata[b]['classes']['all']['instances']}" for b in bins], fontsize=8
    )
    axis.set(ylim=(0, 1.02), xlabel=f"{title}; objects below", ylabel="mAP50-95")
    axis.legend(frameon=False, fontsize=8, ncols=3)
    return png_bytes(figure)


# -- the page


def evaluation_page(facts: Mapping[str, Any], plots: Mapping[str, bytes]) -> str:
    """Return the HTML page with the plots of `draw_plots`; the same facts give the same bytes."""
    detector = {key: value for key, value in facts["detector"].items() if key != "classes"}
    classes = facts["classes"]
    listed = facts.get("first_detections")
    paired = facts["paired"]
    tracks = facts.get("tracks")
    return render_page(
        "evaluation",
        __package__,
        title="Evaluation",
        facts=facts,
        detector=detector,
        head=list(HEAD),
        rows=[
            [*row, class_interval(classes[row[0]]["ci"], "map50"), class_interval(classes[row[0]]["ci"], "map50_95")]
            for row in table_rows(classes)
        ],
        as_one=as_one_text(classes["all"]),
        targets=(target_title(facts["targets"]), list(TARGET_HEAD), target_rows(facts)),
        found_by=kind_rows(facts["targets"]),
        tracks=(
            track_title(tracks),
            [*TRACK_HEAD, *(f"{h}, interval" for h in TRACK_HEAD[4:])],
            track_rows(tracks, measures=TRACK_MEASURES),
        )
        if tracks
        else None,
        alarms=(alarm_title(facts["false_alarms"]), *alarm_table(facts["false_alarms"]))
        if facts["false_alarms"]["pictures"]
        else None,
        ultralytics_rows=table_rows(facts["ultralytics"] or {}),
        paired_rows=_paired_rows(paired["classes"]) if paired else [],
        strata=[
            (kind, title, _stratum_rows(facts["strata"][kind], classes) if facts["strata"].get(kind) else None)
            for kind, title in STRATA.items()
        ],
        found=(found_title(listed), list(FOUND_HEAD), found_rows(listed)) if listed else None,
        plots=plots,
        # Files that could not be read are errors, one each; a single warning counts them.
        warnings=[p["found"] for p in facts["problems"] if p["severity"] == "warning"],
        setting_rows=list((detector | facts["settings"]).items()),
    )


def _paired_rows(classes: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    rows = []
    for name, of in classes.items():
        for measure, title in (("map50", "mAP50"), ("map50_95", "mAP50-95")):
            d = of[measure]
            if d is not None:
                rows.append([name, title, decimals(d["ours"]), decimals(d["theirs"]), f"{d['difference']:+.3f}",
                             interval(d["ci"], signed=True), decimals(d["same_sign"])])  # fmt: skip
    return rows


def _stratum_rows(strata: Mapping[str, Any], classes: Mapping[str, Any]) -> list[list[str]]:
    rows = []
    for name, stratum in strata.items():
        for c in classes:
            row = stratum["classes"][c]
            if row["instances"]:
                rows.append([name, c, decimals(row["images"]), decimals(row["instances"]), decimals(row["map50"]),
                             decimals(row["map50_95"]), class_interval(row["ci"], "map50_95")])  # fmt: skip
    return rows
