"""`infrablend temperatures`: extract the radiometric layers of DJI and FLIR pictures."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from infrablend.cli.options import DatasetArgument, JsonOption, SplitsOption, make_reading


class ConvertedUnit(StrEnum):
    """Unit of other programs' files."""

    CELSIUS = "celsius"
    KELVIN = "kelvin"
    DECIKELVIN = "decikelvin"
    CENTIKELVIN = "centikelvin"


def temperatures(
    ctx: typer.Context,
    data: DatasetArgument,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Dataset folder to write.")],
    slope: Annotated[
        float | None, typer.Option(help="Kelvin per count, for DJI's counts: kelvin = slope * count + offset.")
    ] = None,
    offset: Annotated[
        float | None,
        typer.Option(help="Kelvin of count 0, for DJI's counts; may be negative. Of degrees Celsius, add 273.15."),
    ] = None,
    spot: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE:X,Y=DEGREES",
            help="Known temperature, degrees Celsius, at column X and row Y of the radiometric layer; the median of "
            "the 3 x 3 px around it is used. Give at least two.",
        ),
    ] = None,
    converted: Annotated[
        Path | None, typer.Option(metavar="DIR", help="TIFF files that another program converted, same names.")
    ] = None,
    converted_unit: Annotated[ConvertedUnit | None, typer.Option(help="Unit of the converted files.")] = None,
    split: SplitsOption = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier extraction in DIR.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Extract the radiometric layers of DJI and FLIR pictures as 16-bit PNG with their temperature scale."""
    ctx.obj.json = as_json

    from infrablend import api
    from infrablend.cli.exits import PARTIAL
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import print_json, print_problems, print_result, table
    from infrablend.core.finished import TEMPERATURES_FILE
    from infrablend.pipeline.count_scale import CountScale, Spot

    unit = None if converted_unit is None else converted_unit.value
    scale = CountScale(slope, offset, [Spot.of_text(t) for t in spot or ()], converted, unit)
    with shown_progress(ctx.obj, "extracting") as on_progress:
        report = api.extract_temperatures(
            data, out, scale, reading=make_reading(split, None, None, None, None), overwrite=overwrite,
            on_progress=on_progress,
        )  # fmt: skip
    print_problems(report.problems, ctx.obj.log_path, out / TEMPERATURES_FILE)
    if as_json:
        print_json({"out": str(out), **report.to_json()})
    else:
        rows = {"pictures": str(report.pictures), **{text: str(n) for text, n in report.scales.items()}}
        if report.range_k is not None:
            low, high = (k - 273.15 for k in report.range_k)
            rows["apparent temperatures"] = f"{low:.1f} to {high:.1f} degrees Celsius"
        for s in report.spots:
            rows[f"{s.spot.file}:{s.spot.xy[0]},{s.spot.xy[1]}={s.spot.celsius:g}"] = s.describe()
        print_result(f"{table(rows)}\n\n{out}")
    if not report.ok:
        raise typer.Exit(PARTIAL)
