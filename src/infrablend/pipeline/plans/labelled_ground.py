"""Learns from the labels of a run's dataset on which kinds of ground the recipe's classes are."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from functools import lru_cache

from infrablend.core.dataset import ImageRecord
from infrablend.errors import DatasetError
from infrablend.pipeline.plans.levels import Load
from infrablend.pipeline.plans.plan import RunPlan
from infrablend.places.labelled_ground import LabelledGround, Picture, learn_ground


def labelled_ground(plan: RunPlan, load: Load) -> LabelledGround:
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
