"""What `generate --plan` says of the objects to come: their number, sizes and cameras, and where these came from."""

import json

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.errors import DatasetError, RecipeError
from infrablend.pipeline.runs import forecast
from tests.command_line import done, said
from tests.flat_renderer import render_flat
from tests.unit.pipeline.test_run import dataset

__all__ = ["dataset"]

PAPER, METRIC = "hit-uav-drone", "hit-uav-person"
BROAD = ("placement.size_px=[2, 200]", "placement.min_contrast=off", "placement.max_relief_grey=0",
         "placement.max_noise_grey=100")  # fmt: skip


@pytest.fixture(autouse=True)
def flat(monkeypatch):
    render_flat(monkeypatch)


def expected(recipe, data, *settings):
    facts = api.plan(recipe, data, settings=settings).facts
    return {k.removeprefix("expected_"): v for k, v in facts.items() if k.startswith("expected_")}, facts["warnings"]


def test_objects_and_sizes_are_those_of_the_run(dataset, tmp_path):
    found, _ = expected(PAPER, dataset, "objects.0.count=2")
    report = api.generate(PAPER, dataset, tmp_path / "run", settings=["objects.0.count=2", "output.formats=[coco]"])
    assert found["objects"] == report.counts["labels_inserted"] and "left_out" not in found
    labels = [a for f in (tmp_path / "run").rglob("*.json") for a in json.loads(f.read_text()).get("annotations", ())]
    sizes = [max(a["bbox"][2:]) for a in labels if a.get("inserted")]
    assert len(sizes) == found["objects"]["drone"]
    # Boxes that were drawn from masks differ from projected ones by less than a pixel.
    assert found["size_px"]["drone"]["50 %"] == pytest.approx(np.percentile(sizes, 50), abs=1)
    assert found["size_px"]["drone"]["95 %"] == pytest.approx(np.percentile(sizes, 95), abs=1)


def test_cameras_say_where_they_came_from(dataset):
    paper, _ = expected(PAPER, dataset)
    assert paper["pitch_deg"].keys() == {"metadata"} and paper["distance_m"].keys() == {"recipe"}
    real, _ = expected(METRIC, dataset, *BROAD)
    assert real["height_m"].keys() <= {"labels", "metadata"} and real["hfov_deg"].keys() == {"recipe"}
    stated, _ = expected(METRIC, dataset, *BROAD, "camera.altitude={fixed_m: 31}", "camera.pitch={fixed_deg: 62}")
    assert stated["height_m"] == {"recipe": {"5 %": 31, "50 %": 31, "95 %": 31}}
    assert stated["pitch_deg"] == {"recipe": {"5 %": 62, "50 %": 62, "95 %": 62}}


def test_a_run_that_would_insert_nothing_is_foretold_with_the_size_of_its_objects(dataset):
    """13 mm of a camera with 640 pixels of 17 um see 45 degrees, not the 108 of a sensor 36 mm wide."""
    tight = ("placement.size_px=[12, 200]", *BROAD[1:])
    found, warnings = expected(METRIC, dataset, *tight, "camera.focal_length_mm=13", "camera.altitude={fixed_m: 200}")
    assert set(found["objects"].values()) == {0} and found["left_out"]["no_place"]
    assert any("none of the" in w and " px, less than placement.size_px" in w for w in warnings)
    assert found["hfov_deg"]["recipe"]["50 %"] == pytest.approx(108.3, abs=0.1)


def test_few_frames_speak_for_many(dataset, monkeypatch):
    whole, _ = expected(PAPER, dataset, "configurations=30")
    monkeypatch.setattr(forecast, "_FRAMES", (5, 5))
    some, _ = expected(PAPER, dataset, "configurations=30")
    assert whole["tried"] > some["tried"] == 5 and whole["objects"] == some["objects"]


def test_backgrounds_that_cannot_be_used_are_counted(dataset, monkeypatch):
    def refuse(*_):
        raise DatasetError("damaged")

    monkeypatch.setattr(forecast.FrameComposer, "place", refuse)
    found, _ = expected(PAPER, dataset)
    assert found["unusable"] == {"unusable": found["tried"]}


def test_unchanged_pictures_alone_expect_nothing(dataset):
    both = ["output.originals=true"]
    original = next(f for f in api.frames(PAPER, dataset, settings=both).ids if "_c" not in f)
    facts = api.plan(PAPER, dataset, selection=api.FrameSelection(frames=(original,)), settings=both).facts
    assert facts["frames"] and not any(k.startswith("expected_") for k in facts)


def test_colour_pictures_are_counted_where_a_recipe_cannot_use_them(dataset):
    for k, path in enumerate(sorted(dataset.rglob("*.jpg"))):
        Image.fromarray(np.random.default_rng(k).integers(0, 255, (512, 640, 3)).astype(np.uint8)).save(path)
    found, _ = expected(METRIC, dataset, *BROAD)
    assert found["unusable"] == {"image-colour-mapped": found["tried"]} and found["objects"] == {"Person": 0}
    plan = api.plan(METRIC, dataset, settings=BROAD)
    assert not plan.ok and plan.facts["warnings"][0].startswith("pictures: nothing can be inserted, as none of the ")
    assert "image-colour-mapped" in plan.facts["warnings"][0]


def test_the_command_fails_where_nothing_can_be_inserted(dataset, tmp_path):
    words = ("generate", PAPER, "--data", dataset, "--out", tmp_path / "run", "--plan")
    text = said(*words, "--set", "placement.size_px=[5000, 6000]", "--set", "placement.attempts=4", code=1)
    assert "none of the" in text and "placement.size_px" in text
    assert not json.loads(done(*words, "--json").stdout)["inserts_nothing"]
    done(*words, "--set", "empty_share=1.0")  # that asks for nothing


def test_objects_are_told_by_class(dataset):
    found, _ = expected(PAPER, dataset, "objects.0.category=uav")
    assert found["objects"].keys() == found["size_px"].keys() == {"uav"}


def test_a_printed_focal_length_without_a_pixel_pitch_is_a_warning(dataset):
    found, warnings = expected(METRIC, dataset, *BROAD, "camera.focal_length_mm=13")
    assert found["hfov_deg"]["recipe"]["50 %"] == pytest.approx(108.3, abs=0.1)
    assert any("108 degrees across" in w and "camera.pixel_pitch_um" in w for w in warnings)
    right, quiet = expected(METRIC, dataset, *BROAD, "camera.focal_length_mm=13", "camera.pixel_pitch_um=17")
    assert right["hfov_deg"]["recipe"]["50 %"] == pytest.approx(45.4, abs=0.1)
    assert not any("degrees across" in w for w in quiet)


def test_a_pixel_pitch_for_pictures_of_another_width_is_refused(dataset):
    """Times the recipe's width it would give another field of view."""
    lens = ("camera.focal_length_mm=13", "camera.pixel_pitch_um=17", "camera.size_px=[800, 600]")
    with pytest.raises(RecipeError, match=r"but pictures are 640x512.*camera\.size_px=\[640, 512\]"):
        expected(METRIC, dataset, *BROAD, *lens)


def test_two_spellings_of_a_new_class_are_refused(dataset):
    with pytest.raises(RecipeError, match="the class 'Drones' beside 'drone' of another entry"):
        expected(PAPER, dataset, "objects=[{model: drone}, {model: drone, category: Drones}]")
