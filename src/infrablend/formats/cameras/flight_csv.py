"""Flight logs as CSV: of AirData, Litchi and Flytrex, and DJI's records as decoded by Flight Reader or TXTlogToCSV.

    time(millisecond), datetime(utc), height_above_takeoff(feet), gimbal_pitch(degrees), isVideo, ...
    latitude, longitude, altitude(m), ascent(m), time(millisecond), datetime(utc), gimbalPitchRaw, isTakingVideo, ...
    CUSTOM.date [local], CUSTOM.updateTime [local], OSD.flyTime [s], OSD.height [ft], GIMBAL.pitch, CAMERA.isVideo, ...

Units are those in the columns' names. Heights above the ground, where AirData knows the terrain, are preferred to
heights above take-off. Litchi's and Flytrex's `ascent` is above take-off, their `altitude` above the sea; raw angles
are tenths of a degree.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import comma_of, delimiter_of
from infrablend.formats.cameras.flight_log import (
    MAX_DAMAGED,
    FlightLog,
    Values,
    gimbal_pitches,
    in_order,
    read_log_text,
    with_places,
    with_rolls,
)
from infrablend.formats.values import to_number

_HEADER_LINES = 5
_UNIT = re.compile(r"[\s]*[(\[]\s*([A-Za-z/ ]+?)\s*[)\]]\s*$")
_METRES = {"m": 1.0, "meters": 1.0, "metres": 1.0, "meter": 1.0, "ft": 0.3048, "feet": 0.3048, "foot": 0.3048}
_SECONDS = {"millisecond": 1e-3, "milliseconds": 1e-3, "ms": 1e-3, "s": 1.0, "sec": 1.0, "seconds": 1.0}
_FLY_TIME = re.compile(r"(?:(\d+)\s*h)?\s*(?:(\d+)\s*m)?\s*(\d+(?:\.\d+)?)\s*s", re.ASCII)
_DAY_S = 86_400
_CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d(?:\.\d{1,6})?)\s*([AaPp][Mm])?", re.ASCII)
_DAY = re.compile(r"(\d{1,4})[-/.](\d{1,2})[-/.](\d{1,4})", re.ASCII)
_RECORDING = {"1", "true", "yes", "starting", "recording", "started"}


@dataclass(frozen=True)
class _Dialect:
    """Columns of one kind of log, lower case without units, in the order in which they are preferred.

    A log of the kind has the column `mark` and one of `own`.
    """

    name: str
    mark: str
    own: tuple[str, ...]
    elapsed: tuple[str, ...]
    clock: tuple[str, ...]
    date: str
    height: tuple[str, ...]
    columns: Mapping[str, tuple[str, ...]]
    recording: tuple[str, ...]


_DIALECTS = (
    _Dialect(
        "Litchi CSV", "time", ("gimbalpitchraw", "istakingvideo"), ("time",), ("datetime",), "", ("ascent",),
        {
            "pitch": ("gimbalpitchraw",), "roll_deg": ("gimbalrollraw",), "yaw_deg": ("gimbalyawraw",),
            "latitude_deg": ("latitude",), "longitude_deg": ("longitude",),
        },
        ("istakingvideo",),
    ),
    _Dialect(
        "AirData CSV", "time", ("height_above_takeoff", "gimbal_pitch", "gimbal_heading", "isvideo"),
        ("time",), ("datetime",), "",
        ("height_above_ground_at_drone_location", "height_above_takeoff", "ascent"),
        {
            "pitch": ("gimbal_pitch",), "roll_deg": ("gimbal_roll",), "yaw_deg": ("gimbal_heading", "gimbal_yaw"),
            "latitude_deg": ("latitude",), "longitude_deg": ("longitude",),
        },
        ("isvideo",),
    ),
    _Dialect(
        "Flytrex CSV", "time", ("ascent",), ("time",), ("datetime",), "", ("ascent",),
        {"latitude_deg": ("latitude",), "longitude_deg": ("longitude",)}, (),
    ),
    _Dialect(
        "DJI flight record", "custom.updatetime", ("gimbal.pitch", "osd.height", "osd.latitude"),
        ("osd.flytime",), ("custom.updatetime",), "custom.date",
        ("osd.height",),
        {
            "pitch": ("gimbal.pitch",), "roll_deg": ("gimbal.roll",), "yaw_deg": ("gimbal.yaw",),
            "latitude_deg": ("osd.latitude",), "longitude_deg": ("osd.longitude",),
        },
        ("camera.isvideo", "custom.isvideo", "camera_info.recordstate"),
    ),
)  # fmt: skip


@dataclass(frozen=True)
class _Column:
    """A column: its place, its name as written, and its unit in lower case (empty if it names none).

    Attributes:
        comma: What stands for a comma in its numbers: a point, or nothing where commas separate thousands.
        contradicted: Whether another column of the same name has other values.
    """

    index: int
    title: str
    unit: str
    comma: str = "."
    contradicted: bool = False

    def numbers(self, rows: Sequence[Sequence[str]]) -> Values:
        """Return the column's numbers; NaN where it has none."""
        return np.array([_number(row[self.index].replace(",", self.comma)) for row in rows], np.float64)


def read_flight_csv(path: Path) -> FlightLog:
    """Read a flight log.

    Raises:
        DatasetError: The file cannot be read, is no log of a known kind, or its times do not increase.
    """
    dialect, columns, rows = _table(path)
    elapsed, clock_s, in_utc = _times(path, dialect, columns, rows)
    kept = in_order(elapsed)
    lost = len(rows) - int(kept.sum())
    problems = []
    if lost > MAX_DAMAGED * len(rows) or kept.sum() < 2:
        found = f"{lost} of {len(rows)} row(s) without a time, or out of order"
        column = _first(columns, dialect.elapsed)
        if column is not None and column.unit not in _SECONDS:
            found += f"; column {column.title!r} has no known unit"
        problem = Problem(path.name, "log-times", found, "times that increase", "export the log again")
        raise DatasetError(f"{path}: no usable times", [problem])
    if lost:
        found = f"{lost} of {len(rows)} row(s) without a time, or out of order, left out"
        problems.append(Problem(path.name, "log-times", found, "times that increase", severity="warning"))
    values, height, more = _values(path, dialect, columns, rows, kept)
    problems += _undated(path, dialect, columns, rows) if clock_s is None else []
    values, rolled = with_rolls(values, path.name)
    more += rolled
    start = float(elapsed[kept][0])
    times = elapsed[kept] - start
    flags = _first(columns, dialect.recording)
    recordings = () if flags is None else _recordings([rows[k][flags.index] for k in np.flatnonzero(kept)], times)
    return FlightLog(
        path.name,
        dialect.name,
        times,
        values,
        height,
        None,
        clock_s[kept] if clock_s is not None else None,
        in_utc,
        recordings,
        (*problems, *more),
    )


def _table(path: Path) -> tuple[_Dialect, dict[str, _Column], list[list[str]]]:
    """Return the kind of log, its columns by name without unit, and its rows, padded to the header."""
    try:
        text = read_log_text(path)
        delimiter = delimiter_of(text, _HEADER_LINES)
        lines = list(csv.reader(io.StringIO(text, newline=""), delimiter=delimiter))
    except csv.Error as error:
        problem = Problem(path.name, "log-layout", f"no CSV table ({error})", "a flight log", "export the log again")
        raise DatasetError(f"{path}: cannot be read", [problem]) from error
    for n, line in enumerate(lines[:_HEADER_LINES]):
        names = [_name_and_unit(title) for title in line]
        for dialect in _DIALECTS:
            known = {name for name, _ in names}
            if dialect.mark in known and not known.isdisjoint(dialect.own):
                width = len(line)
                rows = [[*row, *[""] * (width - len(row))] for row in lines[n + 1 :] if any(c.strip() for c in row)]
                if rows:
                    return dialect, _columns(line, names, rows, delimiter), rows
                problem = Problem(path.name, "log-layout", "a header and no rows", "samples", "export the log again")
                raise DatasetError(f"{path}: an empty {dialect.name}", [problem])
    found = f"columns {', '.join(c.strip() for c in (lines[0] if lines else ()))[:120] or 'none'}"
    expected = "columns of AirData, Litchi or Flytrex (time(millisecond), ...) or of a DJI flight record "
    expected += "(CUSTOM.updateTime, ...)"
    problem = Problem(path.name, "log-layout", found, expected, "export the log as CSV with AirData or Flight Reader")
    raise DatasetError(f"{path}: not a flight log of a known kind", [problem])


def _name_and_unit(title: str) -> tuple[str, str]:
    unit = _UNIT.search(title)
    return (title[: unit.start()] if unit else title).strip().lower(), unit[1].lower() if unit else ""


def _first(columns: Mapping[str, _Column], names: Iterable[str]) -> _Column | None:
    return next((columns[n] for n in names if n in columns), None)


def _columns(
    titles: Sequence[str], names: Sequence[tuple[str, str]], rows: Sequence[Sequence[str]], delimiter: str
) -> dict[str, _Column]:
    """Return the columns by name; of equal names the first that has values."""
    comma = comma_of(rows, delimiter)
    places: dict[str, list[int]] = {}
    for index, (name, _) in enumerate(names):
        places.setdefault(name, []).append(index)
    columns = {}
    for name, same in places.items():
        filled = [k for k in same if len(same) == 1 or any(row[k].strip() for row in rows)] or same
        others = {tuple(row[k].strip() for row in rows) for k in filled} if len(filled) > 1 else ()
        chosen = filled[0]
        columns[name] = _Column(chosen, titles[chosen].strip(), names[chosen][1], comma, len(others) > 1)
    return columns


def _times(
    path: Path, dialect: _Dialect, columns: Mapping[str, _Column], rows: Sequence[Sequence[str]]
) -> tuple[Values, Values | None, bool]:
    """Return the seconds of each row on one scale, the clock of each row if the log has dates, and if it is in UTC."""
    clock = _first(columns, dialect.clock)
    date = columns.get(dialect.date) if dialect.date else None
    clock_s: Values | None = None
    if clock is not None:
        texts = [f"{row[date.index]} {row[clock.index]}" if date else row[clock.index] for row in rows]
        clock_s = np.array([_clock(t) for t in texts], np.float64)
    column = _first(columns, dialect.elapsed)
    elapsed = np.full(len(rows), np.nan) if column is None else _elapsed(column, rows)
    dated = clock_s is not None and np.isfinite(clock_s).all() and bool((clock_s > 0).all())
    if clock_s is not None and not np.isfinite(elapsed).any():
        # Without dates the clock still gives the time within the day.
        elapsed = _across_midnight([_seconds_of_day(row[clock.index]) for row in rows]) if clock else elapsed
        elapsed = clock_s if dated else elapsed
    if clock_s is not None and not dated:
        clock_s = None
    if clock_s is not None and np.isfinite(elapsed).any():
        # Clocks are written in whole seconds, rounded down: the largest difference is the closest to the truth.
        clock_s = elapsed + float(np.nanmax(clock_s - elapsed))
    return elapsed, clock_s, clock is not None and clock.unit == "utc"


def _undated(
    path: Path, dialect: _Dialect, columns: Mapping[str, _Column], rows: Sequence[Sequence[str]]
) -> list[Problem]:
    """Return a warning if the log has a column of dates that cannot be used, so that times of capture are unknown."""
    names = (dialect.date,) if dialect.date else dialect.clock
    column = _first(columns, names)
    text = "" if column is None else next((t for row in rows if (t := row[column.index].strip())), "")
    if not text:
        return []
    found = (
        f"dates whose order is not certain, or not in every row, such as {text[:40]!r}: the time of capture is unknown"
    )
    todo = "export the log with dates such as 2024-05-01, or state --time day or night"
    return [Problem(path.name, "log-date", found, "year, month and day in each row", todo, "warning")]


def _elapsed(column: _Column, rows: Sequence[Sequence[str]]) -> Values:
    """Return seconds: texts such as `1m 2.5s`, or numbers in a known unit; NaN for others."""
    matches = [_FLY_TIME.fullmatch(row[column.index].strip()) for row in rows]
    if any(matches):
        return np.array([math.nan if m is None else _seconds(m) for m in matches], np.float64)
    return column.numbers(rows) * _SECONDS.get(column.unit, math.nan)


def _seconds(match: re.Match[str]) -> float:
    return int(match[1] or 0) * 3600 + int(match[2] or 0) * 60 + float(match[3])


def _across_midnight(seconds: Sequence[float]) -> Values:
    """Return seconds of the day that go on rising where midnight sets them back."""
    times = np.array(seconds, np.float64)
    known = np.flatnonzero(np.isfinite(times))
    days = np.cumsum(np.diff(times[known], prepend=times[known[:1]]) < -_DAY_S / 2)
    times[known] += days * _DAY_S
    return times


def _seconds_of_day(text: str) -> float:
    match = _CLOCK.search(text)
    if match is None:
        return math.nan
    hour = int(match[1])
    if match[4]:
        hour = hour % 12 + (12 if match[4].lower() == "pm" else 0)
    return hour * 3600 + int(match[2]) * 60 + float(match[3])


def _clock(text: str) -> float:
    """Return a date and time in seconds since 1970, as if in UTC; NaN without a date whose order is certain."""
    day = _DAY.search(text)
    seconds = _seconds_of_day(text[day.end() :] if day else text)
    if day is None:
        return math.nan
    a, b, c = map(int, day.groups()[:3])
    if a > 31:
        year = a
        month = b
        number = c
    elif c > 31 and (a > 12 or b > 12 or a == b):
        year, month, number = (c, b, a) if a > 12 else (c, a, b)
    else:  # 3/4/2024 is in March or in April
        return math.nan
    try:
        return datetime(year, month, number, tzinfo=UTC).timestamp() + seconds
    except ValueError:
        return math.nan


def _number(text: str) -> float:
    value = to_number(text.strip())
    return value if value is not None and abs(value) < 1e12 else math.nan


def _values(
    path: Path,
    dialect: _Dialect,
    columns: Mapping[str, _Column],
    rows: Sequence[Sequence[str]],
    kept: np.ndarray[tuple[int], np.dtype[np.bool_]],
) -> tuple[dict[str, Values], str, list[Problem]]:
    """Return values per field, the name of the column of heights, and warnings."""
    problems: list[Problem] = []
    taken = [rows[k] for k in np.flatnonzero(kept).tolist()]
    values: dict[str, Values] = {}
    for field, options in dialect.columns.items():
        column = _first(columns, options)
        if column is None:
            continue
        problems += _contradictions(path, column)
        numbers = column.numbers(taken) * (0.1 if column.title.lower().endswith("raw") else 1.0)
        if field == "pitch":
            field = "pitch_deg"
            numbers, remarks = gimbal_pitches(numbers, path.name)
            problems += remarks
        limit = {"latitude_deg": 90.0, "longitude_deg": 180.0}.get(field, 360.0)
        values[field] = np.where(np.abs(numbers) <= limit, numbers, np.nan)
    for name in dialect.height:
        column = columns.get(name)
        if column is None:
            continue
        if column.unit not in _METRES:
            found = f"column {column.title!r} without a known unit, not used"
            problems.append(Problem(path.name, "log-height", found, "metres or feet in its name", severity="warning"))
            continue
        numbers = column.numbers(taken) * _METRES[column.unit]
        # Logs without terrain data have the column with zeros.
        if np.isfinite(numbers).any() and (np.nan_to_num(numbers) != 0).any():
            problems += _contradictions(path, column)
            values["altitude_m"] = np.where(np.abs(numbers) <= 1e5, numbers, np.nan)
            return with_places(values), column.title, problems
    return with_places(values), "", problems


def _contradictions(path: Path, column: _Column) -> list[Problem]:
    if not column.contradicted:
        return []
    found = f"several columns {column.title!r} with different values; the first is used"
    return [Problem(path.name, "log-columns", found, "each column once", severity="warning")]


def _recordings(flags: Sequence[str], times: Values) -> tuple[tuple[float, float], ...]:
    """Return start and end of each run of samples that were taken while a video was recorded."""
    on = np.array([f.strip().lower() in _RECORDING for f in flags], bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(np.int8)))
    return tuple((float(times[a]), float(times[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True))
