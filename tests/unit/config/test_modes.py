"""Each mode has its own fields: fields of other modes are errors, and a change of mode drops and lists them."""

import json

import pytest

from infrablend import api
from infrablend.config.loading import list_recipes, load_recipe, parse_recipe, read_recipe
from infrablend.config.modes import (
    REMOVED,
    Modes,
    all_modes,
    fields_of,
    modes_of,
    recipe_class,
    recipe_from_json,
)
from infrablend.config.recipe import (
    LocalMatching,
    MetricPhysicalRecipe,
    NoSensor,
    PaperArtisticRecipe,
    PercentileMatching,
    RadiometricRecipe,
)
from infrablend.core.temperature import TemperatureScale
from infrablend.errors import RecipeError
from infrablend.pipeline.plans.run_request import Execution

FLAT = Execution(renderer="flat", in_process=True)

DRONE = "name: d\nobjects: [{model: drone}]\n"
OF_ONE_MODE = {
    setting: (needs, has)
    for needs, has, settings in (
        ("placement.mode paper", "metric", [
            "camera.distance_m=5", "objects.0.x_m=5", "objects.0.y_m=5", "placement.on_miss=keep",
        ]),
        ("placement.mode metric", "paper", [
            "camera.altitude={fixed_m: 50}", "camera.calibrate=false", "objects.0.range_m=20",
            "objects.0.group={share: 0.5}", "placement.clear_of_labels=true", "placement.max_relief_grey=3",
        ]),
        ("appearance.mode artistic", "physical", [
            "appearance.cold_below_air_k=5", "appearance.hot_above_air_k=5", "appearance.surroundings_below_air_k=5",
            "matching.low_percentile=5", "matching.high_percentile=95", "matching.min_span=0.5",
        ]),
        ("appearance.mode physical", "artistic", [
            "environment.dew_point_below_air_k=5", "environment.clear_share=0.5",
            "environment.ground_above_air_day_k=5", "environment.ground_above_air_night_k=5",
            "matching.gain_grey_per_k=5", "matching.gain_prior_grey_per_k=5", "matching.gain_prior_day_grey_per_k=5",
            "matching.gain_prior_spread=0.5", "matching.clothing_above_air_k=5", "matching.local_share=0.5",
        ]),
        ("a camera in sensor.profile", "off", [
            "sensor.optics=1", "sensor.motion_px=3",
        ]),
    )
    for setting in settings
}  # fmt: skip


@pytest.mark.parametrize("setting", OF_ONE_MODE)
def test_a_field_of_another_mode_is_an_error_that_names_its_mode(setting):
    needs, has = OF_ONE_MODE[setting]
    name = setting.split("=")[0]
    modes = [m for m in ("placement.mode=metric", "appearance.mode=physical") if m.endswith(f"={has}")]
    with pytest.raises(RecipeError) as caught:
        parse_recipe(DRONE, "d", [*modes, setting])
    (problem,) = caught.value.problems
    assert problem.where == name and problem.code == "recipe-unknown-key"
    assert str(problem).startswith(f"{name}: this field has a meaning only with {needs}; this recipe has {has}. Remove")
    right = needs.replace("a camera in sensor.profile", "sensor.profile hit-uav").replace(" ", "=")
    parse_recipe(DRONE, "d", [right, setting])


def test_a_field_may_need_two_modes():
    with pytest.raises(RecipeError) as caught:
        parse_recipe(DRONE, "d", ["sensor.defocus=1"])
    assert "only with placement.mode metric and a camera in sensor.profile" in str(caught.value)
    assert "set placement.mode to metric and sensor.profile to a camera" in str(caught.value)
    with pytest.raises(RecipeError, match=r"only with placement\.mode metric; this recipe has paper"):
        parse_recipe(DRONE, "d", ["sensor.defocus=1", "sensor.profile=monet"])
    parse_recipe(DRONE, "d", ["sensor.defocus=1", "sensor.profile=monet", "placement.mode=metric"])


def test_fields_of_other_modes_in_the_file_are_errors_too():
    with pytest.raises(
        RecipeError, match=r"camera\.altitude: this field has a meaning only with placement\.mode metric"
    ):
        parse_recipe(DRONE + "camera: {altitude: metadata}", "d")


def test_an_unknown_mode_is_one_problem():
    with pytest.raises(RecipeError) as caught:
        parse_recipe(DRONE, "d", ["placement.mode=metrical", "appearance.mode=3"])
    assert [str(p) for p in caught.value.problems] == [
        "appearance.mode: found 3; expected 'artistic' or 'physical'",
        "placement.mode: found \"metrical\"; expected 'paper' or 'metric'",
    ]


def test_setting_a_mode_drops_the_fields_of_the_old_mode_and_lists_them(caplog):
    loaded = read_recipe("hit-uav-people", {"placement.mode": "paper", "camera.distance_m": [30, 300]})
    assert [p.where for p in loaded.dropped] == [
        "objects.0.group", "camera.altitude", "placement.max_relief_grey", "placement.ground",
    ]  # fmt: skip
    assert {(p.code, p.severity) for p in loaded.dropped} == {("recipe-dropped", "warning")}
    assert str(loaded.dropped[2]) == (
        "placement.max_relief_grey: 25 is not used: this field has a meaning only with placement.mode metric; "
        "this recipe has paper"
    )
    assert loaded.recipe.camera.distance_m == (30, 300)
    assert loaded.recipe.placement.size_px == (8, 160)  # fields of both modes stay

    load_recipe("hit-uav-person", ["appearance.mode=artistic"])
    assert [r.getMessage().split(":")[0] for r in caplog.records] == [
        "environment.clear_share",
        "environment.sun_elevation_deg",
        "environment.ground_above_air_day_k",
        "environment.ground_above_air_night_k",
        "matching.gain_grey_per_k",
        "matching.gain_prior_grey_per_k",
        "matching.gain_prior_day_grey_per_k",
        "matching.gain_prior_spread",
        "matching.clothing_above_air_k",
    ]


def test_a_lens_and_roll_of_the_other_placement_mode_are_warned_about(caplog):
    recipe = load_recipe("hit-uav-drone", ["placement.mode=metric"])
    assert (recipe.camera.focal_length_mm, recipe.camera.roll_deg) == (50, (-10, 10))
    assert [r.getMessage() for r in caplog.records][-2:] == [
        "camera.focal_length_mm: 50 mm on 36 mm is the lens of the recipe's virtual camera; expected that of the real "
        "camera, for placement.mode metric. Set camera.focal_length_mm and camera.sensor_width_mm",
        "camera.roll_deg: [-10, 10] is the roll of the recipe's virtual camera; expected that of the real camera, for "
        "placement.mode metric. Set camera.roll_deg",
    ]
    (back,) = read_recipe("hit-uav-people", ["placement.mode=paper"]).kept
    assert str(back).startswith("camera.focal_length_mm: 115.875 mm on 36 mm is the lens of the real camera; expected")


@pytest.mark.parametrize(
    ("settings", "kept"),
    [
        ({"placement.mode": "metric", "camera.focal_length_mm": 100}, ["camera.roll_deg"]),
        ({"placement.mode": "metric", "camera.sensor_width_mm": 10, "camera.roll_deg": 3}, []),
        ({"placement.mode": "metric", "camera": {"focal_length_mm": 100, "roll_deg": 0}}, []),
        ({"placement": {"mode": "metric"}, "camera": {}}, ["camera.focal_length_mm", "camera.roll_deg"]),
        ({"camera.roll_deg": 0}, []),
    ],
)
def test_a_lens_or_roll_that_was_set_is_not_warned_about(settings, kept):
    assert [p.where for p in read_recipe("hit-uav-drone", settings).kept] == kept


def test_turning_the_sensor_off_drops_its_strengths():
    loaded = read_recipe("hit-uav-person", ["sensor.profile=off"])
    assert loaded.recipe.sensor == NoSensor()
    assert [p.where for p in loaded.dropped] == ["sensor.optics", "sensor.codec"]


def test_a_setting_of_the_old_mode_stays_an_error_beside_a_change_of_mode():
    with pytest.raises(RecipeError) as caught:
        read_recipe("hit-uav-people", ["placement.mode=paper", "placement.max_relief_grey=3"])
    assert [p.where for p in caught.value.problems] == ["placement.max_relief_grey"]
    with pytest.raises(RecipeError, match=r"camera\.altitude"):
        read_recipe("hit-uav-people", {"placement.mode": "paper", "camera": {"altitude": "metadata"}})


def test_without_a_change_of_mode_nothing_is_dropped():
    assert read_recipe("hit-uav-people", ["placement.mode=metric", "sensor.profile=monet"]).dropped == ()
    with pytest.raises(RecipeError, match=r"objects\.0\.x_m"):
        read_recipe("hit-uav-people", ["objects.0.x_m=3"])


def test_misspelt_fields_are_not_dropped():
    with pytest.raises(RecipeError, match=r"placement\.max_releif_grey: unknown key .* Did you mean max_relief_grey\?"):
        parse_recipe(DRONE + "placement: {mode: metric, max_releif_grey: 3}", "d")
    with pytest.raises(RecipeError, match=r"objects\.0\.modle: unknown key"):
        parse_recipe(DRONE.replace("{model", "{modle: x, model"), "d", ["placement.mode=metric"])


@pytest.mark.parametrize(
    ("old", "todo"),
    [
        (
            "placement: {min_contrast_grey: 4}",
            r"placement\.min_contrast_grey: this field was removed. .*; set placement\.min_contrast",
        ),
        ("environment: {wind_m_s: 3}", r"environment\.wind_m_s: .*It never had an effect; remove it"),
        ("matching: {mode: percentile}", r"matching\.mode: .*It follows from appearance\.mode"),
    ],
)
def test_fields_of_older_recipes_are_errors_that_name_the_replacement(old, todo):
    with pytest.raises(RecipeError, match=todo):
        parse_recipe(DRONE + old, "d")


def test_radiometric_matching_needs_metric_placement_and_the_physical_look():
    loaded = read_recipe("hit-uav-person", ["matching.mode=radiometric"])
    assert isinstance(loaded.recipe, RadiometricRecipe)
    assert {"matching.gain_grey_per_k", "environment.ground_above_air_night_k", "sensor.codec"} <= {
        p.where for p in loaded.dropped
    }
    with pytest.raises(
        RecipeError, match=r"found radiometric with placement\.mode paper and appearance\.mode artistic"
    ):
        parse_recipe(DRONE, "d", ["matching.mode=radiometric"])
    with pytest.raises(
        RecipeError, match=r"sensor\.netd_k: this field has a meaning only with matching\.mode radiometric"
    ):
        read_recipe("hit-uav-person", ["sensor.netd_k=0.03"])


def test_the_scale_of_16_bit_pictures_is_checked():
    recipe = load_recipe("hit-uav-person", ["data.unit=counts", "data.slope=0.04"])
    assert recipe.data.scale == TemperatureScale(0.04)
    assert load_recipe("hit-uav-person").data.scale is None
    for wrong in (["data.slope=0.04"], ["data.unit=centikelvin", "data.slope=0.04"], ["data.unit=kelvin"]):
        with pytest.raises(RecipeError, match="data"):
            load_recipe("hit-uav-person", wrong)


def test_no_removed_field_exists():
    existing = {".".join(f) for m in all_modes() for f in fields_of(m)}
    assert not existing & {*REMOVED}


def test_recipes_have_the_class_of_their_modes():
    assert isinstance(load_recipe("hit-uav-drone"), PaperArtisticRecipe)
    assert isinstance(load_recipe("hit-uav-person"), MetricPhysicalRecipe)
    assert isinstance(load_recipe("hit-uav-person").matching, LocalMatching)
    assert isinstance(load_recipe("hit-uav-drone").matching, PercentileMatching)
    of_looks = {recipe_class(Modes(p, a)) for p in ("paper", "metric") for a in ("artistic", "physical")}
    assert {recipe_class(m) for m in all_modes()} == {*of_looks, RadiometricRecipe}


@pytest.mark.parametrize("name", list_recipes())
def test_recipes_keep_their_modes_through_json(name):
    recipe = load_recipe(name)
    text = recipe.model_dump_json()
    assert recipe_from_json(text) == recipe
    # The fields in a card and in a stage's key.
    short = json.loads(recipe.model_dump_json(exclude_defaults=True))
    assert modes_of(short) == modes_of(json.loads(text))
    assert recipe_class(modes_of(short)).model_validate_json(json.dumps(short)) == recipe


def test_plan_and_run_record_list_dropped_fields(tmp_path, write_tiny_hit_uav):
    data = write_tiny_hit_uav(tmp_path / "data", ("normal_json",))
    settings = {"placement.mode": "metric", "camera.altitude": {"random_m": [60, 130]}, "placement.max_relief_grey": 0}
    dropped = ["objects.0.x_m", "objects.0.y_m", "camera.distance_m"]
    plan = api.plan("hit-uav-drone", data, settings=settings)
    assert [text.split(":")[0] for text in plan.to_json()["dropped_fields"]] == dropped
    kept = ["camera.focal_length_mm", "camera.roll_deg"]
    assert [text.split(":")[0] for text in plan.to_json()["kept_fields"]] == kept
    report = api.generate("hit-uav-drone", data, tmp_path / "run", settings=settings, execution=FLAT)
    assert report.ok
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    found = [p["where"] for p in record["problems"] if p["code"] == "recipe-dropped"]
    assert sorted(found) == sorted(dropped)
    assert sorted(p["where"] for p in record["problems"] if p["code"] == "recipe-kept") == kept
