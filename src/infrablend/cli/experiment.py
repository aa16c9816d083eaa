"""`infrablend experiment`: reproduce a table of the paper, or run an experiment of your own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from infrablend.cli.completion import complete_experiment
from infrablend.cli.options import JsonOption, SeedOption, WorkersOption, key_values, yaml_values

if TYPE_CHECKING:
    from infrablend.cli.session import Session
    from infrablend.pipeline.experiments.request import ExperimentRequest


class ScaleName(StrEnum):
    """Scale of an experiment."""

    PAPER = "paper"
    SMALL = "small"
    SMOKE = "smoke"


def experiment(
    ctx: typer.Context,
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]",
            help="Name of a shipped experiment (see --list), or a YAML file.",
            autocompletion=complete_experiment,
        ),
    ] = None,
    data: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[NAME=]DIR",
            help="Folder of a dataset it needs, recognised by format and labelled classes, or named; repeatable.",
        ),
    ] = None,
    scale: Annotated[
        ScaleName,
        typer.Option(help="paper: as published, needs a GPU; small: minutes per training on two cores; smoke: a test."),
    ] = ScaleName.SMALL,
    work: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of the stages. Experiments in one folder share equal stages.")
    ] = Path("experiments"),
    results: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the page [default: results; WORK/results at the scale smoke]."),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="STAGE",
            help="Make only these stages and what they need: a kind (generate), name or id (train:fixed); repeatable.",
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Setting of every training, e.g. passes=4000; repeatable."),
    ] = None,
    adopt: Annotated[
        list[str] | None,
        typer.Option(
            metavar="STAGE=DIR",
            help="Use a training (train:fixed=DIR), run or dataset made by another command; repeatable.",
        ),
    ] = None,
    device: Annotated[str, typer.Option(help="Device to train on: auto, cpu, cuda, or the number of a GPU.")] = "auto",
    seed: SeedOption = 0,
    workers: WorkersOption = None,
    plan: Annotated[
        bool, typer.Option("--plan", help="Show stages, images, time and disk space; write nothing.")
    ] = False,
    show_list: Annotated[bool, typer.Option("--list", help="List the shipped experiments.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Run an experiment: make its data, train, evaluate, and write a page with the paper's figures beside yours.

    The same command continues an interrupted run and makes nothing twice.
    """
    session: Session = ctx.obj
    session.json = as_json

    from infrablend import api
    from infrablend.cli.results import print_json, print_result, table
    from infrablend.pipeline.experiments.request import ExperimentRequest

    if show_list:
        if as_json:
            print_json(api.list_experiments())
        else:
            print_result(table(api.list_experiments()))
        return
    if name is None:
        raise typer.BadParameter("which experiment? --list shows the shipped ones", param_hint="NAME")
    request = ExperimentRequest(
        name,
        tuple(data or ()),
        work,
        results,
        scale=scale.value,
        seed=seed,
        device=device,
        training=yaml_values(settings, "--set"),
        only=tuple(only or ()),
        adopt={stage: Path(folder) for stage, folder in key_values(adopt, "--adopt").items()},
        workers=workers,
    )
    if not plan:
        _run(session, request)
        return
    planned = api.plan_experiment(request).to_json()
    if as_json:
        print_json(planned)
    else:
        print_result("\n\n".join(_plan_blocks(planned)))


def _run(session: Session, request: ExperimentRequest) -> None:
    from infrablend import api
    from infrablend.cli.exits import printable
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import print_json, print_result

    def show_stage(stage: str, event: str, number: int, total: int) -> None:
        if not session.quiet:
            text = f"stage {number} of {total}, {stage}: {_EVENTS[event]}"
            session.console.print(text, markup=False, soft_wrap=True)

    with shown_progress(session, "working") as on_progress:
        report = api.experiment(request, on_stage=show_stage, on_progress=on_progress)
    for problem in report.problems:
        typer.echo(printable(f"{problem.severity}: {problem}"), err=True)
    if session.json:
        print_json(report.to_json())
        return
    print_result("\n\n".join(_result_blocks(report.facts)))
    if report.facts["missing"]:
        print_result(f"\nmissing: {', '.join(report.facts['missing'])}")
    elif not report.made:
        print_result("\nnothing to do: every stage was finished before")
    print_result(f"\n{report.status}, scale {report.scale}: {report.page}")


_EVENTS = {"found": "already finished", "started": "started", "done": "done", "adopted": "adopted"}


def _plan_blocks(plan: Mapping[str, Any]) -> list[str]:
    from infrablend.cli.results import grid, human_bytes, table
    from infrablend.pipeline.experiments.forecast import NO_WORK
    from infrablend.report.figures import human_seconds

    rows = []
    for s in plan["stages"]:
        preset = s.get("training", {})
        passes = preset.get("passes") and f"{preset['passes']:,} passes"
        epochs = preset.get("epochs") and f"at most {preset['epochs']} epochs"
        todo = s["status"] not in NO_WORK
        rows.append(
            [
                s["stage"],
                s["status"],
                s["images"],
                passes or epochs or "",
                human_seconds(s["about_s"]) if todo else "",
                human_bytes(s["disk_bytes"]) if todo else "",
            ]
        )
    total = {
        "scale": plan["scale"],
        "to do": f"{plan['to_do']} of {len(plan['stages'])} stages",
        "time, about": f"{human_seconds(plan['about_s'])} on {plan['device']}",
        "disk, about": f"{human_bytes(plan['disk_bytes'])}, {human_bytes(plan['disk_free_bytes'])} free",
    }
    if plan["stand_ins"]:
        total["stand-ins"] = f"a virtual world for {', '.join(plan['stand_ins'])}"
    for name, why in plan["left_out"].items():
        total[f"left out: {name}"] = why
    return [grid(["stage", "status", "images", "training", "time", "disk"], rows), table(total)]


def _result_blocks(facts: Mapping[str, Any]) -> list[str]:
    """Return the page's tables and conclusions as text for the terminal."""
    blocks = [_table_block(t) for t in facts["tables"]]
    if facts["datasets"]:
        blocks.append(_datasets_block(facts["datasets"]))
    return [*blocks, *(_claim_block(c) for c in facts["checks"])]


def _table_block(table: Mapping[str, Any]) -> str:
    from infrablend.cli.results import grid

    rows = []
    for r in table["rows"]:
        ours = r["ours"] or {}
        cells = [r["title"]]
        for k in ("map50", "map50_95"):
            cells += [_figure(r["paper"][k]), _figure(ours.get(k)), _figure(r["difference"].get(k), "+.3f")]
        rows.append(cells)
    head = ["", "mAP50 paper", "ours", "difference", "mAP50-95 paper", "ours", "difference"]
    return f"{table['title']}\n{grid(head, rows)}"


def _datasets_block(datasets: Sequence[Mapping[str, Any]]) -> str:
    from infrablend.cli.results import grid

    rows = [
        [d["title"], *(f"{d['paper'][k]} / {d['ours'][k] if d['ours'] else '-'}" for k in ("images", "classes"))]
        for d in datasets
    ]
    return grid(["paper / ours", "images", "classes"], rows)


def _claim_block(claim: Mapping[str, Any]) -> str:
    verdict = {True: "yes", False: "no", None: claim.get("missing", "no verdict")}[claim["holds"]]
    if "ci" in claim:
        found = f"{claim['difference']:+.3f} [{claim['ci'][0]:+.3f}, {claim['ci'][1]:+.3f}]"
    else:
        found = f"ratio {claim['ratio']:.3f}" if "ratio" in claim else "-"
    return f"{claim['text']}: {verdict} ({found})"


def _figure(x: float | None, form: str = ".3f") -> str:
    return "-" if x is None else format(x, form)
