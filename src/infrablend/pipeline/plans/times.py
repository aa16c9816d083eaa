"""The time of day of a run's backgrounds, and what contradicts it."""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise

from infrablend.config.recipe import Geolocation, Recipe, SkyEnvironment
from infrablend.core.capture import Capture
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.errors import Problem
from infrablend.sampling.weather import used_time
from infrablend.thermal.daytime import time_of_sun
from infrablend.thermal.sky import time_of

TIME_REPLACED = "time-replaced"
"""Code of the warning about a time of day of the recipe that replaces others of the dataset."""


def with_used_times(dataset: Dataset, recipe: Recipe) -> Dataset:
    """Return a dataset whose pictures have the time of day that a run uses; see `sampling.weather.used_time`."""
    sky = recipe.environment.sky
    if sky is None:
        return dataset
    return replace(dataset, images=tuple(replace(i, capture=used_time(i.capture, sky)) for i in dataset.images))


def with_clock_times(dataset: Dataset) -> Dataset:
    """Return a dataset whose sequences without seconds have those of the clock of their pictures, if it goes on."""
    sequences: dict[tuple[str, str | None], list[ImageRecord]] = {}
    for image in dataset.images:
        sequences.setdefault((image.split, image.capture.sequence), []).append(image)
    since: dict[int, float] = {}
    for (_, name), images in sequences.items():
        images.sort(key=lambda i: i.capture.frame or 0)
        clock = [_clock_s(i.capture.captured) if i.capture.time_s is None else math.nan for i in images]
        if name is not None and all(a < b for a, b in pairwise([*clock, math.inf])):
            since |= {id(i): second - clock[0] for i, second in zip(images, clock, strict=True)}
    timed = (replace(i, capture=replace(i.capture, time_s=since.get(id(i), i.capture.time_s))) for i in dataset.images)
    return replace(dataset, images=tuple(timed))


def _clock_s(captured: str | None) -> float:
    """Return the second of a time of capture, without a zone as if in UTC; NaN if it is no time."""
    with contextlib.suppress(ValueError, OverflowError):
        when = datetime.fromisoformat(captured or "")
        return when.replace(tzinfo=when.tzinfo or UTC).timestamp()
    return math.nan


def time_warnings(recipe: Recipe, read: Sequence[ImageRecord], used: Sequence[ImageRecord]) -> list[Problem]:
    """Return warnings about pictures whose own time of day is not used, or whose time of capture cannot be.

    Args:
        recipe: The recipe.
        read: All pictures as they were read.
        used: Those that a run uses.
    """
    sky = recipe.environment.sky
    known = {(i.split, i.id): i.capture for i in read}
    if sky is None:
        return []
    captures = [known[i.split, i.id] for i in used]
    problems = []
    if sky.time_of_day is not None:
        problems += _replaced(sky.time_of_day, captures, sky)
    else:
        problems += _unknown([i.capture for i in used])
    if sky.place is not None:
        problems += [] if sky.time_of_day is not None else _by_night_in_the_sun(captures, sky.place)
        problems += _without_zone(captures)
    return problems


def _unknown(captures: Sequence[Capture]) -> list[Problem]:
    """Return a warning about pictures of an unknown time of day, with what a run takes them for."""
    count = sum(c.time_of_day is None for c in captures)
    if not count:
        return []
    found = f"unknown time of day of {count} of {len(captures)} picture(s), which are taken as by night, without sun"
    todo = "set environment.time_of_day=day (or dusk, night, dawn), or give a column time_of_day in metadata.csv"
    expected = "a time of day, or time and place of capture"
    return [Problem("environment.time_of_day", "time-unknown", found, expected, todo, "warning")]


def _replaced(stated: str, captures: Sequence[Capture], sky: SkyEnvironment) -> list[Problem]:
    by_sun = sky.model_copy(update={"time_of_day": None})
    own = Counter(t for c in captures if (t := used_time(c, by_sun).time_of_day) is not None)
    air = sum(c.radiometry is not None and c.radiometry.plausible_air_k is not None for c in captures)
    air *= sky.air_of_picture
    if not own.keys() - {stated} and not air:
        return []
    found = f"{stated} for all pictures"
    if own:
        of = ", ".join(f"{n} by {time}" for time, n in sorted(own.items()))
        found += f", but by their files or capture times they are: {of}"
    if air:
        found += f"; the air of {air} picture(s) keeps the temperature that their files state"
    todo = "leave it out for the times of the pictures, unless another time of day is wanted"
    where = "environment.time_of_day"
    expected = "the time of day of each picture"
    return [Problem(where, TIME_REPLACED, found, expected, todo, "warning")]


def _by_night_in_the_sun(captures: Sequence[Capture], place: Geolocation) -> list[Problem]:
    times = [time_of(c.captured) for c in captures if c.time_of_day == "night"]
    suns = [time_of_sun(t, place.latitude_deg, place.longitude_deg) for t in times if t is not None]
    if "day" not in suns:
        return []
    found = f"the sun is high in {suns.count('day')} picture(s) stated to be by night, and is not used there"
    todo = "state time_of_day as day in the pictures' metadata, or check capture times, time zone and place"
    return [Problem("environment.place", "sun-above-horizon", found, "pictures by night", todo, "warning")]


def _without_zone(captures: Sequence[Capture]) -> list[Problem]:
    count = sum(_lacks_zone(c.captured) for c in captures)
    if not count:
        return []
    found = f"{count} picture(s) have a time of capture without a time zone, so the position of the sun is unknown"
    todo = "add the zone to `captured` in the pictures' metadata; their time of day is the dataset's, or the recipe's"
    expected = "times such as 2024-05-01T06:30:00+02:00"
    return [Problem("environment.place", "capture-zone", found, expected, todo, "warning")]


def _lacks_zone(captured: str | None) -> bool:
    if captured is None or len(captured) <= 10:
        return False
    try:
        return datetime.fromisoformat(captured).tzinfo is None
    except ValueError:
        return False
