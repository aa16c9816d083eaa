"""Commands that make runs: `generate`, and `status` and `merge` for runs in shards."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from infrablend import api
from infrablend.cli.call_state import Session
from infrablend.cli.completion import complete_written_formats
from infrablend.cli.exits import PARTIAL
from infrablend.cli.options import (
    BackgroundsOption,
    Fields,
    JsonSession,
    ReadingWithVal,
    RecipeArgument,
    SeedOption,
    SettingsOption,
    comma_list,
    earlier_output,
)
from infrablend.cli.output import facts, loss_lines, print_warnings, show_report, show_result, shown_progress, table
from infrablend.core.addresses import shown
from infrablend.errors import ArgumentError

_SHOWN = 20


def generate(
    session: JsonSession,
    *,
    recipe: RecipeArgument,
    data: Annotated[
        Path,
        typer.Option(
            metavar="DIR", help="Folder of the background dataset, a video, or an address such as s3://bucket/data."
        ),
    ],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder to write the run to; packed shards also to s3://bucket/run.")
    ],
    selection: Annotated[
        api.FrameSelection,
        Fields(limit=typer.Option(min=1), sample=typer.Option(min=1), pictures=typer.Option(min=1)),
    ],
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
    seed: SeedOption = 0,
    execution: Annotated[
        api.Execution,
        Fields(
            "workers device executor address blender",
            workers=typer.Option(min=1),
            address=typer.Option(metavar="HOST:PORT"),
            blender=typer.Option(metavar="PATH"),
        ),
    ],
    to: Annotated[
        Any,
        typer.Option(
            metavar="LIST",
            help="Label formats to write: yolo,coco,dota,... or native [default: those of the recipe].",
            parser=comma_list,
            autocompletion=complete_written_formats,
        ),
    ] = None,
    reading: ReadingWithVal,
    settings: SettingsOption = None,
    plan: Annotated[
        bool, typer.Option("--plan", help="Show what the run would produce without writing anything.")
    ] = False,
    price: Annotated[
        float | None, typer.Option(min=0, help="Price of a core-hour, in any currency: --plan then shows the cost.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Finish the interrupted run in OUT.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the run in OUT.")] = False,
) -> None:
    """Insert rendered objects into a dataset and write merged labels in every format."""
    part = shard_request(shard, shard_size)
    if price is not None and not plan:
        raise typer.BadParameter("used by --plan only; give both, or leave it out", param_hint="--price")
    given = list(settings or [])
    if to is not None:
        given.append(f"output.formats=[{', '.join(to)}]")
    options: dict[str, Any] = {
        "selection": selection,
        "seed": seed,
        "settings": given,
        "reading": reading,
        "execution": execution,
        "existing": earlier_output(resume, overwrite),
    }
    if plan:
        planned = api.plan(recipe, data, out, **options, shard=part, price_per_core_hour=price).to_json()
        brief = {k: v for k, v in planned.items() if k != "warnings"}
        dropped = planned.get("dropped_fields")
        brief["dropped_fields"] = len(dropped) if dropped else None  # --json has their names
        show_result(session, planned, lambda: table(facts(brief)))
        if not session.json:
            print_warnings(planned.get("warnings", []), "all with --json")
        return
    with shown_progress(session, "generating") as on_progress:
        if part is None:
            report = api.generate(recipe, data, out, **options, on_progress=on_progress)
        else:
            report = api.generate_shard(api.RunRequest(recipe, data, out, **options, shard=part), on_progress)
    _show_run(report, session)


def shard_request(text: str | None, size: int | None) -> api.ShardRequest | None:
    """Parse `--shard I/N`, or `--shard I` with `--shard-size`; None if neither is given."""
    if text is None:
        return None if size is None else api.ShardRequest(size=size)
    number, slash, count = text.partition("/")
    numbers = [number, count] if slash else [number]
    if not all(n.isascii() and n.isdigit() and len(n) < 10 for n in numbers):
        raise typer.BadParameter(f"{text!r}: write I/N, such as 2/7, or I with --shard-size", param_hint="--shard")
    try:
        return api.ShardRequest(int(number), int(count) if slash else None, size)
    except ArgumentError as error:
        raise typer.BadParameter(error.message, param_hint="--shard") from error


def _show_run(report: api.RunReport, session: Session) -> None:
    record = report.record_file or report.out / "run.json"
    page = report.out / "report.html"
    rows = _run_rows(report.counts)
    if page.is_file():
        rows["report"] = str(page)
    lines = [table(rows), *loss_lines(report.losses), shown(report.out)]
    show_report(session, report, record, report.to_json(), lambda: "\n".join(lines).lstrip("\n"))


def _run_rows(counts: Mapping[str, Any]) -> dict[str, str]:
    """Return the rows of a run's counts; formats that hold the same labels share one."""
    rows: dict[str, Any] = {}
    for key, value in counts.items():
        if key == "labels" and (by_format := counts.get("labels_by_format")):
            alike: dict[str, list[str]] = {}
            for name, held in by_format.items():
                alike.setdefault(json.dumps(held), []).append(name)
            rows |= {f"labels in {', '.join(names)}": json.loads(held) for held, names in alike.items()}
        elif key != "labels_by_format":
            rows[key] = value
    return facts(rows)


def merge(
    session: JsonSession,
    *,
    sources: Annotated[
        list[Path], typer.Argument(metavar="OUT...", help="Folders with shards of one run, or s3://bucket/run.")
    ],
    dst: Annotated[Path, typer.Argument(metavar="DST", help="Folder to write the run to.")],
    partial: Annotated[
        bool, typer.Option("--partial", help="Merge the finished shards, although others are not.")
    ] = False,
    layout: Annotated[
        Literal["files", "shards"],
        typer.Option(help="Layout of DST: a file per picture, or one packed shard (extra infrablend[shards])."),
    ] = "files",
    data: BackgroundsOption = None,
    resume: Annotated[bool, typer.Option("--resume", help="Finish the interrupted merge in DST.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the run in DST.")] = False,
) -> None:
    """Make one run of finished shards, with the bytes of an undivided run."""
    existing = earlier_output(resume, overwrite)
    with shown_progress(session, "merging") as on_progress:
        report = api.merge(
            sources, dst, data=data, partial=partial, layout=layout, existing=existing, on_progress=on_progress
        )
    _show_run(report, session)


def status(
    session: JsonSession,
    *,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder with shards of a run, or s3://bucket/run.")],
    wait: Annotated[bool, typer.Option("--wait", help="Wait until every shard is done or failed.")] = False,
) -> None:
    """Show which shards of a run are done, running, failed, stopped or missing; exit with 1 unless all are done."""
    states = api.status(out, wait=wait)
    counts = Counter(str(s.state) for s in states)
    data = {"out": shown(out), "states": dict(counts), "shards": [s.to_json() for s in states]}
    show_result(session, data, lambda: "\n".join(_state_lines(states, counts)))
    if counts["done"] < len(states):
        raise typer.Exit(PARTIAL)


def _state_lines(states: Sequence[api.ShardState], counts: Counter[str]) -> list[str]:
    frames = {"frames": sum(s.frames for s in states), "finished": sum(s.finished for s in states)}
    lines = [table(facts({"shards": len(states), **counts, **frames}))]
    rest = [s for s in states if s.state != "done"]
    for s in rest[:_SHOWN]:
        lines.append(f"shard {s.shard}: {s.state}, {s.damage or f'{s.finished} of {s.frames} frames'}")
        if s.command:
            lines.append(f"  {s.command}")
    if len(rest) > _SHOWN:
        lines.append(f"... and {len(rest) - _SHOWN} more (--json lists all)")
    return lines
