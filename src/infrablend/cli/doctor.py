"""`infrablend doctor`: check that everything a run needs is installed."""

from __future__ import annotations

import typer

from infrablend.cli.options import JsonOption


def doctor(ctx: typer.Context, as_json: JsonOption = False) -> None:
    """Report Python, bpy, libraries, devices, torch, Ultralytics, disk; exit code 3 if a run would fail."""
    from infrablend import api
    from infrablend.cli.exits import ENVIRONMENT
    from infrablend.cli.results import print_json, print_result, table

    ctx.obj.json = as_json
    diagnosis = api.diagnose()
    if as_json:
        print_json(diagnosis.to_json())
    else:
        print_result(table({f"{c.status:<7}  {c.name}": c.found for c in diagnosis.checks}))
        for c in diagnosis.checks:
            if c.todo:
                print_result(f"-> {c.name}: {c.todo}")
    if not diagnosis.ok:
        raise typer.Exit(ENVIRONMENT)
