"""The form made from a recipe's schema, and tuned frames and saved recipes, without a browser."""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from infrablend import api
from infrablend.config.loading import list_recipes, load_recipe
from infrablend.config.modes import modes_of
from infrablend.errors import ArgumentError, DatasetError, OutputError, RecipeError
from infrablend.pipeline.compose.trial import TrialRequest, gain_words
from infrablend.pipeline.plans.run_request import Execution
from infrablend.studio.recipe_form import (
    FormField,
    Move,
    fitting,
    form_of,
    input_of,
    moved,
    origin_px,
    path_of,
    released,
    with_path,
    with_place,
    with_point,
)
from infrablend.studio.tuning import Tuning

FLAT = Execution(renderer="flat", in_process=True)
RECIPE = "hit-uav-drone"


def fields(recipe: str, **settings: object) -> dict[str, FormField]:
    return {f.key: f for section in form_of(load_recipe(recipe, settings)).values() for f in section}


@pytest.mark.parametrize("name", list_recipes())
def test_every_value_of_a_form_is_a_value_of_the_recipe(name: str) -> None:
    form = fields(name)
    settings = {key: field.read(field.shown) for key, field in form.items()}
    recipe = load_recipe(name)
    assert load_recipe(name, settings).model_dump() == recipe.model_dump()
    assert all(field.help for key, field in form.items())


def test_the_form_knows_units_ranges_and_modes() -> None:
    metric, paper = fields("hit-uav-drone-physical"), fields(RECIPE)
    ranged = metric["objects.0.range_m"]
    assert (ranged.title, ranged.unit, ranged.kind, ranged.low, ranged.high) == ("range", "m", "range", 0.5, 10_000)
    gain = metric["matching.gain_prior_grey_per_k"]
    assert (gain.title, gain.unit, gain.kind) == ("gain prior", "grey levels per K", "number")
    assert metric["camera.calibrate"].kind == "switch"
    assert metric["placement.mode"].choices == ("paper", "metric")
    assert metric["camera.pitch"].kind == "yaml"
    assert metric["environment.time_of_day"].choices == ("day", "dusk", "night", "dawn", None)
    assert "objects.0.range_m" not in paper and "camera.distance_m" in paper


def test_the_inputs_of_fields_with_several_types_follow_from_their_values() -> None:
    drones = fields("drone-sky")
    category, count = drones["objects.0.category"], drones["objects.0.count"]
    assert (category.kind, category.shown, category.read(" quad "), category.read("")) == (
        "text",
        "drone",
        "quad",
        None,
    )
    assert count.kind == "counts" and fields(RECIPE)["objects.0.count"].kind == "whole"
    by_flight = {"values": [1], "by_flight": [{"values": [2], "below_m": 60}]}
    assert fields("drone-sky", **{"objects.0.count": by_flight})["objects.0.count"].kind == "yaml"
    size = fields("sar-people")["placement.size_px"]
    assert (size.kind, size.value, size.low) == ("range", [6.0, 160.0], 0)
    assert fields("sar-people")["placement.min_contrast"].kind == "yaml"


def test_a_change_of_mode_drops_settings_without_a_meaning() -> None:
    modes = modes_of(load_recipe(RECIPE).model_dump(mode="json"))
    settings = {"objects.0.range_m": [1, 2], "objects.0.scale": [1, 2], "matching.polarity": "black-hot"}
    assert set(fitting(settings, modes)) == {"objects.0.scale", "matching.polarity"}


@pytest.fixture(scope="module")
def data(write_tiny_hit_uav: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_hit_uav(tmp_path_factory.mktemp("data"))


@pytest.fixture
def tuning(data: Path) -> Iterator[Tuning]:
    made = Tuning(TrialRequest(RECIPE, data, seed=3, execution=FLAT))
    yield made
    made.close()


def test_a_saved_recipe_gives_the_bytes_of_the_picture(tuning: Tuning, data: Path, tmp_path: Path) -> None:
    settings = {"objects.0.scale": [1.5, 1.5], "camera.distance_m": [4.0, 5.0]}
    background = tuning.backgrounds[-1]
    tuned = tuning.compose(RECIPE, settings, background)
    frame = tuned.trial.frame
    path = tmp_path / "tuned.yaml"
    saved, words = tuning.save(tuned.recipe, path, frame.id)
    command = shlex.split(words)
    assert saved == path.resolve()
    assert command == ["infrablend", "try", str(path), "--data", str(data), "--seed", "3", "--frame", frame.id]
    again = api.try_recipe(command[2], command[4], command[8], seed=int(command[6]), execution=FLAT)
    assert again.frame.image_bytes == frame.image_bytes
    plain = tuning.compose(RECIPE, {}, background).trial.frame
    assert plain.image_bytes != frame.image_bytes


def test_the_command_of_a_saved_recipe_reads_the_backgrounds_in_the_same_way(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    shutil.copy(next(data.rglob("*.jpg")), pictures / "a.jpg")
    Path("table.csv").write_text("file,pitch_deg\na.jpg,85\n")
    reading = api.Reading(format="folder", metadata=Path("table.csv"))
    tuning = Tuning(TrialRequest(RECIPE, pictures, reading=reading, execution=FLAT))
    frame = tuning.compose(RECIPE, {}, tuning.backgrounds[0]).trial.frame
    command = shlex.split(tuning.save(tuning.read(RECIPE, {}), Path("a.yaml"), frame.id)[1])
    tuning.close()
    assert frame.image.capture.pitch_deg == 85
    assert command[7:-2] == ["--format", "folder", "--metadata", str(tmp_path / "table.csv")]


def test_a_recipe_is_saved_over_nothing_of_others(tuning: Tuning, tmp_path: Path) -> None:
    recipe = tuning.read(RECIPE, {})
    mine = tmp_path / "mine.yaml"
    mine.write_text("mine")
    with pytest.raises(OutputError, match="exists already"):
        tuning.save(recipe, mine, "test/a_c0")
    with pytest.raises(ArgumentError, match=r"\.yaml"):
        tuning.save(recipe, tmp_path / "x.sh", "test/a_c0")
    tuning.save(recipe, tmp_path / "a.yaml", "test/a_c0")
    tuning.save(recipe, tmp_path / "a.yaml", "test/a_c0")
    assert mine.read_text() == "mine"
    # Another studio takes the same recipe for its own, to go on with a run of it.
    tuning._saved.clear()
    tuning.save(recipe, tmp_path / "a.yaml", "test/a_c0")
    tuning._saved.clear()
    with pytest.raises(OutputError, match="exists already"):
        tuning.save(tuning.read(RECIPE, {"configurations": 3}), tmp_path / "a.yaml", "test/a_c0")


def test_wrong_fields_and_deleted_backgrounds_are_named(
    write_tiny_hit_uav: Callable[..., Path], tmp_path: Path
) -> None:
    tuning = Tuning(TrialRequest(RECIPE, write_tiny_hit_uav(tmp_path / "data"), execution=FLAT))
    background = tuning.backgrounds[0]
    with pytest.raises(RecipeError) as error:
        tuning.compose(RECIPE, {"objects.0.scale": [3, 1]}, background)
    assert [p.where for p in error.value.problems] == ["objects.0.scale"]
    tuning.compose(RECIPE, {}, background)
    for path in (tmp_path / "data").rglob(background.path.name):
        path.unlink()
    with pytest.raises(DatasetError, match=background.path.name):
        tuning.compose(RECIPE, {}, background)
    assert tuning.compose(RECIPE, {}, tuning.backgrounds[1]).facts()
    tuning.close()


def test_an_insert_is_shown_beside_the_most_similar_real_object(tuning: Tuning) -> None:
    (real,) = (i for image in tuning.backgrounds for i in image.instances if i.category == "OtherVehicle")
    assert tuning.nearest_real(real, "day") is not None
    drone = tuning.compose(RECIPE, {}, tuning.backgrounds[0]).trial.frame.inserted[0]
    assert tuning.nearest_real(drone, "day") is None


def test_the_gain_is_explained_in_words() -> None:
    gain = {"grey_per_k": 5.94, "anchors_used": 7, "doubts": ["at_bound"]}
    assert gain_words({"gain": {"ground": gain}}) == [
        "gain (ground) 5.9 grey levels per kelvin, from 7 patches of the background; doubtful: at_bound"
    ]
    assert "expectation alone" in gain_words({"gain": {"sky": {**gain, "from_prior": True}}})[0]


def test_an_insert_moved_by_hand_is_where_it_was_put_and_saved_so(tuning: Tuning, tmp_path: Path) -> None:
    background = tuning.backgrounds[-1]
    before = tuning.compose(RECIPE, {}, background).trial.frame
    assert before.scene is not None
    x, y = origin_px(before.scene, 0)
    frames = moved({}, before.scene, 0, Move(-40, 25, turn_deg=90, away=1.5), stands=False)
    tuned = tuning.compose(RECIPE, {"frames": frames}, background)
    after = tuned.trial.frame
    assert after.scene is not None
    assert origin_px(after.scene, 0) == pytest.approx((x - 40, y + 25), abs=0.02)
    path = tmp_path / "moved.yaml"
    tuning.save(tuned.recipe, path, after.id)
    again = api.try_recipe(path, tuning.data, after.id, seed=3, execution=FLAT).frame
    assert again.image_bytes == after.image_bytes != before.image_bytes
    assert released(frames, after.scene, 0) == {}
    assert tuning.compose(RECIPE, {"frames": {}}, background).trial.frame.image_bytes == before.image_bytes


def test_inserts_can_be_moved_where_others_were_left_out(tuning: Tuning) -> None:
    background, many = (
        tuning.backgrounds[-1],
        {"objects.0.count": 3, "objects.0.scale": [6, 6], "placement.min_visibility": 0.9},
    )
    tuned = tuning.compose(RECIPE, many, background)
    scene = tuned.trial.frame.scene
    assert scene is not None and 0 < len(scene.objects) < 3
    absent = tuned.left_out()
    assert sorted([*absent, *(o.number for o in scene.objects if o.number is not None)]) == list(range(3))
    assert all("drone, was left out: " in line for line in absent.values())
    assert not any("not inserted" in line for line in tuned.remarks())
    last = len(scene.objects) - 1
    x, y = origin_px(scene, last)
    frames = moved({}, scene, last, Move(-3, 2), stands=False)
    after = tuning.compose(RECIPE, {**many, "frames": frames}, background).trial.frame.scene
    assert after is not None
    (at,) = (k for k, o in enumerate(after.objects) if o.number == scene.objects[last].number)
    assert after.objects[at].by_hand and origin_px(after, at) == pytest.approx((x - 3, y + 2), abs=0.02)
    gone = min(absent)
    frames = with_place({}, scene.frame_id, gone, {"x_px": 320.0, "y_px": 300.0})
    placed = tuning.compose(RECIPE, {**many, "frames": frames}, background)
    assert gone not in placed.left_out()


def test_a_path_by_hand_is_what_the_recipe_takes() -> None:
    points = with_point(with_point([], 100.04, 80), 300, 90)
    points[0]["range_m"] = 60.0
    points = with_point(points[:1], 310, 95) + points[1:]
    points[1]["time_s"] = 4
    motion = with_path({"kind": "fly", "path": []}, points)
    assert motion is not None and [p["time_s"] for p in motion["path"]] == [0.0, 1.0, 4]
    recipe = load_recipe("drone-video", {"objects.0.motion": motion})
    (kind, *_) = recipe.objects
    assert path_of(kind.model_dump(mode="json")["motion"])[0] | {"offset_m": None} == {
        "time_s": 0.0, "x_px": 100.0, "y_px": 80.0, "range_m": 60.0, "offset_m": None,
    }  # fmt: skip
    assert path_of(motion) == motion["path"]
    assert path_of({"path": [{"time_s": 0, "offset_m": [0, 0, 0]}]}) == path_of("walk") == path_of(None) == []
    assert with_path({"path": points}, []) is None


def test_a_problem_is_shown_in_the_nearest_field_above_it() -> None:
    keys = {"objects.0.scale", "objects.0.options", "objects.0.options.pose"}
    assert input_of("objects.0.options.pose", keys) == "objects.0.options.pose"
    assert input_of("objects.0.options.age.0", keys) == "objects.0.options"
    assert input_of("camera.pitch", keys) is None


def test_a_background_has_a_thumbnail_until_it_changes(
    tuning: Tuning, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path))
    first = tuning.thumbnail(0)
    assert first[:2] == b"\xff\xd8" and tuning.thumbnail(0) == first
    assert len([*tmp_path.rglob("backgrounds/*.jpg")]) == 1
    with pytest.raises(DatasetError, match="no such picture"):
        tuning.thumbnail(99)
    assert tuning.number_of("test/none") is None
    assert all(tuning.number_of(f"{i.split}/{i.id}") == n for n, i in enumerate(tuning.backgrounds))


def test_the_ground_is_shown_only_where_there_is_one(tuning: Tuning) -> None:
    paper = tuning.compose(RECIPE, {}, tuning.backgrounds[-1])
    assert not paper.has_ground
    assert (paper.picture(boxes=False, ground=True) == paper.picture(boxes=False)).all()
    real = tuning.compose("hit-uav-person", {}, tuning.backgrounds[-1])
    assert real.has_ground
    assert real.picture(boxes=False, ground=True).shape[1] == 2 * real.picture(boxes=False).shape[1]
    assert all(real.stands(k) for k in range(len(real.trial.frame.inserted)))
