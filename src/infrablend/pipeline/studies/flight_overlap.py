"""What the overlap of a flight's pictures says of its yaw, ground pixel and lens, beside what their headers state."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from infrablend.core.dataset import ImageRecord
from infrablend.imaging.overlap import (
    MOST_TILT_DEG,
    Link,
    Overlap,
    OverlapValue,
    Place,
    find_link,
    fit_overlap,
    looks_down,
    neighbours,
    places_of,
    shorter_side,
)
from infrablend.pipeline.plans.sequence_motion import sequence_views

# A glance compares so many pairs of so many pictures in rows of so many.
_PAIRS = 30
_PICTURES = 18
_ROW = 6
# Pairs for each picture where all are compared.
_PAIRS_EACH = 4
# Pictures that follow each other at less than this share of their shorter side show almost the same.
_STEP = 0.1
_LEAST = 4
_LASER_M = 1.0
_BAROMETER_M = 2.0


def glance_at_overlap(images: Sequence[ImageRecord]) -> list[OverlapValue] | str | None:
    """Return what overlap says of a flight, from a few of its pictures; in words why nothing; None without positions.

    Pictures that cannot be read show nothing.
    """
    placed = [i for i in images if i.capture.place is not None and i.size_wh is not None]
    if len(placed) < _LEAST:
        return None
    known = [i for i in placed if looks_down(i.capture) and i.size_wh == placed[0].size_wh]
    if len(known) < _LEAST:
        down = f"look straight down to {MOST_TILT_DEG:g} degrees, and state their yaw"
        return f"{len(known)} of {len(placed)} pictures with a position {down}, where yaw and lens follow from overlap"
    ordered = sorted(known, key=flight_order)
    size_wh, lens = ordered[0].size_wh, ordered[0].capture.hfov_deg
    assert size_wh is not None
    every = places_of([i.capture for i in ordered], size_wh)
    rows = spread_rows(every, shorter_side(size_wh, lens))
    chosen = [ordered[k] for k in rows]
    places = [every[k] for k in rows]
    found = fit_overlap(places, link_pictures(chosen, places, lens, _PAIRS), size_wh)
    return found if isinstance(found, str) else offered_values(found, chosen)


def flight_order(image: ImageRecord) -> tuple[str, str, int, str]:
    """Return what to sort pictures of flights by."""
    capture = image.capture
    return capture.sequence or "", capture.captured or "", capture.frame or 0, image.id


def link_pictures(
    images: Sequence[ImageRecord], places: Sequence[Place], hfov_deg: float | None, most: int | None = None
) -> list[Link]:
    """Return the movements between pictures that show much of the same ground.

    Args:
        images: Pictures of one size; those that cannot be read show nothing.
        places: What is stated of each.
        hfov_deg: Their field of view, if it is known.
        most: Number of pairs that are compared; None for some for each picture.
    """
    size_wh = images[0].size_wh
    assert size_wh is not None
    pairs = list(neighbours(places, size_wh, hfov_deg))[: most or _PAIRS_EACH * len(images)]
    numbered = [replace(i, capture=replace(i.capture, frame=k)) for k, i in enumerate(images)]
    views = list(sequence_views(numbered))
    return [link for a, b in pairs if (link := find_link(a, b, views)) is not None]


def spread_rows(places: Sequence[Place], side: float) -> list[int]:
    """Return numbers of some pictures: rows of such as follow each other at some distance, spread over the flight.

    Args:
        places: Places of the pictures in the order of the flight.
        side: Ground along the shorter side of a picture, per height.
    """
    kept = [0]
    for k, place in enumerate(places):
        way = math.hypot(place.east_m - places[kept[-1]].east_m, place.north_m - places[kept[-1]].north_m)
        if way > _STEP * side * place.height_m:
            kept.append(k)
    if len(kept) > _PICTURES:
        begins = np.linspace(0, len(kept) - _ROW, _PICTURES // _ROW).astype(int).tolist()
        kept = sorted({kept[b + n] for b in begins for n in range(_ROW)})
    return kept


def offered_values(found: Overlap, images: Sequence[ImageRecord]) -> list[OverlapValue]:
    """Return what overlap says beside what the pictures state, each with its interval of 95 %."""
    size_wh = images[0].size_wh
    assert size_wh is not None
    captures = [i.capture for i in images]
    source = f"overlap of {found.pictures} pictures, {found.links} pairs; positions to {found.residual_m:.2f} m"
    if found.left_out:
        source += f"; {found.left_out} pairs or positions that contradict them left out"
    turn = found.wide * found.yaw_sigma_deg
    values = [_value("yaw_error_deg", found.yaw_error_deg, turn, 0.0, source)]
    apart = [
        (c.flight_yaw_deg - c.yaw_deg - (c.roll_deg or 0.0) + 180) % 360 - 180
        for c in captures
        if c.flight_yaw_deg is not None and c.yaw_deg is not None
    ]
    if len(apart) == len(images):
        error = (found.yaw_error_deg + float(np.median(apart)) + 180) % 360 - 180
        values.append(_value("flight_yaw_error_deg", error, turn, 0.0, source))
    lens = _median([c.hfov_deg for c in captures])
    height = _median([c.altitude_m for c in captures])
    stated = None
    if lens is not None and height is not None:
        stated = 2 * math.tan(math.radians(lens) / 2) / size_wh[0] * height
    half = found.wide * found.pixel_sigma * found.ground_pixel_m
    values.append(_value("ground_pixel_m", found.ground_pixel_m, half, stated, source))
    if height is not None:
        error = _LASER_M if all(c.altitude_from == "laser" for c in captures) else _BAROMETER_M
        half = found.wide * found.hfov_sigma_deg(size_wh[0], error)
        source = f"{source}; height {height:g} m, to {error:g} m"
        values.append(_value("hfov_deg", found.hfov_deg(size_wh[0]), half, lens, source))
    return values


def _value(name: str, value: float, half: float, stated: float | None, source: str) -> OverlapValue:
    digits = 4 if name == "ground_pixel_m" else 2
    return {
        "name": name,
        "value": round(value, digits),
        "low": round(value - half, digits),
        "high": round(value + half, digits),
        "stated": None if stated is None else round(stated, digits),
        "contradicts": stated is not None and abs(stated - value) > half,
        "source": source,
    }


def _median(values: Sequence[float | None]) -> float | None:
    """Return the median; None if a value is unknown."""
    known = [v for v in values if v is not None]
    return float(np.median(known)) if len(known) == len(values) else None
