"""A run that inserted nothing, or nothing of a kind of object, is no success: exit code, reasons and next step."""

import json

import pytest

from infrablend import api
from infrablend.report.run_warnings import horizon_warnings
from tests.command_line import done, run, said
from tests.flat_renderer import render_flat
from tests.unit.pipeline.test_run import dataset

__all__ = ["dataset"]

# Objects of at least 5000 pixels have no place anywhere.
NO_PLACE = ("placement.size_px=[5000, 6000]", "placement.attempts=4")
# Placement by rules, and behind the virtual camera: the second kind is never seen.
ONE_KIND = ("placement.on_miss=keep", "objects=[{model: drone}, {model: deer, y_m: -3000}]")


@pytest.fixture(autouse=True)
def flat(monkeypatch):
    render_flat(monkeypatch)


def command(data, out, *settings, words=()):
    fields = [word for field in ("configurations=1", *settings) for word in ("--set", field)]
    return "generate", "hit-uav-drone", "--data", data, "--out", out, "--to", "yolo", *fields, *words


def test_a_run_without_any_object_fails_and_says_why_first(dataset, tmp_path):
    text = said(*command(dataset, tmp_path / "run", *NO_PLACE), code=1)
    assert text.startswith("1 problem(s): - objects: none of the 4 objects that the recipe asks for was inserted: ")
    assert "no_place 4" in text.partition("warning(s)")[0]
    assert "placement.size_px" in text.partition("warning(s)")[0]  # the next step
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert record["counts"]["objects_by_kind"] == {"objects.0": {"asked": 4, "inserted": 0}}
    assert "nothing-inserted" in {p["code"] for p in record["problems"]}
    again = said(*command(dataset, tmp_path / "run", *NO_PLACE, words=("--resume",)), code=1)
    assert again.startswith("1 problem(s): - objects: none of the 4 objects")


def test_the_api_reports_it(dataset, tmp_path):
    settings = ["configurations=1", *NO_PLACE]
    how = api.Execution(renderer="flat", in_process=True)
    report = api.generate("hit-uav-drone", dataset, tmp_path / "run", settings=settings, execution=how)
    assert not report.ok and not report.to_json()["ok"]
    assert report.problems[0].code == "nothing-inserted"


def test_a_kind_without_any_object_is_named(dataset, tmp_path):
    text = said(*command(dataset, tmp_path / "run", *ONE_KIND), code=1)
    assert "objects.1: none of the 4 objects of the model deer was inserted" in text and "objects.0: none" not in text


@pytest.mark.parametrize(
    "settings",
    [
        ("empty_share=1.0",),
        ("objects.0.count={values: [0]}",),
        (*NO_PLACE, "frames={test/0_130_70_0_00004_c0: {objects: [{x_px: 9000, y_px: 10, range_m: 5}]}}"),
    ],
)
def test_runs_that_ask_for_nothing_are_no_failures(dataset, tmp_path, settings):
    done(*command(dataset, tmp_path / "run", *settings, words=("--split", "test")))


@pytest.mark.parametrize("layout", ["files", "shards"])
def test_a_part_alone_may_have_no_object_but_the_merged_run_may_not(dataset, tmp_path, layout):
    settings = (*NO_PLACE, f"output.layout={layout}")
    for number in (1, 2):
        done(*command(dataset, tmp_path / "out", *settings, words=("--shard", f"{number}/2")))
    for target in ("files", "shards"):
        ended = run("merge", tmp_path / "out", tmp_path / target, "--layout", target)
        assert ended.exit_code == 1 and "none of the 4 objects" in ended.output
    if layout == "shards":
        assert run(*command(dataset, tmp_path / "all", *settings, words=("--shard-size", 2))).exit_code == 1
        assert run(*command(dataset, tmp_path / "one", *settings)).exit_code == 1


def test_a_printed_focal_length_on_36_mm_is_named_as_the_cause(dataset, tmp_path):
    """13 mm of a camera with 640 pixels of 17 um see 45 degrees, not the 108 of a sensor 36 mm wide."""

    def people(out, *settings, code):
        fields = ["placement.attempts=20", "placement.size_px=[12, 200]", "placement.min_contrast=off"]
        fields += ["placement.max_relief_grey=0", "placement.max_noise_grey=100", "objects.0.count=1", *settings]
        words = [word for field in fields for word in ("--set", field)]
        return said(
            "generate", "hit-uav-person", "--data", dataset, "--out", tmp_path / out, "--to", "yolo", *words, code=code
        )

    text = people("wide", "camera.focal_length_mm=13", code=1).partition("warning(s)")[0]
    assert "no_place" in text and "camera.model" in text and "camera.pixel_pitch_um" in text
    assert " px, less than placement.size_px" in text
    people("right", "camera.model=dji-xt2-25", code=0)


@pytest.mark.parametrize(
    ("origins", "warned"),
    [({}, False), ({"horizon": 3, "recipe": 2}, False), ({"horizon": 2, "recipe": 2}, True), ({"recipe": 7}, True)],
)
def test_pictures_without_a_horizon_are_a_warning_if_they_are_many(origins, warned):
    """Drones in front of a sky that nobody found may be in front of the ground."""
    found = [str(p) for p in horizon_warnings({"pitch_from": origins})]
    assert bool(found) == warned and all("set camera.pitch to their own pitch" in text for text in found)
