"""The results of an experiment, collected from the records of its stages: everything that the page shows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar, cast

from infrablend.annotation.looseness import COUNTS
from infrablend.core.file_names import real_path
from infrablend.detection.truth import class_key
from infrablend.lab.evaluation.evaluation_record import ClassRow, EvaluationRecord, TrackRow
from infrablend.lab.experiments.definition import METRICS, Check, FactsRow, Row, Training
from infrablend.lab.experiments.graph import OTHER_SCALES, StageGraph
from infrablend.lab.experiments.prepare import PreparedExperiment
from infrablend.lab.experiments.recall_cells import check_recall, detectability_figures
from infrablend.lab.experiments.result_record import (
    Claim,
    ComparisonFigures,
    DatasetRow,
    DetectabilityFigures,
    EvaluationFigures,
    ExperimentRecord,
    OurDataset,
    ResultTable,
    SourceFacts,
    TableRow,
)
from infrablend.lab.experiments.stage import FinishedStage, Stage
from infrablend.lab.training.start_weights import AUTO
from infrablend.lab.training.training_record import TrainingRecord

Finished = Mapping[str, FinishedStage]
T = TypeVar("T")

_DATA_KINDS = ("world", "source", "generate", "convert", "split", "merge", "paste")
_OF_TRACKS = ("hota", "mota", "idf1")
_OF_TRAINING = (
    "preset", "task", "seed", "settings", "classes", "left_out", "prepared", "epochs", "epochs_done", "passes",
    "seconds", "precision", "device", "batch", "threads", "versions", "note", "adopted",
)  # fmt: skip
_OF_STAGE = ("adopted", *COUNTS, "pasted")
_FIGURES = ("images", "instances", *METRICS)


def collect_results(prepared: PreparedExperiment, finished: Finished, stopped: str | None = None) -> ExperimentRecord:
    """Return everything that the page shows, as plain JSON, from the records of finished stages alone."""
    experiment = prepared.experiment
    graph = prepared.graph
    request = prepared.request
    evaluations = {
        n: _evaluation(finished[i].evaluated["metrics"])
        for n in experiment.evaluations
        if (i := f"evaluate:{n}") in finished
    }
    detectabilities = {
        n: detectability_figures(n, d, finished[i].measured["facts"])
        for n, d in experiment.detectabilities.items()
        if (i := f"detectability:{n}") in finished
    }
    comparisons: dict[str, ComparisonFigures] = {
        n: {
            "title": c.title or f"{', '.join(c.a)} - {', '.join(c.b)}",
            "a": c.a,
            "b": c.b,
            "classes": finished[i].compared["classes"],
        }
        for n, c in experiment.comparisons.items()
        if (i := f"compare:{n}") in finished
    }
    tables: list[ResultTable] = [
        {
            "title": t.title,
            "note": t.note,
            "columns": t.columns,
            "rows": list(_rows(t.rows, t.evaluation, evaluations, graph.left_out)),
        }
        for t in experiment.tables
    ]
    required = prepared.required(prepared.finished())
    missing = [s.id for s in graph.stages if s.id not in finished and s.id in required]
    records = [finished[s.id].record for s in graph.stages if s.id in finished]
    commits = [commit for r in records if (commit := r["commit"])]
    return {
        "experiment": experiment.name,
        "title": experiment.title,
        "description": experiment.description,
        "about": experiment.about,
        "scale": request.scale,
        "seed": request.seed,
        "renderer": request.renderer,
        "status": "unfinished" if missing else "complete",
        "stopped": stopped if missing else None,
        "missing": missing,
        "left_out": {n: why for n, why in graph.left_out.items() if why != OTHER_SCALES},
        "at_other_scales": [n for n, why in graph.left_out.items() if why == OTHER_SCALES],
        "command": _command(prepared),
        "commit": commits[-1] if commits else None,
        "commits": sorted(set(commits)),
        # Stages may have run on several machines.
        "hardware": _distinct_values(
            [
                *(finished[s.id].record["machine"] for s in graph.stages if s.id in finished),
                *({"trained_on": str(d)} for d in _training_devices(graph, finished)),
            ]
        ),
        "versions": _distinct_values([r["packages"] for r in records]),
        "sources": _sources(prepared, finished),
        "stages": [_stage_row(s, graph, finished, required) for s in graph.stages],
        "trainings": {
            n: _training(finished[i].trained["record"], t)
            for n, t in experiment.trainings.items()
            if (i := f"train:{n}") in finished
        },
        "evaluations": evaluations,
        "detectabilities": detectabilities,
        "comparisons": comparisons,
        "tables": tables,
        "datasets": [_dataset_row(f, graph, finished) for f in experiment.facts],
        "strata_class": experiment.strata,
        "checks": [
            check_claim(c, evaluations, comparisons, graph.left_out, detectabilities, verdict=request.scale != "smoke")
            for c in experiment.checks
            if request.scale in c.scales
        ],
    }


def _evaluation(metrics: EvaluationRecord) -> EvaluationFigures:
    found: EvaluationFigures = {
        "classes": metrics["classes"],
        "confidence": metrics.get("confidence"),
        "ultralytics": metrics.get("ultralytics"),
        "strata": metrics.get("strata"),
        "counts": metrics.get("counts"),
        "settings": metrics.get("settings"),
        "curves": metrics.get("curves"),
        "targets": metrics.get("targets"),
        "false_alarms": metrics.get("false_alarms"),
    }
    if (listed := metrics.get("first_detections")) is not None:
        found["first_detections"] = listed
    if tracks := metrics.get("tracks"):
        found["tracks"] = tracks
        found["classes"] = {n: _with_tracks(of, tracks["classes"].get(n)) for n, of in metrics["classes"].items()}
    return found


def _with_tracks(of_class: ClassRow, tracks: TrackRow | None) -> ClassRow:
    """Return the figures of a class with those of its tracks."""
    row: dict[str, object] = {**of_class, **dict.fromkeys(_OF_TRACKS)}
    intervals = dict(of_class.get("ci") or {})
    if tracks is not None:
        row |= {k: v for k, v in tracks.items() if k in _OF_TRACKS}
        intervals |= {k: v for k, v in (tracks.get("ci") or {}).items() if k in _OF_TRACKS and v}
    return cast("ClassRow", {**row, "ci": intervals})


def _command(prepared: PreparedExperiment) -> str:
    """Return the command that gives these results, without paths of this machine."""
    request = prepared.request
    words = ["infrablend experiment", prepared.experiment.name, "--scale", request.scale]
    words += [f"--set {k}={v}" for k, v in request.training.items()]
    words += [] if request.weights == AUTO else ["--weights", Path(request.weights).name]
    formats = Counter(s.format for s in prepared.experiment.sources.values())
    for name, path in prepared.graph.given.items():
        of_several = formats[prepared.experiment.sources[name].format] > 1
        words += ["--data", f"{name}={real_path(path).name}" if of_several else real_path(path).name]
    return " ".join([*words, *(["--seed", str(request.seed)] if request.seed else [])])


def _distinct_values(records: Sequence[Mapping[str, object]]) -> dict[str, list[object]]:
    names = sorted({k for r in records for k in r})
    return {k: list(dict.fromkeys(r[k] for r in records if r.get(k) is not None)) for k in names}


def _training_devices(graph: StageGraph, finished: Finished) -> Iterator[str]:
    for stage in graph.stages:
        if stage.kind == "train" and stage.id in finished:
            device = finished[stage.id].trained["record"].get("device")
            if device:
                yield device


def _sources(prepared: PreparedExperiment, finished: Finished) -> dict[str, SourceFacts]:
    return {
        name: {
            "title": s.title,
            "stand_in": name in prepared.graph.stand_ins,
            "images": finished[i].data["images"],
            "whole": finished[i].data["whole"],
            "paper_images": {str(split): n for split, n in s.paper_images.items()},
        }
        for name, s in prepared.experiment.sources.items()
        if (i := f"source:{name}") in finished
    }


def _stage_row(stage: Stage, graph: StageGraph, finished: Finished, required: set[str]) -> dict[str, object]:
    row = {"stage": stage.id, "key": graph.keys[stage.id]}
    made = finished.get(stage.id)
    if made is None:
        status = "missing" if stage.id in required else "not needed"
        return {**row, "images": None, "seconds": None, "status": status, **dict.fromkeys(_OF_STAGE)}
    images = made.data["images"] if stage.kind in _DATA_KINDS else stage.images
    seconds = made.record["seconds"]
    if stage.kind == "train":  # over all sittings; the stage's own are of the last
        seconds = max(seconds, made.trained["record"].get("seconds") or 0)
    facts = {"images": sum(images.values()), "seconds": seconds, "status": "complete"}
    return {**row, **facts, **{k: made.record["result"].get(k) for k in _OF_STAGE}}


def _training(record: TrainingRecord, spec: Training) -> dict[str, object]:
    kept = {k: v for k, v in record.items() if k in _OF_TRAINING}
    start: dict[str, object] = {}
    if of := record.get("start"):
        start = {**of}
        if model := of.get("model"):
            start["model"] = Path(model).name
            start["why"] = of.get("why", "").split(":")[0]  # the rest names paths of the machine
    return {**kept, "start": start, "paper_images": spec.paper_images}


def _rows(
    rows: Sequence[Row],
    default: str | None,
    evaluations: Mapping[str, EvaluationFigures],
    left_out: Mapping[str, str],
) -> Iterator[TableRow]:
    """Yield the rows of a table: those of the file, then further classes of the table's own evaluation."""
    shown: set[str] = set()
    of_default = evaluations[default]["classes"] if default is not None and default in evaluations else {}
    for row in rows:
        names = [e for e in row.evaluation or (default or "",) if left_out.get(e) != OTHER_SCALES]
        if not names:
            continue
        figures = [_of_class(evaluations[e]["classes"], row.category) if e in evaluations else None for e in names]
        if names == [default] and figures[0] is not None:
            shown |= {n for n, of in of_default.items() if of is figures[0]}
        yield _row(row, names, figures, next((left_out[e] for e in names if e in left_out), None))
    for name in sorted(of_default):
        if name not in shown:
            yield _row(Row(title=name, category=name), [default or ""], [of_default[name]], None)


def _of_class(classes: Mapping[str, T], category: str) -> T | None:
    """Return what is known of a class, whatever its case and blanks, or None."""
    return next((of for name, of in classes.items() if class_key(name) == class_key(category)), None)


def _numbers(figures: ClassRow) -> dict[str, float | None]:
    of = cast("Mapping[str, float | None]", figures)
    return {k: of.get(k) for k in _FIGURES}


def _row(row: Row, names: Sequence[str], figures: Sequence[ClassRow | None], why: str | None) -> TableRow:
    """Return the paper's figures, ours from the named evaluations, and their differences, or why ours are missing."""
    known = [f for f in figures if f is not None]
    found: dict[str, float | None] = dict.fromkeys(_FIGURES)
    ours: dict[str, object] | None = None
    if len(known) == len(names) == 1:
        found = _numbers(known[0])
        ours = {**found, "ci": known[0].get("ci")}
    elif len(known) == len(names):
        found, extent = _means([_numbers(f) for f in known])
        ours = {**found, "ci": None, "range": extent}
    paper: dict[str, float | None] = row.paper.model_dump()
    both = {k: (found[k], paper.get(k)) for k in METRICS}
    shown: TableRow = {
        "title": row.title,
        "evaluation": names[0],
        "class": row.category,
        "paper": paper,
        "ours": ours,
        "difference": {k: round(a - b, 6) for k, (a, b) in both.items() if a is not None and b is not None},
        "missing": None if ours is not None else why or "not run yet, or the class does not occur",
    }
    if len(names) > 1:
        shown["means_of"] = list(names)
    return shown


def _means(figures: Sequence[Mapping[str, float | None]]) -> tuple[dict[str, float | None], dict[str, list[float]]]:
    """Return the means of figures on the same images, with the smallest and largest value of each metric."""
    means = {k: figures[0][k] for k in _FIGURES}
    extent: dict[str, list[float]] = {}
    for k in METRICS:
        values = [v for f in figures if (v := f[k]) is not None]
        means[k] = round(sum(values) / len(values), 6) if values else None
        extent |= {k: [min(values), max(values)]} if values else {}
    return means, extent


def _dataset_row(row: FactsRow, graph: StageGraph, finished: Finished) -> DatasetRow:
    by_name = {s.name: s.id for s in graph.stages if s.kind in _DATA_KINDS and s.kind != "world"}
    known = [finished[i].data for d in row.data if (i := by_name.get(d)) is not None and i in finished]
    ours: OurDataset | None = None
    if len(known) == len(row.data):
        names = list(dict.fromkeys(c for p in known for c in p["classes"]))
        ours = {
            "images": sum(sum(p["images"].values()) for p in known),
            "classes": len(names),
            "names": names,
            "labels": [k for k in ("AABB", "OBB", "Masks") if any(k in p["label_kinds"] for p in known)],
            "instances": sum(n for p in known for of_split in p["labels"].values() for n in of_split.values()),
        }
    why = next((graph.left_out[d] for d in row.data if d in graph.left_out), "not made yet")
    return {
        "title": row.title,
        "paper": {"images": row.images, "classes": row.classes, "labels": list(row.labels)},
        "ours": ours,
        "missing": None if ours else why,
    }


def check_claim(
    check: Check,
    evaluations: Mapping[str, EvaluationFigures],
    comparisons: Mapping[str, ComparisonFigures],
    left_out: Mapping[str, str],
    detectabilities: Mapping[str, DetectabilityFigures] | None = None,
    *,
    verdict: bool = True,
) -> Claim:
    """Return a claim with the numbers it rests on and `holds`: True, False, or None where that cannot be decided.

    Without `verdict` (a smoke run trains only a few steps) `holds` is always None.
    """
    claim: Claim = {
        "text": check.text,
        "class": check.category,
        "metric": check.metric,
        "expect": check.expect,
        "holds": None,
    }
    if check.recall is not None:
        check_recall(claim, check, detectabilities or {}, left_out)
    elif check.comparison is not None:
        _check_interval(claim, check, comparisons, left_out)
    else:
        _check_ratio(claim, check, evaluations, left_out)
    if not verdict:
        claim["holds"] = None
    return claim


def _check_interval(
    claim: Claim, check: Check, comparisons: Mapping[str, ComparisonFigures], left_out: Mapping[str, str]
) -> None:
    assert check.comparison is not None
    claim["comparison"] = check.comparison
    compared = comparisons.get(check.comparison)
    of_class = None if compared is None else _of_class(compared["classes"], check.category)
    found = None if of_class is None else of_class.get(check.metric)
    if found is None or found["ci"] is None:
        claim["missing"] = left_out.get(check.comparison, "not run yet, or no such class or figure")
        return
    low, high = found["ci"]
    claim["difference"] = found["difference"]
    claim["ci"] = [low, high]
    claim["same_sign"] = found.get("same_sign")
    claim["holds"] = {
        "below": high < 0,
        "above": low > 0,
        "within": low <= 0 <= high,
        "not_below": high >= 0,
        "report": None,
    }[check.expect]


def _check_ratio(
    claim: Claim, check: Check, evaluations: Mapping[str, EvaluationFigures], left_out: Mapping[str, str]
) -> None:
    assert check.ratio is not None
    names = [e for side in check.ratio for e in side]
    found = {e: _figure(evaluations.get(e), check) for e in names}
    first, second = (_mean([found[e] for e in side]) for side in check.ratio)
    claim["ratio_of"] = [", ".join(side) for side in check.ratio]
    claim["least"] = check.least
    if first is None or second is None:
        lacking = [e for e in names if found[e] is None]
        there = all(e in evaluations for e in lacking)
        why = "no such figure in the evaluation" if there else "not run yet"
        claim["missing"] = next((left_out[e] for e in names if e in left_out), why)
    elif second == 0:
        claim["missing"] = "the second figure is 0"
    else:
        claim["values"] = [first, second]
        claim["ratio"] = round(first / second, 6)
        claim["holds"] = None if check.least is None else first / second >= check.least


def _figure(evaluation: EvaluationFigures | None, check: Check) -> float | None:
    if evaluation is None:
        return None
    classes = evaluation["classes"]
    if check.time is not None:
        times = (evaluation.get("strata") or {}).get("time", {})
        classes = times[check.time]["classes"] if check.time in times else {}
    row = _of_class(classes, check.category)
    return None if row is None else _numbers(row)[check.metric]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return sum(known) / len(values) if len(known) == len(values) else None
