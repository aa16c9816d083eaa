"""`infrablend split`: new splits without neighbours in two of them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend.cli.completion import complete_written_format
from infrablend.cli.options import (
    DatasetArgument,
    FormatOption,
    FormOption,
    JsonOption,
    MetadataOption,
    ReadingOption,
    SeedOption,
    make_reading,
)

if TYPE_CHECKING:
    from infrablend.pipeline.split import SplitReport


class By(StrEnum):
    """What stays together."""

    SEQUENCE = "sequence"
    DATE = "date"
    GAP = "gap"


def split(
    ctx: typer.Context,
    data: DatasetArgument,
    out: Annotated[Path, typer.Argument(metavar="DST", help="Folder to write.")],
    by: Annotated[By, typer.Option(help="What stays in one split: a flight, a day, or a run of frame numbers.")],
    gap: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="End a run where the next frame is more than N away [default: 5]."),
    ] = None,
    shares: Annotated[str, typer.Option(metavar="LIST", help="Shares of train, val and test.")] = "0.7,0.1,0.2",
    seed: SeedOption = 0,
    to: Annotated[
        str | None,
        typer.Option(
            metavar="FORMAT",
            help="Format to write [default: that of the dataset].",
            autocompletion=complete_written_format,
        ),
    ] = None,
    lists: Annotated[bool, typer.Option("--list", help="Write only three lists of pictures and split.json.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier split dataset in DST.")] = False,
    form: FormOption = None,
    format: FormatOption = None,
    metadata: MetadataOption = None,
    options: ReadingOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write a dataset with new splits that do not share neighbouring frames; pictures are hard links."""
    if gap is not None and by is not By.GAP:
        raise typer.BadParameter("--gap goes with --by gap", param_hint="--gap")
    if to is not None and lists:
        raise typer.BadParameter("--list writes no dataset; leave out --to", param_hint="--to")
    wanted = _parsed_shares(shares)

    from infrablend import api
    from infrablend.cli.exits import printable
    from infrablend.cli.results import print_json, print_result
    from infrablend.pipeline.split import SplitRule

    ctx.obj.json = as_json
    report = api.split(
        data,
        out,
        SplitRule(by.value, gap, wanted, seed),
        to=to or "native",
        lists=lists,
        reading=make_reading(None, format, form, metadata, options),
        overwrite=overwrite,
    )
    for problem in report.problems:
        typer.echo(printable(f"{problem.severity}: {problem}"), err=True)
    if as_json:
        print_json({"out": str(report.out)} | report.to_json())
    else:
        print_result("\n\n".join(_blocks(report)))


def _parsed_shares(text: str) -> list[float]:
    """Return the numbers that `--shares` gives."""
    try:
        wanted = [float(part) for part in text.split(",")]
    except ValueError:
        wanted = []
    if len(wanted) != 3:
        raise typer.BadParameter(f"{text!r}: three numbers, such as 0.7,0.1,0.2", param_hint="--shares")
    return wanted


def _blocks(report: SplitReport) -> list[str]:
    from infrablend.cli.results import facts, grid, table

    splits = list(report.images)
    rows = []
    for name, of in {"images": report.images, **report.objects}.items():
        shares = report.shares(of)
        rows.append([name, *(f"{of[s]} ({100 * shares[s]:.1f} %)" for s in splits)])
    wanted = ["wanted", *(f"{100 * w:.1f} %" for w in report.wanted)]
    blocks = [f"{len(report.groups)} groups by {report.by}", grid(["", *splits], [wanted, *rows])]
    after = {(one.split, one.other): one for one in report.after}
    near = []
    for one in report.before:
        then = after.get((one.split, one.other))
        near.append(
            [
                f"{one.split} near {one.other}",
                _near(one.near, one.images),
                _near(then.near, then.images) if then else "-",
            ]
        )
    if not near:
        near = [[f"{one.split} near {one.other}", "-", _near(one.near, one.images)] for one in report.after]
    if near:
        blocks.append(grid(["neighbours (at most 5 frames away)", "before", "after"], near))
    if report.losses:
        blocks.append(table(facts({"losses": report.losses})))
    return [*blocks, f"{report.out}: {report.format}, {report.files} files"]


def _near(near: int, images: int) -> str:
    return f"{near} of {images}"
