"""Estimates of a planned run: frames, disk space, time and cost on idle machines."""

from __future__ import annotations

import statistics
from collections import Counter

from infrablend.pipeline.plans.plan import RunPlan
from infrablend.sampling.scene_sampler import mean_objects

# Measured by `bench/recipes.py`, with one worker.
# Start and end of a run, and what Blender adds; workers start in parallel, so their number does not change it.
START_S = 1.8
BLENDER_START_S = 2.0
# Processor time of a frame without its objects and label files: in the artistic look, and in the others, which fit the
# grey levels and the sensor.
ARTISTIC_FRAME_CPU_S = 0.02
FRAME_CPU_S = 0.06
# Processor time of each object, by model, and of drones and others.
OBJECT_CPU_S = {"person": 0.06, "car": 0.065, "deer": 0.085, "boar": 0.085}
OTHER_OBJECT_CPU_S = 0.035
# What Cycles adds for each object: building its scene, and each sample of its pixels.
CYCLES_OBJECT_CPU_S = 0.05
CYCLES_SAMPLE_CPU_S = 0.002
READ_PICTURE_S = 0.002
WRITE_LABELS_S = 0.0016  # per frame and format, by one process
# Bytes of records, logs, reports and labels: per frame, and per inserted object.
_BYTES_PER_FRAME = 6_000
_BYTES_PER_OBJECT = 10_000


def estimate_run(
    plan: RunPlan, workers: int, shards: int | None = None, price_per_core_hour: float | None = None
) -> dict[str, object]:
    """Estimate frames, disk space, time and cost of a run on idle machines.

    Args:
        plan: Plan of the run.
        workers: Worker processes, for each shard if there are any.
        shards: Number of shards that the run is divided into; None for an undivided run.
        price_per_core_hour: Price, in any currency; None gives no cost.
    """
    recipe = plan.recipe
    frames = len(plan.frames)
    workers = max(workers, 1)
    by_model = objects_per_frame(plan)
    objects = sum(by_model.values())
    frame_cpu_s = ARTISTIC_FRAME_CPU_S if recipe.look == "artistic" else FRAME_CPU_S
    frame_cpu_s += sum(n * OBJECT_CPU_S.get(model, OTHER_OBJECT_CPU_S) for model, n in by_model.items())
    begin_s = START_S
    if recipe.needs_blender:
        frame_cpu_s += objects * (CYCLES_OBJECT_CPU_S + CYCLES_SAMPLE_CPU_S * (recipe.samples or 64))
        begin_s += BLENDER_START_S
    sizes = [f.background.path.stat().st_size for f in plan.frames[:: max(1, frames // 200)]]
    factor = 4.0 if recipe.output.image == "png" else 1.0
    per_frame = (statistics.fmean(sizes) if sizes else 0.0) * factor + _BYTES_PER_FRAME
    per_object = _BYTES_PER_OBJECT * objects * sum(f.configuration is not None for f in plan.frames)
    start_s = begin_s + READ_PICTURE_S * (len(plan.sample) if plan.needs_levels else 0)
    labels_s = frames * WRITE_LABELS_S * max(1, len(recipe.output.formats))
    core_hours = (workers * begin_s * (shards or 1) + frames * frame_cpu_s + labels_s) / 3600
    found: dict[str, object] = {
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


def objects_per_frame(plan: RunPlan) -> dict[str, float]:
    """Return the mean number of objects by model in frames that are not unchanged pictures, from about 200 of them."""
    changed = [f for f in plan.frames if f.configuration is not None]
    some = [mean_objects(plan.recipe, f.key((1, 1))) for f in changed[:: max(1, len(changed) // 200)]]
    return {model: statistics.fmean(asked[model] for asked in some) for model in (some[0] if some else ())}
