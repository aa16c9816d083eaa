"""Select the measured frames: drawn by the shipped recipe, spread evenly over its plan."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.config.loading import load_recipe
from infrablend.config.modes import recipe_from_json
from infrablend.config.recipe import Recipe
from infrablend.core.render import PlacedScene
from infrablend.formats.published import hit_uav
from infrablend.pipeline.compose.settings import FrameSettings
from infrablend.pipeline.plans.backgrounds import dataset_levels
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.pipeline.plans.planning import make_plan
from infrablend.pipeline.plans.run_request import Execution
from infrablend.sampling.scene_sampler import sample_scene

RECIPE = "hit-uav-drone"
PHYSICAL_RECIPE = "hit-uav-drone-physical"
SEED = 0


@dataclass(frozen=True, eq=False)
class Work:
    """Input of a measuring process; can be pickled.

    Attributes:
        frames: Frames to make, in order.
        settings: Settings of a worker.
    """

    frames: tuple[PlannedFrame, ...]
    settings: FrameSettings

    @property
    def recipe(self) -> Recipe:
        """Recipe of the frames."""
        return recipe_from_json(self.settings.recipe_json)

    def into(self, out: Path) -> Work:
        """Return the same work with another output folder."""
        return Work(self.frames, replace(self.settings, out=out))

    def part(self, number: int, of: int) -> Work:
        """Return every `of`-th frame, starting with the `number`-th."""
        return Work(self.frames[number::of], self.settings)


def plan_of(data: Path, recipe: str = RECIPE) -> RunPlan:
    """Return the whole run of a shipped recipe on a dataset."""
    return make_plan(load_recipe(recipe), hit_uav.read(data), SEED)


def spread(plan: RunPlan, count: int, out: Path) -> Work:
    """Return `count` frames with an object in view, spread evenly over the plan, or all if there are fewer."""
    total = len(plan.frames)
    picked = sorted({math.floor(i * total / count) for i in range(min(count, total))})
    settings = FrameSettings(
        out=out,
        data_root=plan.dataset.root,
        recipe_json=plan.recipe.model_dump_json(),
        seed=plan.seed,
        execution=Execution(device="cpu", in_process=True),  # without a core of its own
        levels=dataset_levels(plan) if plan.needs_levels else None,
    )
    return Work(tuple(plan.frames[i] for i in picked), settings)


def part_of_plan(plan: RunPlan, frames: Sequence[PlannedFrame]) -> RunPlan:
    """Return the plan with these frames only."""
    return replace(plan, frames=tuple(frames))


def scene_of(frame: PlannedFrame, plan: RunPlan) -> PlacedScene:
    """Return the scene of a frame."""
    size_wh = frame.background.size_wh or plan.recipe.camera.size_px
    return sample_scene(frame.key(size_wh), plan.recipe, plan.models, plan.seed)


def distribution(work: Work, plan: RunPlan) -> dict[str, dict[str, float]]:
    """Return the distributions of distance, pitch and size; `objects` counts the objects in view."""
    distances, pitches, sizes = [], [], []
    for frame in work.frames:
        scene = scene_of(frame, plan)
        camera = scene.spec.camera
        distances.append(camera.distance_m)
        pitches.append(math.degrees(camera.pitch_rad))
        for placed in scene.objects:
            inside = np.clip(placed.xy, 0, np.array(camera.size_wh, np.float64))
            sizes.append(float(np.ptp(inside, axis=0).max()))
    return {
        "distance_m": quantiles(distances),
        "pitch_deg": quantiles(pitches),
        "size_px": quantiles(sizes),
    }


def quantiles(values: Sequence[float]) -> dict[str, Any]:
    """Return count, mean and quantiles."""
    if not values:
        return {"n": 0}
    q = np.quantile(np.asarray(values, np.float64), [0, 0.05, 0.25, 0.5, 0.75, 0.95, 1])
    names = ("min", "p5", "p25", "median", "p75", "p95", "max")
    return {
        "n": len(values),
        "mean": round(statistics.fmean(values), 4),
        **{n: round(float(v), 4) for n, v in zip(names, q, strict=True)},
    }
