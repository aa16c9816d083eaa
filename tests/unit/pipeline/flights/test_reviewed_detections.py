"""Accepted detections become labels of the pictures that are judged to the end."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from infrablend import api
from infrablend.errors import DatasetError, OutputError
from infrablend.pipeline.flights.reviewed_detections import accepted_objects, open_detections
from infrablend.pipeline.runs.review_file import Verdict, read_verdicts
from infrablend.studio.opened_detections import OpenedDetections
from tests.command_line import said
from tests.onnx_files import write_cells
from tests.unit.pipeline.flights.test_detect import flight as flight  # a fixture


@pytest.fixture
def found(flight: Path, tmp_path: Path) -> Path:
    api.detect(write_cells(tmp_path / "cells.onnx"), flight, tmp_path / "found")
    return tmp_path / "found"


def judge(folder: Path, **verdicts: Verdict) -> None:
    """Judge detections by the letter of their picture and their number, such as `a0`."""
    opened = OpenedDetections(folder)
    for short, verdict in verdicts.items():
        opened.review.decide(f"train/{short[0]}.png#{short[1]}", verdict)


def test_detections_are_judged_from_the_highest_score(found: Path) -> None:
    opened = OpenedDetections(found)
    assert [o.id for o in opened.stored.objects] == ["train/a.png#0", "train/b.png#0", "train/b.png#1"]
    assert opened.classes == ("person",)
    judge(found, a0=Verdict("reject"), b1=Verdict("accept", category="dog"))
    assert read_verdicts(found / "review.json")["train/b.png#1"].category == "dog"
    assert opened.shown("", "open") == [1]
    assert opened.shown("person", "accept") == [2]
    assert opened.shown("car", "") == []
    assert opened.picture(0).startswith(b"\x89PNG")
    assert opened.crop(2).startswith(b"\x89PNG")
    with pytest.raises(DatasetError, match="detection 3"):
        opened.picture(3)


def test_accepted_detections_become_labels(found: Path) -> None:
    judge(found, a0=Verdict("reject"), b0=Verdict("accept"), b1=Verdict("accept", category="dog"))
    dataset = accepted_objects(found)
    labels = {i.id: [(o.category, o.box_xyxy.tolist()) for o in i.instances] for i in dataset.images}
    assert labels == {"a": [], "b": [("person", [40, 40, 48, 48]), ("dog", [56, 0, 64, 8])]}
    assert [c.name for c in dataset.categories] == ["person", "dog"]
    assert [p.found for p in dataset.problems] == ["1 pictures without a detection to judge, left out"]


def test_pictures_with_open_detections_are_left_out_and_counted(found: Path, tmp_path: Path) -> None:
    judge(found, a0=Verdict("accept"), b0=Verdict("accept"))
    printed = said("convert", found, tmp_path / "labelled", "--to", "coco", code=0)
    assert "1 pictures with detections that nobody has judged" in printed
    labelled = api.read_dataset(tmp_path / "labelled")
    assert [(i.id, [o.category for o in i.instances]) for i in labelled.images] == [("a", ["person"])]


def test_what_cannot_become_labels_is_said(found: Path, flight: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="0 of 3 judged"):
        accepted_objects(found)
    (found / "review.json").write_text('{"frames": {"train/a.png#0": {"verdict": "maybe"}}}', "utf-8")
    with pytest.raises(OutputError, match="maybe"):
        accepted_objects(found)
    with pytest.raises(DatasetError, match="no detections"):
        open_detections(flight)
    record = json.loads((found / "detect.json").read_text("utf-8"))
    (found / "detect.json").write_text(json.dumps(record | {"confidence": 0.95}), "utf-8")
    with pytest.raises(DatasetError, match="lower --confidence"):
        open_detections(found)
    (found / "detect.json").write_text(json.dumps(record), "utf-8")
    shutil.move(flight, tmp_path / "moved")
    with pytest.raises(DatasetError, match="not there any more"):
        open_detections(found)


def test_a_review_is_not_replaced_with_its_detections(found: Path, flight: Path, tmp_path: Path) -> None:
    judge(found, a0=Verdict("accept"))
    assert "review.json" in said("detect", tmp_path / "cells.onnx", flight, "--out", found, "--overwrite", code=2)
