"""`infrablend train` and `infrablend evaluate`: detectors of the objects."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend import api
from infrablend.cli.options import (
    DatasetArgument,
    Fields,
    JsonSession,
    ReadingOfAllSplits,
    ReadingOfFormat,
    earlier_output,
    reported,
)
from infrablend.cli.output import grid, human_bytes, print_problems, show_result, shown_progress, table
from infrablend.report.figures import human_seconds

if TYPE_CHECKING:
    from infrablend.config.agc import Agc
    from infrablend.lab.evaluation.evaluate import EvaluationReport
    from infrablend.lab.training.training_record import TrainingRecord
    from infrablend.report.page import Table


def _agc(text: str) -> Agc:
    from infrablend.config.agc import parse_agc

    return parse_agc(text)


def train(
    session: JsonSession,
    *,
    dataset: DatasetArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for weights.pt and train.json.")],
    request: Annotated[
        api.TrainRequest,
        Fields(
            settings=typer.Option("--set"),
            weights=typer.Option(metavar="FILE|NAME|scratch|auto"),
            classes=typer.Option(metavar="A,B"),
            agc=Annotated[str, typer.Option(metavar="linear|plateau|{...}", parser=reported(_agc))],
        ),
    ],
    reading: ReadingOfFormat,
    plan: Annotated[bool, typer.Option("--plan", help="Show images, epochs, time and disk without training.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the training in DIR.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the training in DIR.")] = False,
) -> None:
    """Train a detector with Ultralytics (extra `train`); Ctrl-C stops it, and --resume continues."""
    existing = earlier_output(resume, overwrite)
    if plan:
        p = api.plan_train(dataset, request, reading=reading, out=out, existing=existing)
        rows = {
            "tiles" if p.tiled else "images": str(p.images),
            "labels of the split": str(p.labels),
            "epochs": f"{p.epochs} of {p.shown} images shown",
            "start weights": start_text(p.weights, p.network),
            "device": p.device if p.device in ("cpu", "mps") else f"GPU {p.device}",
            "time, about": human_seconds(p.seconds),
            "disk, about": human_bytes(p.disk_bytes),
        }
        show_result(session, asdict(p), lambda: table(rows))
        return
    with shown_progress(session, "training") as on_progress:
        report = api.train(dataset, out, request, reading=reading, existing=existing, on_progress=on_progress)
    show_result(session, report.to_json(), lambda: f"{table(_training(report.record))}\n{report.weights}")


def start_text(weights: str, network: str) -> str:
    """Return a text on start weights and network of a planned training."""
    own = "" if weights in ("auto", "scratch") else "their "
    return f"{weights}, {own}network {network or 'unknown before their download'}"


def _training(record: TrainingRecord) -> dict[str, str]:
    """Return the rows on a finished training; an object counts once per tile that contains it."""
    start = record["start"]
    prepared = record["prepared"]
    used = f"{prepared['images']}, {prepared['labels']}: all used"
    tiles = prepared.get("tiles")
    pieces = tiles and tiles["labels_left_out"]
    rows = {
        "classes": ", ".join(record["classes"]),
        "started from": start["model"] + (f" ({start['why']})" if start["why"] else ""),
        "tiles, labels in them" if tiles else "images, labels": (
            used + (f"; {pieces} small pieces at edges are unlabelled" if pieces else "")
        ),
        "epochs": f"{record['epochs_done']} ({record['passes']} images shown)",
        "time": human_seconds(record["seconds"]),
    }
    if record["left_out"]:
        rows["labels left out"] = ", ".join(f"{k} {n}" for k, n in record["left_out"].items())
    return rows


def evaluate(
    session: JsonSession,
    *,
    weights: Annotated[
        Path,
        typer.Argument(
            metavar="WEIGHTS", help="Weights (.pt), predictions.json of an evaluation, or the folder of either."
        ),
    ],
    dataset: DatasetArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write, new or empty.")] = Path("evaluation"),
    settings: Annotated[
        api.EvaluationSettings,
        Fields(
            image_size=typer.Option(min=0, metavar="PX"),
            classes=typer.Option(metavar="A,B"),
            bootstrap=typer.Option(min=0, metavar="N"),
            list_first=typer.Option(min=0, metavar="N"),
            list_iou=typer.Option(metavar="IOU"),
        ),
    ],
    device: Annotated[str, typer.Option(help="auto, cpu, cuda, cuda:1, mps.")] = "auto",
    against: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Another evaluation on the same images, to compare with.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier evaluation.")] = False,
    reading: ReadingOfAllSplits,
) -> None:
    """Evaluate a detector: P, R, mAP50, mAP50-95 by class with intervals, by size, pitch, altitude, day and night."""
    with shown_progress(session, "detecting") as on_progress:
        report = api.evaluate(
            weights, dataset, out, settings,
            device=device, reading=reading, against=against, overwrite=overwrite, on_progress=on_progress,
        )  # fmt: skip
    print_problems(report.problems, session.log_path, report.out / "evaluation.json")
    show_result(session, {"out": str(report.out)} | report.to_json(), lambda: "\n\n".join(_evaluation(report)))


def _evaluation(report: EvaluationReport) -> list[str]:
    from infrablend.lab.pages import evaluation_page as page
    from infrablend.report.figures import decimals, interval

    metrics = report.metrics
    classes = metrics["classes"]
    targets = page.target_table(metrics["targets"], classes)
    found_by = page.kind_table(metrics["targets"], "size or visible share")
    by_class = page.class_table(classes, {"map50_95": "interval"})
    blocks = [grid(by_class.head, by_class.rows), page.as_one_text(classes["all"]), _titled(targets)]
    blocks.append(grid(found_by.head, found_by.rows))
    if metrics["false_alarms"]["pictures"]:
        blocks.append(_titled(page.alarm_table(metrics["false_alarms"])))
    if tracks := metrics.get("tracks"):
        blocks.append(_titled(page.track_table(tracks, ["hota"])))
    if metrics["ultralytics"]:
        blocks.append(_titled(page.class_table(metrics["ultralytics"]), "by Ultralytics' own code"))
    if metrics["paired"]:
        lines = []
        for name, of in metrics["paired"]["classes"].items():
            d = of["map50_95"]
            if d is not None:
                ends = interval(d["ci"], signed=True)
                lines.append([name, decimals(d["ours"]), decimals(d["theirs"]), f"{d['difference']:+.3f}", ends])
        head = ["class", "this", metrics["paired"]["against"]["name"], "difference", "interval"]
        blocks.append("mAP50-95 on the same images:\n" + grid(head, lines))
    if listed := metrics.get("first_detections"):
        blocks.append(_titled(page.found_table(listed)))
    detector = metrics["detector"]
    if "image_size" in detector:
        size = f"a longer side of {detector['image_size']} px" if detector["image_size"] else "their own size"
        blocks.append(f"pictures at {size}: {detector.get('image_size_from', 'as saved')}")
    return [*blocks, str(report.out / "evaluation.html")]


def _titled(found: Table, title: str = "") -> str:
    return f"{title or found.title}:\n{grid(found.head, found.rows)}"
