"""Objects found among the first detections of all images together."""

from __future__ import annotations

import numpy as np

from infrablend.detection.detections import Detections, detections
from infrablend.detection.truth import Case, Truth, compared
from infrablend.lab.evaluation.evaluation_figures import list_found


def truth(key: str, boxes: list[list[float]], ignore: list[bool] | None = None) -> Truth:
    n = len(boxes)
    array = np.array(boxes, np.float64).reshape(-1, 4)
    return Truth(key, (100, 100), array, np.zeros(n, np.int64), np.array(ignore or [False] * n, np.bool_))


def case(labels: list[Truth], found: dict[str, Detections], class_of: list[int]) -> Case:
    return Case((), labels, compared(found, labels, np.array(class_of), "detect"), ("deer", "boar"), "detect")


def test_detections_take_objects_in_the_order_of_scores_over_all_images() -> None:
    labels = [truth("test/a", [[0, 0, 10, 10], [50, 50, 60, 60]]), truth("test/b", [[20, 20, 40, 40]])]
    found = {
        # The second one is on an object that a better one has taken; the last is beyond the first four.
        "test/a": detections([[0, 0, 10, 9], [1, 1, 10, 10], [50, 50, 60, 60]], [0.9, 0.8, 0.1], [0, 0, 0]),
        "test/b": detections([[70, 70, 80, 80], [20, 20, 40, 30]], [0.7, 0.6], [0, 0]),
    }
    listed = list_found(case(labels, found, [0]), first=4, iou=0.3)
    assert (listed["first"], listed["detections"], listed["found"]) == (4, 4, 2)
    assert [(o["image"], o["rank"], o["score"], o["iou"]) for o in listed["objects"]] == [
        ("test/a", 1, 0.9, 0.9), ("test/a", None, None, None), ("test/b", 4, 0.6, 0.5),
    ]  # fmt: skip
    assert listed["objects"][2] == {
        "image": "test/b", "class": "deer", "box": [20, 20, 40, 40], "rank": 4, "score": 0.6, "iou": 0.5,
    }  # fmt: skip
    assert list_found(case(labels, found, [0]), first=4, iou=0.6)["found"] == 1
    assert list_found(case(labels, found, [0]), first=9, iou=0.3)["found"] == 3


def test_other_classes_and_regions_to_ignore_take_no_place() -> None:
    labels = [truth("test/a", [[0, 0, 10, 10], [50, 50, 90, 90]], [False, True]), truth("test/b", [])]
    found = {
        "test/a": detections([[0, 0, 10, 10], [60, 60, 70, 70], [0, 0, 10, 10]], [0.9, 0.8, 0.2], [1, 0, 0]),
        "test/b": detections([[1, 1, 9, 9]], [0.1], [0]),
    }
    listed = list_found(case(labels, found, [0, -1]), first=30, iou=0.3)
    assert (listed["detections"], listed["found"]) == (2, 1)
    assert [o["rank"] for o in listed["objects"]] == [1]


def test_a_crowd_takes_out_detections_of_its_own_class_only() -> None:
    one = truth("test/a", [[0, 0, 10, 10], [50, 50, 90, 90]], [False, True])
    found = {"test/a": detections([[60, 60, 70, 70], [60, 60, 70, 70], [0, 0, 10, 10]], [0.9, 0.8, 0.2], [0, 1, 0])}
    listed = list_found(case([one], found, [0, 1]), first=30, iou=0.3)
    assert listed["detections"] == 2
    assert [o["rank"] for o in listed["objects"]] == [2]
