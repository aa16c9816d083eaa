"""Temperature scales of 16-bit pictures: those that the user states, and remarks on pictures without one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.temperature import Radiometry, TemperatureScale, describe_plausible, implausible_counts
from infrablend.core.workspace import TEMPERATURES_FILE
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures.images import load_background
from infrablend.formats.pictures.listing import open_picture

OPTIONS: Mapping[str, str] = {
    "unit": "unit of 16-bit pictures: centikelvin, decikelvin or counts",
    "slope": "kelvin per count, for the unit counts",
    "offset": "temperature of count 0 in kelvin, for the unit counts",
}
"""Options that every reader takes: `--read unit=centikelvin`, or `data.unit` in a recipe."""

IMPLAUSIBLE = "temperature-implausible"
"""Code of the problem of temperatures that no scene has."""

CHECK_SCALE = (
    "check the unit, the slope and the offset: counts of another unit look like this. If the pictures show the sky "
    "alone, state their pitch (0 or less) in metadata.csv or the recipe"
)
"""What to do about temperatures that no scene has."""

EXTRACT_AGAIN = (
    "run infrablend temperatures again with --slope and --offset, --spot, or --converted; "
    "unit=counts accepts them as they are"
)
"""What to do about counts that `infrablend temperatures` wrote without a scale: they are in no common unit."""

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

    It goes above what the files state, with a warning; without a scale, the pictures are only counts.
    """
    own = [i.capture.scale for i in dataset.images if i.capture.scale is not None]
    other = [s for s in own if s != scale]
    remarks = dataset.problems
    if other:
        texts = sorted({s.describe() for s in other})
        found = f"the scale of {len(other)} picture(s) in their own files ({'; '.join(texts[:3])}) is replaced by "
        found += "none" if scale is None else f"the stated one ({scale.describe()})"
        todo = "state no unit, slope or offset, unless the files are wrong"
        remarks = (*remarks, Problem(dataset.root.name, "scale-replaced", found, "one scale", todo, "warning"))

    def stated(image: ImageRecord) -> ImageRecord:
        if image.path.suffix.lower() not in DEEP_SUFFIXES:
            return image
        known = image.capture.radiometry or Radiometry(None)
        known = replace(known, scale=scale, source="stated")
        return replace(image, capture=replace(image.capture, radiometry=known))

    return replace(dataset, images=tuple(stated(i) for i in dataset.images), problems=remarks)


def deep_mode(image: ImageRecord) -> str:
    """Return Pillow's mode of a picture of more than 8 bits per channel by its header: `I...`, or `F` for floats.

    Empty for other pictures, and for those that cannot be read.
    """
    if image.path.suffix.lower() not in DEEP_SUFFIXES:
        return ""
    try:
        with open_picture(image.path) as picture:
            return str(picture.mode) if picture.mode.startswith(("I", "F")) else ""
    except Exception:  # unreadable pictures are reported where they are read
        return ""


def is_deep(image: ImageRecord) -> bool:
    """Return whether a picture has 16 bits per pixel, by its header; False if it cannot be read."""
    return deep_mode(image).startswith("I")


def scale_warnings(dataset: Dataset) -> list[Problem]:
    """Return warnings if 16-bit pictures have no temperature scale or one that makes no sense; a few are opened."""
    implausible = implausible_scales(dataset, shows_ground)
    if not any(is_deep(i) for i in _some([i for i in dataset.images if i.capture.radiometry is None])):
        return implausible
    found = "16-bit pictures without a temperature scale: their levels are only counts"
    todo = "state it if it is known, with --read unit=... or data.unit in the recipe; unit=counts accepts them"
    if from_radiometric_files(dataset):
        todo = EXTRACT_AGAIN
    return [
        *implausible,
        Problem(dataset.root.name, "image-counts", found, "a scale, for temperatures", todo, "warning"),
    ]


def _some(images: Sequence[ImageRecord]) -> Sequence[ImageRecord]:
    return images[:: max(1, len(images) // _LOOKED_AT)][:_LOOKED_AT]


def from_radiometric_files(dataset: Dataset) -> bool:
    """Return whether `infrablend temperatures` wrote the dataset."""
    return (dataset.root / TEMPERATURES_FILE).is_file()


def shows_ground(image: ImageRecord) -> bool:
    """Return False for pictures of cameras that look level or up, as far as is known: they may show the sky alone."""
    return image.capture.pitch_deg is None or image.capture.pitch_deg > 0


def implausible_scales(dataset: Dataset, ground: Callable[[ImageRecord], bool]) -> list[Problem]:
    """Return a warning if the medians of all pictures that are looked at are those of no scene.

    Args:
        dataset: Pictures; a few with a scale are opened.
        ground: Whether a picture shows the ground, not the sky alone.
    """
    medians = []
    of_ground = False
    for image in _some([i for i in dataset.images if i.capture.scale is not None]):
        try:
            pixels = load_background(image.path).pixels
        except DatasetError:  # unreadable pictures are reported where they are read
            continue
        if pixels.dtype == np.uint16:
            assert image.capture.scale is not None
            medians.append(implausible_counts(pixels, image.capture.scale, ground(image)))
            of_ground |= ground(image)
    wrong = [m for m in medians if m is not None]
    if not wrong or len(wrong) < len(medians):
        return []
    found = f"temperatures of no scene: medians of {min(wrong):,.1f} to {max(wrong):,.1f} K in {len(wrong)} picture(s)"
    todo = f"{EXTRACT_AGAIN}; or {CHECK_SCALE}" if from_radiometric_files(dataset) else CHECK_SCALE
    return [Problem(dataset.root.name, IMPLAUSIBLE, found, describe_plausible(of_ground), todo, "warning")]


def describe_scales(dataset: Dataset) -> dict[str, int]:
    """Return the number of pictures by their temperature scale and its source; 8-bit pictures do not count."""
    found: dict[str, int] = {}
    for image in dataset.images:
        if image.capture.radiometry is None:
            continue
        scale = image.capture.scale
        text = "counts without a scale" if scale is None else f"{scale.describe()} ({image.capture.radiometry.source})"
        found[text] = found.get(text, 0) + 1
    return dict(sorted(found.items()))


def scale_of_record(value: object, source: str, where: str) -> tuple[Radiometry | None, Problem | None]:
    """Return the scale in a field of a label file, or None and what is wrong with it."""
    if value is None:
        return None, None
    try:
        return Radiometry(TemperatureScale.from_json(value if isinstance(value, dict) else {}), source), None
    except ValueError as error:
        return None, Problem(where, "scale-malformed", str(error), "unit, slope_k, offset_k", severity="warning")


def info_of_scale(images: Iterable[ImageRecord]) -> dict[str, object] | None:
    """Return the scale that all pictures share, as JSON values; None if there is none."""
    scales = {i.capture.scale for i in images}
    (scale,) = scales if len(scales) == 1 else (None,)
    return None if scale is None else scale.to_json()
