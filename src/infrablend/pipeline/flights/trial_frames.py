"""The frames that trials are made of: the recipe's, or those of a flight, through which every object stays in place."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace

from infrablend.config.loading import read_recipe
from infrablend.config.recipe import AUTO
from infrablend.detection.truth import image_key
from infrablend.errors import DatasetError, Problem
from infrablend.formats import dataset_folder
from infrablend.formats.pictures.listing import with_sizes
from infrablend.pipeline.compose.memory_frames import FramesRequest
from infrablend.pipeline.flights.detectability_request import DetectabilityRequest
from infrablend.pipeline.flights.flight_looks import as_flights, motion_by_pose
from infrablend.pipeline.plans.planning import reading_for
from infrablend.pipeline.plans.run_request import Settings


def trial_frames(request: DetectabilityRequest) -> FramesRequest:
    """Return the request for the frames; over a flight, every object stays at its place through all pictures.

    Raises:
        DatasetError: Looks over a flight were asked for, but the pictures or the recipe do not allow them.
    """
    plain = FramesRequest(
        request.recipe,
        request.data,
        request.selection,
        request.trial_seed,
        request.recipe_settings,
        request.reading,
        request.execution,
    )
    recipe = read_recipe(request.recipe, request.recipe_settings).recipe
    dataset = dataset_folder.read(request.data, reading_for(recipe, request.reading, request.data))
    # Pictures whose header cannot be read keep no size, and are named where they are decoded.
    sized = {image_key(i): i for i in with_sizes(dataset.images, image_key, [])}
    dataset = replace(dataset, images=tuple(sized.get(image_key(i), i) for i in dataset.images))
    plain = replace(plain, dataset=dataset)
    if request.settings.looks == "single":
        return plain
    flight = None if recipe.in_sequences or recipe.placement.mode != "metric" else as_flights(dataset)
    if flight is None:
        if request.settings.looks == "flight":
            found = (
                "pictures without pose or overlap, or that are numbered frames of a clip; or a recipe without places"
            )
            expected = "overlapping pictures with poses, and a recipe with placement.mode: metric and without motion"
            raise DatasetError(
                f"{request.data}: no flight", [Problem("looks", "no-flight", found, expected, "take --looks single")]
            )
        return plain
    added: dict[str, object] = {f"objects.{k}.motion": {"kind": "still"} for k in range(len(recipe.objects))}
    if recipe.configurations == AUTO:  # which counts objects of single pictures
        added["configurations"] = 1
    given = request.recipe_settings
    settings: Settings
    if isinstance(given, Mapping):
        settings = {**given, **added}
    else:
        settings = [*given, *(f"{field}={json.dumps(value)}" for field, value in added.items())]
    return replace(plain, dataset=flight, settings=settings, follow=motion_by_pose)
