"""`infrablend evaluate`: evaluate a detector on a split."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from infrablend.cli.options import (
    DatasetArgument,
    FormatOption,
    FormOption,
    JsonOption,
    MetadataOption,
    ReadingOption,
    comma_list,
    make_reading,
)

if TYPE_CHECKING:
    from infrablend.cli.session import Session
    from infrablend.pipeline.evaluate import EvaluationReport


class DetectorTask(StrEnum):
    """Geometry that is compared with the labels."""

    DETECT = "detect"
    OBB = "obb"
    SEGMENT = "segment"


class DrawnBy(StrEnum):
    """Unit that the bootstrap draws."""

    IMAGE = "image"
    SEQUENCE = "sequence"
    DATE = "date"
    GAP = "gap"


def evaluate(
    ctx: typer.Context,
    weights: Annotated[
        Path,
        typer.Argument(
            metavar="WEIGHTS", help="Weights (.pt), predictions.json of an evaluation, or the folder of either."
        ),
    ],
    dataset: DatasetArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write, new or empty.")] = Path("evaluation"),
    split: Annotated[str, typer.Option(help="train, val or test.")] = "test",
    task: Annotated[
        DetectorTask | None, typer.Option(help="Geometry to compare [default: that of the detector].")
    ] = None,
    device: Annotated[str, typer.Option(help="auto, cpu, cuda, cuda:1, mps.")] = "auto",
    classes: Annotated[
        str | None, typer.Option(metavar="A,B", help="Classes to evaluate [default: all of the dataset].")
    ] = None,
    image_size: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="PX",
            help="Longer side of the pictures that the network sees; 0: native size [default: as in training].",
        ),
    ] = None,
    ignore_regions: Annotated[
        bool, typer.Option("--ignore-regions/--no-ignore-regions", help="Ignore detections in DontCare regions.")
    ] = True,
    bootstrap: Annotated[
        int, typer.Option(min=0, metavar="N", help="Bootstrap draws for the intervals; 0: none.")
    ] = 1000,
    group: Annotated[
        DrawnBy, typer.Option(help="Unit to draw: images, sequences, days, or runs of frame numbers.")
    ] = DrawnBy.IMAGE,
    seed: Annotated[int, typer.Option(help="Seed of the draws.")] = 0,
    list_first: Annotated[
        int,
        typer.Option(
            min=0,
            metavar="N",
            help="List which objects are found among the N detections with the highest scores; 0: no list.",
        ),
    ] = 0,
    list_iou: Annotated[float, typer.Option(metavar="IOU", help="Least overlap to be listed as found.")] = 0.3,
    against: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Another evaluation on the same images, to compare with.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier evaluation.")] = False,
    format: FormatOption = None,
    form: FormOption = None,
    metadata: MetadataOption = None,
    reading: ReadingOption = None,
    as_json: JsonOption = False,
) -> None:
    """Evaluate a detector: P, R, mAP50, mAP50-95 by class with intervals, by size, pitch, altitude, day and night."""
    session: Session = ctx.obj
    session.json = as_json
    chosen = comma_list(classes, "--classes")

    from infrablend import api
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import print_json, print_problems, print_result

    settings = api.EvaluationSettings(
        split=split,
        task=None if task is None else task.value,
        image_size=image_size,
        classes=chosen,
        ignore_regions=ignore_regions,
        bootstrap=bootstrap,
        group=group.value,
        seed=seed,
        list_first=list_first,
        list_iou=list_iou,
    )
    source = make_reading(format=format, form=form, metadata=metadata, options=reading)
    with shown_progress(session, "detecting") as on_progress:
        report = api.evaluate(
            weights,
            dataset,
            out,
            settings,
            device=device,
            reading=source,
            against=against,
            overwrite=overwrite,
            on_progress=on_progress,
        )
    print_problems(report.problems, session.log_path, report.out / "evaluation.json")
    if as_json:
        print_json({"out": str(report.out)} | report.to_json())
    else:
        print_result("\n\n".join(_blocks(report)))


def _blocks(report: EvaluationReport) -> list[str]:
    from infrablend.cli.results import grid
    from infrablend.report.evaluation import HEAD, class_interval, table_rows
    from infrablend.report.figures import decimals, interval

    metrics: Any = report.metrics
    classes = metrics["classes"]
    rows = [[*row, class_interval(classes[row[0]]["ci"], "map50_95")] for row in table_rows(classes)]
    blocks = [grid([*HEAD, "interval"], rows)]
    if metrics["ultralytics"]:
        blocks.append("by Ultralytics' own code:\n" + grid(HEAD, table_rows(metrics["ultralytics"])))
    if metrics["paired"]:
        lines = []
        for name, of in metrics["paired"]["classes"].items():
            d = of["map50_95"]
            if d is not None:
                ends = interval(d["ci"], signed=True)
                lines.append([name, decimals(d["ours"]), decimals(d["theirs"]), f"{d['difference']:+.3f}", ends])
        head = ["class", "this", metrics["paired"]["against"]["name"], "difference", "interval"]
        blocks.append("mAP50-95 on the same images:\n" + grid(head, lines))
    if metrics.get("first_detections"):
        blocks.append(_found_list(metrics["first_detections"]))
    detector = metrics["detector"]
    if "image_size" in detector:
        size = f"a longer side of {detector['image_size']} px" if detector["image_size"] else "their own size"
        blocks.append(f"pictures at {size}: {detector.get('image_size_from', 'as saved')}")
    return [*blocks, str(report.out / "evaluation.html")]


def _found_list(listed: Any) -> str:
    """Return the list of objects found and missed among the first detections."""
    from infrablend.cli.results import grid
    from infrablend.report.evaluation import FOUND_HEAD, found_rows, found_title

    return f"{found_title(listed)}:\n" + grid(FOUND_HEAD, found_rows(listed))
