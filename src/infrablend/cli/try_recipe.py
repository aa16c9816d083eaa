"""`infrablend try`: one frame of a recipe as a PNG, without a run folder."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend.cli.options import (
    Device,
    DeviceOption,
    FormatOption,
    FormOption,
    JsonOption,
    MetadataOption,
    ReadingOption,
    RecipeArgument,
    SeedOption,
    SplitsOption,
    make_reading,
)

if TYPE_CHECKING:
    from infrablend.cli.session import Session
    from infrablend.errors import InfraBlendError
    from infrablend.pipeline.trial import Trial

DEFAULT_OUT = Path("try.png")


def try_recipe(
    ctx: typer.Context,
    recipe: RecipeArgument,
    data: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the background dataset.")],
    frame: Annotated[
        str | None,
        typer.Option(metavar="ID", help="Id of the frame, e.g. test/a_c0, or of a background [default: the first]."),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="PNG", help="Picture to write.")] = DEFAULT_OUT,
    watch: Annotated[
        bool, typer.Option("--watch", help="Render again whenever recipe, models or data change, until Ctrl-C.")
    ] = False,
    split: SplitsOption = None,
    seed: SeedOption = 0,
    device: DeviceOption = Device.AUTO,
    format: FormatOption = None,
    form: FormOption = None,
    metadata: MetadataOption = None,
    options: ReadingOption = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Set a recipe field, e.g. objects.0.count=3; repeatable."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write one frame of a recipe as a PNG with its boxes and enlarged inserts."""
    session: Session = ctx.obj
    session.json = as_json
    # Nothing can be freed before the first frame, and looking for it would take a fifth of the time.
    gc.disable()
    reading = make_reading(split, format, form, metadata, options)

    from infrablend import api
    from infrablend.pipeline.request import Execution
    from infrablend.pipeline.trial import Trial

    given, execution = settings or (), Execution(1, device.value)
    if not watch:
        trial = api.try_recipe(recipe, data, frame, seed=seed, settings=given, reading=reading, execution=execution)
        _show(trial, out, session)
        return
    tries = api.watch_recipe(recipe, data, frame, seed=seed, settings=given, reading=reading, execution=execution)
    try:
        for found in tries:
            if isinstance(found, Trial):
                _show(found, out, session)
            else:
                _report(found, session)
    except KeyboardInterrupt:  # the usual end of a watch
        typer.echo("", err=True)


def _report(error: InfraBlendError, session: Session) -> None:
    """Print an error, after which the watch goes on."""
    from infrablend.cli.exits import report_error

    report_error(error, session.log_path)


def _show(trial: Trial, out: Path, session: Session) -> None:
    """Write the picture, and print what is in it."""
    from infrablend.cli.results import print_json, print_problems, print_result

    path = trial.write(out)
    gc.freeze()
    gc.enable()
    if session.json:
        print_json({"out": str(path), **trial.to_json()})
        return
    print_problems(trial.problems, session.log_path, path)
    print_result("\n".join([*_lines(trial), str(path)]))


def _lines(trial: Trial) -> list[str]:
    """Return what is in the frame, a line per inserted object."""
    from infrablend.pipeline.trial import gain_words, how_visible

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
