"""`infrablend world`: renders background images, so that no download is needed."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from infrablend.cli.options import SeedOption, WorkersOption


class Layout(StrEnum):
    """Dataset whose layout to copy, or maker of the camera whose files to write."""

    HIT_UAV = "hit-uav"
    MONET = "monet"
    RADIOMETRIC = "radiometric"
    DJI = "dji"
    FLIR = "flir"


def world(
    ctx: typer.Context,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Dataset folder to write.")],
    count: Annotated[int, typer.Option(min=1, help="Number of images.")] = 12,
    layout: Annotated[
        Layout, typer.Option(help="Dataset or camera whose files to copy; radiometric: 16-bit centikelvin.")
    ] = Layout.HIT_UAV,
    seed: SeedOption = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier world in DIR.")] = False,
    workers: WorkersOption = None,
) -> None:
    """Render a background dataset of a virtual thermal world, as HIT-UAV, MONET or a camera's own files."""
    from infrablend import api
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import print_result

    with shown_progress(ctx.obj, "rendering") as on_progress:
        folder = api.make_world(
            out, count, seed, layout=layout.value, workers=workers, overwrite=overwrite, on_progress=on_progress
        )
    print_result(str(folder))
