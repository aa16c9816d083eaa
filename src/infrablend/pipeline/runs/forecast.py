"""Forecasts what a planned run will insert: some of its frames get their objects, and nothing is drawn."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from infrablend.core.camera import fov_of_width
from infrablend.core.frame_record import FrameRecord
from infrablend.core.frame_row import FrameRow
from infrablend.errors import DatasetError, Problem
from infrablend.pipeline.compose.frame import FrameComposer
from infrablend.pipeline.compose.settings import settings_for
from infrablend.pipeline.plans.estimate import objects_per_frame
from infrablend.pipeline.plans.levels import dataset_levels
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.runs.exports import draw_statistics
from infrablend.pipeline.runs.inserted import count_objects, nothing_inserted
from infrablend.rendering import make_renderer
from infrablend.report.run.run_warnings import absent_warnings

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
    nothing = [replace(p, severity="warning") for p in nothing_inserted(plan.recipe, counts, draws)]
    return {k: v for k, v in found.items() if v}, nothing or (absent_warnings(draws) if draws else [])


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
