"""Small runs for tests of the studio, written without a renderer."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

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
        "background": {"id": "a", "path": "a.png", "pitch_deg": 60.0, "altitude_m": 80.0, "time_of_day": "day"},
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
