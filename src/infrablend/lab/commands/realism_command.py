"""`infrablend realism`: compare inserted objects with real ones."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from infrablend import api
from infrablend.cli.options import JsonSession, ReadingOfAllSplits, RunArgument, WorkersOption, comma_list, split_list
from infrablend.cli.output import show_result, shown_progress, table

if TYPE_CHECKING:
    from infrablend.lab.realism.realism_record import ClassFacts


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
