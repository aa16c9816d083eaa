"""Which frames of a video to extract."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infrablend.errors import ArgumentError

_EVERY = re.compile(r"(\d+(?:\.\d+)?)\s*(s|ms|f|frames?)", re.ASCII)
_TIME = re.compile(r"(?:(?:(\d+):)?(\d{1,3}):)?(\d+(?:\.\d+)?)s?", re.ASCII)


@dataclass(frozen=True)
class FrameChoice:
    """Which frames of a video to extract.

    Attributes:
        every: Step: 2s or 500ms, or 60f for every 60th frame.
        start: Time of the first frame: seconds or [h:]m:s.
        end: Take no frame after this time.

    Raises:
        ArgumentError: A text is none of these.
    """

    every: str = "2s"
    start: str = ""
    end: str = ""

    def __post_init__(self) -> None:
        step, _ = self.step
        if not step > 0:
            raise ArgumentError(f"every {self.every!r}: expected a step above 0")
        if self.end and self.seconds("end") < self.seconds("start"):
            raise ArgumentError(f"end {self.end!r}: is before start {self.start!r}; expected a later time")

    @property
    def step(self) -> tuple[float, bool]:
        """Step, and whether it counts frames instead of seconds."""
        match = _EVERY.fullmatch(self.every.strip().lower())
        if match is None or (match[2][0] == "f" and "." in match[1]):
            raise ArgumentError(f"every {self.every!r}: expected a step such as 2s, 500ms or 60f (frames)")
        number = float(match[1])
        if not math.isfinite(number):
            raise ArgumentError(f"every {self.every[:20]!r}...: expected a shorter step")
        return (number, True) if match[2][0] == "f" else (number / (1000 if match[2] == "ms" else 1), False)

    def seconds(self, name: str) -> float:
        """Return `start` or `end` in seconds; an empty end is infinite."""
        text = str(getattr(self, name)).strip()
        if not text:
            return math.inf if name == "end" else 0.0
        match = _TIME.fullmatch(text)
        if match is None:
            raise ArgumentError(f"{name} {text!r}: expected seconds such as 12.5, or [h:]m:s such as 1:02:30")
        return int(match[1] or 0) * 3600 + int(match[2] or 0) * 60 + float(match[3])

    def numbers(self, times_s: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the numbers of the frames to take, from the times of all frames.

        With a step in seconds, these are the first frames not earlier than each multiple of the step after the start.
        """
        step, in_frames = self.step
        start, end = self.seconds("start"), self.seconds("end")
        inside = np.flatnonzero((times_s >= start - 1e-6) & (times_s <= end + 1e-6))
        if in_frames:
            return inside[:: int(step)]
        due = np.floor((times_s[inside] - start + 1e-6) / step)
        return inside[np.concatenate([[True], np.diff(due) > 0])] if inside.size else inside
