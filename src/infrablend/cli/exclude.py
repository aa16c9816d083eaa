"""`infrablend exclude` and `infrablend include`: leave frames out of a finished run, and take them back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend.cli.options import JsonOption, RunArgument

if TYPE_CHECKING:
    from infrablend.api import ChoiceReport
    from infrablend.cli.session import Session

DataOption = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of the backgrounds, if it has moved.")]


def exclude(
    ctx: typer.Context,
    run: RunArgument,
    frames: Annotated[
        list[str] | None,
        typer.Argument(metavar="[FRAME]...", help="Ids such as test/a_c0, or ids of backgrounds for all their frames."),
    ] = None,
    review: Annotated[
        bool, typer.Option("--review", help="Exclude what RUN/review.json rejects, and include what it accepts.")
    ] = False,
    reason: Annotated[str | None, typer.Option(help="Reason for FRAME, kept in excluded.json.")] = None,
    purge: Annotated[
        bool, typer.Option("--purge", help="Delete the files of all excluded frames, which are kept otherwise.")
    ] = False,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Leave frames out of a finished run: labels, splits, card and counts follow, and the files are kept apart."""
    session: Session = ctx.obj
    session.json = as_json

    from infrablend import api
    from infrablend.cli.progress import shown_progress
    from infrablend.pipeline.choose import BY_HAND
    from infrablend.pipeline.review import REVIEW_FILE

    with shown_progress(session, "excluding") as on_progress:
        report = api.exclude(
            run,
            frames or (),
            review=run / REVIEW_FILE if review else None,
            reason=reason or BY_HAND,
            purge=purge,
            data=data,
            on_progress=on_progress,
        )
    _show(report, session)


def include(
    ctx: typer.Context,
    run: RunArgument,
    frames: Annotated[
        list[str] | None,
        typer.Argument(metavar="[FRAME]...", help="Ids of excluded frames, or of backgrounds for all their frames."),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Take all frames back.")] = False,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Take excluded frames of a run back; purged ones are rendered again."""
    if bool(frames) == every:
        raise typer.BadParameter("give either ids of frames or --all", param_hint="FRAME")
    session: Session = ctx.obj
    session.json = as_json

    from infrablend import api
    from infrablend.cli.progress import shown_progress

    with shown_progress(session, "including") as on_progress:
        report = api.include(run, frames or (), every=every, data=data, on_progress=on_progress)
    _show(report, session)


def _show(report: ChoiceReport, session: Session) -> None:
    from infrablend.cli.exits import PARTIAL
    from infrablend.cli.results import print_json, print_problems, print_result, table

    print_problems(report.problems, session.log_path, report.out / "run.json")
    if session.json:
        print_json(report.to_json())
        if not report.ok:
            raise typer.Exit(PARTIAL)
        return
    rows = {
        "changed": f"{report.changed} frames",
        "excluded": f"{len(report.excluded)} frames",
        "in the dataset": f"{report.counts.get('frames', 0)} frames",
    }
    if report.purged_files:
        rows["deleted"] = f"{report.purged_files} files"
    print_result(f"{table(rows)}\n{report.out}")
    if not report.ok:
        raise typer.Exit(PARTIAL)
