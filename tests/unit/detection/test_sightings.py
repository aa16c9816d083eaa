"""Which detections see which objects, at every confidence at once."""

from __future__ import annotations

import numpy as np

from infrablend.detection.detections import detections
from infrablend.detection.sightings import match_scores

NONE = np.zeros((0, 4))


def test_a_detection_sees_the_object_that_it_overlaps_most() -> None:
    objects = np.array([[0.0, 0, 10, 20], [8.0, 0, 18, 20]])
    found = detections([[7.0, 0, 17, 20], [0.0, 1, 10, 21]], [0.9, 0.6], [0, 0])
    scores, near, alarms = match_scores(objects, NONE, found, 0.3)
    assert scores.tolist() == [0.6, 0.9]
    assert near.tolist() == [0.6, 0.9]
    assert not alarms.any()


def test_one_detection_of_two_people_sees_one_of_them() -> None:
    objects = np.array([[0.0, 0, 10, 20], [8.0, 0, 18, 20]])
    found = detections([[0.0, 0, 18, 20]], [0.9], [0])
    scores, _, _ = match_scores(objects, NONE, found, 0.3)
    assert sorted(scores.tolist()) == [0.0, 0.9]


def test_a_place_is_shown_by_a_box_of_another_size() -> None:
    objects = np.array([[100.0, 100, 104, 104]])
    found = detections([[95.0, 95, 109, 109]], [0.7], [0])
    scores, near, alarms = match_scores(objects, NONE, found, 0.3)
    assert (scores.tolist(), near.tolist(), alarms.tolist()) == ([0.0], [0.7], [False])


def test_alarms_are_detections_of_nothing_outside_regions() -> None:
    objects = np.array([[0.0, 0, 10, 10]])
    regions = np.array([[50.0, 50, 80, 80]])
    found = detections([[0.0, 0, 10, 10], [55.0, 55, 65, 65], [200.0, 0, 210, 10]], [0.9, 0.8, 0.7], [0, 0, 0])
    _, _, alarms = match_scores(objects, regions, found, 0.3)
    assert alarms.tolist() == [False, False, True]


def test_a_second_detection_of_an_object_is_an_alarm() -> None:
    found = detections([[0.0, 0, 10, 10], [0.0, 0, 10, 11]], [0.9, 0.8], [0, 0])
    scores, _, alarms = match_scores(np.array([[0.0, 0, 10, 10]]), NONE, found, 0.3)
    assert (scores.tolist(), alarms.tolist()) == ([0.9], [False, True])


def test_nothing_there_and_nothing_found() -> None:
    scores, near, alarms = match_scores(NONE, NONE, detections([], [], []), 0.3)
    assert (len(scores), len(near), len(alarms)) == (0, 0, 0)
