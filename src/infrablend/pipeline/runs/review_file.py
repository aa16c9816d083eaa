"""Reads and writes `review.json` in the folder of a run, or of detections: what is accepted and rejected, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from infrablend.core.files import load_json, write_json
from infrablend.errors import OutputError

REVIEW_FILE = "review.json"


@dataclass(frozen=True)
class Verdict:
    """A verdict on a frame, or on a detection.

    Attributes:
        word: `accept` or `reject`.
        reason: Reason in words; may be empty.
        category: Class that an accepted detection has instead of the detector's; empty for that.
    """

    word: Literal["accept", "reject"]
    reason: str = ""
    category: str = ""


def read_verdicts(path: Path) -> dict[str, Verdict]:
    """Return the verdicts of a review by frame id.

    Raises:
        OutputError: The file cannot be read.
    """
    try:
        frames: Mapping[str, Any] = load_json(path)["frames"]
        found = {
            str(k): Verdict(v["verdict"], str(v.get("reason") or ""), str(v.get("class") or ""))
            for k, v in frames.items()
        }
        wrong = sorted({str(v.word) for v in found.values()} - {"accept", "reject"})
        if wrong:
            raise ValueError(f"verdict {wrong[0]!r}")
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise OutputError(
            f"{path}: cannot be read as a review ({type(error).__name__}: {error}); expected "
            '{"frames": {"test/a_c0": {"verdict": "reject", "reason": "too bright"}}}, with verdicts accept and reject'
        ) from error
    return found


def write_verdicts(path: Path, verdicts: Mapping[str, Verdict]) -> None:
    """Write a review, whole or not at all; it survives a power cut.

    Raises:
        OutputError: The file cannot be written.
    """
    frames = {
        frame_id: {"verdict": v.word} | {k: t for k, t in (("reason", v.reason), ("class", v.category)) if t}
        for frame_id, v in verdicts.items()
    }
    write_json(path, {"frames": frames}, indent=1, durable=True)
