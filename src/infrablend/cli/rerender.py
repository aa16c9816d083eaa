"""`infrablend rerender`: render one frame of a run again, from its record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from infrablend.cli.options import RunArgument


def rerender(
    run: RunArgument,
    frame: Annotated[str, typer.Argument(metavar="FRAME", help="Id of the frame, e.g. test/1_60_80_0_06117_c0.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Picture to write; .png is lossless [default: the frame's file name, here]."),
    ] = None,
    data: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the backgrounds, if it has moved.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace FILE if it exists and is something else.")
    ] = False,
) -> None:
    """Render one frame of a run again."""
    from infrablend import api
    from infrablend.cli.results import print_result

    print_result(str(api.rerender(run, frame, out, data=data, overwrite=overwrite)))
