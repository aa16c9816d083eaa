"""Commands about finished runs: `preview`, `report`, `rerender`, `show`, `exclude` and `include`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend import api
from infrablend.cli.call_state import Session
from infrablend.cli.options import (
    BackgroundsOption,
    JsonSession,
    RunArgument,
)
from infrablend.cli.output import print_json, print_result, show_report, shown_progress, table

if TYPE_CHECKING:
    from infrablend.report.preview import Draw

FrameArgument = Annotated[str, typer.Argument(metavar="FRAME", help="Id of the frame, e.g. test/1_60_80_0_06117_c0.")]


def preview(
    run: RunArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="PNG",
            help="Picture to write [default: RUN/preview.png]; .webp or .gif: frames one after the other.",
        ),
    ] = None,
    count: Annotated[
        int | None, typer.Option(min=1, max=400, help="Number of frames [default: 12; 6 with --ground].")
    ] = None,
    boxes: Annotated[bool, typer.Option("--boxes", help="Draw axis-aligned boxes.")] = False,
    obb: Annotated[bool, typer.Option("--obb", help="Draw oriented boxes.")] = False,
    masks: Annotated[bool, typer.Option("--masks", help="Draw masks.")] = False,
    ground: Annotated[
        bool, typer.Option("--ground", help="Draw the ground grid and people of 1.7 m instead: is the scale right?")
    ] = False,
) -> None:
    """Write a contact sheet of a run with its labels: all kinds of labels, unless some are chosen."""
    if ground:
        print_result(str(api.preview_ground(run, out or run / "ground.png", count or 6)))
        return
    kinds: dict[Draw, bool] = {"boxes": boxes, "obb": obb, "masks": masks}
    chosen = tuple(name for name, on in kinds.items() if on) or tuple(kinds)
    print_result(str(api.preview(run, out or run / "preview.png", count or 12, chosen)))


def report(run: RunArgument) -> None:
    """Write the report of a finished run again: RUN/report.html, one page that works offline.

    `generate`, `exclude` and `include` write it at their end.
    """
    print_result(str(api.report(run)))


def rerender(
    run: RunArgument,
    frame: FrameArgument,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Picture to write; .png is lossless [default: the frame's file name, here]."),
    ] = None,
    data: BackgroundsOption = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace FILE if it exists and is something else.")
    ] = False,
) -> None:
    """Render one frame of a run again."""
    print_result(str(api.rerender(run, frame, out, data=data, overwrite=overwrite)))


def show(run: RunArgument, frame: FrameArgument) -> None:
    """Print the record of a frame as JSON: scene, labels and decisions, or why it failed."""
    print_json(api.show(run, frame))


def exclude(
    session: JsonSession,
    *,
    run: RunArgument,
    frames: Annotated[
        list[str] | None,
        typer.Argument(metavar="[FRAME]...", help="Ids such as test/a_c0, or ids of backgrounds for all their frames."),
    ] = None,
    review: Annotated[
        bool, typer.Option("--review", help="Exclude what RUN/review.json rejects, and include what it accepts.")
    ] = False,
    reason: Annotated[str | None, typer.Option(help="Reason for FRAME, kept in the ledger.")] = None,
    purge: Annotated[
        bool, typer.Option("--purge", help="Delete the files of all excluded frames, which are kept otherwise.")
    ] = False,
    data: BackgroundsOption = None,
) -> None:
    """Leave frames out of a finished run: labels, splits, card and counts follow, and the files are kept apart."""
    from infrablend.pipeline.runs.choose import BY_HAND
    from infrablend.pipeline.runs.review_file import REVIEW_FILE

    with shown_progress(session, "excluding") as on_progress:
        changed = api.exclude(
            run,
            frames or (),
            review=run / REVIEW_FILE if review else None,
            reason=reason or BY_HAND,
            purge=purge,
            data=data,
            on_progress=on_progress,
        )
    _show_choice(changed, session)


def include(
    session: JsonSession,
    *,
    run: RunArgument,
    frames: Annotated[
        list[str] | None,
        typer.Argument(metavar="[FRAME]...", help="Ids of excluded frames, or of backgrounds for all their frames."),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Take all frames back.")] = False,
    data: BackgroundsOption = None,
) -> None:
    """Take excluded frames of a run back; purged ones are rendered again."""
    if bool(frames) == every:
        raise typer.BadParameter("give either ids of frames or --all", param_hint="FRAME")
    with shown_progress(session, "including") as on_progress:
        changed = api.include(run, frames or (), every=every, data=data, on_progress=on_progress)
    _show_choice(changed, session)


def _show_choice(changed: api.ChoiceReport, session: Session) -> None:
    rows = {
        "changed": f"{changed.changed} frames",
        "excluded": f"{len(changed.excluded)} frames",
        "in the dataset": f"{changed.counts.get('frames', 0)} frames",
    }
    if changed.purged_files:
        rows["deleted"] = f"{changed.purged_files} files"
    record = changed.out / "run.json"
    show_report(session, changed, record, changed.to_json(), lambda: f"{table(rows)}\n{changed.out}")
