"""Subtitles with telemetry that DJI's cameras write beside a video, in all known dialects.

    [rel_alt: 1.300 abs_alt: 132.860] [gb_yaw: 45.0 gb_pitch: -60.0 gb_roll: 0.0]      Mini, Air, Mavic, Matrice
    [gimbal_pitch(degrees): -90.0]                                                     programs that add the gimbal
    GPS(36.6146,-6.1120,0.0M) BAROMETER:47.0M                                          Mavic Pro, Phantom, Matrice 300
    F/5.6, SS 400, ISO 100, EV 0, GPS (..), D 698.70m, H 85.80m, G.PRY (-90.0, 0.0, 0.0)   Phantom 4 RTK, Inspire

Blocks may be wrapped in `<font>` tags and count frames (`FrameCnt`, `SrtCnt`). Heights are above take-off. A bare
`altitude` is not used, because the log does not say what it counts from; neither is `GPS(..)`, in which the order of
latitude and longitude differs between models.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from infrablend.errors import DatasetError, Problem
from infrablend.formats.cameras.flight_log import FlightLog, gimbal_pitches, read_log_text, with_places, with_rolls

_TIME = re.compile(r"\s*(\d{1,3}):(\d{1,2}):(\d{1,2})[,.](\d{1,3})\s*-->", re.ASCII)
_NUMBER = r"([-+]?\d{1,12}(?:\.\d{1,12})?)"
_TAG = re.compile(r"<[^<>\n]{0,100}>")
# The decimal point may be a comma, and a height may be in feet.
_FIELD = re.compile(
    r"(?<![A-Za-z_])([A-Za-z_]{1,40}(?:\(degrees\))?)\s{0,3}:\s{0,3}"
    r"([-+]?\d{1,12}(?:[.,]\d{1,12})?)(\s?(?:ft|feet)\b)?",
    re.ASCII | re.IGNORECASE,
)
_HEIGHT = re.compile(r"(?<![\w.])H\s{1,3}" + _NUMBER + r"\s?([mM]|ft)\b", re.ASCII)
_FEET_M = 0.3048
_GIMBAL = re.compile(rf"G\.PRY\s?\(\s?{_NUMBER}°?\s?,\s?{_NUMBER}°?\s?,\s?{_NUMBER}°?\s?\)", re.ASCII)
_DATE = re.compile(r"(\d{4})[-./](\d{1,2})[-./](\d{1,2})[ T](\d{1,2}):(\d\d):(\d\d)(?:[.,:](\d{1,3}))?", re.ASCII)

# Names of fields in the order in which they are preferred, lower case.
_NAMES: Mapping[str, tuple[str, ...]] = {
    "pitch": ("gb_pitch", "gimbal_pitch(degrees)", "gimbal_pitch"),
    "roll_deg": ("gb_roll", "gimbal_roll(degrees)", "gimbal_roll"),
    "yaw_deg": ("gb_yaw", "gimbal_heading(degrees)", "gimbal_yaw(degrees)", "gimbal_yaw"),
    "altitude_m": ("rel_alt", "h", "barometer", "hb"),
    "latitude_deg": ("latitude",),
    "longitude_deg": ("longitude", "longtitude"),  # DJI's own spelling
}
# Characters of a block that are searched; the longest known have 500.
_MAX_BLOCK = 4000
_COUNTERS = ("framecnt", "srtcnt")
_LIMITS = {"altitude_m": 1e5, "latitude_deg": 90.0, "longitude_deg": 180.0, "roll_deg": 360.0, "yaw_deg": 360.0}


def read_srt(path: Path) -> FlightLog:
    """Read a subtitle file with telemetry.

    Raises:
        DatasetError: The file cannot be read, or no block contains telemetry.
    """
    return parse_srt(read_log_text(path), path)


def parse_srt(text: str, path: Path) -> FlightLog:
    """Return the telemetry in the text of subtitles; `path` is the file that contains them.

    Raises:
        DatasetError: No block contains telemetry.
    """
    blocks = list(_blocks(text))
    found: list[tuple[float, dict[str, float], float]] = []
    names: Counter[str] = Counter()
    silent = 0
    for seconds, block in blocks:
        plain = _TAG.sub(" ", block[:_MAX_BLOCK])
        # Of equal names in a block, the first counts.
        given = {
            name.lower(): float(value.replace(",", ".")) * (_FEET_M if feet else 1.0)
            for name, value, feet in reversed(_FIELD.findall(plain))
        }
        if height := _HEIGHT.search(plain):
            given["h"] = float(height[1]) * (_FEET_M if height[2] == "ft" else 1.0)
        if gimbal := _GIMBAL.search(plain):
            given |= {"gb_pitch": float(gimbal[1]), "gb_roll": float(gimbal[2]), "gb_yaw": float(gimbal[3])}
        names.update(given.keys())
        if any(n in given for options in _NAMES.values() for n in options):
            found.append((seconds, given, _date(plain)))
        else:
            silent += 1
    if not found:
        what = "no subtitle block" if not blocks else f"{len(blocks)} subtitle block(s) without telemetry"
        problem = Problem(
            path.name,
            "log-layout",
            what,
            "DJI's fields, such as rel_alt, gb_pitch or BAROMETER",
            "turn on the camera's caption in the drone's settings, or give a flight log with --log",
        )
        raise DatasetError(f"{path}: no telemetry", [problem])
    problems = _remarks(path, names, silent, len(blocks))
    return _log(path, found, names, problems)


def _blocks(text: str) -> Iterator[tuple[float, str]]:
    """Yield start in seconds and text of each block; a block ends where the next line of times begins.

    The start is NaN for times that cannot be, such as negative ones.
    """
    seconds: float | None = None
    lines: list[str] = []
    for line in text.splitlines():
        match = _TIME.match(line)
        if match is None and "-->" not in line:
            lines.append(line)
            continue
        if seconds is not None:
            yield seconds, "\n".join(lines[:-1] if lines and lines[-1].strip().isdigit() else lines)
        seconds = math.nan
        lines = []
        if match is not None:
            seconds = int(match[1]) * 3600 + int(match[2]) * 60 + int(match[3]) + int(match[4].ljust(3, "0")) / 1000
    if seconds is not None:
        yield seconds, "\n".join(lines)


def _date(text: str) -> float:
    """Return the date and time in a block in seconds since 1970, as if in UTC; NaN if there is none."""
    match = _DATE.search(text)
    if match is None:
        return math.nan
    try:
        when = datetime(*(int(match[k]) for k in range(1, 7)), tzinfo=UTC)  # type: ignore[misc,arg-type]
    except ValueError:
        return math.nan
    return when.timestamp() + int((match[7] or "0").ljust(3, "0")) / 1000


def _remarks(path: Path, names: Counter[str], silent: int, blocks: int) -> list[Problem]:
    problems = []
    if silent:
        found = f"{silent} of {blocks} block(s) without telemetry"
        problems.append(Problem(path.name, "log-sample", found, "telemetry in each", severity="warning"))
    if names["altitude"] and not any(names[n] for n in _NAMES["altitude_m"]):
        found = "a height `altitude` that does not say what it counts from, not used"
        problems.append(Problem(path.name, "log-height", found, "rel_alt or BAROMETER", severity="warning"))
    return problems


def _log(
    path: Path, found: list[tuple[float, dict[str, float], float]], names: Counter[str], problems: list[Problem]
) -> FlightLog:
    """Return the log of the samples; each field comes from one name throughout."""
    chosen = {field: next((n for n in options if names[n]), None) for field, options in _NAMES.items()}
    values = {}
    for field, name in chosen.items():
        if name is None:
            continue
        column = np.array([given.get(name, math.nan) for _, given, _ in found], np.float64)
        if field == "pitch":
            known = np.where(np.abs(column) <= 180, column, np.nan)
            values["pitch_deg"], remarks = gimbal_pitches(known, path.name)
            problems += remarks
        else:
            values[field] = np.where(np.abs(column) <= _LIMITS[field], column, np.nan)
    values, rolled = with_rolls(values, path.name)
    problems += rolled
    counter = next((c for c in _COUNTERS if names[c]), "")
    frames = np.array([given.get(counter, math.nan) for _, given, _ in found], np.float64)
    frames = frames if (frames == 0).any() else frames - 1  # nearly all cameras count from 1
    clock = np.array([when for _, _, when in found], np.float64)
    dated = clock if np.isfinite(clock).any() else None
    return FlightLog(
        path.name,
        "DJI subtitles",
        np.array([s for s, _, _ in found], np.float64),
        with_places(values),
        chosen["altitude_m"] or "",
        frames if counter else None,
        dated,
        problems=tuple(problems),
    )
