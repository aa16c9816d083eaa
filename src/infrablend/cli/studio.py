"""`infrablend studio`: a local page to review a run and to tune a recipe."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend.cli.completion import complete_recipe
from infrablend.cli.options import (
    Device,
    DeviceOption,
    FormatOption,
    FormOption,
    MetadataOption,
    ReadingOption,
    SeedOption,
    SplitsOption,
    make_reading,
)

if TYPE_CHECKING:
    from infrablend.cli.session import Session


def studio(
    ctx: typer.Context,
    recipe: Annotated[
        str | None,
        typer.Argument(
            metavar="[RECIPE]",
            help="Recipe to tune: name of a shipped one, or a YAML file.",
            autocompletion=complete_recipe,
        ),
    ] = None,
    data: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the background dataset to tune on.")
    ] = None,
    run: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Run to review: folder that `generate` wrote.")
    ] = None,
    compare: Annotated[
        str | None,
        typer.Option(
            metavar="RUN|RECIPE",
            help="Second run to compare with that of --run, or second recipe to compare with RECIPE on --data.",
        ),
    ] = None,
    results: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="Folder of a further report on the run, such as an evaluation; repeatable."),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port [default: any free one].")] = 0,
    no_open: Annotated[bool, typer.Option("--no-open", help="Only print the address; open no browser.")] = False,
    host: Annotated[str, typer.Option(help="Address to listen on; only this machine can connect by default.")] = (
        "127.0.0.1"
    ),
    yes_expose: Annotated[
        bool, typer.Option("--yes-expose", help="Let other machines connect through --host, unencrypted.")
    ] = False,
    split: SplitsOption = None,
    seed: SeedOption = 0,
    device: DeviceOption = Device.AUTO,
    format: FormatOption = None,
    form: FormOption = None,
    metadata: MetadataOption = None,
    options: ReadingOption = None,
) -> None:
    """Open a local page in the browser: review a run, tune a recipe on its backgrounds, compare runs or recipes."""
    session: Session = ctx.obj
    reading = make_reading(split, format, form, metadata, options)

    from infrablend.pipeline.request import Execution
    from infrablend.studio.request import Address, StudioRequest
    from infrablend.studio.server import serve

    request = StudioRequest(recipe, data, run, compare, tuple(results or ()), seed, reading, Execution(1, device.value))

    def ready(address: str) -> None:
        typer.echo(address)
        if not session.quiet:
            typer.echo("Open this address in a browser on this machine; Ctrl-C here closes it.", err=True)
        if not no_open:
            import threading
            import webbrowser

            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

    serve(request, Address(host, port, yes_expose), ready)
