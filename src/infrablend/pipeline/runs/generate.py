"""Carries out a run request: reads recipe and backgrounds, plans the frames, and has the plan run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from infrablend.config.loading import read_recipe
from infrablend.config.modes import DROPPED, KEPT
from infrablend.core.addresses import address_of
from infrablend.core.file_names import as_text, is_text, real_path
from infrablend.core.ledger import LEDGER
from infrablend.core.output_checks import require_apart
from infrablend.core.tasks import OnProgress
from infrablend.core.workspace import Existing, unfinished
from infrablend.errors import ArgumentError, OutputError, Problem, format_problems
from infrablend.pipeline.plans.checks import HEIGHT_REPLACED, LENS_REPLACED, PITCH_REPLACED
from infrablend.pipeline.plans.labelled_height import require_height
from infrablend.pipeline.plans.left_out import LEFT_OUT
from infrablend.pipeline.plans.plan import RunPlan
from infrablend.pipeline.plans.planning import plan_folder
from infrablend.pipeline.plans.run_request import RunRequest
from infrablend.pipeline.plans.scenes import scenes_fact
from infrablend.pipeline.plans.shard import ShardRequest
from infrablend.pipeline.plans.times import TIME_REPLACED
from infrablend.pipeline.runs.forecast import described_sources, estimate_run, forecast_objects
from infrablend.pipeline.runs.make_shards import make_shards
from infrablend.pipeline.runs.run import RunReport, run_plan
from infrablend.report.run_warnings import NOTHING_INSERTED


def run_request(request: RunRequest, on_progress: OnProgress | None = None) -> RunReport:
    """Plan a run, and make it: whole, or in shards, here or in object storage.

    Raises:
        RecipeError, DatasetError, ModelError, OutputError, RenderError, Interrupted: See `infrablend.errors`.
    """
    if request.out is None:
        raise OutputError("no output folder given, but a run needs one. Set `out` (--out)")
    plan = plan_request(request)
    wanted = _wanted_shards(request, plan)
    if wanted is None:
        return run_plan(plan, request.out, request.execution, request.existing, on_progress)
    shards = wanted.of(len(plan.frames))
    return make_shards(plan, shards, request.out, request.execution, request.existing, on_progress)


def _wanted_shards(request: RunRequest, plan: RunPlan) -> ShardRequest | None:
    """Return the shards to make; None for a run with a file per frame.

    Raises:
        ArgumentError: All shards of a run with a file per frame are requested.
    """
    packed = plan.recipe.output.layout == "shards"
    if request.shard is not None and request.shard.number is None and not packed:
        raise ArgumentError(
            "--shard-size needs --shard I, the number of the shard, unless the recipe has output.layout: shards"
        )
    return request.shard or (ShardRequest(count=1) if packed else None)


def describe_run(request: RunRequest, price_per_core_hour: float | None = None) -> dict[str, Any]:
    """Return the estimated frames, disk space, time, cost, categories and objects of a run without writing anything.

    With a shard in the request, times are those of one shard and of merging. What is expected of objects and cameras
    is in the fields `expected_...`, see `forecast_objects`.
    """
    plan = plan_request(request)
    wanted = _wanted_shards(request, plan)
    shown = (KEPT, LENS_REPLACED, PITCH_REPLACED, HEIGHT_REPLACED, TIME_REPLACED)
    others = [p for p in plan.problems if p.severity == "warning" and p.code not in (DROPPED, *shown)]
    shards = None if wanted is None else wanted.of(len(plan.frames))[0].count
    expected, absent = forecast_objects(plan)
    return {
        **estimate_run(plan, request.execution.worker_count(), shards, price_per_core_hour),
        **dict(scenes_fact(plan.request)),
        "device": request.execution.device,
        "out": None if request.out is None or wanted else outlook(request.out, request.existing),
        "categories": [c.name for c in plan.categories],
        "new_categories": list(plan.new_categories),
        **described_sources(plan),
        **({"boxes": plan.boxes} if plan.boxes else {}),
        **{f"expected_{name}": value for name, value in expected.items()},
        "dropped_fields": [str(p) for p in plan.problems if p.code == DROPPED],
        "kept_fields": [str(p) for p in plan.problems if p.code in shown],
        "warnings": format_problems(dict.fromkeys([*absent, *others])),
        # Of a whole run: one entry of `objects` may find places in the frames that were not tried.
        "inserts_nothing": any(p.code == NOTHING_INSERTED and "." not in p.where for p in absent),
    }


def outlook(out: Path, existing: Existing) -> str | None:
    """Return what a run would do with what is in its output folder; None if there is nothing. Nothing is touched."""
    left = unfinished(out)
    if left is None and not (out.is_dir() and any(out.iterdir())):
        return None
    if left is None and not (out / LEDGER).is_file():
        return "has something else than a run of InfraBlend: would be refused"
    state = "has an unfinished run" if left else "has a run"
    then = {
        "refuse": "would be refused without --resume (finish it) or --overwrite (replace it)",
        "resume": "--resume would keep its finished frames and make the missing ones",
        "overwrite": "--overwrite would replace it once the new run is complete",
    }[existing]
    return f"{state}: {then}"


def plan_request(request: RunRequest) -> RunPlan:
    """Load the recipe, read the backgrounds, and plan the frames.

    Raises:
        RecipeError, DatasetError, ModelError, OutputError: See `infrablend.errors`.
    """
    loaded = read_recipe(request.recipe, request.settings)
    for option, path in (("--data", request.data), ("--out", request.out or Path())):
        if not is_text(str(path)) or "\0" in str(path):
            raise OutputError(
                f"{option} {as_text(str(path))!r}: a path that is not UTF-8; expected a path that the run record "
                "(JSON) can hold. Rename the folder, or use a link to it"
            )
    address = None if request.out is None else address_of(request.out)
    if address is not None and loaded.recipe.output.layout != "shards":
        raise ArgumentError(
            f"out: found {address} and output.layout: files, expected packed shards in object storage. Add "
            "--set output.layout=shards; `infrablend merge` makes files of them"
        )
    if request.out is not None and address is None and address_of(request.data) is None:
        require_apart(request.data, request.out)
    plan = plan_folder(loaded.recipe, request.data, request.seed, request.reading, request.selection, loaded.warnings)
    require_height(plan.recipe, plan.problems)
    if request.reading.val_share is not None and "val" not in {f.background.split for f in plan.frames}:
        left_out = [p for p in plan.problems if p.code in LEFT_OUT]
        raise ArgumentError(
            f"val_share: none of the {len(plan.frames)} frames is in val"
            + (f", as {len(left_out)} picture(s) cannot be used. Mend these" if left_out else "")
            + ". Choose more pictures, or spread them over the data with --sample instead of --limit; and let --split, "
            "if given, contain val",
            left_out,
        )
    return replace(plan, request={**_recorded(request, loaded.warnings), **plan.request})


def _recorded(request: RunRequest, warnings: Sequence[Problem]) -> dict[str, object]:
    """Return how a request reads and chooses, where it is not the default, and the recipe's warnings; JSON values."""
    reading = {k: v for k, v in asdict(request.reading).items() if v}
    if request.reading.metadata is not None:
        reading["metadata"] = str(real_path(Path(request.reading.metadata)))
    selection = {k: v for k, v in asdict(request.selection).items() if v is not None}
    found = {"reading": reading, "selection": selection, "warnings": [p.to_json() for p in warnings]}
    return {name: value for name, value in found.items() if value}
