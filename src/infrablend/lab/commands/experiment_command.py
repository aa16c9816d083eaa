"""`infrablend experiment`: reproduce a table of the paper, or run an experiment of your own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from infrablend import api
from infrablend.cli.completion import offered
from infrablend.cli.exits import printable
from infrablend.cli.options import Fields, JsonSession
from infrablend.cli.output import grid, human_bytes, show_result, shown_progress, table
from infrablend.lab.commands.detector_commands import start_text
from infrablend.lab.experiments.scales import EXPERIMENTS
from infrablend.report.figures import human_seconds

if TYPE_CHECKING:
    from infrablend.lab.experiments.result_record import Claim, DatasetRow, ExperimentRecord, PlanFacts, ResultTable

_EVENTS = {
    "found": "already finished", "started": "started", "waiting": "another command is making it", "done": "done",
    "adopted": "adopted",
}  # fmt: skip


def experiment(
    session: JsonSession,
    *,
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]",
            help="Name of a shipped experiment (see --list), or a YAML file.",
            autocompletion=offered(lambda: EXPERIMENTS.names, files=True),
        ),
    ] = None,
    options: Annotated[
        dict[str, Any],
        Fields(
            "data work results scale seed device weights training only adopt workers",
            request=api.ExperimentRequest,
            data=Annotated[list[str] | None, typer.Option(metavar="[NAME=]DIR"), tuple],
            work=typer.Option(metavar="DIR"),
            results=typer.Option(metavar="DIR"),
            weights=typer.Option(metavar="FILE"),
            training=typer.Option("--set"),
            only=Annotated[list[str] | None, typer.Option(metavar="STAGE"), tuple],
            adopt=typer.Option(metavar="STAGE=DIR"),
            workers=typer.Option(min=1),
        ),
    ],
    plan: Annotated[
        bool, typer.Option("--plan", help="Show stages, images, time and disk space; write nothing.")
    ] = False,
    show_list: Annotated[bool, typer.Option("--list", help="List the shipped experiments.")] = False,
) -> None:
    """Run an experiment: make its data, train, evaluate, and write a page with the paper's figures beside yours.

    The same command continues an interrupted run and makes nothing twice. Several at once share the stages.
    """
    if show_list:
        shipped = api.list_experiments()
        show_result(session, shipped, lambda: table(shipped))
        return
    if name is None:
        raise typer.BadParameter("which experiment? --list shows the shipped ones", param_hint="NAME")
    request = api.ExperimentRequest(name, **options)
    if plan:
        planned = api.plan_experiment(request)
        show_result(session, planned.to_json(), lambda: "\n\n".join(_plan_blocks(planned.facts)))
        return

    def show_stage(stage: str, event: str, number: int, total: int) -> None:
        if not session.quiet:
            session.tell(f"stage {number} of {total}, {stage}: {_EVENTS[event]}")

    with shown_progress(session, "working") as on_progress:
        report = api.experiment(request, on_stage=show_stage, on_progress=on_progress)
    for problem in report.problems:
        typer.echo(printable(f"{problem.severity}: {problem}"), err=True)
    blocks = _result_blocks(report.facts)
    if missing := report.facts["missing"]:
        blocks.append(f"missing: {len(missing)} of {len(report.facts['stages'])} stages; --plan lists them")
    elif not report.made:
        blocks.append("nothing to do: every stage was finished before")
    blocks.append(f"{report.status}, scale {report.scale}: {report.page}")
    show_result(session, report.to_json(), lambda: "\n\n".join(blocks))


def _plan_blocks(plan: PlanFacts) -> list[str]:
    from infrablend.lab.experiments.experiment_forecast import NO_WORK

    rows = []
    for s in plan["stages"]:
        preset: Any = s.get("training", {})
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
    if starts := dict.fromkeys(start_text(s["weights"], s["network"]) for s in plan["stages"] if "training" in s):
        total["start weights"] = "; ".join(starts)
    if plan["stand_ins"]:
        total["stand-ins"] = f"a virtual world for {', '.join(plan['stand_ins'])}"
    for name, why in plan["left_out"].items():
        total[f"left out: {name}"] = why
    return [grid(["stage", "status", "images", "training", "time", "disk"], rows), table(total)]


def _result_blocks(facts: ExperimentRecord) -> list[str]:
    blocks = [_table_block(t) for t in facts["tables"]]
    if facts["datasets"]:
        blocks.append(_datasets_block(facts["datasets"]))
    return [*blocks, *(_claim_block(c) for c in facts["checks"])]


def _table_block(table: ResultTable) -> str:
    rows = []
    for r in table["rows"]:
        ours = r["ours"] or {}
        cells = [r["title"]]
        for k in ("map50", "map50_95"):
            cells += [_figure(r["paper"][k]), _figure(ours.get(k)), _figure(r["difference"].get(k), "+.3f")]
        rows.append(cells)
    head = ["", "mAP50 paper", "ours", "difference", "mAP50-95 paper", "ours", "difference"]
    return f"{table['title']}\n{grid(head, rows)}"


def _datasets_block(datasets: Sequence[DatasetRow]) -> str:
    rows = []
    for d in datasets:
        paper = d["paper"]
        ours = d["ours"]
        images = ours["images"] if ours else "-"
        classes = ours["classes"] if ours else "-"
        rows.append([d["title"], f"{paper['images']} / {images}", f"{paper['classes']} / {classes}"])
    return grid(["paper / ours", "images", "classes"], rows)


def _claim_block(claim: Claim) -> str:
    verdict = {True: "yes", False: "no", None: claim.get("missing", "no verdict")}[claim["holds"]]
    if "ci" in claim:
        found = f"{claim['difference']:+.3f} [{claim['ci'][0]:+.3f}, {claim['ci'][1]:+.3f}]"
    else:
        found = f"ratio {claim['ratio']:.3f}" if "ratio" in claim else "-"
    return f"{claim['text']}: {verdict} ({found})"


def _figure(x: object, form: str = ".3f") -> str:
    return "-" if x is None else format(x, form)
