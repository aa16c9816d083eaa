"""`infrablend fetch`: download a public dataset if its licence and address allow it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from infrablend import api
from infrablend.cli.completion import complete_source
from infrablend.cli.exits import problem_lines
from infrablend.cli.options import JsonSession, comma_list
from infrablend.cli.output import facts, print_result, show_result, shown_fetch, table


def fetch(
    session: JsonSession,
    *,
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Dataset, see --list.", autocompletion=complete_source)
    ] = None,
    out: Annotated[Path | None, typer.Argument(metavar="DST", help="Output folder: new, or an earlier DST.")] = None,
    part: Annotated[
        Any, typer.Option(metavar="LIST", parser=comma_list, help="Parts to fetch, see --list [default: all].")
    ] = None,
    url: Annotated[str | None, typer.Option(metavar="URL", help="Fetch the file from this address instead.")] = None,
    sha256: Annotated[str | None, typer.Option(metavar="HEX", help="Required SHA-256 of the file.")] = None,
    archive: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Unpack this file instead of fetching it.")
    ] = None,
    keep_archive: Annotated[bool, typer.Option("--keep-archive", help="Keep the archive in DST.")] = False,
    listing: Annotated[bool, typer.Option("--list", help="List the datasets and their licences.")] = False,
) -> None:
    """Fetch a public dataset; without DST, show its address and licence.

    Repeat the command with another --part to add it to DST.
    """
    if listing:
        sources = api.list_sources()
        rows = {s.name: _line(s) for s in sources}
        show_result(session, [asdict(s) for s in sources], lambda: table(rows))
        return
    if name is None:
        raise typer.BadParameter("give the NAME of a dataset, or --list", param_hint="NAME")
    if out is None:
        print_result(api.describe_source(name))
        return
    typer.echo(api.describe_source(name, licence_only=True), err=True)
    request = api.FetchRequest(part, url, sha256, archive, keep_archive)
    with shown_fetch(session) as on_progress:
        report = api.fetch(name, out, request, on_progress=on_progress)
    if report.problems:
        lines = problem_lines(report.problems, session.log_path)
        typer.echo("\n".join([f"{len(report.problems)} warning(s):", *lines]), err=True)
    wanted = ("fetched", "present", "files", "size_bytes")
    brief = facts({k: v for k, v in report.to_json().items() if k in wanted})
    show_result(session, report.to_json(), lambda: f"{table(brief)}\n{report.out}")


def _line(source: api.SourceEntry) -> str:
    how = "fetched" if source.fetched else "by hand"
    several = f", parts {','.join(source.parts)}" if len(source.parts) > 1 else ""
    return f"{how}, licence {source.licence}{several}  {source.page}"
