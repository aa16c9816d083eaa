"""A small labelled dataset of three clips, and detections on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.samples import picture


def write_clips(lab: Path) -> None:
    """Write twelve labelled pictures of two classes in three splits, large enough to train on."""
    for k in range(12):
        split = ("train", "train", "train", "val", "test")[k % 5]
        path = picture(lab / "in" / "data" / "images" / split / f"clip{k // 4}_{2 * k:05}.png", k)
        label = lab / "in" / "data" / "labels" / split / f"{path.stem}.txt"
        label.parent.mkdir(parents=True, exist_ok=True)
        label.write_text(f"{k % 2} 0.5 0.5 0.2 0.25\n0 0.2 0.3 0.1 0.125\n")
    (lab / "in" / "data" / "data.yaml").write_text(
        "path: .\ntrain: images/train\nval: images/val\ntest: images/test\nnames: {0: fox, 1: hare}\n"
    )


def write_detections(lab: Path) -> None:
    """Write the clips, and detections on the pictures of split test."""
    write_clips(lab)
    from infrablend.detection.detections import Predictions, detections, write_predictions

    found = {}
    for path in sorted((lab / "in" / "data" / "images" / "test").iterdir()):
        found[f"test/{path.name}"] = detections([np.array([25.0, 18, 38, 30])], [0.9], [0])
    predictions = Predictions("detect", ("fox", "hare"), found, dict.fromkeys(found, (64, 48)), {"weights": "a.pt"})
    write_predictions(lab / "in" / "predictions.json", predictions)
