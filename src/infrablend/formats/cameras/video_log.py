"""The log of a video's flight: subtitles beside or in it, what they state of each frame, and how well they fit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from infrablend.core.camera import STRAIGHT_DOWN_DEG
from infrablend.errors import DatasetError, Problem
from infrablend.formats.cameras.dji_srt import parse_srt, read_srt
from infrablend.formats.cameras.flight_csv import read_flight_csv
from infrablend.formats.cameras.flight_headers import time_of_day
from infrablend.formats.cameras.flight_log import FlightLog, Sampled
from infrablend.formats.cameras.log_alignment import Aligned
from infrablend.formats.pictures.video import Timeline, Video

_SUBTITLES = (".SRT", ".srt", ".Srt")
_DECIMALS = {"latitude_deg": 7, "longitude_deg": 7}


def read_log(path: Path) -> FlightLog:
    """Read a log of any known kind.

    Raises:
        DatasetError: It cannot be read, or is of no known kind.
    """
    return read_srt(path) if path.suffix.lower() == ".srt" else read_flight_csv(path)


def subtitles_beside(video: Path) -> Path | None:
    """Return the file of subtitles that has the stem of a video; None without one."""
    return next((p for s in _SUBTITLES if (p := video.with_suffix(s)).is_file()), None)


def own_subtitles(video: Video) -> tuple[FlightLog | None, tuple[Problem, ...]]:
    """Return the log of the subtitles beside a video, or else in it; warnings if those in it hold no telemetry.

    Raises:
        DatasetError: The file beside it cannot be read, or holds no telemetry.
    """
    if (beside := subtitles_beside(video.path)) is not None:
        return read_log(beside), ()
    text = video.subtitles()
    try:
        return (parse_srt(text, video.path) if text else None), ()
    except DatasetError as error:
        return None, tuple(replace(p, severity="warning") for p in error.problems)


def is_usable(field_name: str, value: float) -> bool:
    """Return whether a value can be stated: a camera that looks down or up, a height that is not negative."""
    if field_name == "pitch_deg":
        return abs(value) <= STRAIGHT_DOWN_DEG
    return value >= 0 if field_name == "altitude_m" else math.isfinite(value)


def value_text(field_name: str, value: float) -> str:
    """Return a value as tables state it; empty if it cannot be stated."""
    if not math.isfinite(value) or not is_usable(field_name, value):
        return ""
    return f"{value:.{_DECIMALS.get(field_name, 3)}f}"


def telemetry_of(sampled: Sampled, k: int) -> dict[str, str]:
    """Return what a log states at one of the times it was sampled at, by the names of columns; empty where unknown.

    The time of day follows from the sun at time and place.
    """
    row = {name: value_text(name, float(values[k])) for name, values in sampled.values.items()}
    latitude, longitude = (float(row[n]) if row.get(n) else None for n in ("latitude_deg", "longitude_deg"))
    captured = sampled.captured[k] or ""
    by_sun = time_of_day(captured, latitude, longitude)
    return {
        "captured": captured,
        **row,
        "altitude_from": "take-off" if row.get("altitude_m") else "",
        "time_of_day": "" if by_sun is None else str(by_sun.value),
    }


def rate_problems(where: str, timeline: Timeline) -> list[Problem]:
    """Return a warning if the frame rate of a video varies."""
    if not timeline.varies:
        return []
    shortest, longest = timeline.steps_s
    found = f"a varying frame rate: steps of {shortest:.3f} to {longest:.3f} s; frames are matched by their times"
    return [Problem(where, "video-rate", found, "equal steps", severity="warning")]


def log_problems(aligned: Aligned, sampled: Sampled, todo: str) -> list[Problem]:
    """Return the faults of a log, and how it does not fit the frames of its video.

    Args:
        aligned: The log on the time scale of the video.
        sampled: The log at the times of the frames.
        todo: Remedy for frames that the log does not cover.
    """
    log = aligned.log
    c = sampled.coverage
    problems = [*log.problems, *aligned.problems]
    if c.before or c.after or c.in_gaps:
        found = f"{c.before} frame(s) before the log, {c.after} after it, {c.in_gaps} in gaps of up to "
        found += f"{c.largest_gap_s:.1f} s: no telemetry"
        problems.append(Problem(log.name, "log-mismatch", found, "a log that covers the video", todo, "warning"))
    for name, what, expected in (
        ("altitude_m", "below the take-off point", "heights above 0"),
        ("pitch_deg", "with a camera that looks back under the aircraft", "-90 to 90 degrees"),
    ):
        bad = _unusable(name, sampled.values)
        if bad:
            found = f"{bad} frame(s) {what}: {name} is left empty"
            problems.append(Problem(log.name, "log-value", found, expected, severity="warning"))
    return problems


def _unusable(name: str, values: Mapping[str, np.ndarray]) -> int:
    column: Sequence[float] = values.get(name, np.zeros(0)).tolist()
    return sum(math.isfinite(v) and not is_usable(name, v) for v in column)
