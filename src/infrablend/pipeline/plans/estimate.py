"""Estimates of a planned run: frames, disk space, time and cost on idle machines."""

from __future__ import annotations

import statistics
from collections import Counter
from typing import Any

from infrablend.pipeline.plans.plan import RunPlan
from infrablend.sampling.scene import mean_objects

# Measured with Cycles on the CPU and one worker: 4 frames took 6.4 CPU seconds, 24 took 11.8. Workers start in
# parallel, so their number does not change the time until the first frame.
START_S = 5.5
TYPICAL_FRAME_CPU_S = 0.26
# Processor time of each object beyond the first: people 0.29 s, cars 0.5 s.
TYPICAL_OBJECT_CPU_S = 0.3
TYPICAL_LATTICE_FRAME_CPU_S = 0.06  # the artistic look without Cycles
READ_PICTURE_S = 0.01
WRITE_LABELS_S = 0.003  # per frame and format, by one process
# Bytes of records, logs, reports and labels: per frame, and per inserted object.
_BYTES_PER_FRAME = 6_000
_BYTES_PER_OBJECT = 10_000


def estimate_run(
    plan: RunPlan, workers: int, shards: int | None = None, price_per_core_hour: float | None = None
) -> dict[str, Any]:
    """Estimate frames, disk space, time and cost of a run on idle machines.

    Args:
        plan: Plan of the run.
        workers: Worker processes, for each shard if there are any.
        shards: Number of shards that the run is divided into; None for an undivided run.
        price_per_core_hour: Price, in any currency; None gives no cost.
    """
    recipe, frames, workers = plan.recipe, len(plan.frames), max(workers, 1)
    objects = _objects_per_frame(plan)
    of_cycles = recipe.appearance.traces_light or recipe.samples
    frame_cpu_s = TYPICAL_FRAME_CPU_S if of_cycles else TYPICAL_LATTICE_FRAME_CPU_S
    frame_cpu_s += TYPICAL_OBJECT_CPU_S * max(objects - 1, 0)
    sizes = [f.background.path.stat().st_size for f in plan.frames[:: max(1, frames // 200)]]
    factor = 4.0 if recipe.output.image == "png" else 1.0
    per_frame = (statistics.fmean(sizes) if sizes else 0.0) * factor + _BYTES_PER_FRAME
    per_object = _BYTES_PER_OBJECT * objects * sum(f.configuration is not None for f in plan.frames)
    start_s = START_S + READ_PICTURE_S * (len(plan.sample) if plan.needs_levels else 0)
    labels_s = frames * WRITE_LABELS_S * max(1, len(recipe.output.formats))
    core_hours = (workers * START_S * (shards or 1) + frames * frame_cpu_s + labels_s) / 3600
    found: dict[str, Any] = {
        "backgrounds": len(plan.dataset.images),
        "frames": frames,
        "frames_per_split": dict(Counter(f.background.split for f in plan.frames)),
        "disk_bytes": round(per_frame * frames + per_object),
        "about_s": round(start_s + frames * frame_cpu_s / workers + labels_s),
        "workers": workers,
        "core_hours": round(core_hours, 3),
    }
    if price_per_core_hour is not None:
        found["cost"] = round(core_hours * price_per_core_hour, 2)
    if shards is not None:
        # Times of one shard and of merging, not of the whole run.
        most = -(-frames // shards)
        found |= {
            "about_s": None,
            "shards": shards,
            "frames_per_shard": most,
            "about_per_shard_s": round(start_s + most * frame_cpu_s / workers),
            "about_merge_s": round(labels_s),
        }
    return {**found, "left_out": dict(Counter(p.code for p in plan.problems if p.severity == "error"))}


def _objects_per_frame(plan: RunPlan) -> float:
    """Return the mean number of objects in frames that are not unchanged pictures, from about 200 of them."""
    changed = [f for f in plan.frames if f.configuration is not None]
    some = changed[:: max(1, len(changed) // 200)]
    return sum(mean_objects(plan.recipe, f.key((1, 1))) for f in some) / max(len(some), 1)
