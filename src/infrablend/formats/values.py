"""Convert fields of annotation files, which may contain anything, to numbers, flags and sizes."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import date, datetime
from typing import Any

from infrablend.formats.losses import BOXES
from infrablend.formats.pictures.listing import MAX_PIXELS


def to_floats(value: object, count: int) -> tuple[float, ...] | None:
    """Return `count` numbers from a list of numbers or numeric strings; None if it is anything else.

    NaN and infinity pass, because `check_box` reports them.
    """
    if not isinstance(value, list | tuple) or len(value) != count:
        return None
    try:
        if any(isinstance(v, bool) for v in value):
            return None
        return tuple(float(v) for v in value)
    except (TypeError, ValueError, OverflowError, ZeroDivisionError):  # EXIF has fractions
        return None


def to_number(value: object) -> float | None:
    """Return the finite number that a field means, or None."""
    numbers = to_floats([value], 1)
    return numbers[0] if numbers and math.isfinite(numbers[0]) else None


def to_time(value: object) -> datetime | None:
    """Return the date or time in ISO 8601 that a text field means, or None."""
    try:
        return datetime.fromisoformat(value.strip()) if isinstance(value, str) else None
    except ValueError:
        return None


def iso_date(year: str, month: str, day: str) -> str | None:
    """Return a date of three numbers as ISO 8601; None if there is no such day."""
    try:
        return date(int(year), int(month), int(day)).isoformat()
    except ValueError:
        return None


def to_int(value: object) -> int | None:
    """Return the whole number that a JSON or XML field means (4, "4", 4.0), exact whatever its size, or None.

    Larger floats than in `to_id` are none.
    """
    if isinstance(value, int | str) and not isinstance(value, bool):
        with suppress(ValueError):
            return int(value)
    number = to_number(value)
    return int(number) if number is not None and number == int(number) and abs(number) < 2**53 else None


def to_id(value: object) -> int | str | None:
    """Return the exact id of an image, object or track that a JSON field states, or None.

    Floats are whole numbers (1.0); larger ones than these have lost digits, so that they would be the ids of others.
    """
    if isinstance(value, float):
        return int(value) if value.is_integer() and abs(value) < 2**53 else None
    return value if isinstance(value, int | str) and not isinstance(value, bool) else None


def is_unassigned(track: object) -> bool:
    """Return whether the id of a track is -1, which says that no tracker has assigned the object yet."""
    return track is not None and to_int(track) == -1


def to_key(value: object) -> int | str | None:
    """Return the id by which records refer to each other, or None: the text "7" is 7, but "007" and "1e5" are texts."""
    found = to_id(value)
    return None if found is None or found == "" else plain_id(found)


def plain_id(text: int | str) -> int | str:
    """Return the whole number that a text is, as `7` but not `07`, else the id as it is."""
    number = to_int(text)
    return number if isinstance(text, str) and number is not None and str(number) == text else text


def to_bool(value: object) -> bool | None:
    """Return the flag that a JSON or XML field means (true, 1, "1", "True"), or None."""
    text = str(value).strip().casefold()
    return {"1": True, "true": True, "0": False, "false": False}.get(text)


def to_share(value: object) -> float | None:
    """Return the number in [0, 1] that a field means, or None."""
    number = to_number(value)
    return number if number is not None and 0 <= number <= 1 else None


def read_occlusion(fields: Mapping[str, object]) -> dict[str, object]:
    """Return the fields of a partly hidden object; boxes other than four finite numbers are left out."""
    found: dict[str, object] = {"occluded": fields["occluded"]} if isinstance(fields.get("occluded"), bool) else {}
    for name in BOXES:
        box = to_floats(fields.get(name), 4)
        if box is not None and all(map(math.isfinite, box)):
            found[name] = list(box)
    return found


def known(**fields: Any) -> dict[str, object]:
    """Return the fields that have a value."""
    return {k: v for k, v in fields.items() if v is not None}


def to_size(width: object, height: object) -> tuple[int, int] | None:
    """Return (width, height) in px if both are whole numbers above 0 and within the limit for pictures, else None."""
    w, h = to_int(width), to_int(height)
    return (w, h) if w is not None and h is not None and w > 0 and h > 0 and w * h <= MAX_PIXELS else None


def number_text(value: float) -> str:
    """Return a coordinate as text, with up to eight decimals and none for whole numbers."""
    text = f"{value:.8f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def csv_text(head: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """Return the text of a CSV table."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return text.getvalue()


def is_place(latitude_deg: float, longitude_deg: float) -> bool:
    """Return whether two numbers are a place on Earth; 0, 0 is what devices write that have not found theirs yet."""
    known = abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180
    return known and (latitude_deg != 0 or longitude_deg != 0)
