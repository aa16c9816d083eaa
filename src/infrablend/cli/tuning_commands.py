"""`infrablend try` and `infrablend studio`: look at single frames while a recipe is written, or a run reviewed."""

from __future__ import annotations

import gc
import threading
import webbrowser
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from infrablend import api
from infrablend.cli.call_state import Session
from infrablend.cli.completion import complete_recipe
from infrablend.cli.exits import report_error
from infrablend.cli.options import (
    Fields,
    JsonSession,
    ReadingOptions,
    RecipeArgument,
    SeedOption,
    SettingsOption,
)
from infrablend.cli.output import print_json, print_problems, print_result
from infrablend.studio.studio_request import Address, StudioRequest


def try_recipe(
    session: JsonSession,
    *,
    recipe: RecipeArgument,
    data: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the background dataset, or a video.")],
    frame: Annotated[
        str | None,
        typer.Option(metavar="ID", help="Id of the frame, e.g. test/a_c0, or of a background [default: the first]."),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="PNG", help="Picture to write.")] = Path("try.png"),
    watch: Annotated[
        bool, typer.Option("--watch", help="Render again whenever recipe, models or data change, until Ctrl-C.")
    ] = False,
    seed: SeedOption = 0,
    execution: Annotated[api.Execution, Fields("device")],
    reading: ReadingOptions,
    settings: SettingsOption = None,
) -> None:
    """Write one frame of a recipe as a PNG with its boxes and enlarged inserts."""
    # Nothing can be freed before the first frame, and looking for it would take a fifth of the time.
    gc.disable()
    one = replace(execution, workers=1)
    options: dict[str, Any] = {"seed": seed, "settings": settings or (), "reading": reading, "execution": one}
    if not watch:
        _show(api.try_recipe(recipe, data, frame, **options), out, session)
        return
    try:
        for found in api.watch_recipe(recipe, data, frame, **options):
            if isinstance(found, api.Trial):
                _show(found, out, session)
            else:
                report_error(found, session.log_path)
    except KeyboardInterrupt:  # the usual end of a watch
        typer.echo("", err=True)


def _show(trial: api.Trial, out: Path, session: Session) -> None:
    path = trial.write(out)
    gc.freeze()
    gc.enable()
    if session.json:
        print_json({"out": str(path), **trial.to_json()})
        return
    print_problems(trial.problems, session.log_path, path)
    print_result("\n".join([*_lines(trial), str(path)]))


def _lines(trial: api.Trial) -> list[str]:
    from infrablend.pipeline.compose.trial import gain_words, how_visible

    lines = [f"{trial.frame.id}, {trial.seconds:.2f} s"]
    scene = trial.frame.scene
    for label in trial.frame.inserted:
        width, height = label.box_xyxy[2:] - label.box_xyxy[:2]
        facts = [f"{width:.1f} x {height:.1f} px", *how_visible(label)]
        lines.append(f"{label.category}: {', '.join(facts)}")
    lines += gain_words(trial.frame.record.facts.get("matching") or {})
    absent = {} if scene is None else {**scene.draws.get("absent", {})}
    lines += [f"not inserted: {count} ({reason})" for reason, count in sorted(absent.items())]
    if removed := len(trial.frame.record.removed):
        lines.append(f"{removed} original label(s) removed")
    return lines


def studio(
    session: Session,
    *,
    recipe: Annotated[
        str | None,
        typer.Argument(
            metavar="[RECIPE]",
            help="Recipe to tune: name of a shipped one, or a YAML file.",
            autocompletion=complete_recipe,
        ),
    ] = None,
    opened: Annotated[
        dict[str, Any],
        Fields(
            "data run compare results seed",
            request=StudioRequest,
            data=typer.Option(metavar="DIR"),
            run=typer.Option(metavar="DIR"),
            compare=typer.Option(metavar="RUN|RECIPE"),
            results=Annotated[list[Path] | None, typer.Option(metavar="DIR"), tuple],
        ),
    ],
    address: Annotated[Address, Fields(port=typer.Option(min=0, max=65535), expose=typer.Option("--yes-expose"))],
    no_open: Annotated[bool, typer.Option("--no-open", help="Only print the address; open no browser.")] = False,
    execution: Annotated[api.Execution, Fields("device")],
    reading: ReadingOptions,
) -> None:
    """Open a local page in the browser: review a run, tune a recipe on its backgrounds, compare runs or recipes."""
    from infrablend.studio.serve import serve

    request = StudioRequest(recipe, **opened, reading=reading, execution=replace(execution, workers=1))

    def ready(url: str) -> None:
        typer.echo(url)
        if not session.quiet:
            typer.echo("Open this address in a browser on this machine; Ctrl-C here closes it.", err=True)
        if not no_open:
            threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()

    serve(request, address, ready)
