"""The frames of a virtual dataset: split, pitch, altitude and time of day, for every layout."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from typing import Literal

from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import SPLITS, Category, Split
from infrablend.core.rng import stream
from infrablend.errors import ArgumentError, Problem, RecipeError
from infrablend.lab.world.rjpeg_writing import MAKERS, Maker
from infrablend.lab.world.scene_plan import PlaceKind
from infrablend.lab.world.setting import SIZE_WH

Layout = Literal["hit-uav", "monet", "radiometric", "dji", "flir", "flight"]
Engine = Literal["blender", "lattice"]

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
_LOSSY = "runway_04"
_LOST = 1
FPS = 25
# A flight is at one height, over one of these places, which have people and room for animals.
FLIGHT_ALTITUDE_M = 80.0
FLIGHT_KINDS: tuple[PlaceKind, ...] = ("dirtroad", "park", "street")


# Least and most overlap of neighbouring frames and strips.
OVERLAPS = (0.2, 0.9)


@dataclass(frozen=True)
class Survey:
    """A flight of parallel strips, whose pictures state where the camera was.

    Attributes:
        overlap: Share that a frame shows of the one before, and a strip of the strip beside it: 0.2 to 0.9.
        yaw_error_deg: By how much the stated yaw is too large in all pictures.
        walking: Whether the people walk.

    Raises:
        ArgumentError: The overlap is out of range.
    """

    overlap: float = 0.7
    yaw_error_deg: float = 0.0
    walking: bool = False

    def __post_init__(self) -> None:
        low, high = OVERLAPS
        if not low <= self.overlap <= high:
            raise ArgumentError(f"overlap: found {self.overlap:g}, expected {low:g} to {high:g}")


@dataclass(frozen=True)
class FrameFacts:
    """Facts about a frame that are fixed before its scene is drawn.

    Attributes:
        number: Number of the frame in the dataset, from 0.
        split, pitch_deg, altitude_m, time_of_day: As in `ImageRecord`.
        kind: Kind of place; None draws one.
        size_wh: Size of the image in pixels.
        sequence: Name of the MONET sequence or of the flight; None in HIT-UAV's layout.
        index: Number of the frame in its sequence, from 0.
        telemetry: Whether the annotation contains telemetry.
        radiometric: Whether the image stores temperatures.
        maker: Maker of the camera whose radiometric JPEG files to write; None for the layouts of datasets.
        flight: Whether all frames are of one flight over one scene.
        survey: The strips of the flight; None for a smooth course.
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
    flight: bool = False
    survey: Survey | None = None

    @property
    def name(self) -> str:
        """File name: `T_HHH_AA_W_NNNNN.jpg` (or `.tiff`), `<sequence>/lwir/imageNNNNN.png`, or that of a camera.

        Pictures of a flight are `<sequence>/NNNNNN.png`, from 1 on.
        """
        if self.flight:
            return f"{self.sequence}/{self.index + 1:06d}.png"
        if self.maker is not None:
            return f"DJI_{self.number + 1:04d}_T.JPG" if self.maker == "dji" else f"FLIR{self.number + 1:04d}.jpg"
        if self.sequence is not None:
            return f"{self.sequence}/lwir/image{self.index:05d}.png"
        night = int(self.time_of_day == "night")
        return f"{night}_{self.altitude_m}_{self.pitch_deg}_0_{self.number:05d}.{'tiff' if self.radiometric else 'jpg'}"


def plan_frames(
    count: int, seed: int, layout: Layout = "hit-uav", survey: Survey | None = None
) -> tuple[FrameFacts, ...]:
    """Return the facts of `count` frames; frame k does not depend on how many follow.

    Pitches, altitudes and splits come in shuffled rounds, so a few frames already cover the range. The frames of a
    camera are one flight at night, those of a flight one sequence.

    Raises:
        RecipeError: The number is out of range.
    """
    if not 1 <= count <= 100_000:
        expected = "1 to 100000: names of files have five digits"
        problem = Problem("count", "world-value", f"found {count}", expected, "correct the value")
        raise RecipeError("the virtual world cannot be rendered with these values", [problem])
    altitudes = MONET_ALTITUDES_M if layout == "monet" else ALTITUDES_M
    total = sum(SPLIT_SHARES.values())
    given: Counter[Split] = Counter()
    frames = []
    for k in range(count):
        pitch = _of_round(PITCHES_DEG, k, seed, "pitch")
        altitude = _of_round(altitudes, k, seed, "altitude")
        if layout == "monet":
            frames.append(_of_sequence(k, seed, pitch, altitude))
        elif layout == "flight":
            frames.append(replace(_of_flight(k, seed), survey=survey))
        elif layout in MAKERS:
            frames.append(FrameFacts(k, "train", pitch, altitude, "night", maker=layout))
        else:
            # The split that is furthest behind its share gets the frame.
            split = max(SPLITS, key=lambda s: (SPLIT_SHARES[s] / total * (k + 1) - given[s], -SPLITS.index(s)))
            given[split] += 1
            night = stream(seed, "world", k, "facts").random() < NIGHT_SHARE
            radiometric = layout == "radiometric"
            frames.append(FrameFacts(k, split, pitch, altitude, "night" if night else "day", radiometric=radiometric))
    return tuple(frames)


def _of_round(values: Sequence[int], k: int, seed: int, what: str) -> int:
    """Return value number k of a sequence of shuffled rounds through `values`."""
    turn, at = divmod(k, len(values))
    return values[int(stream(seed, "world", what, turn).permutation(len(values))[at])]


def _of_sequence(number: int, seed: int, pitch_deg: float, altitude_m: float) -> FrameFacts:
    """Return a frame of MONET's sequences; its pitch and altitude vary a little around the given values."""
    split, name, telemetry = SEQUENCES[number % len(SEQUENCES)]
    index = number // len(SEQUENCES)
    rng = stream(seed, "world", "monet", number)
    of_day: TimeOfDay = "night" if stream(seed, "world", "monet", name).random() < NIGHT_SHARE else "day"
    kind: PlaceKind = "runway" if name.startswith("runway") else "dirtroad"
    pitch = round(min(90.0, max(10.0, pitch_deg + rng.uniform(-4, 4))), 1)
    altitude = round(max(10.0, altitude_m + rng.uniform(-5, 5)), 1)
    recorded = telemetry and not (name == _LOSSY and index % 10 == _LOST)
    return FrameFacts(number, split, pitch, altitude, of_day, kind, MONET_SIZE_WH, name, index, recorded)


def _of_flight(number: int, seed: int) -> FrameFacts:
    """Return a frame of a flight; its height varies a little around the one given."""
    rng = stream(seed, "world", "flight", "facts")
    of_day: TimeOfDay = "night" if rng.random() < NIGHT_SHARE else "day"
    kind = FLIGHT_KINDS[int(rng.integers(len(FLIGHT_KINDS)))]
    name = f"flight_{seed:03d}"
    return FrameFacts(number, "train", 90, FLIGHT_ALTITUDE_M, of_day, kind, sequence=name, index=number, flight=True)


def telemetry_of(frame: FrameFacts, seed: int) -> dict[str, object]:
    """Return the telemetry of a frame in MONET's terms (gimbal pitch negative downwards); empty if it was lost."""
    if not frame.telemetry:
        return {}
    u = stream(seed, "world", "monet", frame.number, "telemetry").uniform
    taken = datetime(2022, 6, 1, 9, tzinfo=timezone(timedelta(hours=2))) + timedelta(seconds=frame.index / FPS)
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
