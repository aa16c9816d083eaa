"""`infrablend profile`: a sensor profile from a folder of pictures."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
    count: Annotated[int, typer.Option(min=1, help="Number of pictures to read, evenly spread.")] = 64,
    split: SplitsOption = None,
    time: Annotated[Time | None, typer.Option(help="Use only pictures taken by day or by night.")] = None,
    name: Annotated[str | None, typer.Option(help="Name of the profile [default: that of the folder].")] = None,
    against: Annotated[
        str | None, typer.Option(metavar="PROFILE", help="Shipped profile to compare with, e.g. hit-uav.")
    ] = None,
    format: FormatOption = None,
    options: ReadingOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure a camera's sharpness, sharpening, grain, levels and codec in its pictures; write a sensor profile."""
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
        print_result(str(report.path))
        print_result(str(report.plot))
    if report.problems:
        for line in problem_lines(report.problems, session.log_path):
            typer.echo(line, err=True)
    raise typer.Exit(PARTIAL if report.problems else OK)
