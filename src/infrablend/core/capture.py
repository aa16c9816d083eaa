"""What is known of a picture: where the camera was, how it looked, when, and which picture of which flight it is.

A new fact is a field of `Capture`, with the values that it may have. Formats with named fields, metadata tables, run
records and shards take all facts from there; formats with a fixed set of fields list those that they hold in
`core.format_table`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

if TYPE_CHECKING:  # the command line completes names of formats, which have facts, without NumPy
    from infrablend.core.temperature import Radiometry, TemperatureScale

TimeOfDay = Literal["day", "dusk", "night", "dawn"]
AltitudeOrigin = Literal["take-off", "laser", "labels"]


@dataclass(frozen=True)
class Fact:
    """What a fact may be.

    Attributes:
        read: Returns the fact from a value of a JSON file or the text of a table; raises ValueError or TypeError if the
            value is no such fact.
        expected: Such values in words.
        field: What a format lacks that cannot hold the fact: `telemetry` or `sequence`, see `format_table.FIELDS`.
        type: Type of the fact.
    """

    read: Callable[[Any], Any]
    expected: str
    field: Literal["telemetry", "sequence"] = "telemetry"
    type: type[float] | type[str] = str


def _number(low: float, high: float, unit: str) -> Fact:
    def read(value: Any) -> float:
        number = float(value)
        if isinstance(value, bool) or not low <= number <= high:
            raise ValueError
        return number

    return Fact(read, f"{low:g} to {high:g} {unit}", type=float)


def _roll() -> Fact:
    turns = _number(-360, 360, "degrees")

    def read(value: Any) -> float:
        from infrablend.core.camera import roll_of_gimbal

        return roll_of_gimbal(float(turns.read(value)))

    return replace(turns, read=read)


def _frame_number(value: Any) -> int:
    number = float(value)
    if isinstance(value, bool) or not math.isfinite(number) or number != int(number) or number < 0:
        raise ValueError
    return int(number)


def _one_of(*choices: str) -> Fact:
    def read(value: Any) -> str:
        if value not in choices:
            raise ValueError
        return str(value)

    return Fact(read, f"{', '.join(choices[:-1])} or {choices[-1]}")


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError
    return value


def _name(value: Any) -> str:
    return str(value) if type(value) is int else _text(value)


@dataclass(frozen=True)
class Capture:
    """How a picture was taken; None where unknown.

    Attributes:
        pitch_deg: Depression of the optical axis: 0 level, 90 straight down, negative looking up.
        altitude_m: Height above the ground according to the source.
        time_of_day: Day, dusk, night or dawn.
        hfov_deg: Field of view across the width of the picture.
        roll_deg: Rotation of the camera about its axis, positive clockwise as seen from behind it.
        altitude_from: Origin of a height that is no nominal one: measured by the aircraft above the take-off point or
            with a laser, or found by labels of known size (`infrablend camera`).
        sequence: Flight or clip of the picture.
        captured: Date or time of capture, ISO 8601.
        frame: Number of the picture in its sequence, at least 0.
        time_s: Second of the picture in its sequence, from the start of that.
        camera: Maker and model of the camera, from the picture's header.
        latitude_deg: Latitude of the camera, north positive.
        longitude_deg: Longitude of the camera, east positive.
        yaw_deg: Heading of the optical axis, clockwise from north, as the source states it.
        flight_yaw_deg: Heading of the aircraft's nose, clockwise from north. Straight down, where gimbals do not know
            their own, it is that of the picture's upper edge.
        radiometry: Scale of the temperatures of a 16-bit picture, and what its file states about the air. Each format
            has its own form for it.
        time_from: What a run took the time of day from instead of the dataset: its recipe, or the sun at the time of
            capture.
    """

    pitch_deg: float | None = field(default=None, metadata={"fact": _number(-90, 90, "degrees")})
    altitude_m: float | None = field(default=None, metadata={"fact": _number(0, 1e5, "metres")})
    time_of_day: TimeOfDay | None = field(default=None, metadata={"fact": _one_of(*get_args(TimeOfDay))})
    hfov_deg: float | None = field(default=None, metadata={"fact": _number(0.1, 170, "degrees")})
    roll_deg: float | None = field(default=None, metadata={"fact": _roll()})
    altitude_from: AltitudeOrigin | None = field(default=None, metadata={"fact": _one_of(*get_args(AltitudeOrigin))})
    sequence: str | None = field(default=None, metadata={"fact": Fact(_name, "a name", "sequence")})
    captured: str | None = field(
        default=None, metadata={"fact": Fact(_text, "a date or time such as 2024-05-01T06:30:00+02:00", "sequence")}
    )
    frame: int | None = field(
        default=None, metadata={"fact": Fact(_frame_number, "a whole number from 0", "sequence", type=int)}
    )
    time_s: float | None = field(default=None, metadata={"fact": replace(_number(0, 1e7, "seconds"), field="sequence")})
    camera: str | None = field(default=None, metadata={"fact": Fact(_text, "a name")})
    latitude_deg: float | None = field(default=None, repr=False, metadata={"fact": _number(-90, 90, "degrees")})
    longitude_deg: float | None = field(default=None, repr=False, metadata={"fact": _number(-180, 180, "degrees")})
    yaw_deg: float | None = field(default=None, repr=False, metadata={"fact": _number(-360, 360, "degrees")})
    flight_yaw_deg: float | None = field(default=None, repr=False, metadata={"fact": _number(-360, 360, "degrees")})
    radiometry: Radiometry | None = None
    time_from: Literal["recipe", "sun"] | None = field(default=None, repr=False)

    @property
    def place(self) -> tuple[float, float] | None:
        """Latitude and longitude; None if unknown."""
        if self.latitude_deg is None or self.longitude_deg is None:
            return None
        return self.latitude_deg, self.longitude_deg

    @property
    def scale(self) -> TemperatureScale | None:
        """Scale of the temperatures of a 16-bit picture; None if unknown."""
        return None if self.radiometry is None else self.radiometry.scale

    def to_json(self) -> dict[str, Any]:
        """Return the known facts of `FACTS` as plain JSON values, from which `from_json` restores them."""
        return {name: value for name in FACTS if (value := getattr(self, name)) is not None}

    @classmethod
    def from_json(cls, data: Mapping[str, Any], *, strict: bool = True) -> Capture:
        """Restore the facts from the values of `to_json`; other keys are ignored.

        Args:
            data: The values by the names of the facts; None is unknown.
            strict: Whether to refuse a value that is no such fact; otherwise it is unknown.

        Raises:
            ValueError: A value is no such fact.
        """
        found = {}
        for name, fact in FACTS.items():
            value = data.get(name)
            if value is None:
                continue
            try:
                found[name] = fact.read(value)
            except (TypeError, ValueError, OverflowError):
                if strict:
                    raise ValueError(f"{name}: found {value!r}, expected {fact.expected}") from None
        return cls(**found)

    def over(self, other: Capture) -> Capture:
        """Return these facts, completed by `other`'s."""
        mine = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(other, **{name: value for name, value in mine.items() if value is not None})

    def conflicts(self, other: Capture) -> list[str]:
        """Return `fact: this, that` for what the two know differently about the camera and the time of day."""
        pairs = ((n, getattr(self, n), getattr(other, n)) for n, fact in FACTS.items() if fact.field == "telemetry")
        return [f"{n}: {a} and {b}" for n, a, b in pairs if a is not None and b is not None and a != b]


FACTS: Mapping[str, Fact] = {f.name: f.metadata["fact"] for f in fields(Capture) if "fact" in f.metadata}
"""All facts but `radiometry` and `time_from`, by name, in the order in which tables list them."""

UNKNOWN = Capture()
"""Nothing is known of a picture."""
