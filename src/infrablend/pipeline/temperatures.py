"""Writes the radiometric layers of DJI and FLIR pictures as 16-bit PNG files with their temperature scale."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.file_names import distinct_names, file_name, leaves
from infrablend.core.files import write_bytes, write_chunks
from infrablend.core.finished import TEMPERATURES_FILE
from infrablend.core.output import require_apart
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.temperature import TemperatureScale, describe_plausible, implausible_median
from infrablend.errors import ArgumentError, DatasetError, Problem
from infrablend.formats.coco import coco_chunks
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
_FULL = 65_535
_MOST_SPOT_C = 3_000.0
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
        if not -ZERO_C_K < float(match[4]) < _MOST_SPOT_C:
            raise ArgumentError(f"spot {text!r}: expected a temperature from {-ZERO_C_K:g} to {_MOST_SPOT_C:g}")
        return cls(match[1], (int(match[2]), int(match[3])), float(match[4]))


@dataclass(frozen=True, eq=False)
class _Layer:
    """A radiometric layer as it is written.

    Attributes:
        levels: (h, w) 16-bit pixels.
        scale: Their scale; None for counts alone.
        source: Where the scale comes from.
        unfit: Number of pixels without a temperature, or with one that 16 bits do not hold.
    """

    levels: NDArray[np.uint16]
    scale: TemperatureScale | None
    source: str
    unfit: int = 0

    @property
    def kelvin(self) -> NDArray[np.float64]:
        """The temperatures of a layer with a scale, kelvin, as one row without what does not fit."""
        assert self.scale is not None
        fitting = self.levels[(self.levels > 0) & (self.levels < _FULL)] if self.unfit else self.levels
        return self.scale.kelvin(fitting.ravel())

    @classmethod
    def of_kelvin(cls, kelvin: NDArray[np.float64], source: str) -> _Layer:
        """Return a layer in centikelvin; what does not fit becomes 0 or 65535."""
        unfit = int((~(kelvin < _FULL * _CENTIKELVIN.slope_k)).sum())
        return cls(_CENTIKELVIN.counts(np.nan_to_num(kelvin, nan=0.0)), _CENTIKELVIN, source, unfit)


@dataclass(frozen=True)
class _Written:
    """What is known of a layer that was written: its record, its range and median in kelvin, and its unfit pixels."""

    record: ImageRecord
    range_k: tuple[float, float] | None
    implausible_k: float | None
    unfit: int


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
        if self.slope_k is not None and self.slope_k < 0:
            raise ArgumentError(f"slope {self.slope_k:g}: found a negative one; DJI's counts rise with temperature")
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
    require_apart(dataset.root, out)
    stated = _stated_scale(dataset, scale)
    problems: list[Problem] = []
    layers: list[_Written] = []
    stems = Counter(i.path.stem for i in dataset.images)
    names = distinct_names([file_name(str(PurePosixPath(i.name).with_suffix(""))) for i in dataset.images])
    tell = paced(on_progress)
    with folder.writing({"source": str(dataset.root)}, overwrite):
        for k, (image, name) in enumerate(zip(dataset.images, names, strict=True)):
            try:
                raw = read_temperatures(image.path)
                layer = _layer(raw, image, scale, stated, unique=stems[image.path.stem] == 1)
                layers.append(_write(raw, layer, image, f"{name}.png", out))
            except DatasetError as error:
                problems += error.problems
            if tell is not None:
                tell(k + 1, len(dataset.images))
        images = [w.record for w in layers]
        if not images:
            raise DatasetError(f"{dataset.root}: no temperatures in {len(dataset.images)} picture(s)", problems)
        for split, chunks in coco_chunks(images, (), Counter()).items():
            write_chunks(out / "annotations" / f"instances_{split}", chunks)
        scales = Counter(_scale_text(i) for i in images)
        problems += _remarks(dataset, layers) + folder.problems()
        ranges = [w.range_k for w in layers if w.range_k is not None]
        span = (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None
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


def _write(raw: RawTemperatures, layer: _Layer, image: ImageRecord, name: str, out: Path) -> _Written:
    """Write one layer; return what is known of it."""
    path = write_bytes(out / "images" / image.split / name, png_bytes(layer.levels))
    h, w = layer.levels.shape
    hfov = image.hfov_deg
    if hfov is not None and image.path.suffix.lower() in (".jpg", ".jpeg"):
        facts = read_facts(image.path)
        # The layer shows what digital zoom cuts off the picture. A field of view from a table is taken literally.
        hfov = zoomed(hfov, 1 / facts.zoom) if facts.value("hfov_deg") == hfov else hfov
    record = replace(
        image, path=path, file_name=name, size_wh=(w, h), instances=(), hfov_deg=hfov,
        radiometry=raw.facts(layer.scale, layer.source),
    )  # fmt: skip
    if layer.scale is None or not layer.kelvin.size:
        return _Written(record, None, None, layer.unfit)
    kelvin = layer.kelvin
    span = float(kelvin.min()), float(kelvin.max())
    return _Written(record, span, implausible_median(kelvin), layer.unfit)


def _layer(
    raw: RawTemperatures, image: ImageRecord, given: CountScale, stated: TemperatureScale | None, *, unique: bool
) -> _Layer:
    """Return the layer to write; `unique` says that no other picture has the name of this one."""
    kelvin = raw.apparent_k
    if kelvin is not None:
        return _Layer.of_kelvin(kelvin, "FLIR's Planck constants")
    if given.converted is not None and given.unit is not None:
        h, w = raw.counts.shape
        path = _converted_file(image, given.converted, unique=unique)
        return _Layer.of_kelvin(read_converted(path, given.unit, (w, h)), "converted by another program")
    if stated is not None:
        return _Layer(raw.counts, stated, "fitted to stated temperatures" if given.spots else "stated")
    return _Layer(raw.counts, None, "none")


def _converted_file(image: ImageRecord, folder: Path, *, unique: bool) -> Path:
    """Return the converted file of a picture: in the same folder below `folder`, or else in `folder` itself.

    Raises:
        DatasetError: There is none, or it could be that of another picture of the same name.
    """
    relative = PurePosixPath(image.name)
    own = not leaves(image.name) and (len(relative.parts) > 1 or unique)
    if own and (path := _tiff(folder / relative.parent, relative.stem)) is not None:
        return path
    if unique and (path := _tiff(folder, image.path.stem)) is not None:
        return path
    found = f"no {relative.with_suffix('.tif')} in {folder}"
    if not unique:
        found += ", and other pictures have the same name without the folder"
    todo = "convert it too" if unique else "keep the folders of the pictures when converting them"
    raise DatasetError(found, [Problem(image.name, "raw-missing", found, "a TIFF per picture", todo)])


def _tiff(folder: Path, stem: str) -> Path | None:
    return next((p for s in (".tif", ".tiff", ".TIF", ".TIFF") if (p := folder / (stem + s)).is_file()), None)


def _scale_text(image: ImageRecord) -> str:
    known = image.radiometry
    return _COUNTS_ALONE if known is None or known.scale is None else f"{known.scale.describe()} ({known.source})"


def _remarks(dataset: Dataset, layers: Sequence[_Written]) -> list[Problem]:
    # What is missing is asked for when the layers are used.
    problems = [p for p in dataset.problems if p.code.startswith("flight-") and p.code != "flight-missing"]
    where = dataset.root.name
    alone = [w for w in layers if _scale_text(w.record) == _COUNTS_ALONE]
    if alone:
        makers = {w.record.extra.get("camera", "") for w in alone}
        why = "the files lack the constants of their conversion"
        if any(str(m).upper().startswith("DJI") for m in makers) or makers == {""}:
            why = "DJI does not publish how to convert them"
        found = f"{len(alone)} of {len(layers)} layers are only counts: {why}"
        todo = "give --slope and --offset, two --spot temperatures, or --converted files, if you need temperatures"
        problems.append(Problem(where, "counts-only", found, "a scale from counts to kelvin", todo, "warning"))
    hot = [w.implausible_k for w in layers if w.implausible_k is not None]
    if hot:
        found = f"{len(hot)} of {len(layers)} picture(s) with a median of {_span(hot)} degrees Celsius"
        todo = "check the unit, the slope and the offset"
        problems.append(Problem(where, "temperature-implausible", found, describe_plausible(), todo, "warning"))
    unfit = [w for w in layers if w.unfit]
    if unfit:
        found = f"{sum(w.unfit for w in unfit)} pixel(s) of {len(unfit)} picture(s) without a temperature below 655 K"
        expected = "temperatures that fit into 16 bits in centikelvin; others are 0 or 65535"
        problems.append(Problem(where, "temperature-clipped", found, expected, severity="warning"))
    labels = sum(len(i.instances) for i in dataset.images)
    if labels:
        found = f"{labels} label(s) of the pictures not carried over: the layer's size and zoom are its own"
        problems.append(Problem(where, "labels-dropped", found, "pictures without labels", severity="warning"))
    return problems


def _span(kelvin: Iterable[float]) -> str:
    """Return a range of temperatures in degrees Celsius as a text."""
    celsius = sorted(k - ZERO_C_K for k in kelvin)
    low, high = f"{celsius[0]:,.1f}", f"{celsius[-1]:,.1f}"
    return low if low == high else f"{low} to {high}"
