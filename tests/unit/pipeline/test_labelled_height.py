"""Labels that contradict the stated height of the camera: refused above 1.25, warned of above 1.08, silent if few."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infrablend.config.loading import read_recipe
from infrablend.config.recipe import Recipe
from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord
from infrablend.errors import RecipeError
from infrablend.pipeline.plans.labelled_height import height_problems, require_height
from tests.unit.sampling.test_metric import WH, annotated, hit_uav_camera

TRUE_M = 60.0


def pictures(cars: int = 2, people: int = 3, count: int = 8, car_m: float = TRUE_M, **own: Any) -> list[ImageRecord]:
    """Pictures of a camera at 60 m, or at another height if cars alone count, at 60 degrees."""
    rng = np.random.default_rng(1)
    found = []
    for n in range(count):
        labels = annotated(hit_uav_camera(60, car_m), car_m, "Car", cars, rng)
        labels += annotated(hit_uav_camera(60, TRUE_M), TRUE_M, "Person", people, rng)
        found.append(ImageRecord(str(n), Path(f"{n}.png"), "train", WH, tuple(labels), Capture(**own)))
    return found


def recipe(name: str = "sar-people", **settings: object) -> Recipe:
    fields = {f"camera.{k}": v for k, v in settings.items()}
    return read_recipe(name, {"camera.pitch": {"fixed_deg": 60}, **fields}).recipe


def codes(plan: Recipe, images: list[ImageRecord]) -> list[str]:
    return [p.code for p in height_problems(plan, images)]


@pytest.mark.parametrize("stated", [TRUE_M * f for f in (2.27, 1.4, 0.5)])
def test_a_contradicted_height_is_refused_with_both_figures_and_both_ways_out(stated: float) -> None:
    plan = recipe(altitude={"fixed_m": stated})
    found = height_problems(plan, pictures())
    with pytest.raises(RecipeError, match="labels that contradict the height") as caught:
        require_height(plan, found)
    text = str(caught.value)
    assert f"{stated:.3g} m above the ground" in text and ("say 6" in text or "say 5" in text)
    assert "camera.calibrate=true" in text and "camera.accept_height=true" in text
    accepted = recipe(altitude={"fixed_m": stated}, accept_height=True)
    assert codes(accepted, pictures()) == ["height-accepted"]


def test_smaller_contradictions_are_warnings_and_agreement_is_silent() -> None:
    assert codes(recipe(altitude={"fixed_m": TRUE_M * 1.17}), pictures()) == ["height-doubtful"]
    assert codes(recipe(altitude={"fixed_m": TRUE_M}), pictures()) == []
    assert codes(recipe(altitude={"random_m": [50, 200]}), pictures()) == []
    assert codes(recipe(altitude={"random_m": [100, 200]}), pictures()) == ["height-contradicted"]


def test_few_labels_and_labels_that_disagree_say_nothing() -> None:
    plan = recipe(altitude={"fixed_m": TRUE_M * 2.27})
    assert codes(plan, pictures(cars=1, people=0, count=7)) == []
    assert codes(plan, pictures(cars=1, people=0, count=11)) == ["height-contradicted"]
    other = recipe(altitude={"fixed_m": TRUE_M * 1.3})
    assert codes(other, pictures(cars=4, people=4, car_m=TRUE_M * 1.7)) == []


def test_heights_of_the_pictures_that_labels_cannot_correct_are_refused_too() -> None:
    high = {"pitch_deg": 60.0, "altitude_m": TRUE_M * 2.2}
    plan = recipe(altitude="metadata")
    (found,) = height_problems(plan, pictures(**high))
    assert found.code == "height-contradicted" and "120 m above the ground (132 m as stated), but" in found.found
    assert "stated_heights.factor" in found.todo
    assert codes(recipe(altitude="metadata", stated_heights={"factor": 0.5}), pictures(**high)) == []
    near = {"pitch_deg": 60.0, "altitude_m": TRUE_M / 1.2}
    assert codes(plan, pictures(**near)) == []
    assert codes(recipe(altitude="metadata", calibrate=False), pictures(**near)) == ["height-doubtful"]


def test_another_view_on_purpose_is_no_contradiction() -> None:
    assert codes(recipe(altitude={"fixed_m": 200}), pictures(pitch_deg=0.0)) == []
    level = {"pitch_deg": 30.0, "altitude_m": 60.0}
    assert codes(recipe(altitude={"fixed_m": 200}), pictures(**level)) == []
    assert height_problems(read_recipe("deer-above").recipe, pictures(**level)) == []
    assert height_problems(read_recipe("hit-uav-drone").recipe, pictures(**level)) == []
