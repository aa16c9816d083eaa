"""Forecasts of a planned run: frames, disk space, time and cost on idle machines, and what it will insert.

For the latter some of its frames get their objects, and nothing is drawn.
"""

from __future__ import annotations

import math
import statistics
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from infrablend.core.camera import fov_of_width
from infrablend.core.frame_row import FrameRecord, FrameRow
from infrablend.errors import DatasetError, Problem
from infrablend.formats.cameras.flight_headers import GIVEN
from infrablend.pipeline.compose.frame import FrameComposer
from infrablend.pipeline.compose.settings import settings_for
from infrablend.pipeline.plans.backgrounds import dataset_levels
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.runs.exports import draw_statistics
from infrablend.rendering import make_renderer
from infrablend.report.run_warnings import (
    NOTHING_INSERTED,
    absent_warnings,
    count_objects,
    few_inserted,
    nothing_inserted,
)
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


def described_sources(plan: RunPlan) -> dict[str, str]:
    """Return in words where the lens, and the time of day of a recipe that uses it, come from."""
    c = plan.recipe.camera
    images = plan.dataset.images
    lenses = Counter(_source(plan, "hfov_deg") for i in images if c.needs_lens and i.capture.hfov_deg is not None)
    across = fov_of_width(c.sensor_width_mm, c.focal_length_mm)
    lenses[f"from the recipe, {across:.1f} degrees across"] = len(images) - lenses.total()
    found = {"lens": lenses}
    if plan.recipe.environment.sky is not None:
        found["time_of_day"] = Counter(
            f"{time} ({i.capture.time_from or _source(plan, 'time_of_day')})"
            if (time := i.capture.time_of_day)
            else "unknown, taken as night"
            for i in images
        )
    return {k: "; ".join(f"{text} ({n})" for text, n in counts.items() if n) for k, counts in found.items()}


def _source(plan: RunPlan, field: str) -> str:
    """Return the sources of a fact of the pictures, as the reader of their headers lists them."""
    rows = plan.dataset.notes.get("flight", {}).get("facts", ())
    return ", ".join(r["source"] for r in rows if r["field"] == field and r["source"]) or GIVEN


def objects_per_frame(plan: RunPlan) -> dict[str, float]:
    """Return the mean number of objects by model in frames that are not unchanged pictures, from about 200 of them."""
    changed = [f for f in plan.frames if f.configuration is not None]
    some = [mean_objects(plan.recipe, f.key((1, 1))) for f in changed[:: max(1, len(changed) // 200)]]
    return {model: statistics.fmean(asked[model] for asked in some) for model in (some[0] if some else ())}


# Objects, about, that are placed for a forecast, and bounds of the number of frames for them.
_OBJECTS = 60
_FRAMES = (2, 40)
_PERCENT = (5, 50, 95)


def forecast_objects(plan: RunPlan) -> tuple[dict[str, object], list[Problem]]:
    """Place the objects of some frames, and return what they tell of the whole run, and warnings.

    Returns:
        `tried`, the number of frames; `unusable`, those whose background cannot be used, by reason; `objects`, those
        of the tried frames times all frames per tried frame, by class, before any is left out because nobody could see
        it; `left_out` of the tried frames, by reason; and 5, 50 and 95 % of the boxes' longer sides (`size_px`, by
        class) and of the cameras'
        pitch, height (distance from the objects, with the paper's placement) and field of view, by where they came
        from: the picture's `metadata`, `recipe`, `horizon`, or `labels` that correct a height.
    """
    changed = [f for f in plan.frames if f.configuration is not None]
    if not changed:
        return {}, []
    enough = np.clip(_OBJECTS / max(sum(objects_per_frame(plan).values()), 1.0), *_FRAMES)
    some = [changed[int(k)] for k in np.linspace(0, len(changed) - 1, min(len(changed), round(float(enough))))]
    # Its renderer is never asked, so that no Blender is started.
    settings = settings_for(plan, dataset_levels(plan) if plan.needs_levels else None, Execution(renderer="flat"))
    composer = FrameComposer(settings, make_renderer("flat", "cpu"))
    placed: list[tuple[PlannedFrame, FrameRecord]] = []
    unusable = Counter[str]()
    for frame in some:
        try:
            placed.append((frame, composer.place(frame)))
        except DatasetError as error:
            unusable.update({p.code for p in error.problems} or ["unusable"])
    rows = [FrameRow.of(record) for _, record in placed]
    counts = count_objects(plan.recipe, rows)
    draws = draw_statistics(rows)
    classes = [o.category or plan.models[o.model].category for o in plan.recipe.objects]
    times = len(changed) / len(some)
    found = {
        "tried": len(some),
        "unusable": dict(unusable),
        "objects": _objects(classes, counts.get("objects_by_kind", {}), times),
        "left_out": counts.get("objects_left_out", {}),
        "size_px": _sizes(rows),
        **_cameras(plan, placed),
    }
    nothing = nothing_inserted(plan.recipe, counts, draws)
    if not placed:
        text = f"nothing can be inserted, as none of the {len(some)} pictures that were tried can be used: "
        text += ", ".join(f"{code} {n}" for code, n in unusable.most_common())
        todo = "look at one of them (infrablend try), which says why; or use pictures or a recipe that fit each other"
        nothing = [Problem("pictures", NOTHING_INSERTED, text, "pictures that the recipe can use", todo)]
    nothing = [replace(p, severity="warning") for p in nothing]
    some_absent = [*few_inserted(plan.recipe, counts, draws), *(absent_warnings(draws) if draws else ())]
    return {k: v for k, v in found.items() if v}, nothing or some_absent


def _objects(classes: Sequence[str], by_kind: Mapping[str, Mapping[str, int]], times: float) -> dict[str, int]:
    placed = Counter(dict.fromkeys(classes, 0))
    for where, n in by_kind.items():
        placed[classes[int(where.rpartition(".")[2])]] += n["inserted"]
    return {name: round(n * times) for name, n in placed.items()}


def _sizes(rows: Sequence[FrameRow]) -> dict[str, dict[str, float]]:
    sizes = defaultdict[str, list[float]](list)
    for row in rows:
        for insert in row.inserts:
            sizes[insert.category].append(insert.size_px)
    return {name: _spread(values) for name, values in sizes.items()}


def _cameras(
    plan: RunPlan, placed: Iterable[tuple[PlannedFrame, FrameRecord]]
) -> dict[str, dict[str, dict[str, float]]]:
    """Return the spread of pitch, height or distance, and field of view, each by where it came from."""
    of = plan.recipe.camera
    found = defaultdict[str, dict[str, list[float]]](dict)
    for frame, record in placed:
        scene = record.scene
        capture = frame.background.capture
        assert scene is not None
        camera = scene.camera
        stated = "metadata" if of.stated_pitch_deg is None else "recipe"
        values = {("pitch_deg", scene.draws.get("pitch_from", stated)): math.degrees(camera.pitch_rad)}
        if scene.view is None:
            values["distance_m", "recipe"] = camera.distance_m
        else:
            origin = "labels" if scene.view.anchors else "metadata" if of.needs_height else "recipe"
            values["height_m", origin] = scene.view.camera_height_m
        origin = "metadata" if of.needs_lens and capture.hfov_deg is not None else "recipe"
        values["hfov_deg", origin] = fov_of_width(camera.sensor_width_mm, camera.focal_length_mm)
        for (what, origin), value in values.items():
            found[what].setdefault(origin, []).append(value)
    return {what: {origin: _spread(v) for origin, v in by.items()} for what, by in found.items()}


def _spread(values: Sequence[float]) -> dict[str, float]:
    return {f"{p} %": round(float(v), 1) for p, v in zip(_PERCENT, np.percentile(values, _PERCENT), strict=True)}
