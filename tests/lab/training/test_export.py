"""The weights of a training as ONNX: what the file states, and that it finds what the weights find."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from infrablend.detection.finder import load_finder
from tests.lab.training.test_train import SMOKE, train, yolo


def metadata_of(path: Path) -> dict[str, str]:
    import onnx

    return {p.key: p.value for p in onnx.load(path).metadata_props}


def test_a_training_is_exported_with_names_tiles_and_gain_control(ultralytics: None, tmp_path: Path) -> None:
    data = yolo(tmp_path / "data", {"train": 4, "val": 2})
    report = train(data, tmp_path / "out", export="onnx", **SMOKE)
    path = report.out / "weights.onnx"
    stated = metadata_of(path)
    # Pictures of 320 px, and at least half a stride beside them.
    assert (stated["tile_size"], stated["imgsz"], stated["tiles_overlap"]) == ("352", "[352, 352]", "27")
    assert json.loads(stated["class_names"]) == {"0": "car", "1": "drone"}
    tile = report.record["settings"]["tile"]
    assert json.loads(stated["infrablend"]) == {"tile": tile, "image_size": tile, "agc": None}
    assert str(tmp_path) not in str(stated)
    # A finished training is only exported, to the same bytes, and the file may be replaced with it.
    first = path.read_bytes()
    path.unlink()
    again = train(data, tmp_path / "out", existing="resume", export="onnx", **SMOKE)
    assert path.read_bytes() == first
    assert again.record["passes"] == report.record["passes"]
    weights, network = load_finder(report.weights), load_finder(path)
    assert network.classes == weights.classes == ("car", "drone")
    assert (network.agc, network.facts["network"]) == (None, "YOLOv8, 11 or 12")
    # 320x320 px is the size at which both see the same border.
    pixels = np.random.default_rng(5).integers(40, 90, (320, 320)).astype(np.uint8)
    pixels[100:124, 60:70] = 220
    ours, theirs = (f.find(pixels, 1e-4) for f in (network, weights))
    assert len(ours) > 10
    # The same network in 32 bits, computed in another order; nearly equal scores may change places.
    assert np.allclose(ours.scores[:10], theirs.scores[:10], atol=1e-5)
    for box in ours.boxes_xyxy[:10]:
        assert np.abs(theirs.boxes_xyxy - box).max(axis=1).min() < 0.2
    train(data, tmp_path / "out", existing="overwrite", **SMOKE)
    assert not path.exists()


def test_the_gain_control_of_sixteen_bits_is_stated(ultralytics: None, tmp_path: Path) -> None:
    from infrablend.lab.training.export_onnx import export_onnx

    data = yolo(tmp_path / "data", {"train": 4, "val": 2})
    report = train(data, tmp_path / "out", **SMOKE)
    agc = {"mode": "fixed", "low_c": 0.0, "high_c": 40.0}
    settings = {**report.record["settings"], "tile": 0, "image_size": 640}
    path = export_onnx(report.weights, {**report.record, "agc": agc, "settings": settings})
    finder = load_finder(path)
    assert finder.agc is not None
    assert finder.agc.model_dump() == agc
    # Whole pictures of the training, scaled to 640 px.
    assert (finder.facts["tile"], finder.facts["image_size"]) == ([672, 672], 640)
