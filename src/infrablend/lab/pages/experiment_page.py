"""The page of an experiment: tables with the paper's figures beside ours, conclusions, differences, charts, times.

Everything comes from the results' JSON, nothing from the clock or the disk: the same JSON gives the same bytes. Data,
renderer, trainings, boxes and scale that differ from the paper's are listed in a line each.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from infrablend.annotation.looseness import looseness_text
from infrablend.core.dataset import SPLITS
from infrablend.lab.evaluation.evaluation_record import ClassRow
from infrablend.lab.experiments.result_record import (
    Claim,
    ComparisonFigures,
    DatasetRow,
    DetectabilityFigures,
    EvaluationFigures,
    ExperimentRecord,
    ResultTable,
    TableRow,
)
from infrablend.lab.pages.evaluation_page import found_table
from infrablend.report.detectability_page import recall_table
from infrablend.report.figures import stratum_order
from infrablend.report.page import Table, bullets, markdown_page

_STRATA = {
    "size": "longer side, px", "body": "longer side of the body, px", "pitch": "camera pitch, °",
    "altitude": "altitude, m", "time": "time of day",
}  # fmt: skip
_EXPECTED = {
    "below": "whole interval below 0",
    "above": "whole interval above 0",
    "within": "0 inside the interval",
    "not_below": "interval not entirely below 0",
    "at_least": "ratio of at least {least:g}",
    "at_most": "all differences at most {most:g}",
    "report": "reported, no verdict",
}
INDEX_FILE = "index.md"
PAGE_MARK = "This command writes the page:"
"""Words of every page of an experiment, by which a later call knows that it may replace it."""
UNFINISHED_END = "-unfinished"
"""End of the name of an unfinished run's page beside a complete one."""
_CELLS = (
    "Each cell shows paper → ours (difference) and, in brackets, the 95 % interval of ours from a bootstrap "
    "over the test images. P and R are taken at the confidence with the best mean F1; AP is COCO's "
    "with at most 300 detections per image."
)
_FROM_SCRATCH = (
    "No published weights were found when this was run. On a machine that finds them, add `--weights scratch` to train "
    "as here."
)
_RECALL = (
    "Objects of a recipe are inserted into the pictures in memory, and the detector searches these pictures and the "
    "unchanged ones (`infrablend detectability`). The first `found` is the predicted recall, the share of the inserted "
    "objects that it finds, weighted by the sizes of the labelled ones. The second is the actual recall, that of the "
    "labelled ones. The interval of the difference includes the errors of both; those that hold 0 are counted over all "
    "conditions with 40 real objects or more."
)
_SMOKE = "A smoke run trains for a few steps only, to test that everything runs, and gives no verdicts."
METRICS = {
    "p": "P", "r": "R", "map10": "mAP10", "map50": "mAP50", "map50_95": "mAP50-95", "as_one50": "AP50, classes as one",
    "as_one50_95": "AP50-95, classes as one", "found": "found", "named": "named of found",
    "false_alarms": "false alarms a picture at recall 0.8", "hota": "HOTA", "mota": "MOTA", "idf1": "IDF1",
    "recall": "predicted - actual recall",
}  # fmt: skip


def page_text(facts: ExperimentRecord, plots: Sequence[tuple[str, str]] = (), stem: str | None = None) -> str:
    """Return the page as Markdown.

    Args:
        facts: Content of the results' JSON.
        plots: File name and title of each chart.
        stem: Name of the page's files, without suffix; follows from experiment and scale by default.
    """
    stem = stem or page_name(facts["experiment"], facts["scale"])
    evaluations = facts["evaluations"]
    left_out = bullets(f"`{name}`: {why}." for name, why in facts["left_out"].items())
    elsewhere = ", ".join(f"`{n}`" for n in facts["at_other_scales"])
    blocks = [
        f"# {facts['title']}",
        facts["description"],
        facts["about"],
        f"**Scale: {facts['scale']}. {run_state(facts).capitalize()}.** {PAGE_MARK}",
        f"```text\n{facts['command']}\n```",
        _FROM_SCRATCH if any(_found_no_weights(t) for t in facts["trainings"].values()) else "",
        "" if facts["status"] == "complete" else _unfinished(facts),
        f"Left out:\n\n{left_out}" if left_out else "",
        f"At other scales only: {elsewhere}." if elsewhere else "",
        # Rows of stages at other scales are left out, and so are tables without any other row.
        *(
            b
            for t in facts["tables"]
            if t["rows"]
            for b in (f"## {t['title']}", _figures_table(t["rows"], t["columns"]), t["note"])
        ),
        _CELLS if facts["tables"] else "",
        *_found_lists(evaluations),
        *_recall(facts.get("detectabilities", {})),
        *(["## Datasets", _datasets_table(facts["datasets"])] if facts["datasets"] else []),
        *(["## Conclusions", _claims_table(facts["checks"])] if facts["checks"] else []),
        _SMOKE if facts["checks"] and facts["scale"] == "smoke" else "",
        *(["## Paired differences", *_comparisons(facts["comparisons"])] if facts["comparisons"] else []),
        "## What differs from the paper",
        bullets(list_differences(facts)),
        *(["## Plots", *(f"![{title}]({name})" for name, title in plots)] if plots else []),
        *_ultralytics(evaluations),
        *_found_by(facts["tables"], evaluations),
        *_strata(evaluations, facts["strata_class"] or "all"),
        "## Stages",
        _stages_table(facts["stages"]),
        "## Hardware and versions",
        _provenance(facts),
        f"All figures: [{stem}.json]({stem}.json). All experiments: [index]({INDEX_FILE}).",
    ]
    return markdown_page(blocks)


def _unfinished(facts: ExperimentRecord) -> str:
    reason = f" It stopped: {facts['stopped']}." if facts["stopped"] else ""
    return (
        f"**This run is not finished.**{reason} Missing: {', '.join(f'`{m}`' for m in facts['missing'])}. "
        "Run the same command to continue."
    )


def _figures_table(rows: Sequence[TableRow], metrics: Sequence[str]) -> str:
    """Return a table with paper, ours and difference in each cell, without columns that have no figures."""
    shown = [
        k
        for k in ("images", "instances")
        if any(r["paper"][k] is not None or (r["ours"] or {}).get(k) is not None for r in rows)
    ]
    lines = []
    for r in rows:
        ours: Mapping[str, Any] = r["ours"] or {}
        cells = [r["title"], *(paper_and_ours(r["paper"][k], ours.get(k), ",") for k in shown)]
        for k in metrics:
            cell = paper_and_ours(r["paper"].get(k), ours.get(k), ".3f")
            if k in r["difference"]:
                cell += f" ({r['difference'][k]:+.3f})"
            if interval := (ours.get("ci") or {}).get(k):
                cell += f" [{interval[0]:.3f}, {interval[1]:.3f}]"
            if extent := (ours.get("range") or {}).get(k):
                cell += f" ({extent[0]:.3f} to {extent[1]:.3f})"
            cells.append(cell)
        lines.append(cells)
    text = Table(["", *(k.capitalize() for k in shown), *(METRICS[k] for k in metrics)], lines).markdown()
    if several := max((len(r.get("means_of", ())) for r in rows), default=0):
        text += f"\n\nRows with a range in round brackets show means of {several} trainings, smallest to largest."
    why = sorted({f"{r['title']}: {r['missing']}" for r in rows if r["missing"]})
    return text + ("\n\nRows without our figures: " + "; ".join(why) + "." if why else "")


def _found_lists(evaluations: Mapping[str, EvaluationFigures]) -> Iterator[str]:
    """Yield a section per evaluation that lists its objects one by one."""
    for name, evaluation in evaluations.items():
        if listed := evaluation.get("first_detections"):
            yield f"## Found and missed: `{name}`"
            table = found_table(listed)
            yield f"{table.title}."
            yield table.markdown()


def _recall(measured: Mapping[str, DetectabilityFigures]) -> Iterator[str]:
    """Yield the section on the recall that inserted objects predict, beside that of real ones."""
    if not measured:
        return
    yield "## Predicted and actual recall"
    yield _RECALL
    lines = [
        [of["title"], of["recipe"], of["trained_on"], f"{of['pictures']:,}", of["kind"], _share(of)]
        for of in measured.values()
    ]
    every = {k: sum(of[k] for of in measured.values()) for k in ("holding", "compared")}
    head = ["", "Recipe", "Trained on", "Pictures", "Figure", "Intervals that hold 0"]
    yield Table(head, [*lines, ["all", "", "", "", "", _share(every)]]).markdown()
    rows = [
        ((of["title"], f"{row['confidence']:g}", f"{row['alarms_per_picture']:.2f}"), row)
        for of in measured.values()
        for row in of["confidences"]
    ]
    yield recall_table(rows, ["", "confidence", "alarms"], "").markdown()
    confidence = next(iter(measured.values()))["confidence"]
    for by, words in (("time", "time of day"), ("size", "size")):
        cells = [
            ((of["title"], cell["value"]), cell) for of in measured.values() for cell in of["cells"] if cell["by"] == by
        ]
        if cells:
            yield f"### By {words}, at confidence {confidence:g}"
            yield recall_table(cells, ["", words], "").markdown()


def _share(figures: Mapping[str, Any]) -> str:
    """Return how many intervals hold 0, of how many."""
    holding, compared = figures["holding"], figures["compared"]
    return f"{holding} of {compared} ({holding / compared:.2f})" if compared else "-"


def _datasets_table(rows: Sequence[DatasetRow]) -> str:
    lines = []
    for r in rows:
        paper = r["paper"]
        ours = r["ours"]
        cells = [
            paper_and_ours(paper["images"], ours and ours["images"], ","),
            paper_and_ours(paper["classes"], ours and ours["classes"], ","),
            paper_and_ours(", ".join(paper["labels"]), ours and ", ".join(ours["labels"]), "s"),
        ]
        objects = f"{ours['instances']:,} of {', '.join(ours['names'])}" if ours else f"- ({r['missing']})"
        lines.append([r["title"], *cells, objects])
    return Table(["Dataset", "Images", "Classes", "Labels", "Objects (ours)"], lines).markdown()


def _claims_table(checks: Sequence[Claim]) -> str:
    lines = []
    for c in checks:
        verdict = {True: "**yes**", False: "**no**", None: "-"}[c["holds"]]
        if "missing" in c:
            found = c["missing"]
        elif "cells" in c:
            found = f"largest {_difference(c['difference'], c['ci'])}: {c['where']}; "
            found += f"0 inside {c['holding']} of {c['cells']} intervals"
        elif "ratio" in c:
            found = f"{c['ratio']:.3f} = {c['values'][0]:.3f} / {c['values'][1]:.3f}"
        else:
            found = _difference(c["difference"], c["ci"])
            sign = c.get("same_sign")
            found += "" if sign is None else f", sign kept in {100 * sign:.0f} % of the draws"
        form = "share of intervals of at least {least:g}" if "recall_of" in c and c["least"] else _EXPECTED[c["expect"]]
        expected = form.format(least=c.get("least") or 0, most=c.get("most") or 0)
        lines.append([c["text"], f"{c['class']}, {METRICS[c['metric']]}", expected, found, verdict])
    return Table(["Claim", "Class and metric", "Expected", "Found", "Holds"], lines).markdown()


def _comparisons(comparisons: Mapping[str, ComparisonFigures]) -> list[str]:
    lines = []
    for c in comparisons.values():
        for name in sorted(c["classes"], key=class_order):
            found = [c["classes"][name].get(k) for k in ("map50", "map50_95")]
            lines.append([c["title"], name, *(_difference(d["difference"], d.get("ci")) if d else "-" for d in found)])
    note = (
        "Both detectors are evaluated on the same images and the same bootstrap draws; in brackets the 95 % interval."
    )
    if any(len(c["a"]) > 1 or len(c["b"]) > 1 for c in comparisons.values()):
        note += (
            " Where means of several trainings are compared, the detectors are drawn as well, so the interval includes "
            "the spread between training seeds; elsewhere it does not."
        )
    else:
        note += " It does not include the spread between training seeds."
    return [Table(["Difference", "Class", "mAP50", "mAP50-95"], lines).markdown(), note]


def _difference(value: float, ci: Sequence[float] | None) -> str:
    """Return a difference and, in brackets, its interval, if there is one."""
    return f"{value:+.3f} [{ci[0]:+.3f}, {ci[1]:+.3f}]" if ci else f"{value:+.3f}"


def _ultralytics(evaluations: Mapping[str, EvaluationFigures]) -> Iterator[str]:
    tables = {n: found for n, e in evaluations.items() if (found := e.get("ultralytics"))}
    classes = sorted({c for t in tables.values() for c in t}, key=class_order)
    lines = [[c, *(_ap_pair(t.get(c)) for t in tables.values())] for c in classes]
    if tables:
        yield "## The same figures from Ultralytics' own validation"
        yield Table(["mAP50 / mAP50-95", *tables], lines).markdown()


def _ap_pair(figures: ClassRow | None) -> str:
    if figures is None or figures["map50"] is None:
        return "-"
    return f"{figures['map50']:.3f} / {figures['map50_95']:.3f}"


def _found_by(tables: Sequence[ResultTable], evaluations: Mapping[str, EvaluationFigures]) -> Iterator[str]:
    """Yield the section on objects found by size and visible share, if some were partly hidden.

    The trainings of an evaluation are counted together.
    """
    counts: dict[str, dict[tuple[str, str], list[int]]] = {}
    trainings = {r["evaluation"]: r.get("means_of") or [r["evaluation"]] for t in tables for r in t["rows"]}
    for evaluation, names in trainings.items():
        of_row = counts.setdefault(f"`{evaluation}`", {})
        for name in names:
            targets = evaluations[name].get("targets") if name in evaluations else None
            by = targets.get("by", {}) if targets else {}
            for kind, ranges in by.items() if "visibility" in by else ():
                for stratum, of in ranges.items():
                    found = of_row.setdefault((kind, stratum), [0, 0])
                    found[0] += of["found"]
                    found[1] += of["objects"]
    columns = sorted({c for of in counts.values() for c in of}, key=lambda c: (c[0], stratum_order(c[1])))
    if columns:
        words = [f"{s} {'px' if k == 'size' else 'visible'}" for k, s in columns]
        cells = {t: [of.get(c, (0, 0)) for c in columns] for t, of in counts.items() if of}
        lines = [[t, *(f"{a / n:.2f} of {n:,}" if n else "-" for a, n in row)] for t, row in cells.items()]
        yield "## Found, by size and visible share"
        yield "Share of the objects that any detection overlaps, at the confidence of the best F1, over all trainings."
        yield Table(["", *words], lines).markdown()


def _strata(evaluations: Mapping[str, EvaluationFigures], category: str) -> Iterator[str]:
    """Yield the section on AP by size, pitch, altitude and time, of one class or all."""
    tables = []
    for kind, words in _STRATA.items():
        found = {n: of for n, e in evaluations.items() if (of := (e.get("strata") or {}).get(kind))}
        lines = []
        for stratum in sorted({s for of in found.values() for s in of}, key=stratum_order):
            every = [of[stratum]["classes"].items() if stratum in of else () for of in found.values()]
            rows = [next((f for n, f in of if n.casefold() == category.casefold()), None) for of in every]
            if any(r and r["instances"] for r in rows):
                lines.append([stratum, *(f"{_ap_pair(r)} of {r['instances']:,}" if r else "-" for r in rows)])
        if lines:
            tables.append(Table([words, *found], lines).markdown())
    if tables:
        yield f"## By size, pitch, altitude and time: {'all classes' if category == 'all' else category}"
        yield "mAP50 / mAP50-95, and the number of objects."
        yield from tables


def _stages_table(stages: Sequence[Mapping[str, Any]]) -> str:
    lines = [[f"`{s['stage']}`", f"`{s['key']}`", paper_and_ours(None, s["images"], ","), _status(s)] for s in stages]
    total = sum(s["seconds"] or 0 for s in stages)
    return Table(["Stage", "Key", "Images", "Time"], [*lines, ["all", "", "", _duration(total)]]).markdown()


def _status(stage: Mapping[str, Any]) -> str:
    """Return the time a stage took, or why there is none."""
    if stage["status"] != "complete":
        return "not done" if stage["status"] == "missing" else "not needed"
    if stage["adopted"] == "unchecked":
        return "adopted; how it was made was not checked"
    return "adopted and checked" if stage["adopted"] else _duration(stage["seconds"])


def _provenance(facts: ExperimentRecord) -> str:
    lines = [f"{k.replace('_', ' ')}: {', '.join(map(str, values))}" for k, values in facts["hardware"].items()]
    versions = ", ".join(f"{k} {'/'.join(map(str, v))}" for k, v in facts["versions"].items())
    lines += [f"versions: {versions}"] if versions else []
    return bullets([*lines, f"seed: {facts['seed']}", f"commit: {', '.join(facts['commits']) or 'not a checkout'}"])


def page_name(experiment: str, scale: str) -> str:
    """Return the stem of an experiment's files: its name, followed by the scale unless that is `small`."""
    return experiment if scale == "small" else f"{experiment}-{scale}"


def run_state(facts: ExperimentRecord) -> str:
    """Return the state of a run; if some datasets were not given, it is complete only for the others."""
    some_left_out = facts["status"] == "complete" and facts["left_out"]
    return "complete for the data at hand" if some_left_out else str(facts["status"])


def paper_and_ours(paper: object, ours: object, form: str) -> str:
    """Return `paper → ours`, or ours alone where the paper has no figure; `form` is the format of both."""
    first, second = ("-" if value in (None, "") else f"{value:{form}}" for value in (paper, ours))
    return second if first == "-" else f"{first} → {second}"


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02} min"


def class_order(name: str) -> tuple[bool, str]:
    """Return the sorting key of a class name: `all` first, then alphabetically."""
    return name != "all", name.casefold()


def list_differences(facts: ExperimentRecord) -> list[str]:
    """Return the differences from the paper, one line each."""
    return [*_sources(facts), *_trainings(facts), *_boxes(facts["stages"]), *_scale(facts)]


def _sources(facts: ExperimentRecord) -> Iterator[str]:
    for s in facts["sources"].values():
        paper = s["paper_images"]
        ours = s["images"]
        whole = s["whole"]
        if s["stand_in"]:
            yield f"**{s['title']} was not given: a rendered virtual world stands in for it** ({_per_split(ours)})."
            continue
        line = f"{s['title']}: {_per_split(ours)}"
        if ours != whole:
            line += f", a part of the {sum(whole.values()):,} images that were given"
        if paper and paper != ours:
            line += f"; paper {_per_split(paper)}"
        yield line + (", as in the paper." if paper and paper == ours else ".")
    if facts["renderer"] != "blender":
        yield f"Objects are drawn by the renderer `{facts['renderer']}` as flat shapes: this is a test run."


def _trainings(facts: ExperimentRecord) -> Iterator[str]:
    alike: dict[str, list[str]] = {}
    trainings: Mapping[str, Mapping[str, Any]] = facts["trainings"]
    for name, t in trainings.items():
        alike.setdefault(_training(t), []).append(name)
    for text, names in alike.items():
        yield f"Detector {', '.join(names)}: {text}"
    starts = {n: (t.get("start") or {}).get("kind") for n, t in trainings.items()}
    if len(set(starts.values())) > 1:
        which = ", ".join(f"{n} {kind}" for n, kind in sorted(starts.items()))
        yield f"**The detectors started from different weights, so their differences mean little**: {which}."


def _boxes(stages: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    loosened: dict[str, int] = {}
    for s in stages:
        # A later step that only hands the boxes on does not repeat how they were changed.
        if s.get("boxes_loosened") and (text := looseness_text(s)):
            loosened[text] = loosened.get(text, 0) + s["boxes_loosened"]
    for text, n in sorted(loosened.items()):
        yield (
            f"The training boxes of {n:,} inserted objects are {text}, to match the boxes drawn by the "
            "source's annotators; masks and images are unchanged."
        )


def _scale(facts: ExperimentRecord) -> Iterator[str]:
    if not facts["trainings"]:
        return
    yield (
        "Paper: YOLOv8s, learning rate 0.002, batch 64, 640 px, at most 1000 epochs, patience 100; optimizer and "
        "start weights are not stated."
    )
    if facts["scale"] == "smoke":
        yield "Scale `smoke`: a few training steps, to test that everything runs; the detectors' figures mean nothing."
    elif facts["scale"] != "paper":
        yield f"Scale `{facts['scale']}`: compare these figures with each other, not with the paper's."


def _training(record: Mapping[str, Any]) -> str:
    """Return a training in one line: images, network, length, start and time."""
    settings = record.get("settings") or {}
    prepared = record.get("prepared") or {}
    start = record["start"] or {}
    pictures = prepared.get("pictures")
    tiles = (prepared.get("tiles") or {}).get("tiles")
    number = "" if tiles is None else f"{tiles:,} "
    of_paper = f" (paper: {record['paper_images']:,} for training)" if record.get("paper_images") else ""
    origin = "from scratch" if start.get("kind") == "scratch" else f"from {start.get('model')}"
    parts = [
        f"images {_per_split(pictures)}{of_paper}" if pictures else "",
        # A file of weights has its own network.
        start.get("network") or (None if start.get("kind") == "file" else settings.get("model")),
        f"{number}tiles of {settings['tile']} px at native resolution" if settings.get("tile") else "",
        f"{settings['image_size']} px" if settings.get("image_size") else "",
        f"batch {record['batch']}" if record.get("batch") else "",
        f"{record['passes']:,} images shown in {record.get('epochs_done', '?')} epochs" if record.get("passes") else "",
        f"seed {record['seed']}" if record.get("seed") else "",
        origin + (f" ({start['why']})" if start.get("why") else "") if start else "",
        record.get("precision"),
        record.get("note"),
        f"trained in {_duration(record['seconds'])}{_threads(record)}" if record.get("seconds") else "",
        "trained by a separate command and adopted: settings, seed, image and label counts match"
        if record.get("adopted")
        else "",
    ]
    return "; ".join(str(part) for part in parts if part) + "."


def _threads(record: Mapping[str, Any]) -> str:
    n = record.get("threads") if record.get("device") == "cpu" else None
    return f" with {n} thread{'' if n == 1 else 's'}" if n else ""


def _found_no_weights(record: Mapping[str, Any]) -> bool:
    start = record["start"] or {}
    return start.get("kind") == "scratch" and start.get("why") != "requested"


def _per_split(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{s} {counts[s]:,}" for s in SPLITS if s in counts)
