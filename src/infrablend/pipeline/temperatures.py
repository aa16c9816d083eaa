"""Writes the radiometric layers of DJI and FLIR pictures as 16-bit PNG files with their temperature scale."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.file_names import distinct_names, file_name
from infrablend.core.files import write_bytes, write_text
from infrablend.core.finished import TEMPERATURES_FILE
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.temperature import TemperatureScale
from infrablend.errors import ArgumentError, DatasetError, Problem
from infrablend.formats.coco import coco_files
from infrablend.formats.images import png_bytes
from infrablend.formats.rjpeg.facts import read_facts
from infrablend.formats.rjpeg.lens import zoomed
from infrablend.formats.rjpeg.temperatures import (
    CONVERTED_UNITS,
    RawTemperatures,
    fit_scale,
    read_converted,
    read_temperatures,
)
from infrablend.pipeline.dataset_folder import DatasetFolder
from infrablend.thermal.radiometry import ZERO_C_K

_CENTIKELVIN = TemperatureScale(0.01, 0.0, "centikelvin")
_SPOT = re.compile(r"(.+):(\d+),(\d+)=([-+]?\d+(?:\.\d+)?)", re.ASCII)
# Half the side of the square around a spot whose median count is taken, px.
_SPOT_REACH = 1
_COUNTS_ALONE = "counts without a scale"


@dataclass(frozen=True)
class Spot:
    """A temperature that the user knows at one place of a picture.

    Attributes:
        file: Name of the picture.
        xy: Column and row in the radiometric layer.
        celsius: Apparent temperature there.
    """

    file: str
    xy: tuple[int, int]
    celsius: float

    @classmethod
    def of_text(cls, text: str) -> Spot:
        """Return the spot in a text such as `DJI_0001_T.JPG:320,256=21.5`.

        Raises:
            ArgumentError: The text is no spot.
        """
        match = _SPOT.fullmatch(text.strip())
        if match is None:
            raise ArgumentError(f"spot {text!r}: expected FILE:X,Y=DEGREES, e.g. DJI_0001_T.JPG:320,256=21.5")
        return cls(match[1], (int(match[2]), int(match[3])), float(match[4]))


@dataclass(frozen=True)
class CountScale:
    """Where the scale of counts comes from that have none of their own; at most one of the three.

    Attributes:
        slope_k: Kelvin per count.
        offset_k: Kelvin of count 0.
        spots: Known temperatures, at least two; the scale is fitted to them.
        converted: Folder with a TIFF per picture, of the same stem, that another program wrote.
        unit: Unit of the converted files, see `CONVERTED_UNITS`.

    Raises:
        ArgumentError: The values do not fit together.
    """

    slope_k: float | None = None
    offset_k: float | None = None
    spots: Sequence[Spot] = ()
    converted: Path | None = None
    unit: str | None = None

    def __post_init__(self) -> None:
        if (self.slope_k is None) != (self.offset_k is None):
            raise ArgumentError("slope and offset: found one of them, expected both, or neither")
        if sum((self.slope_k is not None, bool(self.spots), self.converted is not None)) > 1:
            raise ArgumentError("slope and offset, spots, converted: found several, expected one source of the scale")
        if (self.converted is None) != (self.unit is None):
            raise ArgumentError("converted and unit: found one of them, expected both, or neither")
        if self.unit is not None and self.unit not in CONVERTED_UNITS:
            raise ArgumentError(f"unit {self.unit!r}: expected one of {', '.join(CONVERTED_UNITS)}")


NO_SCALE = CountScale()


@dataclass(frozen=True, eq=False)
class TemperaturesReport:
    """Result of an extraction.

    Attributes:
        out: Folder that was written.
        pictures: Number of pictures written.
        scales: Number of pictures per scale and its source.
        range_k: Lowest and highest apparent temperature, kelvin; None if no scale is known.
        problems: Pictures without a layer, damaged ones, and what is not known.
    """

    out: Path
    pictures: int
    scales: Mapping[str, int]
    range_k: tuple[float, float] | None
    problems: tuple[Problem, ...] = field(default=())

    @property
    def ok(self) -> bool:
        """True if every radiometric layer could be read."""
        return not any(p.severity == "error" for p in self.problems)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "ok": self.ok, "pictures": self.pictures, "scales": dict(self.scales),
            "range_k": None if self.range_k is None else list(self.range_k),
            "problems": [p.to_json() for p in self.problems],
        }  # fmt: skip


def extract_temperatures(
    dataset: Dataset,
    out: Path,
    scale: CountScale = NO_SCALE,
    *,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> TemperaturesReport:
    """Write the radiometric layer of every picture as a 16-bit PNG, in a COCO dataset that states the scale of each.

    FLIR's layers become apparent temperatures in centikelvin. DJI's counts are kept, with the scale that is given for
    them, if any; with converted files, these files' temperatures are written instead.

    Raises:
        ArgumentError: The scale does not fit the pictures.
        DatasetError: No picture has a radiometric layer.
        OutputError: The folder cannot be used or written.
    """
    folder = DatasetFolder(out, "extraction of temperatures", TEMPERATURES_FILE)
    folder.require_usable(overwrite)
    stated = _stated_scale(dataset, scale)
    problems: list[Problem] = []
    images, ranges = [], []
    names = distinct_names([file_name(str(PurePosixPath(i.name).with_suffix(""))) for i in dataset.images])
    tell = paced(on_progress)
    with folder.writing({"source": str(dataset.root)}, overwrite):
        for k, (image, name) in enumerate(zip(dataset.images, names, strict=True)):
            try:
                written = _write(image, f"{name}.png", out, scale, stated)
            except DatasetError as error:
                problems += error.problems
            else:
                images.append(written[0])
                ranges += [written[1]] if written[1] is not None else []
            if tell is not None:
                tell(k + 1, len(dataset.images))
        if not images:
            raise DatasetError(f"{dataset.root}: no radiometric layer in {len(dataset.images)} picture(s)", problems)
        for split, text in coco_files(images, ())[0].items():
            write_text(out / "annotations" / f"instances_{split}", text)
        scales = Counter(_scale_text(i) for i in images)
        problems += _remarks(dataset, images) + folder.problems()
        lowest = min((low for low, _ in ranges), default=None)
        span = None if lowest is None else (lowest, max(high for _, high in ranges))
        report = TemperaturesReport(out, len(images), dict(sorted(scales.items())), span, tuple(problems))
        folder.finish({"source": str(dataset.root)}, report.to_json())
    return report


def _stated_scale(dataset: Dataset, given: CountScale) -> TemperatureScale | None:
    try:
        if given.slope_k is not None:
            return TemperatureScale(given.slope_k, given.offset_k or 0.0)
        return fit_scale([_count_at(dataset, s) for s in given.spots]) if given.spots else None
    except ValueError as error:
        raise ArgumentError(f"scale: {error}") from error


def _count_at(dataset: Dataset, spot: Spot) -> tuple[float, float]:
    """Return the count around a spot and its temperature in kelvin."""
    found = [i for i in dataset.images if spot.file in (i.name, i.path.name)]
    if len(found) != 1:
        raise ArgumentError(f"spot {spot.file}: found {len(found)} pictures of this name, expected one")
    counts = read_temperatures(found[0].path).counts
    (x, y), (h, w) = spot.xy, counts.shape
    if x >= w or y >= h:
        raise ArgumentError(f"spot {spot.file}:{x},{y}: outside the radiometric layer of {w}x{h} px")
    near = counts[max(0, y - _SPOT_REACH) : y + _SPOT_REACH + 1, max(0, x - _SPOT_REACH) : x + _SPOT_REACH + 1]
    return float(np.median(near)), spot.celsius + ZERO_C_K


def _write(
    image: ImageRecord, name: str, out: Path, given: CountScale, stated: TemperatureScale | None
) -> tuple[ImageRecord, tuple[float, float] | None]:
    """Write one layer; return its record and its range in kelvin."""
    raw = read_temperatures(image.path)
    pixels, scale, source = _levels(raw, image, given, stated)
    path = write_bytes(out / "images" / image.split / name, png_bytes(pixels))
    h, w = pixels.shape
    hfov = image.hfov_deg
    if hfov is not None and image.path.suffix.lower() in (".jpg", ".jpeg"):
        facts = read_facts(image.path)
        # The layer shows what digital zoom cuts off the picture. A field of view from a table is taken literally.
        hfov = zoomed(hfov, 1 / facts.zoom) if facts.value("hfov_deg") == hfov else hfov
    record = replace(
        image, path=path, file_name=name, size_wh=(w, h), instances=(), hfov_deg=hfov,
        radiometry=raw.facts(scale, source),
    )  # fmt: skip
    span = (
        None if scale is None else tuple(sorted(float(v) for v in scale.kelvin(np.array([pixels.min(), pixels.max()]))))
    )
    return record, None if span is None else (span[0], span[1])


def _levels(
    raw: RawTemperatures, image: ImageRecord, given: CountScale, stated: TemperatureScale | None
) -> tuple[NDArray[np.uint16], TemperatureScale | None, str]:
    """Return the 16-bit pixels to write, their scale, and where that comes from."""
    kelvin = raw.apparent_k
    if kelvin is not None:
        # Counts that no black body gives are colder than anything that the camera shows.
        return _CENTIKELVIN.counts(np.nan_to_num(kelvin, nan=0.0)), _CENTIKELVIN, "FLIR's Planck constants"
    if given.converted is not None and given.unit is not None:
        path = next(
            (p for s in (".tif", ".tiff", ".TIF", ".TIFF") if (p := given.converted / (image.path.stem + s)).is_file()),
            None,
        )
        if path is None:
            found = f"no {image.path.stem}.tif in {given.converted}"
            raise DatasetError(
                found, [Problem(image.name, "raw-missing", found, "a TIFF per picture", "convert it too")]
            )
        converted = read_converted(path, given.unit)
        return _CENTIKELVIN.counts(np.nan_to_num(converted, nan=0.0)), _CENTIKELVIN, "converted by another program"
    if stated is not None:
        return raw.counts, stated, "fitted to stated temperatures" if given.spots else "stated"
    return raw.counts, None, "none"


def _scale_text(image: ImageRecord) -> str:
    known = image.radiometry
    return _COUNTS_ALONE if known is None or known.scale is None else f"{known.scale.describe()} ({known.source})"


def _remarks(dataset: Dataset, images: Sequence[ImageRecord]) -> list[Problem]:
    where, problems = dataset.root.name, []
    alone = sum(_scale_text(i) == _COUNTS_ALONE for i in images)
    if alone:
        found = f"{alone} of {len(images)} layers are only counts: DJI does not publish how to convert them"
        todo = "give --slope and --offset, two --spot temperatures, or --converted files, if you need temperatures"
        problems.append(Problem(where, "counts-only", found, "a scale from counts to kelvin", todo, "warning"))
    labels = sum(len(i.instances) for i in dataset.images)
    if labels:
        found = f"{labels} label(s) of the pictures not carried over: the layer's size and zoom are its own"
        problems.append(Problem(where, "labels-dropped", found, "pictures without labels", severity="warning"))
    return problems
