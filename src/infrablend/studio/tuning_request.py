"""What to tune: the recipe and the data that the user gave, or those of the opened run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from infrablend.config.recipe import Recipe
from infrablend.core.files import write_text
from infrablend.errors import DatasetError
from infrablend.formats.reading import READ_ALL
from infrablend.pipeline.recorded_run import RecordedRun
from infrablend.pipeline.trial import TrialRequest
from infrablend.studio.opened_run import OpenedRun
from infrablend.studio.recipe_text import to_yaml

if TYPE_CHECKING:
    from infrablend.studio.server import StudioRequest

FIRST_RECIPE = "hit-uav-drone-physical"
"""Recipe to tune where neither a recipe nor a run is given."""


def tuning_request(request: StudioRequest, run: OpenedRun | None) -> TrialRequest:
    """Return what to tune: without a recipe of the user's the run's own, with its seed, on its backgrounds.

    Backgrounds that the user gave are read as the run read its own, unless the user says how.

    Raises:
        OutputError: The record of the run is damaged, or its recipe cannot be written to the cache folder.
        DatasetError: The backgrounds are not where they were.
    """
    if run is None or (request.recipe is not None and request.data is not None):
        assert request.data is not None
        recipe = request.recipe or FIRST_RECIPE
        return TrialRequest(
            recipe, request.data, seed=request.seed, reading=request.reading, execution=request.execution
        )
    recorded = RecordedRun.from_record(run.record, run.layout.run_file)
    data = request.data or recorded.data
    if not data.is_dir():
        raise DatasetError(
            f"{data}: no such folder; expected the backgrounds of this run. Its frames can be reviewed without "
            f"them; to tune, start with `infrablend studio --run {run.layout.root} --data DIR`, where they are now"
        )
    return TrialRequest(
        request.recipe or _recipe_file(recorded.recipe, run),
        data,
        seed=request.seed or recorded.seed,
        reading=recorded.reading if request.reading == READ_ALL else request.reading,
        execution=replace(request.execution, renderer=recorded.renderer),
    )


def _recipe_file(recipe: Recipe, run: OpenedRun) -> Path:
    """Write the recipe of the run to the user's cache folder: the form reads recipes from files."""
    return write_text(run.thumbnails.folder / f"{run.name}.yaml", to_yaml(recipe))
