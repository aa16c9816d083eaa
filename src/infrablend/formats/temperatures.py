"""Temperature scales of 16-bit pictures: those that the user states, and remarks on pictures without one."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.temperature import Radiometry, TemperatureScale
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures import open_picture

OPTIONS: Mapping[str, str] = {
    "unit": "unit of 16-bit pictures: centikelvin, decikelvin or counts",
    "slope": "kelvin per count, for the unit counts",
    "offset": "temperature of count 0 in kelvin, for the unit counts",
}
"""Options that every reader takes: `--read unit=centikelvin`, or `data.unit` in a recipe."""

DEEP_SUFFIXES = (".png", ".tif", ".tiff")
_LOOKED_AT = 4


def scale_of_options(given: Mapping[str, str]) -> TemperatureScale | None:
    """Return the scale that the options state; None for counts without one.

    Raises:
        DatasetError: A value is no number, or the values do not fit together.
    """

    def number(name: str) -> float | None:
        if name not in given:
            return None
        try:
            return float(given[name])
        except ValueError as error:
            raise _refuse(name, given[name], "a number") from error

    if "unit" not in given:
        raise _refuse("unit", f"none beside {', '.join(sorted(given))}", "unit=counts beside slope and offset")
    try:
        return TemperatureScale.of_unit(given["unit"], number("slope"), number("offset"))
    except ValueError as error:
        raise _refuse("unit", str(error), "a unit, or counts with a slope") from error


def _refuse(name: str, found: str, expected: str) -> DatasetError:
    return DatasetError(f"{name}: {found}", [Problem(f"option {name}", "option-value", found, expected)])


def with_scale(dataset: Dataset, scale: TemperatureScale | None) -> Dataset:
    """Return the dataset with a stated scale on each picture of a type that can have 16 bits.

    It goes above what the files state; without a scale, the pictures are only counts.
    """

    def stated(image: ImageRecord) -> ImageRecord:
        if image.path.suffix.lower() not in DEEP_SUFFIXES:
            return image
        known = image.radiometry or Radiometry(None)
        return replace(image, radiometry=replace(known, scale=scale, source="stated"))

    return replace(dataset, images=tuple(stated(i) for i in dataset.images))


def deep_mode(image: ImageRecord) -> str:
    """Return Pillow's mode of a picture of more than 8 bits per channel by its header: `I...`, or `F` for floats.

    Empty for other pictures, and for those that cannot be read.
    """
    if image.path.suffix.lower() not in DEEP_SUFFIXES:
        return ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with open_picture(image.path) as picture:
                return str(picture.mode) if picture.mode.startswith(("I", "F")) else ""
    except Exception:  # unreadable pictures are reported where they are read
        return ""


def is_deep(image: ImageRecord) -> bool:
    """Return whether a picture has 16 bits per pixel, by its header; False if it cannot be read."""
    return deep_mode(image).startswith("I")


def scale_warnings(dataset: Dataset) -> list[Problem]:
    """Return a warning if 16-bit pictures have no temperature scale; only a few pictures are opened."""
    bare = [i for i in dataset.images if i.radiometry is None]
    looked_at = bare[:: max(1, len(bare) // _LOOKED_AT)][:_LOOKED_AT]
    if not any(is_deep(i) for i in looked_at):
        return []
    found = "16-bit pictures without a temperature scale: their levels are only counts"
    todo = "state it if it is known, with --read unit=centikelvin or data.unit in the recipe; unit=counts accepts them"
    return [Problem(dataset.root.name, "image-counts", found, "a scale, for temperatures", todo, "warning")]


def describe_scales(dataset: Dataset) -> dict[str, int]:
    """Return the number of pictures by their temperature scale and its source; 8-bit pictures do not count."""
    found: dict[str, int] = {}
    for image in dataset.images:
        if image.radiometry is None:
            continue
        scale = image.radiometry.scale
        text = "counts without a scale" if scale is None else f"{scale.describe()} ({image.radiometry.source})"
        found[text] = found.get(text, 0) + 1
    return dict(sorted(found.items()))


def info_of_scale(images: Iterable[ImageRecord]) -> dict[str, Any] | None:
    """Return the scale that all pictures share, as JSON values; None if there is none."""
    scales = {None if i.radiometry is None else i.radiometry.scale for i in images}
    (scale,) = scales if len(scales) == 1 else (None,)
    return None if scale is None else scale.to_json()
