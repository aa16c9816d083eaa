"""Commands that answer questions about a flight: `detect`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from infrablend import api
from infrablend.cli.options import DatasetArgument, Fields, JsonSession, ReadingOptions
from infrablend.cli.output import show_report, shown_progress, table


def detect(
    session: JsonSession,
    *,
    detector: Annotated[
        Path,
        typer.Argument(
            metavar="DETECTOR", help="ONNX file, weights (.pt), predictions.json, or the folder of one of them."
        ),
    ],
    data: DatasetArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the detections.")],
    request: Annotated[
        api.DetectRequest,
        Fields(
            classes=typer.Option(metavar="A,B"),
            image_size=typer.Option(min=0, metavar="PX"),
            overlap=typer.Option(min=0, metavar="PX"),
            threads=typer.Option(min=0, metavar="N"),
        ),
    ],
    reading: ReadingOptions,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier detections in DIR.")] = False,
) -> None:
    """Find objects in the pictures of a dataset, a folder off the card or a video; write detections and a table."""
    with shown_progress(session, "searching") as on_progress:
        report = api.detect(detector, data, out, request, reading=reading, overwrite=overwrite, on_progress=on_progress)
    rows = {
        "pictures searched": str(report.pictures),
        f"pictures with detections from {request.confidence:g}": str(report.with_some),
        **{name: str(n) for name, n in report.found.items()},
    }
    show_report(session, report, out / "detect.json", report.to_json(), lambda: f"{table(rows)}\n{out}")
