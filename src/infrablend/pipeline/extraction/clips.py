"""Which frames to extract from each video, and the log that belongs to it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infrablend.core.arguments import require_names
from infrablend.core.capture import TimeOfDay
from infrablend.core.file_names import distinct_names, file_name
from infrablend.errors import ArgumentError, DatasetError, Problem
from infrablend.formats.cameras.log_alignment import NO_CLOCK, Aligned, Clock, align
from infrablend.formats.cameras.video_log import own_subtitles, read_log
from infrablend.formats.pictures.video import Video

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


@dataclass(frozen=True)
class FlightFacts:
    """What the user says about the flights.

    Attributes:
        log: DJI subtitles (.SRT), or CSV of AirData, Litchi, Flytrex or a DJI flight record [default: subtitles beside
            the video].
        use_log: False to extract without telemetry.
        clock: What is known about the clocks.
        time_of_day: Time of day of the flight [default: by the sun, where known].
        hfov_deg: Field of view across the width of the video, for the table.
        names: Names of the sequences [default: names of the videos].
    """

    log: Path | None = None
    use_log: bool = True
    clock: Clock = NO_CLOCK
    time_of_day: TimeOfDay | None = None
    hfov_deg: float | None = None
    names: Sequence[str] = ()

    def __post_init__(self) -> None:
        require_names("names", self.names)
        if self.hfov_deg is not None and not 0.1 <= self.hfov_deg <= 170:
            raise ArgumentError(f"hfov_deg: found {self.hfov_deg}, expected 0.1 to 170 degrees")


@dataclass(frozen=True, eq=False)
class ClipPlan:
    """What to extract from one video.

    Attributes:
        video: The video.
        sequence: Name of its sequence.
        numbers: Numbers of the frames to take.
        aligned: Log with the times of the video; None without one.
        remarks: Warnings about the name of the sequence and the subtitles in the video.
    """

    video: Video
    sequence: str
    numbers: NDArray[np.int64]
    aligned: Aligned | None
    remarks: tuple[Problem, ...] = ()


def plan_clips(videos: Sequence[Path], choice: FrameChoice, flight: FlightFacts) -> list[ClipPlan]:
    """Open all videos and logs, before anything is written.

    Raises:
        DatasetError: A video or log cannot be read, the log is that of another flight, or no frame is chosen.
    """
    if flight.names and len(flight.names) != len(videos):
        raise ArgumentError(f"names: found {len(flight.names)}, expected one for each of {len(videos)} video(s)")
    wanted = [file_name(n) for n in (flight.names or [v.stem for v in videos])]
    names = distinct_names(wanted)
    common = read_log(flight.log) if flight.log is not None and flight.use_log else None
    plans = []
    opened = _open_all(videos)
    for path, name, given, video in zip(videos, names, wanted, opened, strict=True):
        log, remarks = (common, ()) if common is not None or not flight.use_log else own_subtitles(video)
        aligned = None if log is None else align(log, video.timeline, video.created, flight.clock)
        numbers = choice.numbers(video.timeline.times_s)
        if not numbers.size:
            found = f"no frame between {choice.start or 'the start'} and {choice.end or 'the end'}"
            expected = f"times within the video's {video.timeline.duration_s:.1f} s"
            problem = Problem(path.name, "frames-none", found, expected, "change --start and --end")
            raise DatasetError(f"{path}: no frame to extract", [problem])
        plans.append(ClipPlan(video, name, numbers, aligned, (*_renamed(path, given, name), *remarks)))
    return plans


def _open_all(paths: Sequence[Path]) -> list[Video]:
    """Open all videos.

    Raises:
        DatasetError: Some of them cannot be read; with a problem for each.
    """
    opened = []
    faults = []
    for path in paths:
        try:
            opened.append(Video(path))
        except DatasetError as error:
            faults.append(error)
    if len(faults) == 1:
        raise faults[0]
    if faults:
        problems = [p for error in faults for p in error.problems]
        raise DatasetError(f"{len(faults)} of {len(paths)} videos cannot be read", problems)
    return opened


def _renamed(video: Path, wanted: str, name: str) -> tuple[Problem, ...]:
    if name == wanted:
        return ()
    found = f"another video is also named {wanted!r}, so the sequence of this one is {name!r}"
    todo = "name the sequences with --sequence"
    return (Problem(video.name, "sequence-renamed", found, "a name per video", todo, "warning"),)
