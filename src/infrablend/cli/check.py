"""`infrablend check`: find problems in a dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from infrablend.cli.options import (
    DatasetArgument,
    FormatOption,
    FormOption,
    JsonOption,
    MetadataOption,
    ReadingOption,
    SplitsOption,
    make_reading,
)

if TYPE_CHECKING:
    from infrablend.report.checking import CheckReport

SHOWN_EACH = 3


def check(
    ctx: typer.Context,
    data: DatasetArgument,
    strict: Annotated[bool, typer.Option("--strict", help="Treat warnings as errors.")] = False,
    no_decode: Annotated[bool, typer.Option("--no-decode", help="Read only the headers of the pictures.")] = False,
    split: SplitsOption = None,
    form: FormOption = None,
    format: FormatOption = None,
    metadata: MetadataOption = None,
    options: ReadingOption = None,
    as_json: JsonOption = False,
) -> None:
    """List every problem of a dataset's labels and pictures; exit code 1 if there are errors."""
    from infrablend import api
    from infrablend.cli.exits import PARTIAL
    from infrablend.cli.progress import shown_progress
    from infrablend.cli.results import print_json, print_result

    session = ctx.obj
    session.json = as_json
    reading = make_reading(split, format, form, metadata, options)
    with shown_progress(session, "checking") as on_progress:
        report = api.check(
            data,
            reading=reading,
            decode=not no_decode,
            on_progress=on_progress,
        )
    if as_json:
        print_json(report.to_json())
    else:
        print_result("\n".join(_lines(report)))
    if not report.ok(strict):
        raise typer.Exit(PARTIAL)


def _lines(report: CheckReport) -> list[str]:
    """Return the problems grouped by code, the first few of each, and the totals."""
    lines: list[str] = []
    for title, problems in (("errors", report.errors), ("warnings", report.warnings)):
        if problems:
            lines += [f"{len(problems)} {title if len(problems) > 1 else title[:-1]}"]
        for code in dict.fromkeys(p.code for p in problems):
            same = [p for p in problems if p.code == code]
            lines.append(f"  {code}: {len(same)}")
            lines += [f"    {p}" for p in same[:SHOWN_EACH]]
            if len(same) > SHOWN_EACH:
                lines.append(f"    ... and {len(same) - SHOWN_EACH} more; --json lists all")
    how = "pictures decoded" if report.decoded else "pictures not decoded"
    what = f"{report.format or 'unreadable'}, {report.images} images, {report.objects} objects, {how}"
    return [*lines, f"{report.root}: {what}: {'clean' if not report.problems else _sum(report)}"]


def _sum(report: CheckReport) -> str:
    return f"{len(report.errors)} error(s), {len(report.warnings)} warning(s)"
