"""The frames of a virtual dataset: split, pitch, altitude and time of day, for every layout."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from typing import Any

from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import SPLITS, Category, Split
from infrablend.core.rng import stream
from infrablend.errors import Problem, RecipeError
from infrablend.formats.rjpeg.writing import Maker
from infrablend.world.plan import PlaceKind
from infrablend.world.setting import SIZE_WH

PITCHES_DEG = (30, 40, 50, 60, 70, 80, 90)
ALTITUDES_M = (60, 70, 80, 90, 100, 110, 120, 130)
# HIT-UAV's own proportions.
SPLIT_SHARES: Mapping[Split, float] = {"train": 0.7, "val": 0.1, "test": 0.2}
NIGHT_SHARE = 0.68

MONET_ALTITUDES_M = (40, 50, 60, 80, 100)
MONET_SIZE_WH = (800, 600)
MONET_CATEGORIES = (Category(1, "person"), Category(2, "vehicle"))
# Split, name, whether it has telemetry. Four frames cover the sequences with telemetry, six cover all; runway_01 and
# dirtroad_01 have none, as in the MONET paper.
SEQUENCES: tuple[tuple[Split, str, bool], ...] = (
    ("train", "runway_04", True),
    ("train", "dirtroad_02", True),
    ("test", "dirtroad_03", True),
    ("val", "runway_05", True),
    ("train", "runway_01", False),
    ("train", "dirtroad_01", False),
)
# One frame in ten of this sequence has lost its telemetry.
_LOSSY, _LOST = "runway_04", 1
_FPS = 25


@dataclass(frozen=True)
class FrameFacts:
    """Facts about a frame that are fixed before its scene is drawn.

    Attributes:
        number: Number of the frame in the dataset, from 0.
        split, pitch_deg, altitude_m, time_of_day: As in `ImageRecord`.
        kind: Kind of place; None draws one.
        size_wh: Size of the image in pixels.
        sequence: Name of the MONET sequence; None in HIT-UAV's layout.
        index: Number of the frame in its sequence, from 0.
        telemetry: Whether the annotation contains telemetry.
        radiometric: Whether the image stores temperatures.
        maker: Maker of the camera whose radiometric JPEG files to write; None for the layouts of datasets.
    """

    number: int
    split: Split
    pitch_deg: float
    altitude_m: float
    time_of_day: TimeOfDay
    kind: PlaceKind | None = None
    size_wh: tuple[int, int] = SIZE_WH
    sequence: str | None = None
    index: int = 0
    telemetry: bool = True
    radiometric: bool = False
    maker: Maker | None = None

    @property
    def name(self) -> str:
        """File name: `T_HHH_AA_W_NNNNN.jpg` (or `.tiff`), `<sequence>/lwir/imageNNNNN.png`, or that of a camera."""
        if self.maker is not None:
            return f"DJI_{self.number + 1:04d}_T.JPG" if self.maker == "dji" else f"FLIR{self.number + 1:04d}.jpg"
        if self.sequence is not None:
            return f"{self.sequence}/lwir/image{self.index:05d}.png"
        night = int(self.time_of_day == "night")
        return f"{night}_{self.altitude_m}_{self.pitch_deg}_0_{self.number:05d}.{'tiff' if self.radiometric else 'jpg'}"


def plan_frames(
    count: int,
    seed: int,
    splits: Mapping[Split, float] = SPLIT_SHARES,
    pitches_deg: Sequence[int] = PITCHES_DEG,
    altitudes_m: Sequence[int] = ALTITUDES_M,
) -> tuple[FrameFacts, ...]:
    """Return the facts of `count` frames in HIT-UAV's layout.

    Pitches, altitudes and splits come in shuffled rounds, so a few frames already cover the range.

    Raises:
        RecipeError: A value is out of range; the error lists all of them.
    """
    problems = [
        *_check(count >= 1, "count", str(count), "at least 1"),
        *_check(count <= 100_000, "count", str(count), "at most 100000, the names have five digits"),
        *_check(bool(splits) and set(splits) <= set(SPLITS), "splits", str(sorted(splits)), "train, val or test"),
        *_check(
            all(v >= 0 for v in splits.values()) and sum(splits.values()) > 0,
            "splits", str(dict(splits)), "shares of at least 0, not all 0",
        ),
        *_check(
            bool(pitches_deg) and all(10 <= p <= 90 and p == int(p) for p in pitches_deg),
            "pitches_deg", str(list(pitches_deg)), "whole degrees in [10, 90]",
        ),
        *_check(
            bool(altitudes_m) and all(10 <= a <= 1000 and a == int(a) for a in altitudes_m),
            "altitudes_m", str(list(altitudes_m)), "whole metres in [10, 1000]",
        ),
    ]  # fmt: skip
    if problems:
        raise RecipeError("the virtual world cannot be rendered with these values", problems)
    names = [s for s in SPLITS if splits.get(s, 0) > 0]
    total = sum(splits[s] for s in names)
    given: Counter[Split] = Counter()
    frames = []
    for k in range(count):
        # The split that is furthest behind its share gets the frame.
        split = max(names, key=lambda s: (splits[s] / total * (k + 1) - given[s], -SPLITS.index(s)))
        given[split] += 1
        rng = stream(seed, "world", k, "facts")
        frames.append(
            FrameFacts(
                k,
                split,
                int(_round_robin(pitches_deg, k, seed, "pitch")),
                int(_round_robin(altitudes_m, k, seed, "altitude")),
                "night" if rng.random() < NIGHT_SHARE else "day",
            )
        )
    return tuple(frames)


def plan_flight(
    count: int, seed: int, maker: Maker, pitches_deg: Sequence[int], altitudes_m: Sequence[int]
) -> tuple[FrameFacts, ...]:
    """Return the facts of the frames of one flight at night, in the files of a camera.

    Raises:
        RecipeError: A value is out of range; the error lists all of them.
    """
    frames = plan_frames(count, seed, {"train": 1.0}, pitches_deg, altitudes_m)
    return tuple(replace(f, time_of_day="night", maker=maker) for f in frames)


def _check(good: bool, where: str, found: str, expected: str) -> list[Problem]:
    return [] if good else [Problem(where, "world-value", f"found {found}", expected, "correct the value")]


def _round_robin(values: Sequence[int], k: int, seed: int, what: str) -> int:
    """Return value number k of a sequence of shuffled rounds through `values`."""
    turn, at = divmod(k, len(values))
    return values[int(stream(seed, "world", what, turn).permutation(len(values))[at])]


def plan_sequences(
    count: int, seed: int, pitches_deg: Sequence[int] = PITCHES_DEG, altitudes_m: Sequence[int] = MONET_ALTITUDES_M
) -> tuple[FrameFacts, ...]:
    """Return `count` frames spread over MONET's sequences; pitch and altitude vary a little around the given values.

    Raises:
        RecipeError: A value is out of range; the error lists all of them.
    """
    base = plan_frames(count, seed, {"train": 1.0}, pitches_deg, altitudes_m)
    frames = []
    for f in base:
        split, name, telemetry = SEQUENCES[f.number % len(SEQUENCES)]
        index = f.number // len(SEQUENCES)
        rng = stream(seed, "world", "monet", f.number)
        of_day: TimeOfDay = "night" if stream(seed, "world", "monet", name).random() < NIGHT_SHARE else "day"
        kind: PlaceKind = "runway" if name.startswith("runway") else "dirtroad"
        pitch = round(min(90.0, max(10.0, f.pitch_deg + rng.uniform(-4, 4))), 1)
        altitude = round(max(10.0, f.altitude_m + rng.uniform(-5, 5)), 1)
        recorded = telemetry and not (name == _LOSSY and index % 10 == _LOST)
        frames.append(FrameFacts(f.number, split, pitch, altitude, of_day, kind, MONET_SIZE_WH, name, index, recorded))
    return tuple(frames)


def telemetry_of(frame: FrameFacts, seed: int) -> dict[str, Any]:
    """Return the telemetry of a frame in MONET's terms (gimbal pitch negative downwards); empty if it was lost."""
    if not frame.telemetry:
        return {}
    u = stream(seed, "world", "monet", frame.number, "telemetry").uniform
    taken = datetime(2022, 6, 1, 9, tzinfo=timezone(timedelta(hours=2))) + timedelta(seconds=frame.index / _FPS)
    heading = u(-180, 180)
    values = {
        "alt": frame.altitude_m,
        "g_pitch": -frame.pitch_deg,
        "g_roll": u(-1, 1),
        "g_yaw": heading,
        "d_pitch": u(-8, 8),
        "d_roll": u(-5, 5),
        "d_yaw": heading + u(-2, 2),
        "speed_x": u(-6, 6),
        "speed_y": u(-6, 6),
        "speed_z": u(-1, 1),
        # A few hundred metres around a point in the sea, so that no real airfield is shown.
        "latitude": 43.0 + math.degrees(u(-300, 300) / 6.4e6),
        "longitude": 15.5 + math.degrees(u(-300, 300) / 4.7e6),
    }
    digits = {"latitude": 7, "longitude": 7}
    return {"timestamp": taken.isoformat(), **{k: round(float(v), digits.get(k, 2)) for k, v in values.items()}}
