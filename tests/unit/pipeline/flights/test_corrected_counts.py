"""Objects counted from detections and the share found: right in the mean, with intervals that hold."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord
from infrablend.detection.detections import detections
from infrablend.detection.sightings import Sighting
from infrablend.pipeline.flights.corrected_counts import count_looks
from infrablend.pipeline.flights.insert_trials import SearchedPicture

FOUND = {"50 m": 0.9, "100 m": 0.4}


def flight(rng: np.random.Generator, real: int, inserted: int, false: int = 0) -> Any:
    """Return trials at two heights, where a share of the real objects of each is found."""
    sightings = []
    searched = {}
    for height, share in FOUND.items():
        for k in range(inserted):
            score = 0.9 if rng.random() < share else 0.0
            conditions = {"time": "day", "height": height, "edge": "whole"}
            sightings.append(Sighting(f"{height} {k}", f"{height} {k}", 20.0, score, 0.0, conditions))
        found = int(rng.binomial(real, share)) + false
        capture = Capture(altitude_m=float(height[:-2]), time_of_day="day")
        image = ImageRecord(height, Path("p.png"), "train", (640, 512), (), capture)
        boxes = [[10.0 * k, 0, 10.0 * k + 5, 5] for k in range(found)]
        its = detections(boxes, [0.9] * found, [0] * found)
        alarms = np.arange(found) >= found - false
        searched[height] = SearchedPicture(image, its, [], alarms)
    return SimpleNamespace(inserted=sightings, searched=searched)


def test_intervals_hold_the_number_of_objects() -> None:
    rng = np.random.default_rng(0)
    held = 0
    estimates = []
    for _ in range(300):
        counted = count_looks(flight(rng, 60, 200), 0.25, labelled=True)
        assert counted["corrected"] is not None
        assert counted["low"] is not None
        assert counted["high"] is not None
        estimates.append(counted["corrected"])
        held += counted["low"] <= 120 <= counted["high"]
    assert np.mean(estimates) == pytest.approx(120, rel=0.03)
    assert 0.91 <= held / 300 <= 0.99


def test_labels_keep_false_alarms_out_of_the_count() -> None:
    trials = flight(np.random.default_rng(1), 60, 200, false=20)
    every, right = (count_looks(trials, 0.25, labelled=labelled) for labelled in (False, True))
    assert every["detections"] == right["detections"] + 40
    assert (every["of"], right["of"]) == ("all", "labelled")


def test_nothing_found_is_not_nothing_there() -> None:
    trials = flight(np.random.default_rng(2), 0, 200)
    counted = count_looks(trials, 0.25, labelled=False)
    assert (counted["detections"], counted["corrected"]) == (0, 0.0)
    assert counted["high"] == pytest.approx(3.84 / 0.34, rel=0.15)  # 3.84 over the lower end at 100 m


def test_a_share_of_nothing_gives_no_count() -> None:
    trials = flight(np.random.default_rng(3), 10, 200)
    trials.inserted = [Sighting(s.picture, s.cluster, 20.0, 0.0, 0.0, s.conditions) for s in trials.inserted]
    counted = count_looks(trials, 0.25, labelled=False)
    assert counted["detections"] > 0
    assert counted["corrected"] is None
