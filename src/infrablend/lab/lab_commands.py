"""Commands of the lab: `train`, `evaluate`, `realism`, `experiment`, `world`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from infrablend import api
from infrablend.cli.call_state import Session
from infrablend.cli.exits import printable
from infrablend.cli.options import (
    DatasetArgument,
    Fields,
    JsonSession,
    ReadingOfAllSplits,
    ReadingOfFormat,
    RunArgument,
    SeedOption,
    WorkersOption,
    comma_list,
    earlier_output,
    offered,
    reported,
    split_list,
)
from infrablend.cli.output import grid, human_bytes, print_problems, print_result, show_result, shown_progress, table
from infrablend.errors import ArgumentError
from infrablend.lab.experiments.experiment_request import EXPERIMENTS
from infrablend.report.figures import human_seconds

if TYPE_CHECKING:
    from infrablend.config.agc import Agc
    from infrablend.lab.evaluation.evaluate import EvaluationReport
    from infrablend.lab.experiments.result_record import Claim, DatasetRow, ExperimentRecord, PlanFacts, ResultTable
    from infrablend.lab.realism.realism_record import ClassFacts
    from infrablend.lab.training.training_record import TrainingRecord
    from infrablend.report.page import Table


def _agc(text: str) -> Agc:
    from infrablend.config.agc import parse_agc

    return parse_agc(text)


def train(
    session: JsonSession,
    *,
    dataset: DatasetArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the weights and train.json.")],
    request: Annotated[
        api.TrainRequest,
        Fields(
            settings=typer.Option("--set"),
            weights=typer.Option(metavar="FILE|NAME|scratch|auto"),
            classes=typer.Option(metavar="A,B"),
            agc=Annotated[str, typer.Option(metavar="linear|plateau|{...}", parser=reported(_agc))],
        ),
    ],
    reading: ReadingOfFormat,
    plan: Annotated[bool, typer.Option("--plan", help="Show images, epochs, time and disk without training.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the training in DIR.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the training in DIR.")] = False,
) -> None:
    """Train a detector with Ultralytics (extra `train`) or YOLOX; Ctrl-C stops it, and --resume continues."""
    existing = earlier_output(resume, overwrite)
    if plan:
        p = api.plan_train(dataset, request, reading=reading, out=out, existing=existing)
        rows = {
            "tiles" if p.tiled else "images": f"{p.images} of {p.tile_px} px" if p.tiled else str(p.images),
            "labels of the split": str(p.labels),
            "epochs": f"{p.epochs} of {p.shown} images shown",
            "start weights": start_text(p.weights, p.network),
            "device": p.device if p.device in ("cpu", "mps") else f"GPU {p.device}",
            "time, about": human_seconds(p.seconds),
            "disk, about": human_bytes(p.disk_bytes),
        }
        show_result(session, asdict(p), lambda: table(rows))
        return
    with shown_progress(session, "training") as on_progress:
        report = api.train(dataset, out, request, reading=reading, existing=existing, on_progress=on_progress)
    show_result(session, report.to_json(), lambda: f"{table(_training(report.record))}\n{report.weights}")


def start_text(weights: str, network: str) -> str:
    """Return a text on start weights and network of a planned training."""
    own = "" if weights in ("auto", "scratch") else "their "
    return f"{weights}, {own}network {network or 'unknown before their download'}"


def _training(record: TrainingRecord) -> dict[str, str]:
    """Return the rows on a finished training; an object counts once per tile that contains it."""
    start = record["start"]
    prepared = record["prepared"]
    used = f"{prepared['images']}, {prepared['labels']}: all used"
    tiles = prepared.get("tiles")
    pieces = tiles and tiles["labels_left_out"]
    rows = {
        "classes": ", ".join(record["classes"]),
        "started from": start["model"] + (f" ({start['why']})" if start["why"] else ""),
        "tiles, labels in them" if tiles else "images, labels": (
            used + (f"; {pieces} small pieces at edges are unlabelled" if pieces else "")
        ),
        "epochs": f"{record['epochs_done']} ({record['passes']} images shown)",
        "time": human_seconds(record["seconds"]),
    }
    if record["left_out"]:
        rows["labels left out"] = ", ".join(f"{k} {n}" for k, n in record["left_out"].items())
    return rows


def evaluate(
    session: JsonSession,
    *,
    weights: Annotated[
        Path,
        typer.Argument(
            metavar="WEIGHTS", help="Weights (.pt), ONNX file, predictions.json of an evaluation, or the folder of any."
        ),
    ],
    dataset: DatasetArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write, new or empty.")] = Path("evaluation"),
    settings: Annotated[
        api.EvaluationSettings,
        Fields(
            image_size=typer.Option(min=0, metavar="PX"),
            classes=typer.Option(metavar="A,B"),
            bootstrap=typer.Option(min=0, metavar="N"),
            list_first=typer.Option(min=0, metavar="N"),
            list_iou=typer.Option(metavar="IOU"),
        ),
    ],
    device: Annotated[str, typer.Option(help="auto, cpu, cuda, cuda:1, mps.")] = "auto",
    against: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Another evaluation on the same images, to compare with.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier evaluation.")] = False,
    reading: ReadingOfAllSplits,
) -> None:
    """Evaluate a detector: P, R, mAP50, mAP50-95 by class with intervals, by size, pitch, altitude, day and night."""
    with shown_progress(session, "detecting") as on_progress:
        report = api.evaluate(
            weights, dataset, out, settings,
            device=device, reading=reading, against=against, overwrite=overwrite, on_progress=on_progress,
        )  # fmt: skip
    print_problems(report.problems, session.log_path, report.out / "evaluation.json")
    show_result(session, {"out": str(report.out)} | report.to_json(), lambda: "\n\n".join(_evaluation(report)))


def _evaluation(report: EvaluationReport) -> list[str]:
    from infrablend.lab.pages import evaluation_page as page
    from infrablend.lab.pages.stress_page import stress_table
    from infrablend.report.figures import decimals, interval

    metrics = report.metrics
    classes = metrics["classes"]
    targets = page.target_table(metrics["targets"], classes)
    found_by = page.kind_table(metrics["targets"], "size or visible share")
    small = page.small_text(classes)
    by_class = page.class_table(classes, {"map50_95": "interval"}, map10=bool(small))
    blocks = [grid(by_class.head, by_class.rows), *([small] if small else []), page.as_one_text(classes["all"])]
    blocks += [_titled(targets), grid(found_by.head, found_by.rows)]
    if metrics["false_alarms"]["pictures"]:
        blocks.append(_titled(page.alarm_table(metrics["false_alarms"])))
    if tracks := metrics.get("tracks"):
        blocks.append(_titled(page.track_table(tracks, ["hota"])))
    if metrics["ultralytics"]:
        blocks.append(_titled(page.class_table(metrics["ultralytics"]), "by Ultralytics' own code"))
    if metrics["paired"]:
        lines = []
        for name, of in metrics["paired"]["classes"].items():
            d = of["map50_95"]
            if d is not None:
                ends = interval(d["ci"], signed=True)
                lines.append([name, decimals(d["ours"]), decimals(d["theirs"]), f"{d['difference']:+.3f}", ends])
        head = ["class", "this", metrics["paired"]["against"]["name"], "difference", "interval"]
        blocks.append("mAP50-95 on the same images:\n" + grid(head, lines))
    if listed := metrics.get("first_detections"):
        blocks.append(_titled(page.found_table(listed)))
    if stress := metrics.get("stress"):
        blocks.append(_titled(stress_table(stress)))
    detector = metrics["detector"]
    if "image_size" in detector:
        size = f"a longer side of {detector['image_size']} px" if detector["image_size"] else "their own size"
        blocks.append(f"pictures at {size}: {detector.get('image_size_from', 'as saved')}")
    return [*blocks, str(report.out / "evaluation.html")]


def _titled(found: Table, title: str = "") -> str:
    return f"{title or found.title}:\n{grid(found.head, found.rows)}"


def realism(
    session: JsonSession,
    *,
    run: RunArgument,
    against: Annotated[Path, typer.Option(metavar="DATASET", help="Background dataset of the run.")],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the report [default: RUN-realism].")
    ] = None,
    classes: Annotated[
        Any,
        typer.Option(
            "--class", metavar="A,B", parser=comma_list, help="Classes [default: all with inserted and real objects]."
        ),
    ] = None,
    time: Annotated[Literal["night", "day", "all"], typer.Option(help="Time of day of the images.")] = "all",
    pairs: Annotated[int, typer.Option(min=10, help="Largest number of pairs per class.")] = 1000,
    real: Annotated[
        Path | None,
        typer.Option(metavar="DATASET", help="Dataset of the real objects [default: that of the backgrounds]."),
    ] = None,
    real_split: Annotated[
        Any, typer.Option(metavar="LIST", parser=split_list, help="Splits of --real to read [default: all].")
    ] = None,
    steps: Annotated[
        bool, typer.Option(help="Render inserted objects again with each step of the sensor chain.")
    ] = True,
    page: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Add the figures to realism.md and realism.json in this folder.")
    ] = None,
    workers: WorkersOption = None,
    reading: ReadingOfAllSplits,
) -> None:
    """Compare inserted objects with real ones of their class: classifiers, controls, medians, sheets of crops."""
    if real_split is not None and real is None:
        raise typer.BadParameter("needs --real; without it, splits are those of the run", param_hint="--real-split")
    with shown_progress(session, "comparing") as on_progress:
        compared = api.realism(
            run, against, out, categories=classes, time_of_day=time, pairs=pairs, steps=steps,
            real=None if real is None else api.read_dataset(real, api.Reading(real_split)),
            reading=reading, execution=api.Execution(workers), on_progress=on_progress,
        )  # fmt: skip
    written = [] if page is None else [str(api.realism_page(compared, page))]
    show_result(session, compared.to_json(), lambda: "\n".join([*_realism_lines(compared), *written]))


def _realism_lines(compared: api.RealismReport) -> list[str]:
    from infrablend.lab.pages.realism_report import check_table

    lines = []
    for name, facts in compared.facts["classes"].items():
        lines.append(table({name: "", **_class_rows(facts)}))
        lines += [
            f"  {contrast}: real {real}, inserted {inserted}, {found} ({required}): {holds}"
            for contrast, real, inserted, found, required, holds in check_table(
                [("", *of) for of in facts["contrast"].items()]
            ).rows
        ]
    return [*lines, str(compared.out / "realism.html")]


def _class_rows(facts: ClassFacts) -> dict[str, str]:
    from infrablend.report.figures import decimals, interval

    ends = "" if facts["ci"] is None else f" ({interval(facts['ci'])})"
    return {
        "  pairs": str(facts["n"]),
        "  AUC, logistic": decimals(facts["auc_logistic"]) + ends,
        "  AUC, boosting": decimals(facts["auc_boosting"]),
        "  floor, logistic": decimals(facts["floor_logistic"]),
        "  floor, boosting": decimals(facts["floor_boosting"]),
        "  hard paste, logistic": decimals(facts["hard_paste_logistic"]),
        "  chain off, logistic": decimals(facts.get("chain_off_logistic")),
        "  valid": "yes" if facts["valid"] else "no: " + "; ".join(facts["invalid_because"]),
        "  separated by": ", ".join(f["feature"] for f in facts["separating_features"][:5]),
    }


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


def world(
    session: Session,
    *,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Dataset folder to write.")],
    count: Annotated[int, typer.Option(min=1, help="Number of images.")] = 12,
    layout: Annotated[
        Literal["hit-uav", "monet", "radiometric", "dji", "flir", "flight"],
        typer.Option(
            help="Dataset or camera whose files to copy; radiometric: 16-bit centikelvin; flight: one sequence."
        ),
    ] = "hit-uav",
    seed: SeedOption = 0,
    overlap: Annotated[
        float | None,
        typer.Option(
            metavar="SHARE",
            help="With --layout flight: parallel strips, whose pictures and strips show this share of each other, 0.2 "
            "to 0.9, and which state position and yaw.",
        ),
    ] = None,
    yaw_error: Annotated[
        float, typer.Option(metavar="DEGREES", help="With --overlap: by how much the stated yaw is too large.")
    ] = 0.0,
    walking: Annotated[bool, typer.Option("--walking", help="With --overlap: people walk.")] = False,
    engine: Annotated[
        Literal["blender", "lattice"],
        typer.Option(help="What draws the world; lattice needs no Blender and gives other pixels."),
    ] = "blender",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier world in DIR.")] = False,
    workers: WorkersOption = None,
) -> None:
    """Render a background dataset of a virtual thermal world, as HIT-UAV, MONET, a camera's files or a flight."""
    from infrablend.lab.world.world_frames import Survey

    if overlap is None and (yaw_error or walking):
        raise ArgumentError("--yaw-error, --walking: found no --overlap, expected one, such as --overlap 0.7")
    survey = None if overlap is None else Survey(overlap, yaw_error, walking)
    with shown_progress(session, "rendering") as on_progress:
        folder = api.make_world(
            out, count, seed, layout=layout, survey=survey, engine=engine, workers=workers,
            overwrite=overwrite, on_progress=on_progress,
        )  # fmt: skip
    print_result(str(folder))
