"""`infrablend merge`: make one run of the shards of a run."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend.cli.exclude import DataOption
from infrablend.cli.options import JsonOption, earlier_output

if TYPE_CHECKING:
    from infrablend.cli.session import Session


class Layout(StrEnum):
    """Layout of the merged run."""

    FILES = "files"
    SHARDS = "shards"


def merge(
    ctx: typer.Context,
    sources: Annotated[
        list[Path], typer.Argument(metavar="OUT...", help="Folders with shards of one run, or s3://, gs://, hf://.")
    ],
    dst: Annotated[Path, typer.Argument(metavar="DST", help="Folder to write the run to.")],
    partial: Annotated[
        bool, typer.Option("--partial", help="Merge the finished shards, although others are not.")
    ] = False,
    layout: Annotated[
        Layout, typer.Option(help="Layout of DST: a file per picture, or one packed shard (extra infrablend[shards]).")
    ] = Layout.FILES,
    data: DataOption = None,
    resume: Annotated[bool, typer.Option("--resume", help="Finish the interrupted merge in DST.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the run in DST.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Make one run of finished shards, with the bytes of an undivided run."""
    session: Session = ctx.obj
    session.json = as_json
    existing = earlier_output(resume, overwrite)

    from infrablend import api
    from infrablend.cli.generate import show_run
    from infrablend.cli.progress import shown_progress

    with shown_progress(session, "merging") as on_progress:
        report = api.merge(
            sources,
            dst,
            data=data,
            partial=partial,
            layout=layout.value,
            existing=existing,
            on_progress=on_progress,
        )
    show_run(report, session)
