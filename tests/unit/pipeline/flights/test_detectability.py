"""`detectability` on made-up pictures, with detectors whose share found is known."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.core.surface_kinds import SURFACES
from infrablend.detection.detections import Detections, detections
from infrablend.errors import DatasetError, ModelError
from infrablend.pipeline.flights import detectability as module
from infrablend.report.detectability_page import drawn_text
from tests.command_line import said

FLAT = api.Execution(renderer="flat", in_process=True)


class Differences:
    """A detector that knows the pictures of a flight, and reports what is new in them but for a share of it."""

    classes = ("drone", "Car")
    problems = ()
    facts: ClassVar[dict[str, object]] = {"weights": "differences"}

    def __init__(self, missed: float = 0.0, alarms: int = 0) -> None:
        self.missed = missed
        self.alarms = alarms
        self.known: list[np.ndarray] = []

    def learn(self, flight: Path) -> None:
        """Keep the pictures."""
        self.known = [
            np.asarray(Image.open(p).convert("L"), np.int16) for p in sorted(flight.rglob("normal_json/*/*.jpg"))
        ]

    def find(self, pixels: np.ndarray, confidence: float = 0.01, scale: Any = None) -> Detections:
        """Return a box around each group of pixels that differ from the most similar picture."""
        changes = [np.abs(pixels.astype(np.int16) - of) for of in self.known]
        change = min(changes, key=lambda c: float(c.mean()))
        reach = 12
        seen = cv2.dilate((change > 10).astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
        _, _, stats, _ = cv2.connectedComponentsWithStats(seen)
        boxes = [[x + reach, y + reach, x + w - reach, y + h - reach] for x, y, w, h, _ in stats[1:].tolist()]
        kept = [b for b in boxes if (7 * b[0] + 13 * b[1]) % 100 >= 100 * self.missed]
        kept += [[600 - 12 * k, 4, 610 - 12 * k, 14] for k in range(self.alarms)]
        return detections(kept, [0.9] * len(kept), [0] * len(kept))


@pytest.fixture
def flight(write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> Path:
    return write_tiny_hit_uav(tmp_path / "hit-uav")


@pytest.fixture
def measure(flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., api.DetectabilityReport]:
    def run(
        finder: Any, recipe: str = "hit-uav-drone", fields: tuple[str, ...] = (), **settings: Any
    ) -> api.DetectabilityReport:
        if isinstance(finder, Differences):
            finder.learn(flight)
        monkeypatch.setattr(module, "load_finder", lambda *_, **__: finder)
        monkeypatch.setattr("infrablend.pipeline.flights.detectability_figures._FIRST", 10)
        rules = api.DetectabilitySettings(**{"until": 0.15, "most_rounds": 8, **settings})
        request = api.DetectabilityRequest(
            recipe, tmp_path / "detector", flight, rules, recipe_settings=fields, execution=FLAT
        )
        return api.detectability(request, tmp_path / "out", overwrite=True)

    return run


def test_a_detector_of_everything_finds_what_it_can_see(measure: Callable[..., api.DetectabilityReport]) -> None:
    facts = measure(Differences()).facts
    recall = facts["recall"]
    assert recall["inserted"] >= 10
    assert recall["predicted"] > 0.8
    assert recall["low"] < recall["predicted"] <= recall["high"]
    assert facts["confidences"][0]["alarms_per_picture"] == 0
    assert "real" not in recall


def test_missed_objects_lower_the_share_and_alarms_are_counted(measure: Callable[..., Any]) -> None:
    whole = measure(Differences(), until=0.05).facts
    half = measure(Differences(missed=0.5, alarms=2), until=0.05).facts
    assert half["recall"]["predicted"] == pytest.approx(whole["recall"]["predicted"] / 2, abs=0.15)
    assert half["confidences"][0]["alarms_per_picture"] == 2


def test_the_same_request_gives_the_same_bytes(measure: Callable[..., Any], tmp_path: Path) -> None:
    measure(Differences(0.3))
    files = ("detectability.json", "detectability.html")
    first = [(tmp_path / "out" / f).read_bytes() for f in files]
    measure(Differences(0.3))
    assert [(tmp_path / "out" / f).read_bytes() for f in files] == first


def test_the_record_has_recall_and_cells(measure: Callable[..., Any], tmp_path: Path) -> None:
    measure(Differences())
    facts = json.loads((tmp_path / "out" / "detectability.json").read_text())
    assert {"predicted", "low", "high", "inserted"} <= set(facts["recall"])
    assert all({"by", "value", "predicted", "low", "high", "inserted"} <= set(cell) for cell in facts["cells"])
    assert facts["kind"] == "measured"
    assert facts["map"] is None
    assert any(p["code"] == "map-left-out" for p in facts["problems"])
    assert facts["sentence"].startswith("In these pictures, a drone would be found with ")


def test_what_stands_has_its_surface_and_what_flies_has_none(measure: Callable[..., Any]) -> None:
    assert "surface" not in {cell["by"] for cell in measure(Differences()).facts["cells"]}
    finder = Differences()
    finder.classes = ("Car",)
    facts = measure(finder, "hit-uav-car", ("placement.where=anywhere", "placement.max_relief_grey=0")).facts
    surfaces = {cell["value"]: cell["inserted"] for cell in facts["cells"] if cell["by"] == "surface"}
    assert surfaces
    assert set(surfaces) <= {*SURFACES} - {"object"}
    assert sum(surfaces.values()) <= facts["recall"]["inserted"]


def test_the_page_gives_the_range_over_air_and_clothing() -> None:
    def cell(by: str, value: str, predicted: float) -> dict[str, object]:
        return {"by": by, "value": value, "predicted": predicted, "low": predicted - 0.1, "high": predicted + 0.1}

    cells = [cell("air", "0-10 degrees Celsius", 0.6), cell("clothing", "winter", 0.4), cell("pose", "lying", 0.2)]
    facts: Any = {"cells": cells}
    assert drawn_text(facts).endswith(
        "between 0.400 [0.300 to 0.500] with clothing winter and 0.600 [0.500 to 0.700] with air 0-10 degrees Celsius."
    )
    facts["cells"] = cells[1:]
    assert drawn_text(facts) == ""


def test_a_detector_without_the_class_is_refused(measure: Callable[..., Any]) -> None:
    finder = Differences()
    finder.classes = ("Car",)
    with pytest.raises(ModelError) as error:
        measure(finder)
    assert error.value.problems[0].code == "class-absent"


def test_a_class_that_the_recipe_does_not_insert_is_refused(measure: Callable[..., Any]) -> None:
    with pytest.raises(ModelError, match="inserts no Car"):
        measure(Differences(), category="Car")


def test_a_detector_of_inserted_objects_gives_an_upper_bound(
    measure: Callable[..., Any], flight: Path, tmp_path: Path
) -> None:
    (tmp_path / "detector").mkdir()
    # Losses of the label format are counted over both splits.
    record = {"data": str(flight), "prepared": {"labels": 50, "labels_val": 12, "losses": {"inserted_dropped": 60}}}
    (tmp_path / "detector" / "train.json").write_text(json.dumps(record))
    facts = measure(Differences()).facts
    assert facts["kind"] == "upper bound"
    assert facts["trained_on"] == "2 labels of real and 60 of inserted objects"
    assert "at most" in facts["sentence"]
    assert {p["code"] for p in facts["problems"]} >= {"trained-on", "trained-on-inserts"}


def test_where_nothing_can_stand_nothing_is_written(measure: Callable[..., Any], tmp_path: Path) -> None:
    with pytest.raises(DatasetError) as error:
        measure(SimpleNamespace(classes=("drone",), problems=(), facts={}, find=_sees_all), most_rounds=1)
    assert error.value.problems[0].code == "nothing-inserted"
    assert not (tmp_path / "out").exists()


def _sees_all(pixels: np.ndarray, *_: Any) -> Detections:
    """Report a detection on every place of a picture, so that no inserted object is a trial."""
    sides = (16, 24, 36, 54, 81, 122, 183, 275, 412)
    boxes = [
        [x, y, x + w, y + h]
        for w in sides
        for h in sides
        if w < 2 * h < 4 * w
        for y in range(0, 512, h // 3)
        for x in range(0, 640, w // 3)
    ]
    return detections(boxes, [0.9] * len(boxes), [0] * len(boxes))


def test_wrong_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="until"):
        api.DetectabilitySettings(until=0.0)
    with pytest.raises(ValueError, match="confidence"):
        api.DetectabilitySettings(confidence=1.5)
    with pytest.raises(ValueError, match="cell_m"):
        api.DetectabilitySettings(cell_m=0.0)


def test_the_command_names_a_missing_detector(flight: Path, tmp_path: Path) -> None:
    words = ("detectability", "hit-uav-drone", tmp_path / "none.pt", flight, "--out", tmp_path / "out")
    assert "none.pt" in said(*words, code=2)
