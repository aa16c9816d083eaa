"""`infrablend world`: backgrounds that need no download."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from infrablend.cli.options import Device, DeviceOption, SeedOption, WorkersOption


def world(
    ctx: typer.Context,
    out: Annotated[Path, typer.Option(metavar="DIR", help="The dataset folder to write.")],
    count: Annotated[int, typer.Option(min=1, help="How many images.")] = 12,
    seed: SeedOption = 0,
    workers: WorkersOption = None,
    device: DeviceOption = Device.AUTO,
) -> None:
    """Render a virtual thermal world into a background dataset in HIT-UAV's layout."""
    from infrablend import api
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import say

    with shown_progress(ctx.obj, "rendering") as on_progress:
        folder = api.make_world(out, count, seed, workers=workers, device=device.value, on_progress=on_progress)
    say(str(folder))
