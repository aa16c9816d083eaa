"""`infrablend experiment`: a table of the paper, or an experiment of one's own, in one command."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from infrablend.cli.options import JsonOption, SeedOption, WorkersOption, key_values

if TYPE_CHECKING:
    from infrablend.cli.session import Session


class ScaleName(StrEnum):
    """How much of it."""

    PAPER = "paper"
    SMALL = "small"
    SMOKE = "smoke"


def experiment(
    ctx: typer.Context,
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="A shipped name (see --list) or a YAML file.")
    ] = None,
    data: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="A dataset that it needs; repeatable, they are told apart by their formats."),
    ] = None,
    scale: Annotated[
        ScaleName,
        typer.Option(help="paper: as published, for a GPU; small: two cores, minutes a training; smoke: a test."),
    ] = ScaleName.SMALL,
    work: Annotated[
        Path, typer.Option(metavar="DIR", help="The stages' folder; experiments share what is the same.")
    ] = Path("experiments"),
    results: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of the page [default: docs/results in a checkout, else results; for smoke WORK/results].",
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="STAGE",
            help="A kind (generate), name or id (train:fixed): these and what they need; repeatable.",
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="A setting of every training, e.g. passes=4000; repeatable.",
        ),
    ] = None,
    adopt: Annotated[
        list[str] | None,
        typer.Option(
            metavar="STAGE=DIR",
            help="Take over a training (train:fixed=DIR), run or dataset made elsewhere; repeatable.",
        ),
    ] = None,
    device: Annotated[str, typer.Option(help="Where to train: auto, cpu, cuda, or a GPU's number.")] = "auto",
    seed: SeedOption = 0,
    workers: WorkersOption = None,
    plan: Annotated[bool, typer.Option("--plan", help="Say stages, images, time and disk; do nothing.")] = False,
    show_list: Annotated[bool, typer.Option("--list", help="List the shipped experiments.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Data, trainings, evaluations and a page with the paper's figures beside ours; the same command goes on."""
    session: Session = ctx.obj
    session.json = as_json

    from infrablend import api
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import print_json, print_result, table
    from infrablend.core.yaml_text import read_yaml

    if show_list:
        if as_json:
            print_json(api.list_experiments())
        else:
            print_result(table(api.list_experiments()))
        return
    if name is None:
        raise typer.BadParameter("which experiment? --list shows the shipped ones", param_hint="NAME")
    training = {k: read_yaml(v) for k, v in key_values(settings, "--set").items()}
    if plan:
        planned = api.plan_experiment(
            name, data or [], work, results, scale=scale.value, seed=seed, device=device, training=training,
            only=only or [], adopt=key_values(adopt, "--adopt"),
        ).to_json()  # fmt: skip
        if as_json:
            print_json(planned)
        else:
            print_result("\n\n".join(_plan_blocks(planned)))
        return

    def tell(stage: str, news: str, k: int, n: int) -> None:
        if not session.quiet:
            session.console.print(f"stage {k} of {n}, {stage}: {_NEWS[news]}", markup=False, soft_wrap=True)

    with shown_progress(session, "working") as on_progress:
        report = api.experiment(
            name, data or [], work, results, scale=scale.value, seed=seed, device=device, only=only or [],
            training=training, adopt=key_values(adopt, "--adopt"), workers=workers, on_stage=tell,
            on_progress=on_progress,
        )  # fmt: skip
    for problem in report.problems:
        typer.echo(f"{problem.severity}: {problem}", err=True)
    if as_json:
        print_json(report.to_json())
    else:
        print_result("\n\n".join(_blocks(report.facts)))
        if report.facts["missing"]:
            print_result(f"\nmissing: {', '.join(report.facts['missing'])}")
        elif not report.made:
            print_result("\nnothing to do: every stage was there")
        print_result(f"\n{report.status}, scale {report.scale}: {report.page}")


_NEWS = {"there": "is there", "begins": "begins", "done": "done", "taken over": "is taken over"}


def _plan_blocks(plan: Mapping[str, Any]) -> list[str]:
    from infrablend.cli.results import grid, human_bytes, human_seconds, table
    from infrablend.pipeline.experiment import NOTHING_TO_DO

    rows = []
    for s in plan["stages"]:
        preset = s.get("training", {})
        passes = preset.get("passes") and f"{preset['passes']:,} passes"
        epochs = preset.get("epochs") and f"at most {preset['epochs']} epochs"
        todo = s["status"] not in NOTHING_TO_DO
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


def _blocks(facts: Mapping[str, Any]) -> list[str]:
    """The tables, for the screen: paper, ours, difference."""
    from infrablend.cli.results import grid

    def number(x: float | None, form: str = ".3f") -> str:
        return "-" if x is None else format(x, form)

    blocks = []
    for t in facts["tables"]:
        rows = []
        for r in t["rows"]:
            ours = r["ours"] or {}
            cells = [r["title"]]
            for k in ("map50", "map50_95"):
                cells += [number(r["paper"][k]), number(ours.get(k)), number(r["difference"].get(k), "+.3f")]
            rows.append(cells)
        head = ["", "mAP50 paper", "ours", "difference", "mAP50-95 paper", "ours", "difference"]
        blocks.append(f"{t['title']}\n{grid(head, rows)}")
    if facts["datasets"]:
        rows = [
            [d["title"], *(f"{d['paper'][k]} / {d['ours'][k] if d['ours'] else '-'}" for k in ("images", "classes"))]
            for d in facts["datasets"]
        ]
        blocks.append(grid(["paper / ours", "images", "classes"], rows))
    for c in facts["checks"]:
        verdict = {True: "yes", False: "no", None: c.get("missing", "no verdict asked")}[c["holds"]]
        if "ci" in c:
            found = f"{c['difference']:+.3f} [{c['ci'][0]:+.3f}, {c['ci'][1]:+.3f}]"
        else:
            found = f"ratio {c['ratio']:.3f}" if "ratio" in c else "-"
        blocks.append(f"{c['text']}: {verdict} ({found})")
    return blocks
