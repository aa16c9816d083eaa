"""Matching, average precision and intervals, by hand for small cases and against pycocotools for large ones."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infrablend.core.boxes import corners_of_box, corners_of_cxcywha
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, ImageRecord, Instance
from infrablend.core.rle_masks import Mask
from infrablend.core.rng import stream
from infrablend.detection.detections import Predictions, detections, read_predictions, write_predictions
from infrablend.detection.matching import SIZE_BINS, draw_images, interval, match_all, polygon_areas, quad_intersections
from infrablend.detection.truth import Case, Truth, class_numbers, compared, fingerprint, match_classes, truths
from infrablend.errors import DatasetError
from infrablend.lab.evaluation.evaluation_figures import confusion_matrix, figures, image_strata
from infrablend.lab.evaluation.precision import (
    average_precisions,
    drawn_figures,
    operating_point,
    paired,
    precision_by_recall,
)
from tests.lab.evaluation.coco_precision import coco_precisions
from tests.polygons import polygon_iou

ALL = {"all": (0.0, float("inf"))}
CATEGORIES = (Category(0, "Person"), Category(1, "Car"), Category(2, "DontCare", ignore=True))


def image(stem: str, *objects: tuple[str, list[float]], **facts: object) -> ImageRecord:
    instances = tuple(Instance(name, np.array(box, np.float64)) for name, box in objects)
    return ImageRecord(stem, Path(f"{stem}.png"), "test", (200, 100), instances, Capture(**facts))


def case(labels, found, classes=1, task="detect") -> Case:
    names = tuple(str(k) for k in range(classes))
    return Case((), labels, compared(found, labels, np.arange(classes), task), names, task)


def matched(labels, found, classes=1, task="detect", bins=ALL):
    return match_all(case(labels, found, classes, task), bins)


# Two people; one found exactly with high confidence, one with IoU 0.625 and lower confidence, and a false detection.
TWO = image("a", ("Person", [10, 10, 30, 50]), ("Person", [100, 20, 120, 60]))
FOUND = detections(
    [[10, 10, 30, 50], [150, 10, 170, 50], [100, 35, 120, 60]], [0.9, 0.8, 0.7], [0, 0, 0]
)  # 25 of 40 rows: 0.625


def test_average_precision_by_hand() -> None:
    labels, _ = truths([TWO], CATEGORIES, ["Person"], "detect")
    (m,) = matched(labels, {"test/a.png": FOUND})
    ap = average_precisions(m)[0]
    # 51 of the 101 recalls (0 to 0.5) are reached at precision 1, the other 50 at 2/3, or never.
    assert ap[:3] == pytest.approx((51 + 50 * 2 / 3) / 101, abs=1e-12)
    assert ap[3:] == pytest.approx(51 / 101, abs=1e-12)
    assert np.allclose(coco_precisions(case(labels, {"test/a.png": FOUND}))[0, 0], ap, atol=1e-12)
    curve = precision_by_recall(m)
    assert curve[50] == 1
    assert curve[51] == pytest.approx(2 / 3)


def test_precision_and_recall_are_those_of_the_best_confidence() -> None:
    labels, _ = truths([TWO], CATEGORIES, ["Person"], "detect")
    confidence, points = operating_point(matched(labels, {"test/a.png": FOUND}))
    # F1: 2/3 with the first alone, 0.5 with two, 0.8 with all three.
    assert 0 <= confidence <= 0.7
    assert points[0] == pytest.approx((2 / 3, 1.0))


def test_low_scores_have_a_best_confidence_too() -> None:
    labels, _ = truths([TWO], CATEGORIES, ["Person"], "detect")
    found = detections([[10, 10, 30, 50], [70, 70, 90, 90]], [0.03, 0.01], [0, 0])
    confidence, points = operating_point(matched(labels, {"test/a.png": found}))
    assert confidence == pytest.approx(0.03, abs=0.002)
    assert points[0] == pytest.approx((1.0, 0.5), abs=0.05)


def test_no_detections_give_zero_and_no_objects_give_none() -> None:
    labels, _ = truths([TWO], CATEGORIES, ["Person", "Car"], "detect")
    person, car = matched(labels, {}, 2)
    assert average_precisions(person).tolist() == [[0.0] * 10]
    assert np.isnan(average_precisions(car)).all()
    assert operating_point([person, car])[1] == [(0.0, 0.0), None]
    figures = drawn_figures([person, car], np.ones((1, 1)))
    assert figures[0, 0].tolist() == [0.0, 0.0]  # the mean leaves the car out


def test_label_matches_only_the_most_confident_detection() -> None:
    labels, _ = truths([TWO], CATEGORIES, ["Person"], "detect")
    twice = detections([[10, 10, 30, 50], [10, 12, 30, 50]], [0.6, 0.9], [0, 0])
    (m,) = matched(labels, {"test/a.png": twice})
    assert m.scores.tolist() == [0.9, 0.6]
    assert m.right[0, 0].tolist() == [True, False]
    assert m.right[0, 9].tolist() == [True, False]  # IoU 0.95: right at the last threshold, too
    assert not m.neutral.any()


def test_detections_in_regions_to_ignore_count_neither_way() -> None:
    both = image("a", ("Person", [10, 10, 30, 50]), ("DontCare", [100, 0, 200, 100]))
    found = {
        "test/a.png": detections([[10, 10, 30, 50], [120, 10, 140, 50], [150, 10, 170, 50]], [0.5, 0.9, 0.8], [0, 0, 0])
    }
    labels, counts = truths([both], CATEGORIES, ["Person"], "detect")
    assert counts == {"ignore_regions": 1}
    (m,) = matched(labels, found)
    assert m.neutral[0, 0].tolist() == [True, True, False]
    assert average_precisions(m)[0, 0] == pytest.approx(1.0)
    assert coco_precisions(case(labels, found))[0, 0, 0] == pytest.approx(1.0)
    off, counts = truths([both], CATEGORIES, ["Person"], "detect", ignore_regions=False)
    assert counts == {"ignore_regions_left_out": 1}
    assert average_precisions(matched(off, found)[0])[0, 0] == pytest.approx(1 / 3)


@pytest.mark.parametrize("task", ["detect", "obb", "segment"])
def test_crowd_is_a_region_for_its_own_class_only(task: str) -> None:
    crowd = Instance("Person", np.array([100.0, 10, 180, 90]), extra={"iscrowd": 1})
    own = Instance("Person", np.array([10.0, 10, 30, 50]), mask=filled([10, 10, 30, 50]))
    record = replace(image("a"), instances=(crowd, own))
    labels, counts = truths([record], CATEGORIES, ["Person", "Car"], task)
    assert counts == {"crowds": 1} | ({"objects_without_oriented_box": 1} if task == "obb" else {})
    boxes = [[10, 10, 30, 50], [110, 20, 130, 60], [140, 20, 160, 60], [110, 20, 130, 60]]
    corners = [corners_of_box(np.array(b, np.float64)) for b in boxes] if task == "obb" else None
    masks = [filled(b) for b in boxes] if task == "segment" else None
    found = detections(boxes, [0.9, 0.8, 0.7, 0.6], [0, 0, 0, 1], corners, masks)
    people, cars = matched(labels, {"test/a.png": found}, 2, task)
    assert people.objects.sum() == 1
    assert people.right[0, 0].tolist() == [True, False, False]
    assert people.neutral[0, 0].tolist() == [False, True, True]
    assert not cars.neutral.any()
    assert not cars.objects.any()
    assert coco_precisions(case(labels, {"test/a.png": found}, 2, task))[0, 0] == pytest.approx(1)
    left, counts = truths([record], CATEGORIES, ["Person", "Car"], task, ignore_regions=False)
    assert counts["crowds_left_out"] == 1
    assert len(left[0].classes) == 1


def test_sizes_are_of_the_longer_side_and_others_are_ignored() -> None:
    sizes = image("a", ("Person", [0, 0, 4, 16]), ("Person", [50, 0, 60, 15.5]), ("Person", [100, 0, 140, 10]))
    labels, _ = truths([sizes], CATEGORIES, ["Person"], "detect")
    (m,) = matched(labels, {"test/a.png": detections([[50, 0, 60, 15.5]], [0.9], [0])}, bins=SIZE_BINS)
    assert m.objects[:, 0].tolist() == [3, 0, 1, 1, 1, 0, 0]
    ap = [float(average_precisions(m, size=a)[0, 0]) for a in range(7)]
    assert ap[2] == pytest.approx(1.0)
    assert ap[3] == ap[4] == 0.0
    assert np.isnan([ap[1], ap[5], ap[6]]).all()


def made_up(number: int, task: str, classes: int = 3) -> tuple[list[Truth], dict]:
    """Labels on small images, and detections: jittered, missing, duplicated, false, in regions to ignore."""
    rng = stream(0, "made up", task)
    labels, found = [], {}
    for k in range(number):
        n = int(rng.integers(0, 7))
        low = rng.uniform(0, [160, 70], (n, 2))
        boxes = np.concatenate([low, low + rng.uniform(4, 30, (n, 2))], axis=1)
        ignore = np.sort(rng.random(n) < 0.1)
        its = np.where(ignore, -1, rng.integers(0, classes, n))
        hit = np.flatnonzero(rng.random(n) < 0.85)
        again = hit[rng.random(len(hit)) < 0.3]
        which = np.concatenate([hit, again])
        jitter = rng.normal(0, 1.2, (len(which), 4))
        wrong = rng.uniform(0, [160, 70], (3, 2))
        theirs = np.concatenate([boxes[which] + jitter, np.concatenate([wrong, wrong + rng.uniform(4, 30, (3, 2))], 1)])
        theirs = np.concatenate([np.minimum(theirs[:, :2], theirs[:, 2:] - 1), theirs[:, 2:]], axis=1).clip(0, 200)
        class_ = np.concatenate([np.where(its[which] < 0, 0, its[which]), rng.integers(0, classes, 3)])
        scores = np.round(rng.random(len(class_)), 2)  # many ties
        corners, masks, their_corners, their_masks = None, None, None, None
        if task == "obb":
            corners, their_corners = turned(boxes, rng), turned(theirs, rng)
        if task == "segment":
            masks, their_masks = [filled(b) for b in boxes], [filled(b) for b in theirs]
        key = f"test/{k}.png"
        labels.append(Truth(key, (200, 100), boxes, its, ignore, corners, masks if masks is None else tuple(masks)))
        found[key] = detections(theirs, scores, class_, their_corners, their_masks)
    return labels, found


def turned(boxes, rng):
    centre, size = (boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]
    return corners_of_cxcywha(np.concatenate([centre, size, rng.uniform(-0.2, 0.2, (len(boxes), 1))], axis=1))


def filled(box) -> Mask:
    mask = np.zeros((100, 200), np.bool_)
    x0, y0, x1, y1 = (round(v) for v in box)
    mask[y0 : y1 + 1, x0 : x1 + 1] = True
    return Mask.from_array(mask)


@pytest.mark.parametrize("task", ["detect", "obb", "segment"])
def test_our_matching_is_that_of_pycocotools_at_every_size_and_threshold(task: str) -> None:
    labels, found = made_up(120, task)
    matches = matched(labels, found, 3, task, SIZE_BINS)
    ours = np.array([[average_precisions(m, size=a)[0] for m in matches] for a in range(len(SIZE_BINS))])
    theirs = coco_precisions(case(labels, found, 3, task), list(SIZE_BINS.values()))
    assert ours[0, :, 0].min() > 0.2
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)


@pytest.mark.parametrize("task", ["detect", "obb", "segment"])
def test_the_table_has_the_precision_of_pycocotools(task: str) -> None:
    labels, found = made_up(40, task)
    images = tuple(ImageRecord(t.key, Path(t.key), "test", t.size_wh, ()) for t in labels)
    whole = replace(case(labels, found, 4, task), images=images)  # there is no object of the last class
    rows = figures(whole, [t.key for t in labels], 0, 0)[0]["classes"]
    theirs = coco_precisions(whole)[0]
    for name, ap in (("all", theirs[:3]), *zip(whole.classes[:3], theirs, strict=False)):
        assert rows[name]["map50"] == pytest.approx(ap[..., 0].mean(), abs=1e-9)
        assert rows[name]["map50_95"] == pytest.approx(ap.mean(), abs=1e-9)
    assert rows["3"]["map50"] is None and np.isnan(theirs[3]).all()


def test_image_with_weight_two_equals_two_copies() -> None:
    labels, found = made_up(40, "detect")
    # Scores without ties, as equal ones may come in another order.
    found = {
        k: detections(d.boxes_xyxy, d.scores * 0.5 + stream(0, k).random(len(d)) * 0.5, d.classes)
        for k, d in found.items()
    }
    counts = stream(1, "counts").integers(0, 3, (1, 40)).astype(np.int32)
    copies, copied = [], {}
    for k, label in enumerate(labels):
        for n in range(counts[0, k]):
            key = f"{label.key}-{n}"
            copies.append(Truth(key, label.size_wh, label.boxes_xyxy, label.classes, label.ignore))
            copied[key] = found[label.key]
    for once, many in zip(matched(labels, found, 3), matched(copies, copied, 3), strict=True):
        np.testing.assert_allclose(average_precisions(once, counts), average_precisions(many), rtol=0, atol=1e-9)


def test_draws_depend_only_on_the_seed_and_keep_groups_together() -> None:
    groups = ["a", "a", "b", "c", "c", "c"]
    drawn = draw_images(groups, 200, 3)
    assert (drawn == draw_images(groups, 200, 3)).all()
    assert (drawn != draw_images(groups, 200, 4)).any()
    assert (drawn[:, 0] == drawn[:, 1]).all()
    assert (drawn[:, 3] == drawn[:, 4]).all()
    assert (drawn[:, [0, 2, 3]].sum(axis=1) == 3).all()
    assert np.unique(drawn[:, 0]).tolist() == [0, 1, 2, 3]


def test_intervals_hold_the_figure_and_narrow_with_more_images() -> None:
    widths = []
    for number in (30, 240):
        labels, found = made_up(number, "detect")
        matches = matched(labels, found, 3)
        drawn = drawn_figures(matches, draw_images([t.key for t in labels], 300, 0))
        figure = drawn_figures(matches, np.ones((1, number)))[0, 0, 0]
        low, high = interval(drawn[:, 0, 0])
        assert low < figure < high
        widths.append(high - low)
    assert widths[1] < 0.6 * widths[0]


def test_pairs_on_the_same_images() -> None:
    labels, found = made_up(80, "detect")
    better = {
        t.key: detections(
            np.concatenate([found[t.key].boxes_xyxy, t.boxes_xyxy[~t.ignore]]),
            np.concatenate([found[t.key].scores * 0.5, np.full((~t.ignore).sum(), 0.9)]),
            np.concatenate([found[t.key].classes, t.classes[~t.ignore]]),
        )
        for t in labels
    }
    first, second = matched(labels, better, 3), matched(labels, found, 3)
    groups = [t.key for t in labels]
    weights = draw_images(groups, 200, 0)
    names = ("Person", "Car", "Bicycle")
    same = paired([second], [second], names, weights, groups)
    assert same["all"]["map50"]["difference"] == 0
    assert same["all"]["map50"]["ci"] == [0, 0]
    assert same["all"]["map50"]["same_sign"] is None
    gain = paired([first], [second], names, weights, groups)
    loss = paired([second], [first], names, weights, groups)
    for name in ("all", *names):
        assert gain[name]["map50_95"]["ci"][0] > 0
        assert gain[name]["map50_95"]["same_sign"] == 1
        assert loss[name]["map50_95"]["difference"] == -gain[name]["map50_95"]["difference"]


def test_draws_without_a_class_have_no_mean() -> None:
    """A class on one image of many: without it the mean would be that of the other class, which is found wholly."""
    records = [image(str(k), ("Person", [10, 10, 30, 50])) for k in range(8)]
    records[0] = image("0", ("Person", [10, 10, 30, 50]), ("Car", [100, 20, 140, 60]))
    labels, _ = truths(records, CATEGORIES, ["Person", "Car", "Bicycle"], "detect")
    found = {t.key: detections([[10, 10, 30, 50]], [0.9], [0]) for t in labels}
    matches, groups = matched(labels, found, 3), [t.key for t in labels]
    weights = draw_images(groups, 300, 0)
    drawn = drawn_figures(matches, weights)
    without = weights[:, 0] == 0
    assert 50 < without.sum() < 200
    assert np.isnan(drawn[without, 0]).all()
    assert drawn[~without, 0] == pytest.approx(0.5)  # and bicycles, of which there are none, stay out
    assert interval(drawn[:, 0, 0]) == pytest.approx([0.5, 0.5])
    assert drawn_figures(matches, np.ones((1, 8)))[0, 0] == pytest.approx(0.5)
    pair = paired([matches], [matched(labels, {}, 3)], ("Person", "Car", "Bicycle"), weights, groups)
    assert pair["all"]["map50"]["ci"] == pytest.approx([0.5, 0.5])


def test_one_group_has_no_interval() -> None:
    labels, found = made_up(30, "detect")
    ours, theirs = matched(labels, found, 3), matched(labels, {}, 3)
    names, groups = ("Person", "Car", "Bicycle"), ["a"] * 30
    for of in paired([ours], [theirs], names, draw_images(groups, 50, 0), groups).values():
        assert of["map50"]["difference"] > 0
        assert of["map50"]["ci"] is of["map50"]["same_sign"] is None


def test_detectors_that_differ_in_the_seed_are_drawn_too() -> None:
    """The interval of means includes the spread between detectors; equal detectors add nothing to it."""
    labels, found = made_up(80, "detect")

    def seen(share: float) -> Any:
        """Detections that find a share of the objects."""
        rng = np.random.default_rng(int(1000 * share))
        kept = {}
        for t in labels:
            which = ~t.ignore & (rng.random(len(t.classes)) < share)
            kept[t.key] = detections(t.boxes_xyxy[which], np.full(which.sum(), 0.9), t.classes[which])
        return matched(labels, kept, 3)

    groups = [t.key for t in labels]
    weights = draw_images(groups, 500, 0)
    names = ("Person", "Car", "Bicycle")
    low, middle, high = seen(0.5), seen(0.6), seen(0.7)
    base = matched(labels, found, 3)
    one = paired([middle], [base], names, weights, groups)
    alike = paired([middle, middle, middle], [base, base], names, weights, groups)
    for name in ("all", *names):
        repeated: Any = alike[name]["map50"]
        for key, value in one[name]["map50"].items():
            assert repeated[key] == pytest.approx(value)
    three = paired([low, middle, high], [base], names, weights, groups)
    for name in ("all", *names):
        of = [paired([d], [base], names, weights, groups)[name]["map50"]["ours"] for d in (low, middle, high)]
        assert three[name]["map50"]["ours"] == pytest.approx(np.mean(of))
        assert three[name]["map50"]["difference"] == pytest.approx(np.mean(of) - one[name]["map50"]["theirs"])

    def width(found: Any) -> float:
        ci = found["all"]["map50"]["ci"]
        return float(ci[1] - ci[0])

    # The two sources of spread add up as squares: the images' and that of a mean of three detectors.
    figures = [paired([d], [base], names, weights, groups)["all"]["map50"]["ours"] for d in (low, middle, high)]
    of_seeds = 2 * 1.96 * np.std(figures, ddof=1) / np.sqrt(3)
    of_images = np.mean([width(paired([d], [base], names, weights, groups)) for d in (low, middle, high)])
    assert width(three) == pytest.approx(np.hypot(of_seeds, of_images), rel=0.15)
    assert width(three) > 1.3 * of_images
    assert paired([low, middle, high], [base], names, weights, groups, seed=1) != three


def test_confusion_by_hand() -> None:
    objects = (
        ("Person", [0, 0, 10, 20]),
        ("Car", [50, 0, 90, 20]),
        ("Car", [100, 0, 140, 20]),
        ("DontCare", [150, 0, 200, 50]),
    )
    labels, _ = truths([image("a", *objects)], CATEGORIES, ["Person", "Car"], "detect")
    found = detections(
        [[0, 0, 10, 20], [50, 0, 90, 20], [0, 60, 10, 80], [160, 10, 170, 30], [100, 0, 140, 20]],
        [0.9, 0.8, 0.7, 0.9, 0.1], [1, 1, 0, 0, 1],
    )  # fmt: skip
    matrix = confusion_matrix(case(labels, {"test/a.png": found}, 2), 0.5)
    # Rows: detected as person, car, nothing; columns: labelled person, car, nothing.
    assert matrix.tolist() == [[0, 0, 1], [1, 1, 0], [0, 1, 0]]


def test_quadrilaterals_meet_as_polygons_do() -> None:
    rng = stream(0, "quads")
    a = corners_of_cxcywha(
        np.concatenate([rng.uniform(0, 40, (30, 2)), rng.uniform(2, 30, (30, 2)), rng.uniform(0, 3.2, (30, 1))], 1)
    )
    area = quad_intersections(a, a)
    whole = polygon_areas(a)
    iou = area / (whole[:, None] + whole[None] - area)
    expected = np.array([[polygon_iou(p, q) for q in a] for p in a])
    np.testing.assert_allclose(iou, expected, rtol=0, atol=1e-9)
    assert np.diag(iou) == pytest.approx(1.0)
    assert (expected == 0).any()


def test_classes_go_together_by_name_then_case_then_kind() -> None:
    detector = ("person", "car", "Car", "other vehicle", "pedestrian", "bike")
    mapping = match_classes(detector, ["Person", "Car", "OtherVehicle", "Bicycle", "drone"])
    assert mapping == {"Person": (0,), "Car": (2,), "OtherVehicle": (3,), "Bicycle": (5,), "drone": ()}
    assert class_numbers(mapping, 6).tolist() == [0, -1, 1, 2, -1, 3]
    assert match_classes(("pedestrian", "people"), ["Person"]) == {"Person": (0, 1)}


def test_strata_have_bins_of_their_own_for_few_values_and_ranges_for_many() -> None:
    few = [
        image(str(k), pitch_deg=v, time_of_day=t)
        for k, (v, t) in enumerate([(30.0, "day"), (90.0, "night"), (None, None)])
    ]
    strata = image_strata(few)
    assert {k: v.tolist() for k, v in strata["pitch"].items()} == {
        "30": [True, False, False], "90": [False, True, False], "unknown": [False, False, True]
    }  # fmt: skip
    assert list(strata["time"]) == ["day", "night", "unknown"]
    assert list(strata["altitude"]) == ["unknown"]
    many = image_strata([image(str(k), pitch_deg=float(k) * 7 - 5, altitude_m=float(k) * 25) for k in range(14)])
    assert list(many["pitch"]) == ["<0", "0-15", "15-30", "30-45", "45-60", "60-75", ">=75"]
    assert list(many["altitude"])[:2] == ["0-20", "20-40"]
    for bins in many.values():
        assert sum(b.sum() for b in bins.values()) == 14


def test_labels_decide_the_fingerprint() -> None:
    moved = image("a", ("Person", [10, 10, 30, 50]), ("Person", [100, 20, 120, 61]))
    assert fingerprint([TWO]) == fingerprint([TWO])
    assert len({fingerprint([TWO]), fingerprint([moved]), fingerprint([TWO, moved]), fingerprint([])}) == 4


@pytest.mark.parametrize("task", ["detect", "obb", "segment"])
def test_saved_detections_read_back_equal(task: str, tmp_path: Path) -> None:
    labels, found = made_up(5, task)
    before = Predictions(task, ("a", "b", "c"), found, {t.key: t.size_wh for t in labels}, {"weights": "x.pt"})
    write_predictions(tmp_path / "one.json", before)
    after = read_predictions(tmp_path / "one.json")
    write_predictions(tmp_path / "two.json", after)
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()
    assert (after.task, after.classes, after.facts) == (task, before.classes, before.facts)
    for key, d in found.items():
        np.testing.assert_allclose(after.images[key].boxes_xyxy, d.boxes_xyxy, rtol=0, atol=1e-9)
        assert (after.images[key].scores == d.scores).all()
        assert (after.images[key].classes == d.classes).all()


GOOD = {
    "task": "detect",
    "categories": [{"id": 1, "name": "a"}],
    "images": [{"id": 1, "file_name": "test/a.png", "width": 9, "height": 9}],
    "annotations": [{"image_id": 1, "category_id": 1, "bbox": [0, 0, 1, 1], "score": 0.5}],
}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"task": "pose"}, "detect, obb or segment"),
        ({"categories": []}, "no categories"),
        ({"images": [{"id": 1, "file_name": "a", "width": "9", "height": 9}]}, "width and height"),
        ({"annotations": [{"image_id": 2, "category_id": 1, "bbox": [0, 0, 1, 1], "score": 0.5}]}, "image_id 2"),
        ({"annotations": [{"image_id": 1, "category_id": 7, "bbox": [0, 0, 1, 1], "score": 0.5}]}, "category_id 7"),
        ({"annotations": [{"image_id": 1, "category_id": 1, "bbox": [0, 0, 1], "score": 0.5}]}, "bbox"),
        ({"annotations": [{"image_id": 1, "category_id": 1, "bbox": [0, 0, 1, 1], "score": 1.5}]}, "score 1.5"),
        (
            {"annotations": [{"image_id": 1, "category_id": 1, "bbox": [0.1, 0.9, 0.3, 0.4], "score": 0.5}]},
            "shares of the picture",
        ),
        ({"task": "segment"}, "no segmentation"),
        ({"task": "obb"}, "corners None"),
    ],
)
def test_files_without_detections_are_refused(tmp_path: Path, change: dict, says: str) -> None:
    path = tmp_path / "p.json"
    path.write_text(json.dumps(GOOD))
    assert len(read_predictions(path).images["test/a.png"]) == 1
    path.write_text(json.dumps(GOOD | change))
    with pytest.raises(DatasetError, match=says):
        read_predictions(path)


@pytest.mark.parametrize("content", [b"", b"[1, 2]", b"\xff\xfe", b'{"annotations": '])
def test_non_json_files_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "p.json").write_bytes(content)
    with pytest.raises(DatasetError, match=r"p\.json"):
        read_predictions(tmp_path / "p.json")


@pytest.mark.parametrize("turned", ["labels", "detections", "both"])
def test_oriented_boxes_may_be_given_in_any_direction(turned: str) -> None:
    """The area of counter-clockwise corners was taken as 0, so that nothing was found."""
    corners = corners_of_cxcywha(np.array([[60.0, 40, 40, 16, 0.4]]))[0]
    other = corners[[0, 3, 2, 1]]
    ours, theirs = other if turned != "detections" else corners, other if turned != "labels" else corners
    box = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
    one = replace(TWO, instances=(Instance("Person", box, corners_xy=ours),))
    labels, _ = truths([one], CATEGORIES, ["Person"], "obb")
    (m,) = matched(labels, {"test/a.png": detections([box], [0.9], [0], [theirs])}, task="obb")
    assert average_precisions(m)[0].min() == pytest.approx(1.0)


def test_a_crowd_hides_no_false_detections_of_other_classes() -> None:
    crowd = Instance("Person", np.array([100.0, 10, 180, 90]), extra={"iscrowd": 1})
    labels, _ = truths([replace(TWO, instances=(crowd,))], CATEGORIES, ["Person", "Car"], "detect")
    found = {"test/a.png": detections([[110, 20, 130, 40], [140, 20, 160, 40]], [0.9, 0.8], [0, 1])}
    matrix = confusion_matrix(case(labels, found, 2), 0.1)
    assert (matrix[0, 2], matrix[1, 2]) == (0, 1)
