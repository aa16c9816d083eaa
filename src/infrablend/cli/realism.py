"""`infrablend realism`: compare inserted objects with real ones."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from infrablend.cli.options import (
    FormatOption,
    FormOption,
    JsonOption,
    MetadataOption,
    ReadingOption,
    RunArgument,
    WorkersOption,
    comma_list,
    make_reading,
)

if TYPE_CHECKING:
    from infrablend.cli.session import Session


class TimeOfDay(StrEnum):
    """Time of day of the images to compare."""

    NIGHT = "night"
    DAY = "day"
    ALL = "all"


def realism(
    ctx: typer.Context,
    run: RunArgument,
    against: Annotated[Path, typer.Option(metavar="DATASET", help="Background dataset of the run.")],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the report [default: RUN/realism].")
    ] = None,
    classes: Annotated[
        str | None,
        typer.Option("--class", metavar="A,B", help="Classes [default: all with inserted and real objects]."),
    ] = None,
    time: Annotated[TimeOfDay, typer.Option(help="Time of day of the images.")] = TimeOfDay.ALL,
    pairs: Annotated[int, typer.Option(min=10, help="Largest number of pairs per class.")] = 1000,
    real: Annotated[
        Path | None,
        typer.Option(metavar="DATASET", help="Dataset of the real objects [default: that of the backgrounds]."),
    ] = None,
    real_split: Annotated[
        str | None, typer.Option(metavar="LIST", help="Splits of --real to read [default: all].")
    ] = None,
    steps: Annotated[
        bool, typer.Option(help="Render inserted objects again with each step of the sensor chain.")
    ] = True,
    page: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Add the figures to realism.md and realism.json in this folder.")
    ] = None,
    workers: WorkersOption = None,
    format: FormatOption = None,
    form: FormOption = None,
    metadata: MetadataOption = None,
    options: ReadingOption = None,
    as_json: JsonOption = False,
) -> None:
    """Compare inserted objects with real ones of their class: classifiers, controls, medians, sheets of crops."""
    session: Session = ctx.obj
    session.json = as_json
    chosen = comma_list(classes, "--class")
    if real_split is not None and real is None:
        raise typer.BadParameter("needs --real; without it, splits are those of the run", param_hint="--real-split")

    from infrablend import api
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import print_json, print_result, table
    from infrablend.pipeline.request import Execution

    with shown_progress(session, "comparing") as on_progress:
        report = api.realism(
            run,
            against,
            out,
            categories=chosen,
            time_of_day=time.value,
            pairs=pairs,
            real=None if real is None else api.read_dataset(real, make_reading(real_split)),
            steps=steps,
            reading=make_reading(None, format, form, metadata, options),
            execution=Execution(workers),
            on_progress=on_progress,
        )
    written = None if page is None else api.realism_page(report, page)
    if as_json:
        print_json(report.to_json())
        return
    for name, facts in report.facts["classes"].items():
        print_result(table({name: "", **_lines(facts)}))
        for line in _contrast_lines(facts):
            print_result(line)
    print_result(str(report.out / "realism.html"))
    if written is not None:
        print_result(str(written))


def _lines(facts: dict[str, Any]) -> dict[str, str]:
    from infrablend.report.figures import decimals, interval

    def show(key: str) -> str:
        return decimals(facts.get(key))

    ends = "" if facts["ci"] is None else f" ({interval(facts['ci'])})"
    return {
        "  pairs": str(facts["n"]),
        "  AUC, logistic": show("auc_logistic") + ends,
        "  AUC, boosting": show("auc_boosting"),
        "  floor, logistic": show("floor_logistic"),
        "  floor, boosting": show("floor_boosting"),
        "  hard paste, logistic": show("hard_paste_logistic"),
        "  chain off, logistic": show("chain_off_logistic"),
        "  valid": "yes" if facts["valid"] else "no: " + "; ".join(facts["invalid_because"]),
        "  separated by": ", ".join(f["feature"] for f in facts["separating_features"][:5]),
    }


def _contrast_lines(facts: dict[str, Any]) -> list[str]:
    """Return a line per check of the contrasts."""
    from infrablend.report.realism import check_rows

    return [
        f"  {name}: real {real}, inserted {inserted}, {found} ({required}): {holds}"
        for name, real, inserted, found, required, holds in check_rows(facts["contrast"])
    ]
