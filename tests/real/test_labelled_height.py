"""Labels of real datasets against the height of the camera: what people and cars say, and no false alarm."""

from __future__ import annotations

from pathlib import Path

import pytest

from infrablend.errors import RecipeError
from infrablend.formats.read_write import Reading
from infrablend.pipeline.plans.run_request import RunRequest
from infrablend.pipeline.runs.generate import plan_request

CODES = {"height-doubtful", "height-contradicted"}


@pytest.mark.parametrize("recipe", ["hit-uav-people", "hit-uav-cars", "sar-people", "herd-at-rest", "deer-above"])
def test_calibrated_heights_of_hit_uav_are_no_contradiction(real_data: Path, recipe: str) -> None:
    plan = plan_request(RunRequest(recipe, real_data / "hit-uav", reading=Reading(splits=("val",))))
    assert not CODES & {p.code for p in plan.problems}


def test_a_height_that_people_and_cars_contradict_is_refused(real_data: Path) -> None:
    view = {"camera.pitch": {"fixed_deg": 2}, "camera.focal_length_mm": 57, "camera.altitude": {"fixed_m": 8.4}}
    with pytest.raises(RecipeError, match=r"(?s)8\.4 m above the ground.*say [34]\..*times too small"):
        plan_request(RunRequest("sar-people", real_data / "camel", settings=view))
    plan_request(RunRequest("sar-people", real_data / "camel", settings={**view, "camera.accept_height": True}))
