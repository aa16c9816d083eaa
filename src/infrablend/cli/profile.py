"""`infrablend profile`: a sensor profile from a folder of pictures."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from infrablend.cli.options import FormatOption, JsonOption, ReadingOption, SplitsOption, make_reading

if TYPE_CHECKING:
    from infrablend.cli.session import Session


class Time(StrEnum):
    """Time of day."""

    DAY = "day"
    NIGHT = "night"


def profile(
    ctx: typer.Context,
    data: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of pictures or of a dataset.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for profile.json and profile.png.")],
    count: Annotated[int, typer.Option(min=1, help="Number of pictures to fit the camera to, evenly spread.")] = 64,
    split: SplitsOption = None,
    time: Annotated[Time | None, typer.Option(help="Use only pictures taken by day or by night.")] = None,
    name: Annotated[str | None, typer.Option(help="Name of the profile [default: that of the folder].")] = None,
    against: Annotated[
        str | None, typer.Option(metavar="PROFILE", help="Shipped profile to compare with, e.g. hit-uav.")
    ] = None,
    rendered: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="Run with inserted objects, to correct the looseness of boxes with."),
    ] = None,
    format: FormatOption = None,
    options: ReadingOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure a camera's sharpness, sharpening, grain, levels and codec in its pictures; write a sensor profile.

    Where objects are annotated, also how far grey levels follow the neighbourhood, and how loose the boxes are.
    """
    session: Session = ctx.obj
    session.json = as_json

    from infrablend import api
    from infrablend.cli.exits import OK, PARTIAL, problem_lines
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import print_json, print_result

    with shown_progress(session, "reading") as on_progress:
        report = api.profile(
            data,
            out,
            count=count,
            time=None if time is None else time.value,
            name=name,
            against=against,
            rendered=rendered,
            reading=make_reading(split, format, options=options),
            on_progress=on_progress,
        )
    if as_json:
        print_json(report.to_json())
    else:
        first = max(len(what) for what, _ in report.rows)
        widths = [max(len(c), *(len(cells[i]) for _, cells in report.rows)) for i, c in enumerate(report.columns)]
        for what, cells in (("", report.columns), *report.rows):
            columns = "  ".join(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True))
            print_result(f"{what:<{first}}  {columns}".rstrip())
        for line in _object_lines(report.objects):
            print_result(line)
        print_result(str(report.path))
        print_result(str(report.plot))
    if report.problems:
        for line in problem_lines(report.problems, session.log_path):
            typer.echo(line, err=True)
    raise typer.Exit(PARTIAL if report.problems else OK)


def _object_lines(objects: Mapping[str, Any]) -> list[str]:
    """Return a line per time of day and class on what annotated objects show."""
    lines = []
    for time, share in objects["local_share"].items():
        bound = f"at most {share['upper_bound']:.2f} ({share['ci'][0]:.2f} to {share['ci'][1]:.2f})"
        fields = {"night": "matching.local_share", "day": "matching.local_share_day"}
        field = fields.get(time, "matching.local_share")
        lines.append(f"local share of the camera, {time}: {bound}; for recipes: {field}={share['recommended']}")
    for category, boxes in objects["box_looseness"].items():
        factor = f"{boxes['factor']:.2f} ({boxes['ci'][0]:.2f} to {boxes['ci'][1]:.2f})"
        margin = f"{boxes['margin_px']:.1f} px on each side"
        line = f"boxes of {category}: {factor} times the visible extent, or wider by {margin}; {boxes['n']:,} boxes"
        if against := boxes.get("against_rendered"):
            corrected = f"{against['factor']:.2f} ({against['ci'][0]:.2f} to {against['ci'][1]:.2f})"
            line += f"; {corrected} times the boxes of inserted objects (labels.loosen)"
            line += f", or wider by {max(against['margin_px'], 0.0):.1f} px on each side (labels.loosen_px)"
            line += f"; the {against['better']} fits better"
        else:
            line += "; not for recipes, as parts that cannot be seen are beyond this extent: see --rendered"
        lines.append(line)
    return lines
