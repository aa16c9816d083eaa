"""Settings of frame workers: what a run hands to each of them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from infrablend.core.dataset import ImageRecord
from infrablend.errors import DatasetError
from infrablend.pipeline.compose.extensions import NO_EXTENSIONS, Extensions
from infrablend.pipeline.plans.backgrounds import Load
from infrablend.pipeline.plans.plan import PlannedSequence, RunPlan
from infrablend.pipeline.plans.run_request import DEFAULT_EXECUTION, Execution
from infrablend.sampling.labelled_ground import LabelledGround, Picture, learn_ground


@dataclass(frozen=True)
class FrameSettings:
    """Settings that all workers of a run share; picklable.

    Attributes:
        out: Folder of the run; None for frames in memory.
        data_root: Folder of the backgrounds as it was given; their paths are recorded relative to it.
        recipe_json: The recipe.
        seed: The run's seed.
        execution: Renderer and device, and whether each worker keeps to a processor core of its own.
        levels: Darkest and brightest level that the dataset uses; for `appearance.mode: physical` and the sensor.
        ignored: The source's own names of the categories that mark ignore regions.
        extensions: The caller's own sampler, backgrounds and look.
        run: Identity of the run, for the records of its frames.
        models: Digests of the recipe's own models: changed models are loaded again.
        labelled_ground: On which kinds of ground the dataset's labelled objects are.
        sequences: Sequences by name, if the recipe's objects move through them.
    """

    out: Path | None
    data_root: Path
    recipe_json: str
    seed: int
    execution: Execution = DEFAULT_EXECUTION
    levels: tuple[float, float] | None = None
    ignored: tuple[str, ...] = ()
    extensions: Extensions = NO_EXTENSIONS
    run: str = ""
    models: Mapping[str, str] = field(default_factory=dict)
    labelled_ground: LabelledGround = field(default_factory=dict)
    sequences: Mapping[str, PlannedSequence] = field(default_factory=dict)


def settings_for(
    plan: RunPlan,
    levels: tuple[float, float] | None,
    execution: Execution,
    out: Path | None = None,
    extensions: Extensions = NO_EXTENSIONS,
) -> FrameSettings:
    """Return what workers need to compose the frames of a plan; extensions are only for frames in memory."""
    return FrameSettings(
        out=out,
        data_root=plan.dataset.root,
        recipe_json=plan.recipe.model_dump_json(),
        seed=plan.seed,
        execution=execution,
        levels=levels,
        ignored=plan.ignored,
        extensions=extensions,
        run=plan.run,
        models=plan.key.get("models", {}),
        labelled_ground=_labelled_ground(plan, extensions.load),
        sequences=plan.sequences,
    )


def _labelled_ground(plan: RunPlan, load: Load) -> LabelledGround:
    """Return on which kinds of ground labelled objects of the recipe's classes are, in the plan's sample of pictures.

    Empty if the recipe does not ask for it, or the dataset labels none of these classes.
    """
    where = plan.recipe.placement.surfaces
    if where is None or not where.learned or where.surfaces:
        return {}
    wanted = {o.category or plan.models[o.model].category for o in plan.recipe.objects if plan.models[o.model].stands}
    labelled = {i.category for image in plan.sample for i in image.instances}
    classes = tuple(sorted(wanted & labelled))
    return _learned(plan.sample, classes, load) if classes else {}


# The studio plans the same pictures again for each change of a recipe.
@lru_cache(maxsize=2)
def _learned(sample: tuple[ImageRecord, ...], classes: tuple[str, ...], load: Load) -> LabelledGround:
    return learn_ground(_pictures(sample, load), classes)


def _pictures(sample: Sequence[ImageRecord], load: Load) -> Iterator[Picture]:
    for image in sample:
        with contextlib.suppress(DatasetError):  # reported when its frame is rendered
            yield load(image).pixels, image.instances, image.capture.time_of_day
