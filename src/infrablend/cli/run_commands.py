"""Commands that make runs and look at them: `try`, `studio`, `generate`, `status`, `merge`, `preview`, `report`, ..."""

from __future__ import annotations

import gc
import json
import threading
import webbrowser
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from infrablend import api
from infrablend.cli.call_state import Session
from infrablend.cli.exits import PARTIAL, report_error
from infrablend.cli.options import (
    BackgroundsOption,
    Fields,
    JsonSession,
    ReadingOptions,
    ReadingWithVal,
    RecipeArgument,
    RunArgument,
    SeedOption,
    SettingsOption,
    comma_list,
    complete_recipe,
    complete_written_formats,
    earlier_output,
)
from infrablend.cli.output import (
    facts,
    losses_by_format,
    print_json,
    print_problems,
    print_result,
    print_warnings,
    show_report,
    show_result,
    shown_progress,
    table,
)
from infrablend.core.addresses import shown
from infrablend.errors import ArgumentError
from infrablend.studio.studio_request import Address, StudioRequest

if TYPE_CHECKING:
    from infrablend.report.preview import Draw

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
        bool,
        typer.Option(
            "--plan", help="Show what the run would produce without writing anything; exit with 1 for no object."
        ),
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
        forecast = api.plan(recipe, data, out, **options, shard=part, price_per_core_hour=price)
        planned = forecast.to_json()
        brief = {k: v for k, v in planned.items() if k not in ("warnings", "inserts_nothing")}
        dropped = planned.get("dropped_fields")
        from infrablend.report.run_warnings import in_words

        if absent := planned.get("expected_left_out"):
            brief["expected_left_out"] = in_words(absent)
        brief["dropped_fields"] = len(dropped) if dropped else None  # --json has their names
        show_result(session, planned, lambda: table(facts(brief)))
        if not session.json:
            print_warnings(planned.get("warnings", []), "all with --json")
        if not forecast.ok:
            raise typer.Exit(PARTIAL)
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
    lines = [table(rows), *losses_by_format(report.losses, shown(record)), shown(report.out)]
    show_report(session, report, record, report.to_json(), lambda: "\n".join(lines).lstrip("\n"))


def _run_rows(counts: Mapping[str, Any]) -> dict[str, str]:
    """Return the rows of a run's counts; formats that hold the same labels share one."""
    from infrablend.report.run_warnings import in_words

    rows: dict[str, Any] = {}
    for key, value in counts.items():
        if key == "labels" and (by_format := counts.get("labels_by_format")):
            alike: dict[str, list[str]] = {}
            for name, held in by_format.items():
                alike.setdefault(json.dumps(held), []).append(name)
            rows |= {f"labels in {', '.join(names)}": json.loads(held) for held, names in alike.items()}
        elif key == "objects_left_out":
            rows[key] = in_words(value)
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


FrameArgument = Annotated[str, typer.Argument(metavar="FRAME", help="Id of the frame, e.g. test/1_60_80_0_06117_c0.")]


def preview(
    run: RunArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="PNG",
            help="Picture to write [default: RUN/preview.png]; .webp or .gif: frames one after the other.",
        ),
    ] = None,
    count: Annotated[
        int | None, typer.Option(min=1, max=400, help="Number of frames [default: 12; 6 with --ground].")
    ] = None,
    boxes: Annotated[bool, typer.Option("--boxes", help="Draw axis-aligned boxes.")] = False,
    obb: Annotated[bool, typer.Option("--obb", help="Draw oriented boxes.")] = False,
    masks: Annotated[bool, typer.Option("--masks", help="Draw masks.")] = False,
    ground: Annotated[
        bool,
        typer.Option(
            "--ground",
            help="Draw the ground grid and people of 1.7 m instead: is the scale right? Also of a dataset, without a "
            "run, by what its pictures state; then to ground.png here.",
        ),
    ] = False,
    metadata: Annotated[
        Path | None, typer.Option(metavar="FILE", help="With --ground, of a dataset: table of pitch, height, lens.")
    ] = None,
) -> None:
    """Write a contact sheet of a run with its labels: all kinds of labels, unless some are chosen."""
    if ground:
        from infrablend.report.ground_preview import is_data

        place = out or (Path() if is_data(run) else run) / "ground.png"
        print_result(str(api.preview_ground(run, place, count or 6, api.Reading(metadata=metadata))))
        return
    kinds: dict[Draw, bool] = {"boxes": boxes, "obb": obb, "masks": masks}
    chosen = tuple(name for name, on in kinds.items() if on) or tuple(kinds)
    print_result(str(api.preview(run, out or run / "preview.png", count or 12, chosen)))


def report(run: RunArgument) -> None:
    """Write the report of a finished run again: RUN/report.html, one page that works offline.

    `generate`, `exclude` and `include` write it at their end.
    """
    print_result(str(api.report(run)))


def rerender(
    run: RunArgument,
    frame: FrameArgument,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Picture to write; .png is lossless [default: the frame's file name, here]."),
    ] = None,
    data: BackgroundsOption = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace FILE if it exists and is something else.")
    ] = False,
) -> None:
    """Render one frame of a run again."""
    print_result(str(api.rerender(run, frame, out, data=data, overwrite=overwrite)))


def show(run: RunArgument, frame: FrameArgument) -> None:
    """Print the record of a frame as JSON: scene, labels and decisions, or why it failed."""
    print_json(api.show(run, frame))


def exclude(
    session: JsonSession,
    *,
    run: RunArgument,
    frames: Annotated[
        list[str] | None,
        typer.Argument(metavar="[FRAME]...", help="Ids such as test/a_c0, or ids of backgrounds for all their frames."),
    ] = None,
    review: Annotated[
        bool, typer.Option("--review", help="Exclude what RUN/review.json rejects, and include what it accepts.")
    ] = False,
    reason: Annotated[str | None, typer.Option(help="Reason for FRAME, kept in the ledger.")] = None,
    purge: Annotated[
        bool, typer.Option("--purge", help="Delete the files of all excluded frames, which are kept otherwise.")
    ] = False,
    data: BackgroundsOption = None,
) -> None:
    """Leave frames out of a finished run: labels, splits, card and counts follow, and the files are kept apart."""
    from infrablend.pipeline.runs.choose import BY_HAND
    from infrablend.pipeline.runs.review_file import REVIEW_FILE

    with shown_progress(session, "excluding") as on_progress:
        changed = api.exclude(
            run,
            frames or (),
            review=run / REVIEW_FILE if review else None,
            reason=reason or BY_HAND,
            purge=purge,
            data=data,
            on_progress=on_progress,
        )
    _show_choice(changed, session)


def include(
    session: JsonSession,
    *,
    run: RunArgument,
    frames: Annotated[
        list[str] | None,
        typer.Argument(metavar="[FRAME]...", help="Ids of excluded frames, or of backgrounds for all their frames."),
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Take all frames back.")] = False,
    data: BackgroundsOption = None,
) -> None:
    """Take excluded frames of a run back; purged ones are rendered again."""
    if bool(frames) == every:
        raise typer.BadParameter("give either ids of frames or --all", param_hint="FRAME")
    with shown_progress(session, "including") as on_progress:
        changed = api.include(run, frames or (), every=every, data=data, on_progress=on_progress)
    _show_choice(changed, session)


def _show_choice(changed: api.ChoiceReport, session: Session) -> None:
    rows = {
        "changed": f"{changed.changed} frames",
        "excluded": f"{len(changed.excluded)} frames",
        "in the dataset": f"{changed.counts.get('frames', 0)} frames",
    }
    if changed.purged_files:
        rows["deleted"] = f"{changed.purged_files} files"
    record = changed.out / "run.json"
    show_report(session, changed, record, changed.to_json(), lambda: f"{table(rows)}\n{changed.out}")


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
            "data run compare detections results seed",
            request=StudioRequest,
            data=typer.Option(metavar="DIR"),
            run=typer.Option(metavar="DIR"),
            compare=typer.Option(metavar="RUN|RECIPE"),
            detections=typer.Option(metavar="DIR"),
            results=Annotated[list[Path] | None, typer.Option(metavar="DIR"), tuple],
        ),
    ],
    address: Annotated[Address, Fields(port=typer.Option(min=0, max=65535), expose=typer.Option("--yes-expose"))],
    no_open: Annotated[bool, typer.Option("--no-open", help="Only print the address; open no browser.")] = False,
    execution: Annotated[api.Execution, Fields("device")],
    reading: ReadingOptions,
) -> None:
    """Open a local page in the browser: review a run or detections, tune recipes, compare runs or recipes."""
    from infrablend.studio.serve import serve

    request = StudioRequest(recipe, **opened, reading=reading, execution=replace(execution, workers=1))

    def ready(url: str) -> None:
        typer.echo(url)
        if not session.quiet:
            typer.echo("Open this address in a browser on this machine; Ctrl-C here closes it.", err=True)
        if not no_open:
            threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()

    serve(request, address, ready)
