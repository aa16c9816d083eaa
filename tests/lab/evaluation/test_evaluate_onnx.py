"""Evaluation of ONNX files: what `infrablend detect` finds with them, without weights of Ultralytics."""

from __future__ import annotations

from pathlib import Path

import pytest

from infrablend import api
from infrablend.errors import DatasetError, InfraBlendError
from tests.lab.training.test_train import yolo
from tests.onnx_files import write_cells


def test_an_onnx_file_is_evaluated_as_its_saved_detections_are(tmp_path: Path) -> None:
    data = yolo(tmp_path / "data", {"test": 3})
    network = write_cells(tmp_path / "cells.onnx", {"names": "{0: 'car'}"})
    found = api.detect(network, data, tmp_path / "found", api.DetectRequest(confidence=0.3))
    assert sum(found.found.values()) > 3
    settings = api.EvaluationSettings(classes=["car"], bootstrap=0)
    by_network = api.evaluate(network, data, tmp_path / "a", settings)
    by_file = api.evaluate(tmp_path / "found", data, tmp_path / "b", settings)
    assert by_network.metrics["classes"] == by_file.metrics["classes"]
    assert by_network.metrics["detector"]["network"] == "YOLOv8, 11 or 12"
    halved = api.evaluate(network, data, tmp_path / "c", api.EvaluationSettings(image_size=160, classes=["car"]))
    assert halved.metrics["detector"]["image_size"] == 160


def test_pictures_that_cannot_be_read_stop_an_evaluation(tmp_path: Path) -> None:
    data = yolo(tmp_path / "data", {"test": 3})
    network = write_cells(tmp_path / "cells.onnx", {"names": "{0: 'car'}"})
    settings = api.EvaluationSettings(classes=["car"], bootstrap=0, stress=True)
    with pytest.raises(InfraBlendError, match="ONNX file"):
        api.evaluate(network, data, tmp_path / "a", settings)
    picture = data / "images" / "test" / "1.png"
    picture.write_bytes(picture.read_bytes()[:4000])
    with pytest.raises(DatasetError) as caught:
        api.evaluate(network, data, tmp_path / "b", api.EvaluationSettings(classes=["car"], bootstrap=0))
    assert "1.png" in str(caught.value) or any("1" in p.where for p in caught.value.problems)
