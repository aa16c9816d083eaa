"""Put a flight log on the time scale of a video: by frame numbers, by times, by recordings in the log, or by clocks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from infrablend.errors import ArgumentError, DatasetError, Problem
from infrablend.formats.cameras.flight_log import MAX_DAMAGED, FlightLog, Values, in_order
from infrablend.formats.pictures.video import Timeline

Mask = NDArray[np.bool_]

# A recording in a log is that of a video if they differ in length by at most this much, or this share.
_SAME_S = 2.5
_SAME_SHARE = 0.02
# Subtitles may be longer than their video by this much, or this share.
_LONGER_S = 3.0
_LONGER_SHARE = 0.05
# Clocks are wrong by up to decades.
_MOST_S = 4e9
# Times of subtitles that differ more than this from those of the frames that they count are not used.
_WRONG_S = 1.0


@dataclass(frozen=True)
class Clock:
    """What the user says about the clocks.

    Attributes:
        offset_s: Seconds to add to the video's time to get the log's time.
        log_start_s: Second of a flight log at which the video starts [default: found].

    Raises:
        ArgumentError: A value is not finite, or longer than any clock is wrong.
    """

    offset_s: float = 0.0
    log_start_s: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("offset", self.offset_s), ("log start", self.log_start_s or 0.0)):
            if not abs(value) <= _MOST_S:
                raise ArgumentError(f"{name} {value:g} s: expected at most {_MOST_S:g} s")


NO_CLOCK: Clock = Clock()


@dataclass(frozen=True, eq=False)
class Aligned:
    """A log on the time scale of a video.

    Attributes:
        log: The log, with `times_s` since the video's first frame.
        by: How it was matched, for people.
        problems: Warnings.
    """

    log: FlightLog
    by: str
    problems: tuple[Problem, ...] = ()


def align(log: FlightLog, timeline: Timeline, created: datetime | None, clock: Clock) -> Aligned:
    """Return the log on the time scale of a video.

    Args:
        log: The log.
        timeline: Times of the video's frames.
        created: Creation time in the video's container.
        clock: What the user says about the clocks.

    Raises:
        DatasetError: The log is not one of this video.
    """
    if log.recordings or log.dialect != "DJI subtitles":
        start, by = _start(log, timeline, created, clock)
        times = log.times_s - start - clock.offset_s
        return _require_overlap(Aligned(replace(log, times_s=times), by), timeline)
    return _require_overlap(_subtitles(log, timeline, clock.offset_s), timeline)


def _subtitles(log: FlightLog, timeline: Timeline, offset_s: float) -> Aligned:
    """Return subtitles by frame number if they count the video's frames, else by time."""
    count = len(timeline.times_s)
    least = (1 - MAX_DAMAGED) * len(log.times_s)
    by_time = in_order(log.times_s)
    numbers = log.frames
    if numbers is None and by_time.sum() < least and _is_about(len(log.times_s), count):
        numbers = np.arange(len(log.times_s), dtype=np.float64)
    if numbers is not None:
        kept = in_order(numbers)
        frames = numbers[kept].astype(np.int64)
        if kept.sum() >= least and _is_about(int(frames[-1]) + 1, count):
            kept[kept] = (frames >= 0) & (frames < count)
            times = timeline.times_s[frames[(frames >= 0) & (frames < count)]]
            off = np.abs(times - log.times_s[kept])
            problems = _left_out(log, kept)
            if np.isfinite(off).any() and np.nanmedian(off) > _WRONG_S:
                found = f"times up to {np.nanmax(off):.1f} s away from those of the frames that they count"
                todo = "the frames' times are used"
                problems.append(Problem(log.name, "log-times", found, "the video's times", todo, "warning"))
            return Aligned(_select(log, kept, times - offset_s), "frame numbers", tuple(problems))
    if by_time.sum() < max(least, 1):
        found = "subtitles whose times do not increase, and that do not count the video's frames"
        problem = Problem(log.name, "log-times", found, "times that increase", "give a flight log with --log")
        raise DatasetError(f"{log.name}: no usable times", [problem])
    times = log.times_s[by_time]
    longest = timeline.duration_s + max(_LONGER_S, _LONGER_SHARE * timeline.duration_s)
    if times[-1] > longest:
        found = f"subtitles up to {times[-1]:.1f} s, for a video of {timeline.duration_s:.1f} s"
        expected = f"subtitles that end within {longest:.1f} s"
        raise _other_flight(log, found, expected, "give the subtitles of this video")
    return Aligned(_select(log, by_time, times - offset_s), "times", tuple(_left_out(log, by_time)))


def _is_about(number: int, count: int) -> bool:
    """Return whether a number of frames or subtitles is that of the video's frames, give or take its ends."""
    return abs(number - count) <= max(2, 0.02 * count)


def _left_out(log: FlightLog, kept: Mask) -> list[Problem]:
    lost = int((~kept).sum())
    if not lost:
        return []
    found = f"{lost} of {len(kept)} subtitle(s) out of order, or of no frame of the video, left out"
    return [Problem(log.name, "log-times", found, "subtitles in order", severity="warning")]


def _select(log: FlightLog, kept: Mask, times: Values) -> FlightLog:
    clock = None if log.clock_s is None else log.clock_s[kept]
    frames = None if log.frames is None else log.frames[kept]
    return replace(log, times_s=times, values={k: v[kept] for k, v in log.values.items()}, clock_s=clock, frames=frames)


def _start(log: FlightLog, timeline: Timeline, created: datetime | None, clock: Clock) -> tuple[float, str]:
    """Return the second of the log at which the video starts, and how it was found."""
    if clock.log_start_s is not None:
        return clock.log_start_s, "--log-start"
    length = timeline.duration_s
    by_clock = None
    if created is not None and log.start is not None and log.in_utc:
        by_clock = (created - log.start) / timedelta(seconds=1)
    same = [(a, b) for a, b in log.recordings if abs((b - a) - length) <= max(_SAME_S, _SAME_SHARE * length)]
    if len(same) == 1:
        return same[0][0], "the recording of this length in the log"
    if by_clock is not None and same:
        return min(same, key=lambda r: abs(r[0] - by_clock))[0], "the recording of this length nearest in time"
    if by_clock is not None:
        if -length <= by_clock <= float(log.times_s[-1]):
            return by_clock, "clocks"
        found = f"a log from {log.start:%Y-%m-%d %H:%M:%S} UTC for {log.times_s[-1]:.0f} s, and a video created at "
        found += f"{created:%Y-%m-%d %H:%M:%S} UTC"
        todo = "give the log of this flight, or --log-start SECONDS if the video's clock is wrong"
        raise _other_flight(log, found, "a log that covers the video", todo)
    starts = ", ".join(f"{a:.1f} s for {b - a:.1f} s" for a, b in (same or log.recordings)[:5]) or "none"
    found = f"a video of {length:.1f} s, and recordings in the log that start at: {starts}"
    expected = "one recording of the video's length, or a log and a video with dates in UTC"
    todo = "give the log of this flight, or the start of the video in the log with --log-start SECONDS"
    raise _other_flight(log, found, expected, todo)


def _require_overlap(aligned: Aligned, timeline: Timeline) -> Aligned:
    times = aligned.log.times_s
    if times.size and times[0] <= timeline.duration_s and times[-1] >= 0:
        return aligned
    found = f"a video of {timeline.duration_s:.1f} s, and a log of its seconds "
    found += f"{times[0]:.1f} to {times[-1]:.1f}" if times.size else "that has no sample in it"
    todo = "check --offset and --log-start, or give the log of this flight"
    raise _other_flight(aligned.log, found, "a log that overlaps the video", todo)


def _other_flight(log: FlightLog, found: str, expected: str, todo: str) -> DatasetError:
    problem = Problem(log.name, "log-other-flight", found, expected, todo)
    return DatasetError(f"{log.name}: seems to be the log of another flight or video", [problem])
