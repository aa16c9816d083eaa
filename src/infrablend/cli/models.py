"""`infrablend models`: list and show object models."""

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
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of a model, or path of your own .yaml.")],
    out: Annotated[
        Path | None, typer.Option(metavar="PNG", help="File to write [default: NAME.png in the current folder].")
    ] = None,
) -> None:
    """Render a contact sheet of a model over pitch and yaw."""
    from infrablend import api
    from infrablend.cli.results import print_result

    print_result(str(api.show_model(name, out or Path(f"{Path(name).stem}.png"))))
