"""`evaluate --tracks` with Ultralytics' trackers, as a command on sequences that a camera films."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend.core.boxes import corners_of_cxcywha
from infrablend.core.rng import stream
from infrablend.detection.detections import Predictions, detections, read_predictions, write_predictions
from tests.lab.evaluation.test_evaluate_ultralytics import MAKE_WEIGHTS, python

SIZE_WH, FRAMES = (320, 256), 20
CLASSES = ("drone", "bird")

pytest.importorskip("trackeval", reason="NEEDS TRACKEVAL: `make train` installs it")
pytestmark = pytest.mark.usefixtures("ultralytics")


def figures(out: Path, *arguments: object) -> dict:
    done = python("-m", "infrablend", "-q", "evaluate", *arguments, "--out", out, "--tracks", "--bootstrap", 50)
    assert done.returncode == 0, done.stderr
    return json.loads((out / "evaluation.json").read_text())["tracks"]


def film(root: Path, pan_px: int, names: tuple[str, ...] = ("a", "b")) -> tuple[Path, Path]:
    """Write sequences as MOTChallenge, and detections: two objects on a ground that moves by `pan_px` every 4th frame.

    Each box is also detected as a bird, with a lower score.
    """
    found = {}
    for name in names:
        folder = root / "data" / "test" / name
        (folder / "img1").mkdir(parents=True)
        (folder / "gt").mkdir()
        (folder / "gt" / "labels.txt").write_text("\n".join(CLASSES))
        rng = stream(0, "film", name)
        ground = np.repeat(np.repeat(rng.integers(40, 200, (80, 200)).astype(np.uint8), 4, 0), 4, 1)
        rows = []
        for k in range(FRAMES):
            at = 10 + pan_px * (k // 4)
            picture = ground[20 : 20 + SIZE_WH[1], at : at + SIZE_WH[0]].copy()
            boxes = []
            for track, (x, y) in enumerate(((260 + 2 * k, 60), (280 - k, 160)), 5):
                left = x - at
                picture[y : y + 14, left : left + 14] = 255
                rows.append(f"{k + 1},{track},{left + 1},{y + 1},14,14,1,1,1")
                boxes.append([left, y, left + 14, y + 14])
            file = folder / "img1" / f"{k + 1:06}.png"
            Image.fromarray(picture).save(file)
            noisy = np.array(boxes) + rng.uniform(-0.4, 0.4, (2, 4))
            key = f"test/{name}/{file.name}"
            found[key] = detections([*noisy, *noisy], [0.9, 0.8, 0.4, 0.4], [0, 0, 1, 1])
        (folder / "gt" / "gt.txt").write_text("\n".join(rows))
    keys = dict.fromkeys(found, SIZE_WH)
    return root / "data", write_predictions(root / "found.json", Predictions("detect", CLASSES, found, keys))


def test_trackers_start_anew_with_each_sequence_and_give_the_same_bytes(tmp_path: Path) -> None:
    data, found = film(tmp_path, 0)
    facts = figures(tmp_path / "out", found, data)
    drone = facts["classes"]["drone"]
    # A track is sure at once in the first picture alone: later, what is seen for the first time would be missed.
    assert (drone["mota"], drone["idf1"], drone["switches"]) == (1, 1, 0)
    assert (drone["tracks"], drone["found"], facts["classes"]["bird"]["found"]) == (4, 4, 0)
    assert 0.9 < drone["hota"] < 1
    assert drone["ci"]["hota"][0] <= drone["hota"] <= drone["ci"]["hota"][1]
    assert facts["tracker"]["tracker_type"] == "bytetrack"
    again = figures(tmp_path / "again", tmp_path / "out", data)
    assert again == facts
    for name in ("evaluation.json", "evaluation.html"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "out" / name).read_bytes()


def test_botsort_follows_the_camera_and_bytetrack_does_not(tmp_path: Path) -> None:
    data, found = film(tmp_path, 24)
    by_byte = figures(tmp_path / "byte", found, data)["classes"]["drone"]
    by_bot = figures(tmp_path / "bot", found, data, "--tracker", "botsort")["classes"]["drone"]
    assert by_bot["switches"] == 0 < by_byte["switches"]
    assert by_bot["assa"] > 0.9 > by_byte["assa"]
    again = figures(tmp_path / "again", found, data, "--tracker", "botsort")["classes"]["drone"]
    assert again == by_bot


def test_turned_boxes_keep_their_angle(tmp_path: Path) -> None:
    data, found = film(tmp_path, 0, ("a",))
    saved = read_predictions(found)

    def turned(boxes: np.ndarray) -> np.ndarray:
        centres, sides = (boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]
        return corners_of_cxcywha(np.concatenate([centres, sides, np.full((len(boxes), 1), np.pi / 2)], axis=1))

    images = {k: replace(of, corners_xy=turned(of.boxes_xyxy)) for k, of in saved.images.items()}
    write_predictions(found, replace(saved, task="obb", images=images))
    drone = figures(tmp_path / "out", found, data, "--tracker", "botsort")["classes"]["drone"]
    assert (drone["mota"], drone["found"]) == (1, 2)
    assert drone["hota"] > 0.9


@pytest.mark.slow
def test_weights_and_their_saved_detections_give_the_same_tracks(tmp_path: Path) -> None:
    data, _ = film(tmp_path, 4)
    for labels in data.rglob("labels.txt"):
        labels.write_text("person\ncar")
    made = python("-c", MAKE_WEIGHTS, "detect", tmp_path / "weights.pt")
    assert made.returncode == 0, made.stderr
    facts = figures(tmp_path / "out", tmp_path / "weights.pt", data, "--image-size", 160)
    assert facts["counts"] == {"classes_without_tracks": 1, "pictures": 2 * FRAMES, "sequences": 2}
    assert facts["classes"]["person"]["found"] > 0
    assert figures(tmp_path / "again", tmp_path / "out", data) == facts
