"""Commands that answer questions about a flight: `detect`, `detectability`."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend import api
from infrablend.cli.options import (
    DatasetArgument,
    Fields,
    JsonSession,
    ReadingOptions,
    RecipeArgument,
    SeedOption,
    SettingsOption,
    comma_list,
    key_values,
    split_at_commas,
)
from infrablend.cli.output import print_problems, show_report, show_result, shown_progress, table
from infrablend.report.figures import human_seconds

if TYPE_CHECKING:
    from infrablend.detection.detectability_record import DetectabilityFacts
    from infrablend.pipeline.flights.detectability import DetectabilityPlan


def _pose_errors(texts: list[str] | None) -> api.PoseErrors:
    """Return standard errors from texts such as `position=3,yaw=1`; units may be written, as in `position_m=3`."""
    names = {name: f.name for f in fields(api.PoseErrors) for name in (f.name, f.name.rpartition("_")[0])}
    found = key_values([pair for text in texts or () for pair in split_at_commas(text)], "--errors")
    try:
        return api.PoseErrors(**{names[name]: float(text) for name, text in found.items()})
    except (KeyError, ValueError) as error:
        known = ", ".join(sorted(n for n in names if names[n] != n))
        raise typer.BadParameter(f"{error}; write NAME=NUMBER with {known}", param_hint="--errors") from error


def _take_off(text: str) -> tuple[float, float]:
    try:
        latitude, longitude = map(float, text.split(","))
    except ValueError as error:
        raise typer.BadParameter(f"{text!r}; write LAT,LON in degrees", param_hint="--take-off") from error
    return latitude, longitude


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
    places: Annotated[
        api.PlaceSettings,
        Fields(
            errors=Annotated[list[str] | None, typer.Option(metavar="NAME=VALUE,..."), _pose_errors],
            terrain=typer.Option(metavar="FILE"),
            take_off=Annotated[str | None, typer.Option(metavar="LAT,LON"), _take_off],
            speed=typer.Option(min=0, metavar="M/S"),
        ),
    ],
    reading: ReadingOptions,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace earlier detections in DIR.")] = False,
) -> None:
    """Find objects in the pictures of a dataset, a folder off the card or a video; write detections and a table."""
    with shown_progress(session, "searching") as on_progress:
        report = api.detect(
            detector, data, out, request, places, reading=reading, overwrite=overwrite, on_progress=on_progress
        )
    rows = {
        "pictures searched": str(report.pictures),
        f"pictures with detections from {request.confidence:g}": str(report.with_some),
        **{name: str(n) for name, n in report.found.items()},
        "detections with a place on the ground": str(report.placed),
    }
    if (objects := report.objects) is not None:
        rows["detections in a picture on the map"] = f"{objects['per_picture']:.2f}"
        rows["objects on the flight"] = f"about {objects['expected']:.0f} ({objects['fewest']} to {objects['most']})"
    show_report(session, report, out / "detect.json", report.to_json(), lambda: f"{table(rows)}\n{out / 'report.html'}")


def detectability(
    session: JsonSession,
    *,
    recipe: RecipeArgument,
    detector: Annotated[
        Path, typer.Argument(metavar="DETECTOR", help="Weights (.pt), an ONNX file, or the folder of a training.")
    ],
    data: DatasetArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write, new or empty.")] = Path("detectability"),
    settings: Annotated[api.DetectabilitySettings, Fields(category=typer.Option(metavar="NAME"))],
    selection: Annotated[api.FrameSelection, Fields("sample", sample=typer.Option(min=1))],
    recipe_settings: SettingsOption = None,
    reading: ReadingOptions,
    execution: Annotated[api.Execution, Fields("workers", workers=typer.Option(min=1))],
    device: Annotated[str, typer.Option(help="Device of the detector: auto, cpu, cuda, cuda:1, mps.")] = "auto",
    classes: Annotated[
        str | None,
        typer.Option(metavar="A,B", help="Names of the classes of a detector that has none.", parser=comma_list),
    ] = None,
    seed: SeedOption = 0,
    plan: Annotated[bool, typer.Option("--plan", help="Show frames and time, from a few frames.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier result in DIR.")] = False,
) -> None:
    """Measure how likely a detector finds a recipe's objects in your own pictures, by inserting them in memory."""
    request = api.DetectabilityRequest(
        recipe, detector, data, settings, tuple(recipe_settings or ()), selection, reading, execution, device,
        tuple(classes or ()), seed,
    )  # fmt: skip
    if plan:
        planned = api.plan_detectability(request)
        print_problems(planned.problems, session.log_path, session.log_path or Path())
        show_result(session, asdict(planned), lambda: table(_plan_rows(planned, settings)))
        return
    with shown_progress(session, "inserting", "objects") as on_progress:
        report = api.detectability(request, out, overwrite=overwrite, on_progress=on_progress)
    show_report(session, report, out / "detectability.json", report.facts, lambda: _text(report.facts, out))


def _plan_rows(plan: DetectabilityPlan, settings: api.DetectabilitySettings) -> dict[str, str]:
    return {
        "objects a frame": f"{plan.objects_per_frame:.1f}",
        f"objects for +-{settings.until:g}": f"about {plan.objects}, more where pictures differ",
        "frames": f"{plan.frames}, of {plan.pictures} pictures, {settings.most_rounds} times at most",
        "time, about": human_seconds(plan.seconds),
    }


def _text(facts: DetectabilityFacts, out: Path) -> str:
    rows = {f"confidence {row['confidence']:g}": _row(row) for row in facts["confidences"]}
    return f"{facts['sentence']}\n{table(rows)}\n{out / 'detectability.html'}"


def _row(row: api.AlarmFacts) -> str:
    text = f"found {row['predicted']:.3f} ({row['low']:.3f} to {row['high']:.3f}) of {row['inserted']} inserted"
    if "actual" in row:
        text += f", {row['actual']:.3f} ({row['actual_low']:.3f} to {row['actual_high']:.3f}) of {row['real']} real"
    return f"{text}; {row['alarms_per_picture']:.2f} alarms a picture"
