"""The report of an evaluation: tables, plots of precision, confusion and strata, and a self-contained HTML page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Final

import numpy as np

from infrablend.lab.evaluation.evaluation_record import (
    ClassRow,
    ClassRows,
    EvaluationRecord,
    FalseAlarms,
    FirstDetections,
    Interval,
    Measure,
    Paired,
    Stratum,
    Targets,
    TrackFacts,
)
from infrablend.lab.evaluation.small_targets import SMALL_PX
from infrablend.lab.pages.stress_page import STRESS_PAGE
from infrablend.report.charts import COLOURS, curves, legend, matrix, panels, plot_text, png_bytes
from infrablend.report.figures import decimals, interval
from infrablend.report.page import Table, render_page

COLUMNS: Final[Mapping[Measure, str]] = {
    "images": "images", "instances": "instances", "p": "P", "r": "R", "map10": "mAP10", "map50": "mAP50",
    "map50_95": "mAP50-95",
}  # fmt: skip
STRATA = {
    "size": "longer side, px",
    "body": "longer side of the body, px",
    "pitch": "pitch, degrees below the horizon",
    "altitude": "altitude, m",
    "time": "time of day",
}
TRACK_MEASURES = {
    "hota": "HOTA",
    "deta": "DetA",
    "assa": "AssA",
    "mota": "MOTA",
    "idf1": "IDF1",
    "switches": "switches",
}


# -- tables


def class_table(classes: ClassRows, intervals: Mapping[str, str] = {}, *, map10: bool = False) -> Table:
    """Return the paper's table: class, images, instances, P, R, mAP50, mAP50-95, and the intervals of some measures.

    Args:
        classes: Figures by class.
        intervals: Measure -> head of its column.
        map10: Whether mAP10 is a column, see `small_text`.
    """
    columns = {measure: head for measure, head in COLUMNS.items() if map10 or measure != "map10"}
    rows = [
        [name, *(decimals(row.get(c)) for c in columns), *(_interval(row.get("ci"), m) for m in intervals)]
        for name, row in classes.items()
    ]
    return Table(["class", *columns.values(), *intervals.values()], rows)


def small_text(classes: ClassRows) -> str:
    """Return why mAP10 stands beside mAP50, in words; empty where no class is small."""
    sizes = {name: row.get("median_px") for name, row in classes.items() if name != "all"}
    small = ", ".join(f"{name} {size:.0f} px" for name, size in sizes.items() if size is not None and size < SMALL_PX)
    if not small:
        return ""
    return (
        f"Boxes of small objects are inexact (median longer side: {small}): mAP10, at IoU 0.1, says whether they are "
        "found"
    )


def _interval(of: Mapping[str, Interval | None] | None, measure: str) -> str:
    return interval(None if of is None else of[measure])


def as_one_text(row: ClassRow) -> str:
    """Return the AP of all classes taken as one, in words, from the row `all`."""
    return f"All classes as one: AP50 {decimals(row['as_one50'])}, AP50-95 {decimals(row['as_one50_95'])}"


def found_table(listed: FirstDetections) -> Table:
    """Return the objects found and missed among the first detections; missed ones have no rank."""
    rows = []
    for o in listed["objects"]:
        box = ", ".join(f"{v:g}" for v in o["box"])
        hit = ["missed", "", ""]
        if o["rank"] is not None:
            hit = [str(o["rank"]), decimals(o["score"]), f"{o['iou']:.2f}"]
        rows.append([o["image"], o["class"], box, *hit])
    title = (
        f"{listed['found']} of {len(rows)} objects are among the {listed['detections']} detections with the highest "
        f"scores (IoU at least {listed['iou']:g})"
    )
    return Table(["image", "class", "box, px", "rank", "score", "IoU"], rows, title)


def target_table(targets: Targets, classes: ClassRows) -> Table:
    """Return AP at IoU 0.1, numbers of objects found and named, and what those of other names are called."""
    rows = []
    for name, of in targets["classes"].items():
        others = [f"{n} {k}" for n, k in of["called"].items() if name not in ("all", n)]
        numbers = [decimals(v) for v in (of["objects"], classes[name].get("map10"), of["found"], of["named"])]
        if of["objects"]:
            rows.append([name, *numbers, ", ".join(others)])
    title = (
        f"Objects found by any class (IoU at least {targets['iou']:g}, confidence {decimals(targets['confidence'])})"
    )
    return Table(["class", "objects", "AP10", "found", "named", "others called"], rows, title)


def kind_table(targets: Targets, head: str) -> Table:
    """Return numbers of objects, and the share of them found, by size and visible share; `head` names both."""
    named = {"size": "px", "visibility": "visible"}
    rows = [
        [f"{name} {named[kind]}", decimals(of["objects"]), decimals(of["found"] / of["objects"])]
        for kind, ranges in targets.get("by", {}).items()
        for name, of in ranges.items()
    ]
    return Table([head, "objects", "found"], rows)


def track_table(tracks: TrackFacts, intervals: Sequence[str]) -> Table:
    """Return the figures of tracks by class, and the intervals of some measures."""
    rows = []
    for name, row in tracks["classes"].items():
        figures = (row["sequences"], row["tracks"], row["found"], row["hota"], row["deta"], row["assa"], row["mota"],
                   row["idf1"], row["switches"])  # fmt: skip
        rows.append([name, *map(decimals, figures), *(_interval(row["ci"], m) for m in intervals)])
    counts = tracks["counts"]
    where = f"{counts['pictures']} pictures of {counts['sequences']} sequences"
    head = ["class", "sequences", "tracks", "found", *TRACK_MEASURES.values()]
    head += [f"{TRACK_MEASURES[m]}, interval" for m in intervals]
    return Table(head, rows, f"Tracks by {tracks['tracker']['tracker_type']} in {where}")


def alarm_table(alarms: FalseAlarms) -> Table:
    """Return the false alarms a picture by class: at the confidence of P and R, and at each recall."""
    rows = [
        [name, *(decimals(at and at["per_picture"]) for at in (of, *of["at_recall"].values()))]
        for name, of in alarms["classes"].items()
    ]
    head = ["class", "as P and R", *(f"recall {level}" for level in alarms["classes"]["all"]["at_recall"])]
    return Table(
        head, rows, f"False alarms a picture on {alarms['pictures']} pictures without objects of these classes"
    )


def _paired_table(paired: Paired) -> Table:
    rows = []
    for name, of in paired["classes"].items():
        for measure, title in (("map50", "mAP50"), ("map50_95", "mAP50-95")):
            d = of[measure]
            if d is not None:
                sides = [decimals(d["ours"]), decimals(d["theirs"]), f"{d['difference']:+.3f}"]
                rows.append([name, title, *sides, interval(d["ci"], signed=True), decimals(d["same_sign"])])
    return Table(["class", "", "this", "other", "difference", "interval", "same sign"], rows)


def _stratum_table(strata: Mapping[str, Stratum]) -> Table:
    rows = []
    for name, stratum in strata.items():
        for c, row in stratum["classes"].items():
            figures = (row["images"], row["instances"], row["map50"], row["map50_95"])
            if row["instances"]:
                rows.append([name, c, *map(decimals, figures), _interval(row.get("ci"), "map50_95")])
    return Table(["", "class", "images", "instances", "mAP50", "mAP50-95", "interval"], rows)


# -- plots


def draw_plots(facts: EvaluationRecord) -> dict[str, bytes]:
    """Return PNG files by name; the same facts give the same bytes."""
    plots = {"pr.png": _pr(facts), "confusion.png": _confusion(facts)}
    for kind, title in STRATA.items():
        strata = facts["strata"].get(kind, {})
        if len(strata) > 1:
            plots[f"{kind}.png"] = _stratum(facts["classes"], strata, title)
    return plots


def _pr(facts: EvaluationRecord) -> bytes:
    figure, (ax,) = panels(1, 1, (6.4, 4.8))
    found = facts["curves"]
    for (name, row), colour in zip(facts["classes"].items(), cycle(COLOURS), strict=False):
        if name in found["precision"]:
            label = f"{name} {decimals(row['map50'])}"
            curves(ax, found["recall"], {label: found["precision"][name]}, color=colour, lw=1.8)
            if row["p"] is not None and row["r"] is not None:
                ax.plot(row["r"], row["p"], "o", color=colour, ms=5)
    ax.set(xlim=(0, 1.01), ylim=(0, 1.02), xlabel="recall", ylabel="precision")
    ax.set_title("Precision by recall at IoU 0.5; dots at the confidence of best mean F1", fontsize=10)
    legend(ax, fontsize=9, title="class, AP50", title_fontsize=9)
    return png_bytes(figure)


def _confusion(facts: EvaluationRecord) -> bytes:
    names = facts["confusion"]["classes"]
    counts = np.array(facts["confusion"]["found_by_labelled"])
    shares = counts / np.maximum(counts.sum(axis=0, keepdims=True), 1)
    texts = [f"{n}\n{share:.2f}" for n, share in zip(counts.flat, shares.flat, strict=True)]
    texts[-1] = ""  # background found as background has no number
    side = 2.2 + 0.75 * len(names)
    figure, (ax,) = panels(1, 1, (side + 1, side))
    matrix(ax, shares, texts, names, names)
    ax.set(xlabel="labelled", ylabel="found")
    ax.set_title(f"Counts and shares of the column, confidence {facts['confidence']:.3f}", fontsize=10)
    return png_bytes(figure)


def _stratum(classes: ClassRows, strata: Mapping[str, Stratum], title: str) -> bytes:
    figure, (ax,) = panels(1, 1, (6.8, 4.2))
    names = [n for n, row in classes.items() if row["instances"]]
    for k, name in enumerate(names):
        points = []
        for at, stratum in enumerate(strata.values()):
            row = stratum["classes"][name]
            value = row["map50_95"]
            if value is not None:
                low, high = (row.get("ci") or {}).get("map50_95") or (value, value)
                points.append(
                    (at + (k - (len(names) - 1) / 2) * 0.12, value, max(value - low, 0), max(high - value, 0))
                )
        x, y, below, above = np.array(points).reshape(-1, 4).T
        colour = COLOURS[k % len(COLOURS)]
        ax.errorbar(x, y, yerr=(below, above), fmt="o-", ms=4, lw=1.1, capsize=2, color=colour, label=plot_text(name))
    objects = [f"{plot_text(b)}\n{of['classes']['all']['instances']}" for b, of in strata.items()]
    ax.set_xticks(range(len(objects)), objects, fontsize=8)
    ax.set(ylim=(0, 1.02), xlabel=f"{title}; objects below", ylabel="mAP50-95")
    legend(ax, ncols=3)
    return png_bytes(figure)


# -- the page


def evaluation_page(facts: EvaluationRecord, plots: Mapping[str, bytes]) -> str:
    """Return the HTML page with the plots of `draw_plots`; the same facts give the same bytes."""
    detector = {key: value for key, value in facts["detector"].items() if key != "classes"}
    classes = facts["classes"]
    alarms = facts["false_alarms"]
    small = small_text(classes)
    intervals = {"map50": "mAP50, interval", "map50_95": "mAP50-95, interval"}
    return render_page(
        "evaluation",
        __package__,
        title="Evaluation",
        facts=facts,
        detector=detector,
        classes=class_table(classes, intervals, map10=bool(small)),
        small=small,
        as_one=as_one_text(classes["all"]),
        targets=target_table(facts["targets"], classes),
        found_by=kind_table(facts["targets"], "longer side, visible share"),
        alarms=alarm_table(alarms) if alarms["pictures"] else None,
        tracks=track_table(facts["tracks"], list(TRACK_MEASURES)) if "tracks" in facts else None,
        ultralytics=class_table(facts["ultralytics"] or {}),
        paired=_paired_table(facts["paired"]) if facts["paired"] else None,
        strata=[(kind, title, _stratum_table(facts["strata"].get(kind, {}))) for kind, title in STRATA.items()],
        stress_page=STRESS_PAGE,
        found=found_table(facts["first_detections"]) if "first_detections" in facts else None,
        plots=plots,
        # Files that could not be read are errors, one each; a single warning counts them.
        warnings=[p["found"] for p in facts["problems"] if p["severity"] == "warning"],
        settings=Table(["", ""], [[key, str(value)] for key, value in {**detector, **facts["settings"]}.items()]),
    )
