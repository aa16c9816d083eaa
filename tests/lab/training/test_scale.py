"""The image scale of an evaluation: that of the training, and a warning where it is unknown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from infrablend.detection.scale import MARK, training_scale
from infrablend.lab.training.presets import PRESETS

OURS = {"name": "run", "data": "runs/detector/data/data.yaml"}


def mark(preset: str) -> dict[str, Any]:
    return {"tile": PRESETS[preset].tile, "image_size": PRESETS[preset].image_size}


@pytest.mark.parametrize(
    ("checkpoint", "size", "known"),
    [
        ({MARK: mark("small"), "train_args": OURS | {"imgsz": 320}}, 0, True),
        ({MARK: mark("smoke"), "train_args": OURS | {"imgsz": 160}}, 0, True),
        ({MARK: mark("paper"), "train_args": OURS | {"imgsz": 640}}, 640, True),
        ({MARK: mark("paper") | {"image_size": 960}}, 960, True),
        ({"train_args": {"imgsz": 512, "name": "train3", "data": "x.yaml"}}, 512, True),
        ({"train_args": {"imgsz": [384, 640]}}, 640, True),
        ({"train_args": OURS | {"imgsz": 640}}, 640, True),
        ({"train_args": OURS | {"imgsz": 320}}, 0, False),  # of an earlier version, without its record
        ({"train_args": {"imgsz": "large"}}, 640, False),
        ({"train_args": None}, 640, False),
        ({}, 640, False),
    ],
)
def test_the_scale_is_that_of_the_training(checkpoint: dict[str, Any], size: int, known: bool, tmp_path: Path) -> None:
    scale = training_scale(tmp_path / "weights.pt", checkpoint)
    assert (scale.image_size, scale.known) == (size, known)
    assert scale.origin
    warnings = scale.warnings(tmp_path / "weights.pt")
    assert [p.code for p in warnings] == ([] if known else ["image-size-unknown"])
    assert all(p.severity == "warning" and "--image-size" in str(p) for p in warnings)


@pytest.mark.parametrize(("preset", "size"), [("small", 0), ("paper", 640)])
def test_weights_without_scale_use_the_record_beside_them(preset: str, size: int, tmp_path: Path) -> None:
    (tmp_path / "train.json").write_text(json.dumps({"settings": mark(preset)}))
    checkpoint = {"train_args": OURS | {"imgsz": PRESETS[preset].image_size}}
    assert training_scale(tmp_path / "weights.pt", checkpoint).image_size == size
    # A record belongs to weights.pt alone.
    assert training_scale(tmp_path / "best.pt", {"train_args": {"imgsz": 256}}).image_size == 256


@pytest.mark.parametrize("text", ["", "[]", '{"settings": 3}', "{}"])
def test_unreadable_record_is_ignored(text: str, tmp_path: Path) -> None:
    (tmp_path / "train.json").write_text(text)
    assert training_scale(tmp_path / "weights.pt", {"train_args": {"imgsz": 256}}).image_size == 256
