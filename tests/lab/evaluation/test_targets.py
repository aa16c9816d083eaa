"""Classes taken as one, names of found objects, false alarms, and AP by the size of the body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from infrablend.core.dataset import ImageRecord
from infrablend.core.rle_masks import Mask
from infrablend.core.rng import stream
from infrablend.detection.detections import Detections, detections
from infrablend.detection.matching import SIZE_BINS, match_all
from infrablend.detection.truth import Case, Truth
from infrablend.lab.evaluation.evaluation_figures import figures
from infrablend.lab.evaluation.precision import average_precisions
from infrablend.lab.evaluation.small_targets import (
    BODY_BINS,
    NO_BODY_PX,
    as_one_class,
    body_sizes,
    false_alarms,
    found_and_named,
    found_by_kind,
    name_objects,
    sizes_by_body,
)
from infrablend.lab.pages.evaluation_page import class_table, small_text
from tests.lab.evaluation.coco_precision import coco_precisions

DRONE, BIRD = 0, 1
A, B, FAR = [0, 0, 10, 10], [50, 50, 60, 60], [80, 80, 90, 90]


def truth(boxes: list[list[float]], classes: list[int], ignore: list[bool] | None = None) -> Truth:
    array = np.array(boxes, np.float64).reshape(-1, 4)
    marks = np.array(ignore or [False] * len(classes), np.bool_)
    return Truth("test/a", (100, 100), array, np.array(classes, np.int64), marks)


def case(*images: tuple[Truth, Detections]) -> Case:
    records = [ImageRecord(str(k), f"{k}.png", "test", (100, 100), ()) for k in range(len(images))]
    labels, found = zip(*images, strict=True)
    return Case(records, labels, found, ("drone", "bird"), "detect")


def ap50(of: Case) -> float:
    return float(average_precisions(match_all(of, {"all": SIZE_BINS["all"]})[0])[0, 0])


def test_wrong_names_cost_nothing_where_classes_are_one() -> None:
    """The drone is called bird with 0.9 and drone with 0.8, at one place; the bird is called drone."""
    both = case((truth([A, B], [DRONE, BIRD]), detections([A, A, B], [0.9, 0.8, 0.7], [BIRD, DRONE, DRONE])))
    one = as_one_class(both)
    assert one.found[0].scores.tolist() == [0.9, 0.7]
    assert ap50(one) == pytest.approx(1)
    # 2 of 2 objects are found by the first detection and by the third: precision 1 and 2/3 at recall 0.5 and 1.
    repeated = case((truth([A, B], [DRONE, BIRD]), detections([A, A, B], [0.9, 0.8, 0.7], [DRONE, DRONE, DRONE])))
    assert len(as_one_class(repeated).found[0]) == 3
    assert ap50(as_one_class(repeated)) == pytest.approx((51 + 50 * 2 / 3) / 101)
    # A detection is dropped for one that is kept only: the third is like the second, but not like the first.
    chain = detections([[0, 0, 10, 10], [1.5, 0, 11.5, 10], [3, 0, 13, 10]], [0.9, 0.8, 0.7], [DRONE, BIRD, DRONE])
    assert as_one_class(case((truth([], []), chain))).found[0].scores.tolist() == [0.9, 0.7]


def test_turned_boxes_and_masks_of_two_names_are_one_detection() -> None:
    turned = np.array([[5, 0], [10, 5], [5, 10], [0, 5]], np.float64)
    both = detections([A, A], [0.9, 0.8], [BIRD, DRONE], [turned, turned])
    label = replace(truth([A], [DRONE]), corners_xy=turned[None])
    one = as_one_class(replace(case((label, both)), task="obb"))
    assert (len(one.found[0]), ap50(one)) == (1, pytest.approx(1))
    square = np.zeros((100, 100), np.bool_)
    square[:10, :10] = True
    mask = Mask.from_array(square)
    label, both = (
        replace(truth([A], [DRONE]), masks=(mask,)),
        detections([A, A], [0.9, 0.8], [BIRD, DRONE], None, [mask] * 2),
    )
    one = as_one_class(replace(case((label, both)), task="segment"))
    assert (len(one.found[0]), ap50(one)) == (1, pytest.approx(1))


def test_pycocotools_gives_the_same_precision_of_classes_as_one() -> None:
    rng = stream(0, "as one")
    images = []
    for _ in range(20):
        boxes = np.concatenate([low := rng.uniform(0, 80, (6, 2)), low + rng.uniform(5, 20, (6, 2))], axis=1)
        near = np.concatenate([boxes, boxes]) + rng.normal(0, 2, (12, 4))
        names = rng.integers(0, 2, 6).tolist()
        found = detections(near, rng.uniform(0, 1, 12), rng.integers(0, 2, 12))
        images.append((truth(boxes.tolist(), [*names[:5], -1], [False] * 4 + [True] * 2), found))
    one = as_one_class(case(*images))
    ours = average_precisions(match_all(one)[0])[0]
    assert 0.2 < ours[0] < 0.9
    assert coco_precisions(one)[0, 0] == pytest.approx(ours, abs=1e-9)


def test_a_crowd_of_one_class_takes_detections_of_all_where_classes_are_one() -> None:
    both = case((truth([A, B], [DRONE, BIRD], [False, True]), detections([B, A], [0.9, 0.8], [DRONE, DRONE])))
    assert ap50(as_one_class(both)) == pytest.approx(1)
    assert ap50(both) == pytest.approx(0.5)


def test_wide_boxes_cost_nothing_at_iou_0_1() -> None:
    """A box of twice the width and height overlaps by a quarter; one beside the object is wrong at any overlap."""
    one = case((truth([A], [DRONE], [False]), detections([[-5, -5, 15, 15], B], [0.9, 0.8], [DRONE, DRONE])))
    rows = figures(one, ["0"], 0, 0)[0]["classes"]
    assert (rows["drone"]["map50"], rows["drone"]["map10"]) == (0, pytest.approx(1))
    assert (rows["bird"]["map10"], rows["all"]["map10"]) == (None, pytest.approx(1))


def test_ap10_stands_beside_ap50_where_objects_of_a_class_are_small() -> None:
    wide = [0, 50, 40, 60]
    labels = truth([A, [0, 0, 20, 8], wide, [0, 0, 99, 99]], [DRONE, DRONE, BIRD, BIRD], [False] * 3 + [True])
    rows = figures(case((labels, detections([A, wide], [0.9, 0.8], [DRONE, BIRD]))), ["0"], 0, 0)[0]["classes"]
    assert {name: row["median_px"] for name, row in rows.items()} == {"all": 20, "drone": 15, "bird": 40}
    small = small_text(rows)
    assert "median longer side: drone 15 px)" in small
    table = class_table(rows, map10=bool(small))
    assert table.head[5:7] == ["mAP10", "mAP50"] and {row[5] for row in table.rows} == {"0.752", "0.505", "1.000"}
    only = {name: rows[name] for name in ("all", "bird")}
    assert small_text(only) == "" and "mAP10" not in class_table(only).head
    earlier = {name: {k: v for k, v in row.items() if k != "median_px"} for name, row in rows.items()}
    assert small_text(earlier) == ""  # type: ignore[arg-type]


def test_found_objects_are_counted_by_size_and_visible_share() -> None:
    labels = replace(
        truth([A, B, FAR, [0, 50, 40, 60]], [DRONE, BIRD, DRONE, DRONE], [False, False, True, False]),
        visibility=np.array([0.3, np.nan, 0.1, 0.8]),
    )
    found = detections([A, [0, 50, 40, 60]], [0.9, 0.2], [BIRD, DRONE])
    one = case((labels, found), (truth([A], [DRONE], [False]), detections([], [], [])))
    hit = {"objects": 1, "found": 1}
    assert found_by_kind(one, 0.1) == {
        "size": {"8-16": {"objects": 3, "found": 1}, "32-64": hit}, "visibility": {"<0.5": hit, ">=0.8": hit},
    }  # fmt: skip
    assert found_by_kind(one, 0.5)["visibility"] == {"<0.5": hit, ">=0.8": {"objects": 1, "found": 0}}


def test_an_object_has_the_name_of_the_best_detection_that_overlaps_it_most() -> None:
    labels = truth([A, [8, 0, 18, 10], B, FAR], [DRONE, BIRD, BIRD, DRONE], [False, False, False, True])
    found = detections(
        # Around the first object with IoU 0.25; on the second, which it shares more with than with the first; the first
        # again, with a lower score; the third with IoU 0.09; in the region to ignore; and below the confidence.
        [[-5, -5, 15, 15], [7, 0, 17, 10], A, [50, 50, 53, 53], FAR, B],
        [0.7, 0.9, 0.6, 0.8, 0.9, 0.1],
        [BIRD, DRONE, DRONE, BIRD, DRONE, BIRD],
    )
    one = case((labels, found))
    assert name_objects(one, 0.5).tolist() == [[0, 1, 0], [1, 0, 1]]
    assert name_objects(one, 0.1).tolist() == [[0, 1, 0], [1, 1, 0]]
    assert name_objects(one, 0.65).tolist() == [[0, 1, 0], [1, 0, 1]]
    assert found_and_named(one, 0.1) == {
        "all": {"objects": 3, "found": 3, "named": 1, "called": {"drone": 1, "bird": 2}},
        "drone": {"objects": 1, "found": 1, "named": 0, "called": {"bird": 1}},
        "bird": {"objects": 2, "found": 2, "named": 1, "called": {"drone": 1, "bird": 1}},
    }
    assert name_objects(case((truth([], []), found)), 0.5).tolist() == [[0, 0, 0], [0, 0, 0]]


def test_false_alarms_are_counted_on_pictures_without_objects() -> None:
    """Of the drones, half are found at 0.7, all at 0.5; no bird is labelled."""
    only_region = truth([B], [-1], [True])
    found = case(
        (truth([A], [DRONE]), detections([A, FAR], [0.7, 0.9], [DRONE, DRONE])),
        (truth([A], [DRONE]), detections([A], [0.5], [DRONE])),
        (only_region, detections([A, B, A, FAR], [0.8, 0.8, 0.6, 0.65], [DRONE, DRONE, DRONE, BIRD])),
        (truth([], []), detections([FAR], [0.4], [DRONE])),
        (truth([A], [DRONE], [True]), detections([FAR], [0.9], [DRONE])),  # a crowd of drones
    )
    matches = dict(zip(found.classes, match_all(found), strict=True))
    alarms = false_alarms(found, matches, 0.65)
    assert alarms["pictures"] == 2
    assert alarms["classes"]["drone"] == {
        "per_picture": 0.5,
        "at_recall": {
            "0.5": {"confidence": 0.7, "per_picture": 0.5},
            "0.8": {"confidence": 0.5, "per_picture": 1.0},
            "0.9": {"confidence": 0.5, "per_picture": 1.0},
        },
    }
    assert alarms["classes"]["bird"] == {"per_picture": 0.5, "at_recall": {"0.5": None, "0.8": None, "0.9": None}}
    metrics, _ = figures(found, list("abcde"), 0, 0)
    assert metrics["classes"]["drone"]["false_alarms"] == 1
    assert metrics["classes"]["bird"]["false_alarms"] is None
    # The second drone is found last, after 5 false detections; without the bird among these, after 4.
    assert metrics["classes"]["all"]["as_one50"] == pytest.approx(2 / 7)
    assert metrics["classes"]["drone"]["map50"] == pytest.approx(2 / 6)
    none = case((truth([A], [DRONE]), detections([FAR], [0.9], [DRONE])))
    assert false_alarms(none, {"drone": match_all(none)[0]}, 0.5) == {"pictures": 0, "classes": {}}


def test_detections_have_the_size_of_their_box_less_the_margin_of_the_labels() -> None:
    """A body of 3 px in a box of 10 px has a margin of 7 px; a false detection of 20 px is one of 13 px."""
    labels = truth([A, [50, 50, 70, 70], FAR], [DRONE, DRONE, BIRD])
    one = case((labels, detections([[30, 0, 50, 20], A], [0.9, 0.8], [DRONE, DRONE])))
    sizes = sizes_by_body(one, [np.array([3.0, 13.0, NO_BODY_PX])])
    assert sizes[0][1].tolist() == [13, 3]
    metrics, _ = figures(one, ["a"], 0, 0, [np.array([3.0, 13.0, NO_BODY_PX])])
    bins = {name: of["classes"]["drone"] for name, of in metrics["strata"]["body"].items()}
    assert list(bins) == list(BODY_BINS)
    assert {n: (row["instances"], round(row["map50"], 9)) for n, row in bins.items() if row["instances"]} == {
        "2-4": (1, 1.0), "8-14": (1, 0.0),
    }  # fmt: skip
    assert all(of["classes"]["bird"]["instances"] == 0 for of in metrics["strata"]["body"].values())
    assert "body" not in figures(one, ["a"], 0, 0)[0]["strata"]


def test_bodies_are_measured_of_objects_and_not_of_regions() -> None:
    picture = np.full((100, 100), 100, np.uint8)
    picture[20:23, 20:25] = 40  # colder than what surrounds it
    picture[60, 60] = 200
    labels = truth(
        [[15, 15, 30, 28], [58, 58, 63, 63], [80, 20, 90, 30], [15, 15, 30, 28]], [0, 1, 1, -1], [False] * 3 + [True]
    )
    assert body_sizes(picture, labels).tolist() == [5, 1, NO_BODY_PX, NO_BODY_PX]
