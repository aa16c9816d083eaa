"""`infrablend world`: backgrounds that need no download."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from infrablend.cli.options import Device, DeviceOption, SeedOption, WorkersOption


class Layout(StrEnum):
    """Whose layout."""

    HIT_UAV = "hit-uav"
    MONET = "monet"


def world(
    ctx: typer.Context,
    out: Annotated[Path, typer.Option(metavar="DIR", help="The dataset folder to write.")],
    count: Annotated[int, typer.Option(min=1, help="How many images.")] = 12,
    layout: Annotated[Layout, typer.Option(help="Whose layout, size, places and metadata.")] = Layout.HIT_UAV,
    seed: SeedOption = 0,
    workers: WorkersOption = None,
    device: DeviceOption = Device.AUTO,
) -> None:
    """Render a virtual thermal world into a background dataset in HIT-UAV's layout or in MONET's."""
    from infrablend import api
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import say

    with shown_progress(ctx.obj, "rendering") as on_progress:
        folder = api.make_world(
            out, count, seed, layout=layout.value, workers=workers, device=device.value, on_progress=on_progress
        )
    say(str(folder))
