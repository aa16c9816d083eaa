"""Contrast of real and inserted objects: slopes, quantiles, verdicts and their page; local share; loose boxes."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from infrablend.annotation.measured_looseness import BoxExtent, box_extent, looseness, looseness_against
from infrablend.compositing.contrast import Contrast
from infrablend.compositing.object_contrast import (
    ObjectContrast,
    bound_local_share,
    object_contrast,
    slope_within_images,
)
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.rng import stream
from infrablend.errors import OutputError
from infrablend.lab.pages.realism_page import add_to_page
from infrablend.lab.realism.class_comparison import compare_contrasts
from infrablend.pipeline.studies.profile import ObjectReadings, annotated_pictures, object_figures, read_objects


def of_level(image, ring, high, middle=None, time="night"):
    middle = high if middle is None else middle
    return ObjectContrast(
        "Person", image, time, Contrast(float(high), ring - 5.0, float(middle), float(ring), 3.0), 100.0
    )


def crowd(slope, images=40, each=5, lift=60.0, time="night"):
    """Objects whose level follows the ring by a known share, from a level of each image's own."""
    rng = stream(1, "crowd", str(slope))
    found = []
    for k in range(images):
        own = rng.uniform(-20, 20)
        for ring in rng.uniform(60, 110, each):
            found.append(of_level(f"{k}", ring, 85 + own + lift + slope * (ring - 85) + rng.normal(0, 2), time=time))
    return found


def contrast_checks(real, inserted):
    return compare_contrasts(real, inserted)["night"]["checks"]


@pytest.mark.parametrize("slope", [0.0, 0.4, 1.0])
def test_the_slope_within_images_is_found_whatever_the_level_of_each_image(slope):
    found = slope_within_images(crowd(slope), "high")
    assert found.value == pytest.approx(slope, abs=0.03)
    assert found.interval[0] < slope < found.interval[1]
    assert (found.objects, found.images) == (200, 40)


def test_clipped_objects_and_images_with_two_objects_have_no_slope():
    clipped = [of_level("a", ring, 230) for ring in (60, 70, 80, 90)]
    assert slope_within_images(clipped, "high") is None
    assert slope_within_images([of_level("a", 60, 100), of_level("a", 70, 110)], "high") is None
    # Three of four are left where one is clipped; the middles of all count.
    mixed = [of_level("a", 60, 100, 90), of_level("a", 70, 110, 90), of_level("a", 80, 120, 90)]
    mixed.append(of_level("a", 90, 240, 90))
    assert slope_within_images(mixed, "high").value == pytest.approx(1)
    assert slope_within_images(mixed, "high").objects == 3
    assert slope_within_images(mixed, "middle").value == pytest.approx(0)
    # All rings are equal: there is nothing to follow.
    assert slope_within_images([of_level("a", 60, 100 + k) for k in range(4)], "high") is None


def test_figures_are_quantiles_of_the_stronger_end():
    objects = [ObjectContrast("Car", "a", "day", Contrast(120, 100 - d, 100, 100, 4), 90.0) for d in (10, 40, 60)]
    compared = compare_contrasts([], objects)["day"]
    figures = compared["inserted"]
    assert figures["signed"]["p50"] == -40
    assert figures["ground_level"]["p50"] == 10
    assert figures["ground_clutter"]["p95"] == 4
    assert figures["change"]["p50"] == 40
    assert figures["scr"]["p50"] == 8
    assert figures["n"] == 3
    assert compared["real"]["signed"] == {}


def test_verdicts_on_slope_and_least_contrast():
    checks = contrast_checks(crowd(0.1), crowd(0.2))
    assert checks["slope_high"]["holds"]
    assert checks["slope_high"]["ci"][0] < checks["slope_high"]["found"] < checks["slope_high"]["ci"][1]
    assert checks["change_p1"]["holds"]
    assert "signed_p50" not in checks
    bad = contrast_checks(crowd(0.1), crowd(0.8, lift=20))
    assert bad["slope_middle"]["holds"] is bad["change_p5"]["holds"] is False
    few = contrast_checks(crowd(0.1), crowd(0.8, images=4))
    assert few["slope_high"]["holds"] is few["change_p1"]["holds"] is None


def test_objects_alone_in_their_images_are_compared_by_their_quartiles():
    checks = contrast_checks(crowd(0.1, 100, 1), crowd(0.1, 100, 1, lift=66))
    assert checks["signed_p50"]["holds"]
    assert checks["signed_p50"]["found"] == pytest.approx(1.1, abs=0.03)
    assert not contrast_checks(crowd(0.1, 100, 1), crowd(0.1, 100, 1, lift=30))["signed_p25"]["holds"]
    assert "slope_high" not in checks


def test_small_objects_and_those_at_the_edge_are_left_out():
    picture = np.full((64, 64), 100, np.float32)
    picture[30:40, 30:36] = 180
    labels = [Instance("Person", np.array([30.0, 30, 36, 40]))]
    assert object_contrast(picture, labels[0], labels).change == 80
    for box in ([30.0, 30, 36, 37], [1.0, 30, 12, 40]):
        other = Instance("Person", np.array(box))
        assert object_contrast(picture, other, [*labels, other]) is None
    # The other label's pixels do not count as surroundings.
    beside = Instance("Person", np.array([36.0, 30, 46, 40]))
    picture[30:40, 36:46] = 255
    assert object_contrast(picture, labels[0], [*labels, beside]).ring == 100


# ---- the page


def report(time, real, inserted, category="Person"):
    scores = {
        "n": 10, "n_real": 20, "n_inserted": 15, "auc_logistic": 0.8, "ci": [0.7, 0.9], "auc_boosting": 0.85,
        "floor_logistic": None, "hard_paste_logistic": 0.99, "valid": False, "invalid_because": ["10 pairs"],
        "medians": {"real": {}}, "box_looseness": {"real": None, "inserted": None, "real_against_inserted": None},
        "contrast": compare_contrasts(real, inserted),
    }  # fmt: skip
    run = {"recipe": "people", "seed": 0, "frames": 9, "backgrounds": "b", "splits": ["val"], "real": "b"}
    return {"time_of_day": time, "run": {**run, "real_splits": ["val"]}, "classes": {category: scores}}


def test_a_page_collects_comparisons_by_class_and_time(tmp_path):
    night = report("night", crowd(0.0), crowd(0.1))
    day = report("day", crowd(0.4, time="day"), crowd(0.9, time="day"))
    drones = report("all", crowd(0, 90, 1, time="unknown"), crowd(0, 90, 1, time="unknown"), "drone")
    for facts in (day, night, drones):
        page = add_to_page(facts, tmp_path)
    collected = json.loads((tmp_path / "realism.json").read_text())["classes"]
    assert set(collected) == {"person", "drone"}
    assert collected["person"]["time_of_day"] == "night"
    assert collected["person"]["auc_logistic"] == 0.8
    assert set(collected["person"]["by_time"]) == set(collected["person"]["contrast"]) == {"night", "day"}
    assert "medians" not in collected["person"]
    text = page.read_text()
    assert "| person by day: slope of the middle | 0." in text
    assert "difference within 0.15 | no |" in text
    assert "| drone: contrast, median |" in text
    assert "10 pairs" in text
    assert {p.name for p in tmp_path.glob("*.svg")} == {"realism_slopes.svg", "realism_contrast.svg"}
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    add_to_page(night, tmp_path)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_a_page_shows_dusk_and_dawn(tmp_path):
    both = [[*crowd(k, time="dusk"), *crowd(k, time="dawn")] for k in (0.0, 0.1)]
    text = add_to_page(report("all", *both), tmp_path).read_text()
    assert "| person by dusk: slope of the middle |" in text and "| person by dawn: slope of the middle |" in text


def test_a_file_of_that_name_that_is_no_page_is_kept(tmp_path):
    (tmp_path / "realism.json").write_text('{"classes": {}}')
    with pytest.raises(OutputError, match="is not a page on realism"):
        add_to_page(report("night", crowd(0.0), crowd(0.1)), tmp_path)
    assert (tmp_path / "realism.json").read_text() == '{"classes": {}}'


# ---- local share and looseness of boxes


def as_class(category, objects):
    return [replace(o, category=category, image=f"{category}{o.image}") for o in objects]


def test_the_local_share_is_bounded_by_the_class_that_follows_least():
    objects = [*as_class("Person", crowd(0.1)), *as_class("Car", crowd(0.5, lift=-20))]
    bound = bound_local_share(objects)
    assert bound["upper_bound"] == pytest.approx(0.1, abs=0.03)
    assert bound["ci"][0] < 0.1 < bound["ci"][1]
    assert bound["recommended"] == pytest.approx(0.3, abs=0.03)
    assert set(bound["classes"]) == {"Person", "Car"}
    assert bound_local_share(crowd(0.1, images=4)) is None


def blob(side, margin, others=()):
    """A warm square of some side, blurred as by a lens, and its label with a margin on each side."""
    picture = np.full((96, 96), 100, np.float32)
    low, high = 48 - side // 2, 48 + side - side // 2
    picture[low:high, low:high] = 200
    for x0, y0, x1, y1 in others:
        picture[y0:y1, x0:x1] = 200
    box = np.array([low - margin, low - margin, high + margin, high + margin], np.float64)
    return cv2.GaussianBlur(picture, (0, 0), 0.9), Instance("Person", box)


def extent_of(picture, label, *others):
    labels = [label, *others]
    contrast = ObjectContrast("Person", "a", "night", object_contrast(picture, label, labels), 100.0)
    return box_extent(picture, label, labels, contrast)


@pytest.mark.parametrize(("side", "margin", "expected"), [(12, 3, 1.5), (20, 2, 1.2), (20, -2, 0.8)])
def test_looseness_is_box_over_visible_extent(side, margin, expected):
    picture, label = blob(side, margin)
    assert np.exp(extent_of(picture, label).log_factor) == pytest.approx(expected)


def test_objects_that_run_on_into_their_surroundings_have_no_extent():
    picture, label = blob(12, 2, [(0, 45, 96, 50)])
    assert extent_of(picture, label) is None
    # The box of another label is not part of the object.
    picture, label = blob(12, 2, [(56, 42, 68, 54)])
    beside = Instance("Person", np.array([56.0, 42, 68, 54]))
    assert extent_of(picture, label, beside) is not None
    # Half of the object is as dark as the other is bright: neither is its outline.
    picture, label = blob(12, 2)
    picture[42:48] = 200 - picture[42:48]
    assert extent_of(picture, label) is None


def test_exact_boxes_cancel_the_bias_of_the_extent():
    """Extents that are a tenth too small make exact boxes look loose; drawn ones are compared with those."""
    sizes = np.arange(10, 40)

    def boxes(factor):
        return [BoxExtent("Person", str(s % 7), "night", (1.1 * s * factor, 1.1 * s * factor), (s, s)) for s in sizes]

    assert looseness(boxes(1.0))["factor"] == pytest.approx(1.1)
    assert looseness(boxes(1.2))["factor"] == pytest.approx(1.32)
    against = looseness_against(boxes(1.2) * 2, boxes(1.0) * 3)
    assert against["factor"] == pytest.approx(1.2)
    assert against["ci"] == pytest.approx([1.2, 1.2])
    assert looseness(boxes(1.2))["spread"]["factor"] == pytest.approx(0, abs=1e-6)
    assert looseness(boxes(1.2)[:20]) is None
    assert looseness_against(boxes(1.2), boxes(1.0)[:5]) is None


def test_margins_in_px_are_told_from_factors():
    sizes = np.arange(10, 40)

    def boxes(margin):
        return [
            BoxExtent("Person", str(s % 7), "night", (s + 2 * margin, s + 2 * margin), (float(s), float(s)))
            for s in sizes
        ]

    found = looseness(boxes(3.5))
    assert found["margin_px"] == 3.5
    assert found["spread"]["margin"] < 1e-6 and found["spread"]["factor"] > 0.05
    against = looseness_against(boxes(3.5) * 2, boxes(0.5) * 3)
    assert (against["margin_px"], against["better"]) == (3.0, "margin")
    # Exact boxes with the same preference show that it is none of the annotators.
    assert looseness_against(boxes(3.5) * 2, boxes(3.5) * 3)["better"] == "factor"


def test_readings_leave_out_inserted_objects_and_regions_to_ignore(tmp_path):
    picture, label = blob(14, 2)
    path = tmp_path / "a.png"
    Image.fromarray(picture.astype(np.uint8)).save(path)
    labels = [label, replace(label, inserted=True), replace(label, category="DontCare")]
    image = ImageRecord("a", path, "train", (96, 96), tuple(labels), capture=Capture(time_of_day="night"))
    dataset = Dataset(tmp_path, "coco", (Category(0, "Person"), Category(1, "DontCare", ignore=True)), (image,))
    for inserted in (False, True):
        assert annotated_pictures(dataset, inserted=inserted) == [image]
        found = read_objects(dataset, [image], (16.0, 235.0), inserted=inserted)
        assert [c.category for c in found.contrasts] == ["Person"]
    extents = [
        BoxExtent("Person", "a", time, (12, 12), (side, side))
        for time, side in (("night", 10), ("day", 8))
        for _ in range(30)
    ]
    many = ObjectReadings(crowd(0.1), extents)
    figures = object_figures(many, ObjectReadings())
    assert figures["local_share"]["night"]["upper_bound"] == pytest.approx(0.1, abs=0.03)
    assert figures["box_looseness"]["Person"]["factor"] == 1.2
    assert figures["box_looseness"]["Person"]["against_rendered"] is None
    assert figures["box_looseness"]["Person"]["by_time"]["day"]["factor"] == 1.5
    json.dumps(figures, allow_nan=False)
