"""`infrablend fetch`: download a public dataset if its licence and address allow it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend.cli.completion import complete_source
from infrablend.cli.options import JsonOption, comma_list

if TYPE_CHECKING:
    from infrablend.cli.session import Session
    from infrablend.fetching.fetch import SourceEntry


def fetch(
    ctx: typer.Context,
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Dataset, see --list.", autocompletion=complete_source)
    ] = None,
    out: Annotated[Path | None, typer.Argument(metavar="DST", help="Output folder: new, or an earlier DST.")] = None,
    part: Annotated[
        str | None, typer.Option("--part", metavar="LIST", help="Parts to fetch, see --list [default: all].")
    ] = None,
    url: Annotated[
        str | None, typer.Option("--url", metavar="URL", help="Fetch the file from this address instead.")
    ] = None,
    sha256: Annotated[str | None, typer.Option("--sha256", metavar="HEX", help="Required SHA-256 of the file.")] = None,
    archive: Annotated[
        Path | None, typer.Option("--archive", metavar="FILE", help="Unpack this file instead of fetching it.")
    ] = None,
    keep_archive: Annotated[bool, typer.Option("--keep-archive", help="Keep the archive in DST.")] = False,
    listing: Annotated[bool, typer.Option("--list", help="List the datasets and their licences.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Fetch a public dataset; without DST, show its address and licence.

    Repeat the command with another --part to add it to DST.
    """
    session: Session = ctx.obj
    session.json = as_json
    parts = None if part is None else comma_list(part)

    from infrablend import api
    from infrablend.cli.exits import problem_lines
    from infrablend.cli.output import facts, print_json, print_result, shown_fetch, table

    if listing:
        sources = api.list_sources()
        if as_json:
            print_json([asdict(s) for s in sources])
        else:
            print_result(table({s.name: _line(s) for s in sources}))
        return
    if name is None:
        raise typer.BadParameter("give the NAME of a dataset, or --list", param_hint="NAME")
    if out is None:
        print_result(api.describe_source(name))
        return
    typer.echo(api.describe_source(name, licence_only=True), err=True)
    request = api.FetchRequest(parts, url, sha256, archive, keep_archive)
    with shown_fetch(session) as on_progress:
        report = api.fetch(name, out, request, on_progress=on_progress)
    if report.problems:
        lines = problem_lines(report.problems, session.log_path)
        typer.echo("\n".join([f"{len(report.problems)} warning(s):", *lines]), err=True)
    if as_json:
        print_json(report.to_json())
    else:
        wanted = ("fetched", "present", "files", "size_bytes")
        print_result(table(facts({k: v for k, v in report.to_json().items() if k in wanted})))
        print_result(str(report.out))


def _line(source: SourceEntry) -> str:
    how = "fetched" if source.fetched else "by hand"
    several = f", parts {','.join(source.parts)}" if len(source.parts) > 1 else ""
    return f"{how}, licence {source.licence}{several}  {source.page}"
