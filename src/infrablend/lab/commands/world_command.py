"""`infrablend world`: render the virtual thermal world."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from infrablend import api
from infrablend.cli.call_state import Session
from infrablend.cli.options import SeedOption, WorkersOption
from infrablend.cli.output import print_result, shown_progress


def world(
    session: Session,
    *,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Dataset folder to write.")],
    count: Annotated[int, typer.Option(min=1, help="Number of images.")] = 12,
    layout: Annotated[
        Literal["hit-uav", "monet", "radiometric", "dji", "flir", "flight"],
        typer.Option(
            help="Dataset or camera whose files to copy; radiometric: 16-bit centikelvin; flight: one sequence."
        ),
    ] = "hit-uav",
    seed: SeedOption = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier world in DIR.")] = False,
    workers: WorkersOption = None,
) -> None:
    """Render a background dataset of a virtual thermal world, as HIT-UAV, MONET, a camera's files or a flight."""
    with shown_progress(session, "rendering") as on_progress:
        folder = api.make_world(
            out, count, seed, layout=layout, workers=workers, overwrite=overwrite, on_progress=on_progress
        )
    print_result(str(folder))
