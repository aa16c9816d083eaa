"""`infrablend recipes`: list and print the shipped recipes."""

from __future__ import annotations

from typing import Annotated

import typer

from infrablend.cli.completion import complete_shipped_recipe


def list_recipes() -> None:
    """List the shipped recipes."""
    from infrablend import api
    from infrablend.cli.results import print_result, table

    print_result(table(api.list_recipes()))


def show_recipe(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="Name of a shipped recipe.", autocompletion=complete_shipped_recipe)
    ],
) -> None:
    """Print a recipe, to save and edit."""
    from infrablend import api
    from infrablend.cli.results import print_result

    print_result(api.show_recipe(name).rstrip("\n"))
