"""The results of an experiment, collected from the records of its stages: everything that the page shows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from infrablend.annotation.looseness import COUNTS
from infrablend.core.file_names import real_path
from infrablend.detection.truth import class_key
from infrablend.lab.experiments.definition import METRICS, Check, FactsRow, Row, Training
from infrablend.lab.experiments.graph import OTHER_SCALES, StageGraph
from infrablend.lab.experiments.prepare import PreparedExperiment
from infrablend.lab.experiments.stage import FinishedStage, Stage
from infrablend.lab.training.start_weights import AUTO

Finished = Mapping[str, FinishedStage]

_DATA_KINDS = ("world", "source", "generate", "convert", "split", "merge", "paste")
_OF_EVALUATION = (
    "classes",
    "confidence",
    "ultralytics",
    "strata",
    "counts",
    "settings",
    "curves",
    "targets",
    "false_alarms",
)
_IF_LISTED = "first_detections"
_OF_TRACKS = ("hota", "mota", "idf1")
_OF_TRAINING = (
    "preset", "task", "seed", "settings", "classes", "left_out", "prepared", "epochs", "epochs_done", "passes",
    "seconds", "precision", "device", "batch", "threads", "versions", "note", "adopted",
)  # fmt: skip
_OF_STAGE = ("adopted", *COUNTS, "pasted")
_FIGURES = ("images", "instances", *METRICS)


def collect_results(prepared: PreparedExperiment, finished: Finished, stopped: str | None = None) -> dict[str, Any]:
    """Return everything that the page shows, as plain JSON, from the records of finished stages alone."""
    experiment = prepared.experiment
    graph = prepared.graph
    request = prepared.request
    evaluations = {
        n: _evaluation(finished[i].result["metrics"])
        for n in experiment.evaluations
        if (i := f"evaluate:{n}") in finished
    }
    comparisons = {
        n: {
            "title": c.title or f"{', '.join(c.a)} - {', '.join(c.b)}",
            "a": c.a,
            "b": c.b,
            "classes": finished[i].result["classes"],
        }
        for n, c in experiment.comparisons.items()
        if (i := f"compare:{n}") in finished
    }
    required = prepared.required(prepared.finished())
    missing = [s.id for s in graph.stages if s.id not in finished and s.id in required]
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
        **_provenance([finished[s.id].record for s in graph.stages if s.id in finished]),
        "sources": _sources(prepared, finished),
        "stages": [_stage_row(s, graph, finished, required) for s in graph.stages],
        "trainings": {
            n: _training(finished[i].result["record"], t)
            for n, t in experiment.trainings.items()
            if (i := f"train:{n}") in finished
        },
        "evaluations": evaluations,
        "comparisons": comparisons,
        "tables": [
            {
                "title": t.title,
                "note": t.note,
                "columns": t.columns,
                "rows": list(_rows(t.rows, t.evaluation, evaluations, graph.left_out)),
            }
            for t in experiment.tables
        ],
        "datasets": [_dataset_row(f, graph, finished) for f in experiment.facts],
        "strata_class": experiment.strata,
        "checks": [
            check_claim(c, evaluations, comparisons, graph.left_out, verdict=request.scale != "smoke")
            for c in experiment.checks
            if request.scale in c.scales
        ],
    }


def _evaluation(metrics: Mapping[str, Any]) -> dict[str, Any]:
    listed = {_IF_LISTED: metrics[_IF_LISTED]} if _IF_LISTED in metrics else {}
    found = {k: metrics.get(k) for k in _OF_EVALUATION} | listed
    if tracks := metrics.get("tracks"):
        found["tracks"] = tracks
        found["classes"] = {n: _with_tracks(of, tracks["classes"].get(n, {})) for n, of in metrics["classes"].items()}
    return found


def _with_tracks(of_class: Mapping[str, Any], tracks: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of a class with those of its tracks."""
    figures = {k: tracks.get(k) for k in _OF_TRACKS}
    intervals = {k: v for k in _OF_TRACKS if (v := (tracks.get("ci") or {}).get(k))}
    return {**of_class, **figures, "ci": {**(of_class.get("ci") or {}), **intervals}}


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


def _provenance(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return commits, hardware and versions of the stages, which may have run on several machines."""
    commits = [r["commit"] for r in records if r["commit"]]
    return {
        "commit": commits[-1] if commits else None,
        "commits": sorted(set(commits)),
        "hardware": _distinct_values([{**r["machine"], **_training_device(r)} for r in records]),
        "versions": _distinct_values([r["packages"] for r in records]),
    }


def _distinct_values(records: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    names = sorted({k for r in records for k in r})
    return {k: list(dict.fromkeys(r[k] for r in records if r.get(k) is not None)) for k in names}


def _training_device(record: Mapping[str, Any]) -> dict[str, Any]:
    trained = record["result"].get("record", {}) if record["kind"] == "train" else {}
    return {"trained_on": str(trained["device"])} if trained.get("device") else {}


def _sources(prepared: PreparedExperiment, finished: Finished) -> dict[str, dict[str, Any]]:
    return {
        name: {
            "title": s.title,
            "stand_in": name in prepared.graph.stand_ins,
            "images": finished[i].result["images"],
            "whole": finished[i].result["whole"],
            "paper_images": dict(s.paper_images),
        }
        for name, s in prepared.experiment.sources.items()
        if (i := f"source:{name}") in finished
    }


def _stage_row(stage: Stage, graph: StageGraph, finished: Finished, required: set[str]) -> dict[str, Any]:
    row = {"stage": stage.id, "key": graph.keys[stage.id]}
    made = finished.get(stage.id)
    if made is None:
        status = "missing" if stage.id in required else "not needed"
        return {**row, "images": None, "seconds": None, "status": status, **dict.fromkeys(_OF_STAGE)}
    images = made.result["images"] if stage.kind in _DATA_KINDS else stage.images
    trained_s = made.result.get("record", {}).get("seconds") or 0  # over all sittings; the stage's own are of the last
    facts = {"images": sum(images.values()), "seconds": max(made.record["seconds"], trained_s), "status": "complete"}
    return {**row, **facts, **{k: made.result.get(k) for k in _OF_STAGE}}


def _training(record: Mapping[str, Any], spec: Training) -> dict[str, Any]:
    kept = {k: record[k] for k in _OF_TRAINING if k in record}
    start = dict(record.get("start") or {})
    if start.get("model"):
        start["model"] = Path(start["model"]).name
        start["why"] = start.get("why", "").split(":")[0]  # the rest names paths of the machine
    return {**kept, "start": start, "paper_images": spec.paper_images}


def _rows(
    rows: Sequence[Row], default: str | None, evaluations: Mapping[str, Any], left_out: Mapping[str, str]
) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table: those of the file, then further classes of the table's own evaluation."""
    shown: set[str] = set()
    of_default: Mapping[str, Any] = evaluations.get(default or "", {}).get("classes", {})
    for row in rows:
        names = [e for e in row.evaluation or (default or "",) if left_out.get(e) != OTHER_SCALES]
        if not names:
            continue
        figures = [_class_figures(evaluations.get(e, {}), row.category) for e in names]
        if names == [default] and figures[0] is not None:
            shown |= {n for n, of in of_default.items() if of is figures[0]}
        yield _row(row, names, figures, next((left_out[e] for e in names if e in left_out), None))
    for name in sorted(of_default):
        if name not in shown:
            yield _row(Row(title=name, category=name), [default or ""], [of_default[name]], None)


def _class_figures(found: Mapping[str, Any], category: str) -> Mapping[str, Any] | None:
    """Return the figures of a class in an evaluation or comparison, whatever its case and blanks, or None."""
    classes: Mapping[str, Any] = found.get("classes", {})
    return next((of for name, of in classes.items() if class_key(name) == class_key(category)), None)


def _row(
    row: Row, names: Sequence[str], figures: Sequence[Mapping[str, Any] | None], why: str | None
) -> dict[str, Any]:
    """Return the paper's figures, ours from the named evaluations, and their differences, or why ours are missing."""
    known = [f for f in figures if f is not None]
    ours = None if len(known) < len(names) else known[0] if len(known) == 1 else _means(known)
    paper = row.paper.model_dump()
    found = {k: (ours or {}).get(k) for k in _FIGURES}
    both = {k: (found[k], paper.get(k)) for k in METRICS}
    extent = {} if ours is None or "range" not in ours else {"range": ours["range"]}
    return {
        "title": row.title,
        "evaluation": names[0],
        **({"means_of": list(names)} if len(names) > 1 else {}),
        "class": row.category,
        "paper": paper,
        "ours": None if ours is None else {**found, "ci": ours.get("ci"), **extent},
        "difference": {k: round(a - b, 6) for k, (a, b) in both.items() if a is not None and b is not None},
        "missing": None if ours is not None else why or "not run yet, or the class does not occur",
    }


def _means(figures: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the means of figures on the same images, with the smallest and largest value of each metric."""
    means: dict[str, Any] = {k: figures[0].get(k) for k in _FIGURES}
    extent: dict[str, list[float]] = {}
    for k in METRICS:
        values = [f[k] for f in figures if f.get(k) is not None]
        means[k] = round(sum(values) / len(values), 6) if values else None
        extent |= {k: [min(values), max(values)]} if values else {}
    return {**means, "range": extent}


def _dataset_row(row: FactsRow, graph: StageGraph, finished: Finished) -> dict[str, Any]:
    by_name = {s.name: s.id for s in graph.stages if s.kind in _DATA_KINDS and s.kind != "world"}
    parts = [finished[by_name[d]].result if by_name.get(d) in finished else None for d in row.data]
    paper = {"images": row.images, "classes": row.classes, "labels": list(row.labels)}
    known = [p for p in parts if p is not None]
    ours = None
    if len(known) == len(parts):
        names = list(dict.fromkeys(c for p in known for c in p["classes"]))
        ours = {
            "images": sum(sum(p["images"].values()) for p in known),
            "classes": len(names),
            "names": names,
            "labels": [k for k in ("AABB", "OBB", "Masks") if any(k in p["label_kinds"] for p in known)],
            "instances": sum(n for p in known for of_split in p["labels"].values() for n in of_split.values()),
        }
    why = next((graph.left_out[d] for d in row.data if d in graph.left_out), "not made yet")
    return {"title": row.title, "paper": paper, "ours": ours, "missing": None if ours else why}


def check_claim(
    check: Check,
    evaluations: Mapping[str, Any],
    comparisons: Mapping[str, Any],
    left_out: Mapping[str, str],
    *,
    verdict: bool = True,
) -> dict[str, Any]:
    """Return a claim with the numbers it rests on and `holds`: True, False, or None where that cannot be decided.

    Without `verdict` (a smoke run trains only a few steps) `holds` is always None.
    """
    claim: dict[str, Any] = {
        "text": check.text,
        "class": check.category,
        "metric": check.metric,
        "expect": check.expect,
        "holds": None,
    }
    if check.comparison is not None:
        return claim | _check_interval(check, comparisons, left_out, verdict)
    return claim | _check_ratio(check, evaluations, left_out, verdict)


def _check_interval(
    check: Check, comparisons: Mapping[str, Any], left_out: Mapping[str, str], verdict: bool
) -> dict[str, Any]:
    assert check.comparison is not None
    found = (_class_figures(comparisons.get(check.comparison, {}), check.category) or {}).get(check.metric)
    if found is None or found.get("ci") is None:
        why = left_out.get(check.comparison, "not run yet, or no such class or figure")
        return {"comparison": check.comparison, "missing": why}
    low, high = found["ci"]
    holds = {
        "below": high < 0,
        "above": low > 0,
        "within": low <= 0 <= high,
        "not_below": high >= 0,
        "report": None,
    }[check.expect]
    return {
        "comparison": check.comparison,
        "difference": found["difference"],
        "ci": [low, high],
        "same_sign": found.get("same_sign"),
        "holds": holds if verdict else None,
    }


def _check_ratio(
    check: Check, evaluations: Mapping[str, Any], left_out: Mapping[str, str], verdict: bool
) -> dict[str, Any]:
    assert check.ratio is not None
    names = [e for side in check.ratio for e in side]
    found = {e: _figure(evaluations.get(e, {}), check) for e in names}
    means = [_mean([found[e] for e in side]) for side in check.ratio]
    head = {"ratio_of": [", ".join(side) for side in check.ratio], "least": check.least}
    if means[0] is None or means[1] is None:
        lacking = [e for e in names if found[e] is None]
        there = all(e in evaluations for e in lacking)
        why = "no such figure in the evaluation" if there else "not run yet"
        return {**head, "missing": next((left_out[e] for e in names if e in left_out), why)}
    if means[1] == 0:
        return {**head, "missing": "the second figure is 0"}
    ratio = means[0] / means[1]
    holds = None if check.least is None or not verdict else ratio >= check.least
    return {**head, "values": means, "ratio": round(ratio, 6), "holds": holds}


def _figure(evaluation: Mapping[str, Any], check: Check) -> float | None:
    if check.time is not None:
        evaluation = evaluation.get("strata", {}).get("time", {}).get(check.time, {})
    found: float | None = (_class_figures(evaluation, check.category) or {}).get(check.metric)
    return found


def _mean(values: Sequence[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return sum(known) / len(values) if len(known) == len(values) else None
