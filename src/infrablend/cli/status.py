"""`infrablend status`: show the states of the shards of a run."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from infrablend.cli.options import JsonOption

if TYPE_CHECKING:
    from infrablend.cli.session import Session

_SHOWN = 20


def status(
    ctx: typer.Context,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder with shards of a run, or s3://, gs://, hf://.")],
    wait: Annotated[bool, typer.Option("--wait", help="Wait until every shard is done or failed.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show which shards of a run are done, running, failed, stopped or missing; exit with 1 unless all are done."""
    session: Session = ctx.obj
    session.json = as_json

    from infrablend import api
    from infrablend.cli.exits import PARTIAL
    from infrablend.cli.results import facts, print_json, print_result, table
    from infrablend.core.addresses import shown

    states = api.status(out, wait=wait)
    counts = Counter(str(s.state) for s in states)
    if as_json:
        print_json({"out": shown(out), "states": dict(counts), "shards": [s.to_json() for s in states]})
    else:
        frames = {"frames": sum(s.frames for s in states), "finished": sum(s.finished for s in states)}
        lines = [table(facts({"shards": len(states), **counts, **frames}))]
        rest = [s for s in states if s.state != "done"]
        for s in rest[:_SHOWN]:
            lines.append(f"shard {s.shard}: {s.state}, {s.damage or f'{s.finished} of {s.frames} frames'}")
            lines += [f"  {s.command}"] * bool(s.command)
        lines += [f"... and {len(rest) - _SHOWN} more (--json lists all)"] * (len(rest) > _SHOWN)
        print_result("\n".join(lines))
    if counts["done"] < len(states):
        raise typer.Exit(PARTIAL)
