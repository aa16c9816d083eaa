"""Careless or hostile input gives a clear error, no partial output, and no loss of the user's files."""

import json
import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from infrablend import api
from infrablend.assets.user_model import read_description
from infrablend.cli.exits import ENVIRONMENT, exit_code
from infrablend.config.loading import list_recipes, load_recipe, parse_recipe
from infrablend.core.files import part_path
from infrablend.core.operating_system import hold
from infrablend.core.workspace import partial_of
from infrablend.core.yaml_text import read_yaml
from infrablend.errors import Interrupted, ModelError, OutputError, Problem, RecipeError
from infrablend.pipeline.execution import process_pool
from infrablend.pipeline.plans import run_request
from infrablend.pipeline.plans.run_request import Execution, RunRequest
from infrablend.pipeline.runs import run
from infrablend.pipeline.runs.generate import plan_request
from tests.run_files import hashes

pytestmark = pytest.mark.long


@pytest.fixture
def data(tmp_path, write_tiny_hit_uav):
    return write_tiny_hit_uav(tmp_path / "data", ("normal_json",))


def generate(data, out, recipe="hit-uav-drone", **kwargs):
    options = {"execution": api.Execution(renderer="flat", in_process=True), "settings": ["output.formats=[coco]"]}
    return api.generate(recipe, data, out, **{**options, **kwargs})


# ---- YAML


def test_an_alias_bomb_is_refused_before_it_grows():
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n"
    bomb += "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 40))
    with pytest.raises(ValueError, match="aliases"):
        read_yaml(bomb)
    with pytest.raises(RecipeError, match="aliases"):
        parse_recipe(bomb, "bomb")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("a: 1\na: 2", "duplicate key"),
        ("&a [*a]", "contains itself"),
        ("[" * 5000, "nested too deeply"),
        ("!!python/object/apply:os.system ['true']", "not YAML"),
        ("a: !!binary aGk=", "type bytes"),
        ("x" * 1_000_001, "characters"),
    ],
)
def test_yaml_that_is_not_plain_values_is_refused(text, match):
    with pytest.raises(ValueError, match=match):
        read_yaml(text)


def test_yaml_numbers_dates_and_aliases_have_their_plain_meaning():
    assert read_yaml("a: 1e3\nb: 2020-01-01\nc: &c [1, 2]\nd: *c") == {
        "a": 1000.0,
        "b": "2020-01-01",
        "c": [1, 2],
        "d": [1, 2],
    }


# ---- recipes: one problem for one mistake, in plain words


@pytest.mark.parametrize(
    ("setting", "problem"),
    [
        ("camera.distance_m=abc", 'camera.distance_m: found "abc"; expected a range [lo, hi] or a number'),
        ("camera.distance_m=[1, 2, 3]", "camera.distance_m: found [1, 2, 3]; expected a range [lo, hi] or a number"),
        ("camera.distance_m=[5, 1]", "expected a range [lo, hi] whose low end is not above its high end"),
        ("camera.distance_m=.inf", "camera.distance_m: found Infinity; expected a finite number"),
        ("camera.pitch=5", "camera.pitch: found 5; expected 'metadata' or a mapping with fixed_deg or random_deg"),
        ("camera.pitch={fixed_deg: abc}", 'camera.pitch.fixed_deg: found "abc"; expected a number'),
        ("camera.pitch={foo: 1}", "expected a mapping with fixed_deg or from_horizon or random_deg alone"),
        ("camera.pitch={fixed_deg:30}", "Write a space after the colon"),
        ("objects.0.count=abc", 'objects.0.count: found "abc"; expected a whole number or a mapping with values'),
        ("objects.0.count={values: [-1]}", "objects.0.count.values.0: found -1; expected greater than or equal to 0"),
        ("objects.0.count={values: [1], weights: [.inf]}", "objects.0.count.weights.0: found Infinity"),
        ("objects.0.parts={Body: {foo: 1}}", "objects.0.parts.Body.foo: unknown key"),
        ("objects.0.category='a\tb'", "objects.0.category"),
        ("objects=3", "objects: found 3; expected a list"),
        ("objects=[]", "objects: found []; expected at least 1 item"),
        ("output.formats=[yolo, yolo]", "expected each item once"),
    ],
)
def test_one_mistake_gives_one_readable_problem(setting, problem):
    with pytest.raises(RecipeError) as caught:
        load_recipe("hit-uav-drone", [setting])
    assert len(caught.value.problems) == 1, caught.value
    assert problem in str(caught.value.problems[0])


def test_a_missing_space_is_one_problem():
    with pytest.raises(RecipeError) as caught:
        load_recipe("hit-uav-people", ["objects.0.group={share:0.5}"])
    assert [p.where for p in caught.value.problems] == ["objects.0.group.share:0.5"]
    assert "Write a space after the colon" in str(caught.value)


def test_options_and_categories_are_checked_before_the_first_frame(data, tmp_path):
    with pytest.raises(RecipeError, match=r"objects\.0\.options"):
        generate(data, tmp_path / "run", settings={"objects.0.options": {"pose": "x"}})
    walking = {"objects.0.group": {"share": 0.5}, "objects.0.align": {"along": "view"}}
    report = generate(data, tmp_path / "flying", recipe="hit-uav-drone-physical", settings=walking)
    found = [p for p in report.problems if p.code == "no-effect"]
    assert [p.where for p in found] == ["objects.0.group", "objects.0.align"]
    assert all(p.severity == "warning" and "drone flies" in p.found for p in found)
    planned = api.plan("hit-uav-drone-physical", data, settings=walking).to_json()
    assert sum("drone flies" in text for text in planned["warnings"]) == 2
    with pytest.raises(RecipeError, match="Persn"):
        generate(data, tmp_path / "run", settings={"labels.keep_categories": ["Persn"]})
    assert not (tmp_path / "run").exists()


def _of_pictures(name):
    """Return the settings that make a recipe of sequences one of single pictures."""
    recipe = load_recipe(name)
    return {f"objects.{k}.motion": None for k in range(len(recipe.objects))} if recipe.in_sequences else {}


@pytest.mark.parametrize(
    ("recipe", "settings", "where", "why"),
    [
        ("hit-uav-person", {"objects.0.range_m": [5, 9]}, "objects.0.range_m", "person stands on the ground"),
        ("hit-uav-drone-physical", {"objects.0.z_m": [2, 3]}, "objects.0.z_m", "drone flies"),
        ("drone-sky", {"objects.0.range_m": [5, 9]}, "objects.0.range_m", "size_px decides the distance"),
        ("drone-sky", {"objects.0.range_m": [5, 9], "objects.0.size_px": None}, None, None),
        ("drone-sky", {"appearance.mode": "artistic"}, "sensor.headroom", "appearance.mode is artistic"),
        ("hit-uav-person", {"objects.0.range_m": [15, 60], "objects.0.z_m": [2, 3]}, None, None),  # the default
        ("hit-uav-drone-physical", {"objects.0.range_m": [5, 9], "sensor.headroom": 1}, None, None),
        ("hit-uav-drone", {"objects.0.z_m": [2, 3]}, None, None),  # metric placement only
        *((name, _of_pictures(name), None, None) for name in list_recipes()),
    ],
)
def test_settings_without_effect_are_reported(data, recipe, settings, where, why):
    plan = plan_request(RunRequest(recipe, data, settings=settings))
    found = [p for p in plan.problems if p.code == "no-effect"]
    assert [p.where for p in found] == ([] if where is None else [where])
    assert all(p.severity == "warning" and why in p.found for p in found)


def test_a_models_description_is_read_as_strictly(tmp_path):
    path = tmp_path / "fox.yaml"
    path.write_text(
        "name: fox\ncategory: fox\nfile: fox.obj\nlength_m: .inf\nparts: {body: {match: [a], delta_t_k: x}}"
    )
    with pytest.raises(ModelError) as caught:
        read_description(path)
    text = str(caught.value)
    assert "length_m: found Infinity" in text
    assert "parts.body.delta_t_k" in text
    assert "a range [lo, hi] or a number" in text
    assert "parts.body.emissivity" in text
    path.write_text("- a")
    with pytest.raises(ModelError, match="expected a mapping"):
        read_description(path)


# ---- output folder


def test_output_and_data_must_be_apart(data, tmp_path):
    (tmp_path / "link").symlink_to(data)
    for out in (data, data / "run", tmp_path, tmp_path / "link", tmp_path / "link" / "run"):
        with pytest.raises(OutputError):
            generate(data, out)
    assert sorted(p.name for p in data.iterdir()) == ["normal_json"]


def test_two_runs_in_one_folder_are_refused(data, tmp_path):
    out = tmp_path / "run"
    with hold(tmp_path / ".run.partial.lock"):
        with pytest.raises(OutputError, match="another process is writing this run"):
            generate(data, out)
        assert not out.exists()
    assert generate(data, out).ok


def test_full_disk_in_a_worker_is_an_environment_error():
    full = OutputError("cannot write x", [Problem("x", "disk-full", "No space left on device")])
    assert exit_code(full) == ENVIRONMENT


# ---- data that change


def test_frames_of_a_changed_background_are_rendered_again(data, tmp_path, caplog):
    out, fresh = tmp_path / "run", tmp_path / "fresh"
    generate(data, out)
    before = hashes(out)
    picture = sorted((data / "normal_json" / "train").glob("*.jpg"))[0]
    other = sorted((data / "normal_json" / "test").glob("*.jpg"))[0]
    picture.write_bytes(other.read_bytes())
    with caplog.at_level(logging.WARNING):
        generate(data, out, existing="resume")
    assert "has changed" in caplog.text
    generate(data, fresh)
    assert hashes(out) == hashes(fresh) != before


def test_interruption_while_writing_labels_explains_resuming(data, tmp_path, monkeypatch):
    out, fresh = tmp_path / "run", tmp_path / "fresh"

    def stop(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(run, "export_run", stop)
        with pytest.raises(Interrupted, match="--resume"):
            generate(data, out)
    assert not out.exists()
    assert generate(data, out, existing="resume").counts == generate(data, fresh).counts


def test_half_written_files_of_a_killed_run_are_removed_on_resume(data, tmp_path):
    out, fresh = tmp_path / "run", tmp_path / "fresh"

    def stop(_):
        raise Interrupted("stop")

    with pytest.raises(Interrupted):
        generate(data, out, on_progress=stop)
    part_path(partial_of(out) / "images" / "train" / "0_60_30_0_00001_c1.jpg").write_bytes(b"half")
    generate(data, out, existing="resume")
    generate(data, fresh)
    assert hashes(out) == hashes(fresh)


def test_every_image_left_out_counts(data, tmp_path):
    file = data / "normal_json" / "annotations" / "train.json"
    content = json.loads(file.read_text())
    content["images"][0]["filename"] = "../../climbs.jpg"
    content["images"][1]["filename"] = "gone.jpg"
    file.write_text(json.dumps(content))
    (file.parent / "val.json").write_text("{not json")
    report = generate(data, tmp_path / "run")
    assert report.counts["skipped_backgrounds"] == 3, report.problems
    assert not report.ok


# ---- what a killed parent leaves


def test_temporary_folders_of_killed_parents_are_swept_and_those_in_use_are_not(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(process_pool.tempfile, "tempdir", None)
    code = (
        "import os, signal; from infrablend.pipeline.execution.process_pool import scratch_folder\n"
        "with scratch_folder() as s: open(s + '/x', 'w').close(); os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code], check=False)
    left, _ = found = sorted(tmp_path.iterdir())
    assert [p.name for p in found] == [left.name, left.name + ".lock"]
    with process_pool.scratch_folder() as one:
        assert not any(p.exists() for p in found)
        with process_pool.scratch_folder() as two:
            assert Path(one).is_dir()
            assert one != two
    assert list(tmp_path.iterdir()) == []


# ---- names


def test_a_file_name_that_is_not_utf8_is_skipped_and_counted(tmp_path, data):
    folder = tmp_path / "plain"
    folder.mkdir()
    picture = sorted((data / "normal_json" / "train").glob("*.jpg"))[0].read_bytes()
    for name in (b"good.jpg", b"bad\xff.jpg", b"line\nbreak.jpg", "\u6771 \u4eac'\".jpg".encode()):
        Path(os.fsdecode(os.fsencode(folder) + b"/" + name)).write_bytes(picture)
    settings = {"camera.pitch.fixed_deg": 30, "output.formats": ["yolo", "yolo-seg", "coco"]}
    report = generate(folder, tmp_path / "run", settings=settings)
    assert report.counts["skipped_backgrounds"] == 1
    assert report.counts["frames"] == 6
    (problem,) = [p for p in report.problems if p.code == "name-not-utf8"]
    assert problem.where == "train/bad\\udcff.jpg"
    with pytest.raises(OutputError, match="not UTF-8"):
        generate(folder, tmp_path / "run\udcff")


def test_more_workers_than_memory_holds_are_not_started(monkeypatch, caplog):
    monkeypatch.setattr(run_request, "usable_processors", lambda: [0, 1])
    assert Execution(None).worker_count() == 2
    assert Execution(1).worker_count() == 1
    assert Execution(10**9).worker_count() < 10**6
    assert "--workers 1000000000" in caplog.text


@pytest.mark.parametrize("bad", [[1e308] * 4, [1, 1, 0, 4], [1, 1, 4, -0.8], [1, 2, 3], "x"])
def test_exact_and_visible_boxes_without_extent_are_left_out(tmp_path: Path, bad: object) -> None:
    (tmp_path / "annotations").mkdir()
    annotation = {"id": 1, "image_id": 1, "category_id": 1, "bbox": [10, 10, 8, 8], "inserted": True}
    content = {
        "images": [{"id": 1, "file_name": "a.png", "width": 64, "height": 48}],
        "annotations": [annotation | {"tight_bbox": bad, "seen_bbox": bad}],
        "categories": [{"id": 1, "name": "car"}],
    }
    (tmp_path / "annotations" / "instances_train.json").write_text(json.dumps(content))
    (tmp_path / "images" / "train").mkdir(parents=True)
    Image.new("L", (64, 48)).save(tmp_path / "images" / "train" / "a.png")
    (image,) = api.read_dataset(tmp_path).images
    assert not {"tight_bbox", "seen_bbox"} & set(image.instances[0].extra)
