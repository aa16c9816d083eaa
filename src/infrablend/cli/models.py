"""`infrablend models`: list and show object models."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from infrablend.cli.completion import complete_model
from infrablend.cli.options import key_values

ModelArgument = Annotated[
    str,
    typer.Argument(metavar="NAME", help="Name of a model, or path of your own .yaml.", autocompletion=complete_model),
]


def list_models() -> None:
    """List the object models."""
    from infrablend import api
    from infrablend.cli.results import print_result, table

    print_result(table(api.list_models()))


def describe_model(
    name: ModelArgument,
) -> None:
    """List the options, parts and temperatures of a model that a recipe can set."""
    from infrablend import api
    from infrablend.cli.results import print_result, table

    model = api.describe_model(name)
    parts = {
        part: f"{role.delta_t_k[0]:+g} to {role.delta_t_k[1]:+g} K, {role.emissivity[0]:g} to {role.emissivity[1]:g}"
        + (f"  {role.what}" if role.what else "")
        for part, role in model.parts.items()
    }
    print_result(f"{model.name}: {model.description}\nCategory: {model.category}. Origin: {model.origin}.")
    if model.options:
        print_result(f"\nOptions (objects.N.options)\n{table(model.options)}")
    print_result(f"\nParts (objects.N.parts): surface minus air temperature, emissivity\n{table(parts)}")


def show_model(
    name: ModelArgument,
    out: Annotated[
        Path | None, typer.Option(metavar="PNG", help="File to write [default: NAME.png in the current folder].")
    ] = None,
    options: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Option of the model, e.g. propellers=spinning; repeatable."),
    ] = None,
) -> None:
    """Render a contact sheet of a model: from below, level and from above, and at 8 to 60 pixels."""
    from infrablend import api
    from infrablend.cli.results import print_result
    from infrablend.core.yaml_text import read_yaml

    try:
        settings = {key: read_yaml(text) for key, text in key_values(options, "--set").items()}
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--set") from error
    print_result(str(api.show_model(name, out or Path(f"{Path(name).stem}.png"), options=settings)))
