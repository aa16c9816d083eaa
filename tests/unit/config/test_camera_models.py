"""`camera.model` and `camera.pixel_pitch_um`: the field of view that the maker states, and which statement counts."""

import math
from typing import get_args

import pytest

from infrablend.config.camera_models import OPTICS, CameraModel
from infrablend.config.loading import load_recipe, parse_recipe
from infrablend.config.modes import recipe_from_json
from infrablend.errors import RecipeError

TEXT = "name: a\nobjects: [{model: person}]\nplacement: {mode: metric}\ncamera: {model: dji-xt2-25, pitch: metadata}\n"


def lens(recipe) -> tuple[float, float]:
    return recipe.camera.focal_length_mm, recipe.camera.sensor_width_mm


def hfov_deg(focal_length_mm: float, sensor_width_mm: float) -> float:
    return 2 * math.degrees(math.atan(sensor_width_mm / 2 / focal_length_mm))


def test_every_name_has_its_optics():
    assert set(OPTICS) == set(get_args(CameraModel))


# Across the picture, from the data sheets; DJI's 35 mm equivalents are rounded and diagonal, 43.27 mm for 819.6 pixels.
@pytest.mark.parametrize(
    ("model", "stated_deg"),
    [
        ("dji-xt2-13", 45), ("dji-xt2-19", 32), ("dji-xt2-25", 25),
        ("flir-vue-pro-640-13", 45), ("flir-vue-pro-640-19", 32),
        ("dji-h20t", hfov_deg(58, 43.27 * 640 / 819.6)),
        ("dji-m30t", hfov_deg(40, 43.27 * 640 / 819.6)),
        ("dji-m3t", hfov_deg(40, 43.27 * 640 / 819.6)), ("dji-m4t", hfov_deg(52, 43.27 * 640 / 819.6)),
        ("dji-m2ea", hfov_deg(9.12, 7.68)), ("autel-640t", hfov_deg(13, 7.68)), ("skydio-x10", hfov_deg(1135.47, 640)),
    ],
)  # fmt: skip
def test_field_of_view_is_that_of_the_data_sheet(model, stated_deg):
    recipe = load_recipe("hit-uav-person", {"camera.model": model})
    assert hfov_deg(*lens(recipe)) == pytest.approx(stated_deg, abs=0.8)
    assert recipe.camera.field_of_view == "recipe"  # as for any lens that settings state
    assert recipe_from_json(recipe.model_dump_json()) == recipe


def test_pixel_pitch_times_the_width_of_the_picture_is_the_sensor():
    stated = {"camera.pixel_pitch_um": 17, "camera.focal_length_mm": 13}
    assert lens(load_recipe("hit-uav-person", stated)) == (13, 10.88)
    assert lens(load_recipe("hit-uav-person", {**stated, "camera.size_px": [320, 256]})) == (13, 5.44)


def test_the_last_statement_of_the_lens_counts():
    def of(**settings):
        return lens(parse_recipe(TEXT, "a", {f"camera.{k}": v for k, v in settings.items()}).recipe)

    assert of() == (25, 10.88)
    assert of(model="dji-h20t") == (13.5, 7.68)
    assert of(focal_length_mm=13) == (13, 10.88)
    assert of(focal_length_mm=50, sensor_width_mm=36) == (50, 36)
    assert of(pixel_pitch_um=12) == (25, 7.68)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"camera.model": "dji-xt2-13", "camera.focal_length_mm": 19}, "model dji-xt2-13 gives 13"),
        ({"camera.model": "dji-xt2-13", "camera.pixel_pitch_um": 17}, "found both model and pixel_pitch_um"),
        ({"camera.pixel_pitch_um": 17}, "expected camera.focal_length_mm, the focal length printed on the lens"),
        ({"camera.model": "xt2"}, "dji-xt2-13"),
        ({"camera.model": ["xt2"]}, "camera.model"),
        ({"camera.pixel_pitch_um": 17, "camera.focal_length_mm": 13, "camera.sensor_width_mm": 36}, "gives 10.88"),
    ],
)
def test_contradictions_are_refused(settings, message):
    with pytest.raises(RecipeError, match=message):
        load_recipe("hit-uav-person", settings)
