"""`infrablend generate`: insert rendered objects into a dataset."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend.cli.completion import complete_written_formats
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
    WorkersOption,
    comma_list,
    earlier_output,
    make_reading,
)

if TYPE_CHECKING:
    from infrablend.api import RunReport
    from infrablend.cli.session import Session
    from infrablend.pipeline.shard import ShardRequest


class Executor(StrEnum):
    """Where the workers of a run are."""

    LOCAL = "local"
    RAY = "ray"


def generate(
    ctx: typer.Context,
    recipe: RecipeArgument,
    data: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of the background dataset, or s3://, gs://, hf://.")
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder to write the run to; packed shards also to s3://, gs://, hf://.")
    ],
    limit: Annotated[int | None, typer.Option(min=1, help="Use only the first N backgrounds in sorted order.")] = None,
    sample: Annotated[
        int | None, typer.Option(min=1, help="Use only N backgrounds, spread over the dataset and drawn with --seed.")
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(metavar="LIST", help="Render only these frames: ids such as test/a_c0, or ids of backgrounds."),
    ] = None,
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="I/N", help="Render only shard I of N, from 1 to N, into a folder of its own in OUT; then merge."
        ),
    ] = None,
    shard_size: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Most frames per shard, with --shard I instead of I/N, or for all shards of output.layout=shards.",
        ),
    ] = None,
    split: SplitsOption = None,
    seed: SeedOption = 0,
    workers: WorkersOption = None,
    device: DeviceOption = Device.AUTO,
    executor: Annotated[
        Executor, typer.Option(help="Where the workers run: processes of this machine, or Ray (extra infrablend[ray]).")
    ] = Executor.LOCAL,
    address: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT", help="Ray cluster to use [default: RAY_ADDRESS, else Ray is started for the run]."
        ),
    ] = None,
    to: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="Label formats to write: yolo,coco,dota,... or native [default: those of the recipe].",
            autocompletion=complete_written_formats,
        ),
    ] = None,
    format: FormatOption = None,
    form: FormOption = None,
    metadata: MetadataOption = None,
    options: ReadingOption = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Set a recipe field, e.g. output.image=png; repeatable."),
    ] = None,
    plan: Annotated[
        bool, typer.Option("--plan", help="Show what the run would produce without writing anything.")
    ] = False,
    price: Annotated[
        float | None, typer.Option(min=0, help="Price of a core-hour, in any currency: --plan then shows the cost.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Finish the interrupted run in OUT.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the run in OUT.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Insert rendered objects into a dataset and write merged labels in every format."""
    session: Session = ctx.obj
    session.json = as_json
    existing = earlier_output(resume, overwrite)
    reading = make_reading(split, format, form, metadata, options)
    names = comma_list(to, "--to")
    chosen = comma_list(frames, "--frames")
    require_one_selection(limit, sample, frames)
    part = shard_request(shard, shard_size)
    if price is not None and not plan:
        raise typer.BadParameter("used by --plan only; give both, or leave it out", param_hint="--price")
    fields = [*(settings or []), *([] if names is None else [f"output.formats=[{', '.join(names)}]"])]

    from infrablend import api
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import facts, print_json, print_result, print_warnings, table
    from infrablend.pipeline.frame_selection import FrameSelection
    from infrablend.pipeline.request import Execution, RunRequest

    execution = Execution(workers, device.value, executor=executor.value, address=address)
    selection = FrameSelection(limit, sample, chosen)
    if plan:
        planned = api.plan(
            recipe,
            data,
            out,
            selection=selection,
            seed=seed,
            settings=fields,
            reading=reading,
            execution=execution,
            existing=existing,
            shard=part,
            price_per_core_hour=price,
        ).to_json()
        if as_json:
            print_json(planned)
        else:
            dropped = planned.get("dropped_fields")  # by name in --json
            warnings = planned.pop("warnings", [])
            print_result(table(facts({**planned, "dropped_fields": len(dropped) if dropped else None})))
            print_warnings(warnings, "all with --json")
        return
    with shown_progress(session, "generating") as on_progress:
        if part is not None:
            request = RunRequest(recipe, data, out, selection, seed, fields, reading, execution, existing, part)
            report = api.generate_shard(request, on_progress)
        else:
            report = api.generate(
                recipe,
                data,
                out,
                selection=selection,
                seed=seed,
                settings=fields,
                reading=reading,
                execution=execution,
                existing=existing,
                on_progress=on_progress,
            )
    show_run(report, session)


def require_one_selection(limit: int | None, sample: int | None, frames: str | None) -> None:
    """Check that at most one option chooses the frames.

    Raises:
        typer.BadParameter: Several do.
    """
    given = [n for n, v in (("--limit", limit), ("--sample", sample), ("--frames", frames)) if v is not None]
    if len(given) > 1:
        raise typer.BadParameter(f"{' and '.join(given)} exclude each other; give one of them", param_hint=given[1])


def shard_request(text: str | None, size: int | None) -> ShardRequest | None:
    """Parse `--shard I/N`, or `--shard I` with `--shard-size`; None if neither is given.

    Raises:
        typer.BadParameter: The values are not a shard, or do not fit together.
    """
    from infrablend.errors import ArgumentError
    from infrablend.pipeline.shard import ShardRequest

    if text is None:
        return None if size is None else ShardRequest(size=size)
    number, slash, count = text.partition("/")
    numbers = [number, *([count] if slash else [])]
    if not all(n.isascii() and n.isdigit() and len(n) < 10 for n in numbers):
        raise typer.BadParameter(f"{text!r}: write I/N, such as 2/7, or I with --shard-size", param_hint="--shard")
    try:
        return ShardRequest(int(number), int(count) if slash else None, size)
    except ArgumentError as error:
        raise typer.BadParameter(error.message, param_hint="--shard") from error


def show_run(report: RunReport, session: Session) -> None:
    """Print the report, and its problems on stderr; exit with 1 if something was skipped or failed."""
    from infrablend.cli.exits import PARTIAL
    from infrablend.cli.results import facts, print_json, print_problems, print_result, table
    from infrablend.core.addresses import shown

    print_problems(report.problems, session.log_path, report.record_file or report.out / "run.json")
    if session.json:
        print_json(report.to_json())
    else:
        print_result(table(facts(report.counts)))
        print_result(shown(report.out))
    if not report.ok:
        raise typer.Exit(PARTIAL)
