"""Recipes: they contain the paper's values, and all mistakes are reported at once."""

import pytest

from infrablend.config.loading import load_recipe, parse_recipe
from infrablend.config.recipe import FixedPitch, RandomPitch
from infrablend.config.sensor_profile import find_profile
from infrablend.errors import RecipeError


@pytest.mark.parametrize(
    ("name", "model", "configurations"), [("hit-uav-drone", "drone", 2), ("monet-deer", "deer", 1)]
)
def test_shipped_recipes_hold_the_papers_values(name, model, configurations):
    r = load_recipe(name)
    assert r.configurations == configurations
    assert [o.model for o in r.objects] == [model]
    assert r.camera.distance_m == (1, 10)
    assert r.camera.roll_deg == (-10, 10)
    assert r.camera.size_px == (640, 512)
    assert r.camera.pitch == "metadata"
    assert (r.camera.focal_length_mm, r.camera.sensor_width_mm) == (50, 36)
    o = r.objects[0]
    assert (o.x_m, o.y_m, o.yaw_deg, o.count) == ((-3, 3), (-3, 3), (0, 360), 1)
    assert (r.placement.on_miss, r.placement.attempts) == ("redraw", 200)
    assert (r.placement.min_inside, r.placement.min_depth_m) == (0.5, 0.3)


def test_ablation_recipes_differ_from_the_drones_in_pitch_alone():
    plain = load_recipe("hit-uav-drone").model_dump(exclude={"name": True, "description": True, "camera": {"pitch"}})
    for name, pitch in (
        ("hit-uav-drone-fixed-pitch", FixedPitch(fixed_deg=0.0)),
        ("hit-uav-drone-random-pitch", RandomPitch(random_deg=(0.0, 90.0))),
    ):
        r = load_recipe(name)
        assert r.camera.pitch == pitch
        assert r.model_dump(exclude={"name": True, "description": True, "camera": {"pitch"}}) == plain


def test_quality_paper_is_640_samples():
    assert load_recipe("hit-uav-drone", ["render.quality=paper"]).samples == 640
    assert load_recipe("hit-uav-drone").samples == 0
    assert load_recipe("hit-uav-drone", ["render.samples=7"]).samples == 7


def test_a_lens_of_the_settings_counts_more_than_what_the_file_says_of_the_pictures_lens():
    text = (
        "name: a\nobjects: [{model: person}]\nplacement: {mode: metric}\n"
        "camera: {focal_length_mm: 40, field_of_view: metadata}\n"
    )

    def view(*settings):
        return parse_recipe(text, "a", settings).recipe.camera.field_of_view

    assert view() == "metadata"  # a lens in the file is for pictures that do not state theirs
    assert view("camera.focal_length_mm=60") == view("camera.sensor_width_mm=10") == "recipe"
    assert view("camera.focal_length_mm=60", "camera.field_of_view=metadata") == "metadata"


def test_every_wrong_field_is_named_at_once():
    settings = ["output.image=gif", "camera.distance_m=[5, 1]", "objects.0.yaw_deg=true", "colour=blue"]
    settings += ["objects.0.count=-1", "nothing", "objects.7.model=deer"]
    with pytest.raises(RecipeError) as caught:
        load_recipe("hit-uav-drone", settings)
    for setting in settings:
        name = setting.split("=")[0].removesuffix(".model")
        assert name in str(caught.value), name


def test_a_number_stands_for_a_range_and_a_word_can_become_a_mapping():
    r = load_recipe("hit-uav-drone", {"camera.distance_m": 5, "camera.pitch.fixed_deg": 0})
    assert r.camera.distance_m == (5, 5)
    assert r.camera.pitch == FixedPitch(fixed_deg=0.0)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("- a\n- b", "expected a mapping"),
        ("name: [", "not YAML"),
        ("name: x\nobjects: []", "objects"),
        ("name: x\nobjects: [{model: drone, x_m: [.nan, 1]}]", "x_m"),
        ("name: x\nconfigurations: '2'\nobjects: [{model: drone}]", "configurations"),
        ("name: ../x\nobjects: [{model: drone}]", "name"),
    ],
)
def test_bad_texts(text, match):
    with pytest.raises(RecipeError, match=match):
        parse_recipe(text, "test")


def test_unknown_recipe_names_the_shipped_ones():
    with pytest.raises(RecipeError, match=r"shipped are .*monet-deer.*\. Did you mean hit-uav-drone\?"):
        load_recipe("hit-uav-dron")
    with pytest.raises(RecipeError, match="Give one of these names or the path"):
        load_recipe("zzz")


def test_model_paths_are_relative_to_the_recipe(tmp_path):
    (tmp_path / "r.yaml").write_text("name: r\nobjects: [{model: fox.yaml}]")
    assert load_recipe(tmp_path / "r.yaml").objects[0].model == str(tmp_path / "fox.yaml")


@pytest.mark.parametrize("shipped", [True, False])
@pytest.mark.parametrize(
    "settings",
    [
        ["objects.0.model=models/fox.yaml"],
        {"objects.0.model": "models/fox.yaml"},
        {"objects.0": {"model": "models/fox.yaml"}},
        {"objects": [{"model": "models/fox.yaml"}]},
    ],
)
def test_a_model_that_is_set_is_relative_to_the_current_folder(tmp_path, monkeypatch, settings, shipped):
    here, recipe = tmp_path / "here", tmp_path / "recipes" / "r.yaml"
    here.mkdir()
    recipe.parent.mkdir()
    recipe.write_text("name: r\nobjects: [{model: hare.yaml}, {model: hare.yaml}]")
    monkeypatch.chdir(here)
    objects = load_recipe("hit-uav-drone" if shipped else recipe, settings).objects
    assert objects[0].model == str(here / "models" / "fox.yaml")  # whole, for the record of the run
    assert [o.model for o in objects[1:]] == [str(recipe.parent / "hare.yaml")] * (len(objects) - 1)


def test_a_profile_that_is_set_is_relative_to_the_current_folder(tmp_path, monkeypatch):
    here, recipe = tmp_path / "here", tmp_path / "recipes" / "r.yaml"
    for folder, name in ((here, "mine"), (recipe.parent, "theirs")):
        folder.mkdir()
        (folder / "p.json").write_text(find_profile("monet").model_copy(update={"name": name}).model_dump_json())
    recipe.write_text("name: r\nobjects: [{model: drone}]\nsensor: {profile: p.json}")
    monkeypatch.chdir(here)
    assert load_recipe(recipe).sensor.profile.name == "theirs"
    assert load_recipe(recipe, ["sensor.profile=p.json"]).sensor.profile.name == "mine"
    (recipe.parent / "p.json").unlink()
    assert load_recipe(recipe, ["sensor.profile=p.json"]).sensor.profile.name == "mine"


def test_incompatible_options_are_reported():
    with pytest.raises(RecipeError, match=r"overlay\.flat needs sensor\.profile: off"):
        load_recipe("hit-uav-person", ["overlay.flat=true"])


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("{method: x}", "a mapping with mode"),
        ("{mode: x}", "mode as one of linear, plateau, fixed"),
        ("3", "a mapping"),
    ],
)
def test_a_wrong_gain_control_is_explained(value, message):
    with pytest.raises(RecipeError) as caught:
        load_recipe("hit-uav-people", [f"output.agc={value}"])
    assert [(p.where, p.expected) for p in caught.value.problems] == [("output.agc", message)]


def test_the_mode_of_a_gain_control_is_enough():
    short, long = (load_recipe("hit-uav-people", [f"output.agc={v}"]) for v in ("plateau", "{mode: plateau}"))
    assert short == long
