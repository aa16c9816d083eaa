"""Small runs for tests of the studio, written without a renderer."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from infrablend.core.ledger import DoneFrame, Ledger
from tests.samples import picture


def frame_record(frame_id: str, **changes: Any) -> dict[str, Any]:
    """Return the record of a frame with one drone."""
    label = {
        "category": "drone", "box_xyxy": [5.0, 6.0, 15.0, 12.0], "corners_xy": None, "mask": None, "visibility": 1.0,
        "truncated": False, "inserted": True, "difficult": None, "source_id": None, "extra": {"contrast_grey": -12.0},
    }  # fmt: skip
    return {
        "run": "", "frame_id": frame_id, "image": f"{frame_id}.png", "image_sha256": _digest(frame_id), "kept": [],
        "background": {
            "id": "a", "path": "a.png", "size_wh": [64, 48], "pitch_deg": 60.0, "altitude_m": 80.0, "time_of_day": "day"
        },
        "scene": None, "mapping": None, "inserted": [label], "removed": [], "facts": {}, "warnings": [], **changes,
    }  # fmt: skip


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def write_run(folder: Path, frames: Mapping[str, Mapping[str, Any]]) -> Path:
    """Write a run with these records and a picture of 64 x 48 px for each; return its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    run = {"infrablend": "0.1.0", "recipe": {}, "frames": len(frames), "seed": 0}
    (folder / "run.json").write_text(json.dumps(run))
    with Ledger.create(folder, run) as ledger:
        for number, (frame_id, record) in enumerate(frames.items()):
            ledger.add(frame_id, DoneFrame(record["image"], 0, record["image_sha256"], 1), json.dumps(record))
            picture(folder / "images" / str(record["image"]), number)
    return folder


def write_sequence(folder: Path, count: int = 24, name: str = "s") -> Path:
    """Write a run of one sequence, `test/<name>`, at 25 frames per second, and return its folder.

    A bright square, the inserted drone 2, moves by two pixels a frame; frames 10 to 13 do not show it. The original
    drone 0 stands still, and has no picture.
    """
    ids = [f"test/{name}_{k:06d}" for k in range(count)]
    write_run(folder, {frame_id: frame_record(frame_id) for frame_id in ids})
    lines = []
    for k, frame_id in enumerate(ids):
        shown = not 10 <= k < 14
        x, pixels = 2 + 2 * k, np.zeros((48, 64), np.uint8)
        if shown:
            pixels[20:26, x : x + 6] = 255
        cv2.imwrite(str(folder / "images" / f"{frame_id}.png"), pixels)
        boxes = [[50, 2, 8, 6], [x, 20, 6, 6]][: 1 + shown]
        objects = {"bbox": boxes, "category": ["drone"] * 2, "inserted": [False, True], "track_id": ["0", "2"]}
        row = {"file_name": f"{frame_id[5:]}.png", "sequence": name, "frame": k, "time_s": k / 25}
        lines.append(json.dumps({**row, "objects": {name: values[: len(boxes)] for name, values in objects.items()}}))
    (folder / "images/test/metadata.jsonl").write_text("\n".join(lines))
    (folder / f"tracks/test/{name}/gt").mkdir(parents=True)
    return folder
