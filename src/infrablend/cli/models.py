"""`infrablend models`: what can be inserted."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def list_models() -> None:
    """List the object models."""
    from infrablend import api
    from infrablend.cli.results import print_result, table

    print_result(table(api.list_models()))


def show_model(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Of a model, or the path of your own .yaml.")],
    out: Annotated[
        Path | None, typer.Option(metavar="PNG", help="Where to write it [default: NAME.png, here].")
    ] = None,
) -> None:
    """Render a sheet of a model over pitch and yaw."""
    from infrablend import api
    from infrablend.cli.results import print_result

    print_result(str(api.show_model(name, out or Path(f"{Path(name).stem}.png"))))
