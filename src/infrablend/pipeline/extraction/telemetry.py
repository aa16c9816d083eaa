"""The table of pitch, height and time of the extracted frames."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from infrablend.core.camera import STRAIGHT_DOWN_DEG
from infrablend.formats.flight import time_of_day
from infrablend.formats.flight_log import Sampled
from infrablend.pipeline.extraction.plan import ClipPlan, FlightFacts

TABLE = "metadata.csv"
COLUMNS = (
    "file", "sequence", "captured", "pitch_deg", "altitude_m", "altitude_from", "hfov_deg",
    "time_of_day", "frame", "time_s",
    "roll_deg", "yaw_deg", "latitude_deg", "longitude_deg",
)  # fmt: skip
_DECIMALS = {"latitude_deg": 7, "longitude_deg": 7}


@dataclass(frozen=True)
class WrittenFrame:
    """A frame that has been written.

    Attributes:
        number: Number of the frame in its video, from 0.
        time_s: Time in its video.
        path: Path of the picture in the folder.
        colour: Whether the picture is in colour.
    """

    number: int
    time_s: float
    path: str
    colour: bool


def telemetry_rows(
    plan: ClipPlan, written: Sequence[WrittenFrame], sampled: Sampled | None, flight: FlightFacts
) -> list[dict[str, str]]:
    """Return the rows of the frames of one video, by column."""
    rows = []
    for k, frame in enumerate(written):
        row = {
            "file": frame.path, "sequence": plan.sequence, "time_of_day": flight.time_of_day or "",
            "frame": str(frame.number), "time_s": f"{frame.time_s:.3f}",
            "hfov_deg": "" if flight.hfov_deg is None else f"{flight.hfov_deg:g}",
        }  # fmt: skip
        if sampled is not None:
            row["captured"] = sampled.captured[k] or ""
            row |= {name: value_text(name, float(values[k])) for name, values in sampled.values.items()}
            row["altitude_from"] = "take-off" if row.get("altitude_m") else ""
            row["time_of_day"] = row["time_of_day"] or _time_of_day(row)
        rows.append(row)
    return rows


def _time_of_day(row: Mapping[str, str]) -> str:
    """Return day or night by the sun, if time and place of a frame are known and leave no doubt; else nothing."""
    latitude, longitude = (float(row[k]) if row.get(k) else None for k in ("latitude_deg", "longitude_deg"))
    return time_of_day(row["captured"], latitude, longitude) or ""


def table_text(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the table as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def is_usable(field_name: str, value: float) -> bool:
    """Return whether a value can be in the table: a camera that looks down or up, a height that is not negative."""
    if field_name == "pitch_deg":
        return abs(value) <= STRAIGHT_DOWN_DEG
    return value >= 0 if field_name == "altitude_m" else math.isfinite(value)


def value_text(field_name: str, value: float) -> str:
    """Return a value as it is written to the table; empty if it cannot be in it."""
    if not math.isfinite(value) or not is_usable(field_name, value):
        return ""
    return f"{value:.{_DECIMALS.get(field_name, 3)}f}"
