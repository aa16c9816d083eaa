"""`infrablend show`: what is known of a frame of a run."""

from __future__ import annotations

from typing import Annotated

import typer

from infrablend.cli.options import RunArgument


def show(
    run: RunArgument,
    frame: Annotated[str, typer.Argument(metavar="FRAME", help="Id of the frame, e.g. test/1_60_80_0_06117_c0.")],
) -> None:
    """Print the record of a frame as JSON: scene, labels and decisions, or why it failed."""
    from infrablend import api
    from infrablend.cli.results import print_json

    print_json(api.show(run, frame))
