"""`infrablend train`: train a detector on a dataset."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from infrablend.cli.options import (
    DatasetArgument,
    FormatOption,
    JsonOption,
    ReadingOption,
    comma_list,
    earlier_output,
    make_reading,
    yaml_values,
)

if TYPE_CHECKING:
    from infrablend.cli.session import Session
    from infrablend.config.agc import Agc


class PresetName(StrEnum):
    """Training preset."""

    PAPER = "paper"
    SMALL = "small"
    SMOKE = "smoke"


class TaskName(StrEnum):
    """Task of the detector."""

    DETECT = "detect"
    OBB = "obb"
    SEGMENT = "segment"


def train(
    ctx: typer.Context,
    dataset: DatasetArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for weights.pt and train.json.")],
    preset: Annotated[
        PresetName,
        typer.Option(help="paper: YOLOv8s as in the paper, for a GPU; small: two cores, minutes; smoke: a few steps."),
    ] = PresetName.SMALL,
    task: Annotated[TaskName, typer.Option(help="Boxes, oriented boxes or masks.")] = TaskName.DETECT,
    weights: Annotated[
        str,
        typer.Option(
            metavar="FILE|NAME|scratch|auto",
            help="Starting point; auto: the preset's published weights, or scratch if they cannot be downloaded.",
        ),
    ] = "auto",
    classes: Annotated[str | None, typer.Option(metavar="A,B", help="Only these classes [default: all].")] = None,
    device: Annotated[str, typer.Option(help="auto, cpu, mps, cuda, or one GPU: cuda:1 or 1.")] = "auto",
    seed: Annotated[int, typer.Option(help="Seed of weights, order, augmentation and tiles.")] = 0,
    setting: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Field of the preset (passes, epochs, batch ...) or argument of Ultralytics.",
        ),
    ] = None,
    agc: Annotated[
        str,
        typer.Option(
            metavar="linear|plateau|{...}",
            help="Automatic gain control for 16-bit pictures, e.g. {mode: fixed, low_c: 0, high_c: 40}.",
        ),
    ] = "linear",
    format: FormatOption = None,
    options: ReadingOption = None,
    plan: Annotated[bool, typer.Option("--plan", help="Show images, epochs, time and disk without training.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the training in DIR.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the training in DIR.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Train a detector with Ultralytics (extra `train`); Ctrl-C stops it, and --resume continues."""
    session: Session = ctx.obj
    session.json = as_json

    from infrablend import api
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import human_bytes, print_json, print_result, table
    from infrablend.report.figures import human_seconds

    request = api.TrainRequest(
        preset=preset.value,
        settings=yaml_values(setting, "--set"),
        task=task.value,
        weights=weights,
        device=device,
        seed=seed,
        classes=comma_list(classes, "--classes"),
        agc=_agc(agc),
    )
    reading = make_reading(format=format, options=options)
    existing = earlier_output(resume, overwrite)
    if plan:
        p = api.plan_train(dataset, request, reading=reading, out=out, existing=existing)
        rows = {
            "tiles" if p.tiled else "images": str(p.images),
            "labels of the split": str(p.labels),
            "epochs": f"{p.epochs} of {p.shown} images shown",
            "device": p.device if p.device in ("cpu", "mps") else f"GPU {p.device}",
            "time, about": human_seconds(p.seconds),
            "disk, about": human_bytes(p.disk_bytes),
        }
        if as_json:
            print_json(asdict(p))
        else:
            print_result(table(rows))
        return
    with shown_progress(session, "training") as on_progress:
        report = api.train(dataset, out, request, reading=reading, existing=existing, on_progress=on_progress)
    if as_json:
        print_json(report.to_json())
        return
    r = report.record
    start = r["start"]
    rows = {
        "classes": ", ".join(r["classes"]),
        "started from": start["model"] + (f" ({start['why']})" if start["why"] else ""),
        **_used(r["prepared"]),
        "epochs": f"{r['epochs_done']} ({r['passes']} images shown)",
        "time": human_seconds(r["seconds"]),
    }
    if r["left_out"]:
        rows["labels left out"] = ", ".join(f"{k} {n}" for k, n in r["left_out"].items())
    print_result(table(rows))
    print_result(str(report.weights))


def _used(prepared: dict[str, Any]) -> dict[str, str]:
    """Return the images and labels that the trainer used; an object counts once per tile that contains it."""
    both = f"{prepared['images']}, {prepared['labels']}: all used"
    tiles = prepared.get("tiles")
    if not tiles:
        return {"images, labels": both}
    pieces = tiles["labels_left_out"]
    return {"tiles, labels in them": both + (f"; {pieces} small pieces at edges are unlabelled" if pieces else "")}


def _agc(text: str) -> Agc:
    from infrablend.config.agc import parse_agc

    try:
        return parse_agc(text)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--agc") from error
