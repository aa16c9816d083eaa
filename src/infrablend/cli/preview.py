"""`infrablend preview`: a contact sheet of a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend.cli.options import RunArgument

if TYPE_CHECKING:
    from infrablend.report.preview import Draw


def preview(
    run: RunArgument,
    out: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Picture to write [default: RUN/preview.png].")
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
    from infrablend import api
    from infrablend.cli.results import print_result

    if ground:
        print_result(str(api.preview_ground(run, out or run / "ground.png", count or 6)))
        return
    kinds: tuple[tuple[Draw, bool], ...] = (("boxes", boxes), ("obb", obb), ("masks", masks))
    chosen = tuple(name for name, on in kinds if on)
    print_result(str(api.preview(run, out or run / "preview.png", count or 12, chosen or ("boxes", "obb", "masks"))))
