"""`infrablend generate`: a dataset in, the same dataset with inserted objects out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend.cli.options import (
    Device,
    DeviceOption,
    JsonOption,
    ReadingOption,
    SeedOption,
    WorkersOption,
    comma_list,
    key_values,
    split_list,
)

if TYPE_CHECKING:
    from infrablend.api import RunReport
    from infrablend.cli.session import Session


def generate(
    ctx: typer.Context,
    recipe: Annotated[
        str, typer.Argument(metavar="RECIPE", help="A shipped name (see `recipes list`) or a YAML file.")
    ],
    data: Annotated[Path, typer.Option(metavar="DIR", help="The background dataset.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="The run folder to write.")],
    limit: Annotated[int | None, typer.Option(min=1, help="Only the first N backgrounds in sorted order.")] = None,
    split: Annotated[str | None, typer.Option(metavar="LIST", help="Some of train,val,test [default: all].")] = None,
    seed: SeedOption = 0,
    workers: WorkersOption = None,
    device: DeviceOption = Device.AUTO,
    formats: Annotated[
        str | None,
        typer.Option("--format", metavar="LIST", help="Some of yolo,coco,dota,... or native [default: the recipe's]."),
    ] = None,
    form: Annotated[
        str | None,
        typer.Option(help="Read only this form of the dataset, e.g. rotate_json [default: detected]."),
    ] = None,
    metadata: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="CSV or JSON of pitch and altitude, for a folder of images."),
    ] = None,
    reading: ReadingOption = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Set a recipe field, e.g. output.image=png; repeatable."),
    ] = None,
    plan: Annotated[bool, typer.Option("--plan", help="Say what would be made; make nothing.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Finish the run in OUT.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the run in OUT.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Insert rendered objects into a dataset; merged labels in every format."""
    session: Session = ctx.obj
    session.json = as_json
    if resume and overwrite:
        raise typer.BadParameter("--resume and --overwrite exclude each other; give one of them")
    splits = split_list(split)
    format_names = comma_list(formats, "--format")

    from infrablend import api
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import facts, say, say_json, table

    if plan:
        planned = api.plan(
            recipe,
            data,
            out,
            limit=limit,
            splits=splits,
            seed=seed,
            workers=workers,
            device=device.value,
            formats=format_names,
            form=form,
            metadata=metadata,
            options=key_values(reading, "--read"),
            settings=settings or [],
        ).to_json()
        if as_json:
            say_json(planned)
        else:
            say(table(facts(planned)))
        return
    with shown_progress(session, "generating") as on_progress:
        report = api.generate(
            recipe,
            data,
            out,
            limit=limit,
            splits=splits,
            seed=seed,
            workers=workers,
            device=device.value,
            formats=format_names,
            form=form,
            metadata=metadata,
            options=key_values(reading, "--read"),
            settings=settings or [],
            resume=resume,
            overwrite=overwrite,
            on_progress=on_progress,
        )
    _show(report, session)


def _show(report: RunReport, session: Session) -> None:
    """The report on stdout, its problems on stderr, and exit code 1 if something was skipped or failed."""
    from infrablend.cli.exits import PARTIAL
    from infrablend.cli.results import facts, say, say_json, table, tell_problems

    tell_problems(report.problems, session.log_path, report.out / "run.json")
    if session.json:
        say_json(report.to_json())
    else:
        say(table(facts(report.counts)))
        say(str(report.out))
    if not report.ok:
        raise typer.Exit(PARTIAL)
