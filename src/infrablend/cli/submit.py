"""`infrablend submit`: give a run in shards to the scheduler of a cluster."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from infrablend.cli.generate import require_one_selection
from infrablend.cli.options import JsonOption

if TYPE_CHECKING:
    from infrablend.cli.session import Session

_OURS = {
    "shard": "--shard",
    "shard_size": "--shard-size",
    "plan": "--plan",
    "resume": "--resume",
    "overwrite": "--overwrite",
    "as_json": "--json",
}
"""Options of `generate` that the jobs set themselves."""


class To(StrEnum):
    """Schedulers."""

    SLURM = "slurm"
    KUBERNETES = "kubernetes"


def submit(
    ctx: typer.Context,
    words: Annotated[
        list[str], typer.Argument(metavar="-- RECIPE --data DIR --out DIR...", help="Arguments of `generate`.")
    ],
    to: Annotated[To, typer.Option(help="Scheduler of the cluster.")],
    shards: Annotated[int, typer.Option(metavar="N", help="Number of shards.")],
    into: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the merged run.")],
    show: Annotated[
        bool, typer.Option("--print", help="Print the script or manifest instead of submitting it.")
    ] = False,
    name: Annotated[str, typer.Option(help="Name of the jobs.")] = "infrablend",
    cores: Annotated[int, typer.Option(min=1, help="Cores, and worker processes, of a shard.")] = 8,
    memory: Annotated[int, typer.Option(metavar="GIB", min=1, help="Memory of a shard.")] = 16,
    minutes: Annotated[
        int, typer.Option(min=3, help="SLURM: time limit of a shard, which is then queued again and continues.")
    ] = 240,
    parallel: Annotated[int | None, typer.Option(min=1, help="Most shards at the same time [default: all].")] = None,
    partition: Annotated[str | None, typer.Option(help="SLURM: partition.")] = None,
    account: Annotated[str | None, typer.Option(help="SLURM: account.")] = None,
    image: Annotated[str | None, typer.Option(help="Kubernetes: container image with InfraBlend.")] = None,
    volumes: Annotated[
        list[str] | None,
        typer.Option("--volume", metavar="CLAIM:/PATH", help="Kubernetes: shared storage of the pods; repeatable."),
    ] = None,
    program: Annotated[
        str | None,
        typer.Option(help="Path of infrablend on the cluster [default: SLURM this one, Kubernetes infrablend]."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Submit a run in shards to SLURM or Kubernetes: a job for each shard, and one that merges them."""
    session: Session = ctx.obj
    session.json = as_json

    from infrablend import api
    from infrablend.cli.results import print_json, print_result

    given = parse_generate(words)
    job = api.Submission(
        tuple(words) if given["workers"] else (*words, "--workers", str(cores)),
        shards,
        given["out"],
        into,
        _program(program, to),
        tuple(_paths(given)),
        name,
        cores,
        memory,
        minutes,
        parallel,
        partition,
        account,
        image,
        tuple(api.Volume.parse(v) for v in volumes or ()),
    )
    if show:
        text = api.submission_text(job, to.value)
        if as_json:
            print_json({"to": to.value, "text": text})
        else:
            sys.stdout.buffer.write(os.fsencode(text))
            sys.stdout.flush()
        return
    said = api.submit(job, to.value)
    if as_json:
        print_json({"to": to.value, "said": said})
    else:
        print_result(said)


def parse_generate(words: Sequence[str]) -> dict[str, Any]:
    """Return the values of the arguments of `generate`, without running it.

    Raises:
        click.UsageError: They are wrong, or contain what the jobs set themselves.
    """
    from typer.main import get_command

    from infrablend.cli.app import build_app

    if "--" in words:
        raise typer.BadParameter("-- a second time; write a name that begins with - as ./-NAME")
    group: Any = get_command(build_app())
    command = group.commands["generate"]
    given: dict[str, Any] = command.make_context("infrablend submit ... --", list(words)).params
    normal = {p.name: p.default for p in command.params}
    if wrong := [option for key, option in _OURS.items() if (given[key] or None) != (normal[key] or None)]:
        raise typer.BadParameter(f"{', '.join(wrong)}: the jobs set it themselves; leave it out")
    require_one_selection(given["limit"], given["sample"], given["frames"])
    if given["price"] is not None:
        raise typer.BadParameter("used by --plan only, which no job gives; leave it out", param_hint="--price")
    return given


def _paths(given: dict[str, Any]) -> list[Path]:
    recipe = Path(str(given["recipe"]))
    named = [recipe] if len(recipe.parts) > 1 or recipe.suffix else []
    return [*named, *(v for v in given.values() if isinstance(v, Path))]


def _program(given: str | None, to: To) -> tuple[str, ...]:
    if given is not None:
        return (given,)
    if to is To.KUBERNETES:
        return ("infrablend",)
    here = Path(sys.executable).with_name("infrablend")
    return (str(here),) if here.is_file() else (sys.executable, "-m", "infrablend")
