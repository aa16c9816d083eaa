"""Telemetry of a flight over time: samples of a log, and their values at the times of a video's frames."""

from __future__ import annotations

import math
import stat
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infrablend.core.camera import STRAIGHT_DOWN_DEG, is_plausible_roll, pitch_of_gimbal, roll_of_gimbal
from infrablend.errors import DatasetError, Problem
from infrablend.formats.values import is_place

Values = NDArray[np.float64]

LINEAR = ("pitch_deg", "altitude_m", "latitude_deg", "longitude_deg")
ROUND = ("roll_deg", "yaw_deg")
"""Angles around a full circle: interpolated the short way round."""
FIELDS = (*LINEAR, *ROUND)
MAX_LOG_BYTES = 200_000_000
MAX_GAP_S = 2.0
"""Longest time between two samples over which values are interpolated."""
MAX_DAMAGED = 0.1
"""Share of a log's samples that may be out of order; a log with more is refused."""


@dataclass(frozen=True, eq=False)
class FlightLog:
    """Samples of one log, in our units and angle conventions.

    Attributes:
        name: Name of the file.
        dialect: What wrote it, for people.
        times_s: (n,) seconds since the start of the video for subtitles, else since the log's own start. Subtitles may
            be out of order; see `log_alignment`.
        values: (n,) values per field of `FIELDS` that the log has; NaN where a sample has none.
        height: Name of the source's field behind `altitude_m`; empty if it has none.
        frames: (n,) frame number of each sample, from 0; NaN where it has none, None if the log counts no frames.
        clock_s: (n,) seconds since 1970 by the log's clock; NaN where unknown.
        in_utc: Whether that clock shows UTC; else it is local time of an unknown zone.
        recordings: Start and end of each video recording in the log, by `times_s`; empty for subtitles.
        problems: Faults of the file, and fields whose meaning is not certain.
    """

    name: str
    dialect: str
    times_s: Values
    values: Mapping[str, Values]
    height: str = ""
    frames: Values | None = None
    clock_s: Values | None = None
    in_utc: bool = False
    recordings: tuple[tuple[float, float], ...] = ()
    problems: tuple[Problem, ...] = ()

    @property
    def start(self) -> datetime | None:
        """Time of the log's first second by its own clock, as if in UTC; None if the log has no dates."""
        known = None if self.clock_s is None else np.flatnonzero(np.isfinite(self.clock_s))
        if self.clock_s is None or known is None or not known.size:
            return None
        k = int(known[0])
        return datetime.fromtimestamp(float(self.clock_s[k] - self.times_s[k]), UTC)


@dataclass(frozen=True)
class Coverage:
    """How well a log covers the frames of a video.

    Attributes:
        inside: Frames with telemetry.
        before: Frames before the log's first sample.
        after: Frames after its last sample.
        in_gaps: Frames in gaps of the log that are too long to interpolate.
        largest_gap_s: Longest time between two samples that are next to each other, around the frames.
    """

    inside: int
    before: int
    after: int
    in_gaps: int
    largest_gap_s: float

    def to_json(self) -> dict[str, float]:
        """Return plain JSON values."""
        return {**asdict(self), "largest_gap_s": round(self.largest_gap_s, 3)}


@dataclass(frozen=True, eq=False)
class Sampled:
    """Values of a log at given times; NaN where unknown.

    Attributes:
        values: (m,) values per field of the log.
        captured: ISO 8601 times by the log's clock; None where unknown.
        coverage: How well the log covers the times.
    """

    values: Mapping[str, Values]
    captured: tuple[str | None, ...]
    coverage: Coverage = field(default_factory=lambda: Coverage(0, 0, 0, 0, 0.0))


def sample(log: FlightLog, at: Sequence[float], positions: Values | None = None) -> Sampled:
    """Return the values of a log at some times, interpolated linearly between neighbouring samples.

    Times at most one usual step outside the log take its first or last sample; times further out, or inside gaps longer
    than `MAX_GAP_S` and three usual steps, have no values.

    Args:
        log: The log.
        at: (m,) times, or frame numbers where `positions` are frame numbers.
        positions: (n,) positions of the samples on the same scale; None for the log's times.
    """
    x = log.times_s if positions is None else positions
    wanted = np.asarray(at, np.float64)
    step_s = float(np.median(np.diff(log.times_s))) if len(x) > 1 else 1.0
    step = float(np.median(np.diff(x))) if len(x) > 1 else 1.0
    allowed_s = max(MAX_GAP_S, 3 * step_s)
    before, after = wanted < x[0] - step - 1e-9, wanted > x[-1] + step + 1e-9
    inner = np.clip(wanted, x[0], x[-1])
    right = np.clip(np.searchsorted(x, inner, side="left"), 0, len(x) - 1)
    left = np.where(x[right] <= inner, right, np.maximum(right - 1, 0))
    gaps_s = log.times_s[right] - log.times_s[left]
    outside = before | after
    in_gap = ~outside & (gaps_s > allowed_s) & (inner > x[left]) & (inner < x[right])
    known = ~(outside | in_gap)
    span = np.where(right > left, x[right] - x[left], 1.0)
    weight = np.where(right > left, (inner - x[left]) / span, 0.0)
    values = {
        name: np.where(known, _between(v[left], v[right], weight, round_=name in ROUND), np.nan)
        for name, v in log.values.items()
    }
    clock = None if log.clock_s is None else _between(log.clock_s[left], log.clock_s[right], weight, round_=False)
    captured = tuple(
        None if clock is None or not ok else _iso(float(clock[k]), log.in_utc) for k, ok in enumerate(known.tolist())
    )
    around = (log.times_s >= log.times_s[left].min()) & (log.times_s <= log.times_s[right].max()) if len(inner) else []
    steps = np.diff(log.times_s[around]) if len(inner) else np.zeros(0)
    coverage = Coverage(
        int(known.sum()), int(before.sum()), int(after.sum()), int(in_gap.sum()), float(steps.max(initial=0.0))
    )
    return Sampled(values, captured, coverage)


def gimbal_pitches(column: Values, name: str) -> tuple[Values, list[Problem]]:
    """Return the angles below the horizon of a gimbal's own pitches, and a warning of those that look back.

    Args:
        column: (n,) degrees as the log has them.
        name: Name of the log's file.
    """
    pitches = np.array([pitch_of_gimbal(v) for v in column.tolist()], np.float64)
    back = int((pitches > STRAIGHT_DOWN_DEG).sum())
    found = f"{back} sample(s) with a gimbal that looks back under the aircraft"
    warning = Problem(name, "log-pitch", found, "-90 to 90 degrees", severity="warning")
    return pitches, [warning] if back else []


def with_places(values: Mapping[str, Values]) -> dict[str, Values]:
    """Return the values of a log without latitudes and longitudes that are no places; see `is_place`."""
    latitude, longitude = values.get("latitude_deg"), values.get("longitude_deg")
    if latitude is None or longitude is None:
        return {**values}
    known = np.array([is_place(a, b) for a, b in zip(latitude.tolist(), longitude.tolist(), strict=True)], np.bool_)
    if not known.any():
        return {k: v for k, v in values.items() if k not in ("latitude_deg", "longitude_deg")}
    places = {"latitude_deg": np.where(known, latitude, np.nan), "longitude_deg": np.where(known, longitude, np.nan)}
    return {**values, **places}


def with_rolls(values: Mapping[str, Values], name: str) -> tuple[dict[str, Values], list[Problem]]:
    """Return the values of a log without rolls that a camera cannot have, and a warning if there are any.

    Args:
        values: Values of the log, with the gimbal's own roll.
        name: Name of the log's file.
    """
    rolls = values.get("roll_deg")
    if rolls is None:
        return {**values}, []
    pitches = values.get("pitch_deg", np.full(len(rolls), np.nan))
    pairs = zip(rolls.tolist(), pitches.tolist(), strict=True)
    turned = np.array([roll_of_gimbal(r) for r in rolls.tolist()], np.float64)
    known = np.array([is_plausible_roll(roll_of_gimbal(r), p) for r, p in pairs], np.bool_)
    lost = int((np.isfinite(rolls) & ~known).sum())
    found = f"{lost} sample(s) with a gimbal that is turned on its side or upside down: their roll is left out"
    warning = Problem(name, "log-roll", found, "-45 to 45 degrees, or any near straight down", severity="warning")
    return {**values, "roll_deg": np.where(known, turned, np.nan)}, [warning] if lost else []


def in_order(values: Sequence[float] | Values) -> NDArray[np.bool_]:
    """Return a mask of the longest series of values that increases; it leaves out single values that are damaged."""
    ends: list[float] = []
    last: list[int] = []
    before = [-1] * len(values)
    for k, value in enumerate(np.asarray(values, np.float64).tolist()):
        if not math.isfinite(value):
            continue
        at = bisect_left(ends, value)
        before[k] = last[at - 1] if at else -1
        if at == len(ends):
            ends.append(value)
            last.append(k)
        else:
            ends[at] = value
            last[at] = k
    mask = np.zeros(len(values), np.bool_)
    k = last[-1] if last else -1
    while k >= 0:
        mask[k] = True
        k = before[k]
    return mask


def _between(a: Values, b: Values, weight: Values, *, round_: bool) -> Values:
    """Return values between a (weight 0) and b (weight 1); around a full circle the short way, in (-180, 180]."""
    step = b - a
    if round_:
        step = (step + 180.0) % 360.0 - 180.0
    result = np.where(weight <= 0, a, np.where(weight >= 1, b, a + weight * step))
    return 180.0 - (180.0 - result) % 360.0 if round_ else result


def _iso(seconds: float, in_utc: bool) -> str | None:
    """Return seconds since 1970 as ISO 8601 with milliseconds, with a zone only if it is known."""
    if not math.isfinite(seconds) or not -6e10 < seconds < 2e11:
        return None
    when = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(milliseconds=round(seconds * 1000))
    text = when.isoformat(timespec="milliseconds")
    return text if in_utc else text.removesuffix("+00:00")


def read_log_text(path: Path) -> str:
    """Return the text of a log: UTF-8 with or without a mark, UTF-16 with one, else Latin-1; without null characters.

    Raises:
        DatasetError: The file is missing, not a regular file, too large or empty.
    """
    found = ""
    expected = "a log"
    todo = "check the path"
    data = b""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            found = "not a regular file"
        elif status.st_size > MAX_LOG_BYTES:
            found = f"{status.st_size / 1e6:.0f} MB"
            expected = f"at most {MAX_LOG_BYTES / 1e6:.0f} MB"
            todo = "split the log"
        else:
            data = path.read_bytes()
            found = "" if data.strip() else "an empty file"
    except OSError as error:
        found = error.strerror or str(error)
    if found:
        problem = Problem(path.name, "log-unreadable", found, expected, todo)
        raise DatasetError(f"{path}: cannot be read", [problem])
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", "replace").replace("\0", "")
    data = data.replace(b"\0", b"")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")
