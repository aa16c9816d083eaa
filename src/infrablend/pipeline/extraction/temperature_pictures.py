"""Writes the radiometric layers of DJI and FLIR pictures as 16-bit PNG files with their temperature scale."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.file_names import distinct_names, file_name, leaves
from infrablend.core.files import write_bytes, write_chunks
from infrablend.core.output_checks import require_apart
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.temperature import TemperatureScale, describe_plausible, implausible_median
from infrablend.core.workspace import TEMPERATURES_FILE, replacing, workspace
from infrablend.errors import ArgumentError, DatasetError, Problem
from infrablend.formats.cameras.header_facts import read_facts, zoomed
from infrablend.formats.cameras.raw_temperatures import (
    RawTemperatures,
    read_converted,
    read_temperatures,
)
from infrablend.formats.labels.coco import coco_chunks
from infrablend.formats.losses import LOSSES
from infrablend.formats.pictures.images import png_bytes
from infrablend.formats.pictures.temperature_scale import CHECK_SCALE, IMPLAUSIBLE, shows_ground
from infrablend.pipeline.extraction.count_scale import (
    NO_SCALE,
    CountScale,
    SpotCount,
    count_at,
    spot_warnings,
    stated_scale,
)
from infrablend.thermal.radiometry import ZERO_C_K

_CENTIKELVIN = TemperatureScale(0.01, 0.0, "centikelvin")
_FULL = 65_535
# Remarks on pictures that are taken as they are shown.
_OF_PLAIN_PICTURES = ("image-radiometric", "image-counts")
_OF_FLIR = "FLIR's Planck constants"
_COUNTS_ALONE = "counts without a scale"


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
    """What is known of a layer that was written.

    Attributes:
        record: Its record.
        source: Where its scale comes from.
        range_k: Its range, kelvin; None without a scale.
        implausible_k: Its median, kelvin, if that is one of no scene.
        unfit: Number of pixels without a temperature, or with one that 16 bits do not hold.
        labels_lost: Number of labels of the picture that do not fit the layer.
    """

    record: ImageRecord
    source: str
    range_k: tuple[float, float] | None
    implausible_k: float | None
    unfit: int
    labels_lost: int = 0


@dataclass(frozen=True, eq=False)
class TemperaturesReport:
    """Result of an extraction.

    Attributes:
        out: Folder that was written.
        pictures: Number of pictures written.
        scales: Number of pictures per scale and its source.
        range_k: Lowest and highest apparent temperature, kelvin; None if no scale is known.
        spots: Counts that were used for known temperatures, if any.
        problems: Pictures without a layer, damaged ones, and what is not known.
    """

    out: Path
    pictures: int
    scales: Mapping[str, int]
    range_k: tuple[float, float] | None
    spots: tuple[SpotCount, ...] = ()
    problems: tuple[Problem, ...] = field(default=())

    @property
    def ok(self) -> bool:
        """True if every radiometric layer could be read."""
        return not any(p.severity == "error" for p in self.problems)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "ok": self.ok,
            "pictures": self.pictures,
            "scales": dict(self.scales),
            "range_k": None if self.range_k is None else list(self.range_k),
            "spots": [s.to_json() for s in self.spots],
            "problems": [p.to_json() for p in self.problems],
        }


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
    require_apart(dataset.root, out)
    if scale.converted is not None and not scale.converted.is_dir():
        raise ArgumentError(
            f"--converted {scale.converted}: found no such folder, expected one with a TIFF per picture"
        )
    spots = tuple(count_at(dataset, s) for s in scale.spots)
    stated = stated_scale(scale, spots)
    problems: list[Problem] = []
    layers: list[_Written] = []
    stems = Counter(i.path.stem for i in dataset.images)
    names = distinct_names([file_name(str(PurePosixPath(i.name).with_suffix(""))) for i in dataset.images])
    tell = paced(on_progress)
    with workspace(out, "extraction of temperatures", TEMPERATURES_FILE, replacing(overwrite)) as space:
        for k, (image, name) in enumerate(zip(dataset.images, names, strict=True)):
            try:
                raw = read_temperatures(image.path)
                layer = _layer(raw, image, scale, stated, unique=stems[image.path.stem] == 1)
            except DatasetError as error:
                problems += error.problems
            else:
                layers.append(_write(raw, layer, image, f"{name}.png", space.folder))
            if tell is not None:
                tell(k + 1, len(dataset.images))
        if not layers:
            raise DatasetError(f"{dataset.root}: no temperatures in {len(dataset.images)} picture(s)", problems)
        images = [w.record for w in layers]
        losses: Counter[str] = Counter()
        for split, chunks in coco_chunks(images, dataset.categories, losses).items():
            write_chunks(space.folder / "annotations" / f"instances_{split}", chunks)
        scales = Counter(_scale_text(i) for i in images)
        problems += _of_reading(dataset, problems) + _remarks(dataset, layers) + spot_warnings(spots, stated)
        problems += _unused_scale(dataset, scale, layers)
        problems += [
            Problem(dataset.root.name, "labels-changed", f"{n} {LOSSES[kind]}", severity="warning")
            for kind, n in sorted(losses.items())
            if n
        ]
        ranges = [w.range_k for w in layers if w.range_k is not None]
        span = (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None
        report = TemperaturesReport(out, len(images), dict(sorted(scales.items())), span, spots, tuple(problems))
        space.finish({"source": str(dataset.root), **report.to_json()})
    return report


def _write(raw: RawTemperatures, layer: _Layer, image: ImageRecord, name: str, out: Path) -> _Written:
    path = write_bytes(out / "images" / image.split / name, png_bytes(layer.levels))
    h, w = layer.levels.shape
    facts = read_facts(image.path)
    hfov = image.capture.hfov_deg
    if hfov is not None and facts.value("hfov_deg") == hfov:
        # The layer shows what digital zoom cuts off the picture. A field of view from a table is taken literally.
        hfov = zoomed(hfov, 1 / facts.zoom)
    fits = facts.size_wh == (w, h) and facts.zoom == 1 and not facts.turned
    record = replace(
        image,
        path=path,
        file_name=name,
        size_wh=(w, h),
        instances=image.instances if fits else (),
        capture=replace(image.capture, hfov_deg=hfov, radiometry=raw.facts(layer.scale, layer.source)),
    )
    lost = 0 if fits else len(image.instances)
    kelvin = np.zeros(0) if layer.scale is None else layer.kelvin
    if not kelvin.size:
        return _Written(record, layer.source, None, None, layer.unfit, lost)
    span = float(kelvin.min()), float(kelvin.max())
    implausible = implausible_median(kelvin, shows_ground(image))
    return _Written(record, layer.source, span, implausible, layer.unfit, lost)


def _layer(
    raw: RawTemperatures, image: ImageRecord, given: CountScale, stated: TemperatureScale | None, *, unique: bool
) -> _Layer:
    """Return the layer to write; `unique` says that no other picture has the name of this one."""
    kelvin = raw.apparent_k
    if kelvin is not None:
        return _Layer.of_kelvin(kelvin, _OF_FLIR)
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
    known = image.capture.radiometry
    return _COUNTS_ALONE if known is None or known.scale is None else f"{known.scale.describe()} ({known.source})"


def _of_reading(dataset: Dataset, told: Sequence[Problem]) -> list[Problem]:
    """Return the problems of reading the pictures, but for those of pictures that the extraction reports itself."""
    known = {(p.where, p.code) for p in told}
    return [p for p in dataset.problems if p.code not in _OF_PLAIN_PICTURES and (p.where, p.code) not in known]


def _unused_scale(dataset: Dataset, given: CountScale, layers: Sequence[_Written]) -> list[Problem]:
    """Return a warning if a scale was given and FLIR's files have their own, which is used."""
    option = "--slope and --offset" if given.slope_k is not None else "--spot" if given.spots else ""
    option = option or ("--converted" if given.converted is not None else "")
    flir = sum(w.source == _OF_FLIR for w in layers)
    if not option or not flir:
        return []
    found = (
        f"{option} not used for {flir} of {len(layers)} picture(s): FLIR's files hold the constants of their conversion"
    )
    todo = "leave it out" if flir == len(layers) else ""
    return [Problem(dataset.root.name, "scale-unused", found, "a scale for DJI's counts", todo, "warning")]


def _remarks(dataset: Dataset, layers: Sequence[_Written]) -> list[Problem]:
    problems = []
    where = dataset.root.name
    alone = [w for w in layers if _scale_text(w.record) == _COUNTS_ALONE]
    if alone:
        makers = {w.record.capture.camera or "" for w in alone}
        why = "the files lack the constants of their conversion"
        if any(str(m).upper().startswith("DJI") for m in makers) or makers == {""}:
            why = "DJI does not publish how to convert them"
        found = f"{len(alone)} of {len(layers)} layers are only counts: {why}"
        todo = "give --slope and --offset, two --spot temperatures, or --converted files, if you need temperatures"
        problems.append(Problem(where, "counts-only", found, "a scale from counts to kelvin", todo, "warning"))
    hot = [w.implausible_k for w in layers if w.implausible_k is not None]
    if hot:
        found = f"{len(hot)} of {len(layers)} picture(s) with a median of {_span(hot)} degrees Celsius"
        problems.append(Problem(where, IMPLAUSIBLE, found, describe_plausible(True), CHECK_SCALE, "warning"))
    unfit = [w for w in layers if w.unfit]
    if unfit:
        found = f"{sum(w.unfit for w in unfit)} pixel(s) of {len(unfit)} picture(s) without a temperature below 655 K"
        expected = "temperatures that fit into 16 bits in centikelvin; others are 0 or 65535"
        problems.append(Problem(where, "temperature-clipped", found, expected, severity="warning"))
    lost = [w for w in layers if w.labels_lost]
    if lost:
        found = f"{sum(w.labels_lost for w in lost)} label(s) of {len(lost)} picture(s) left out: the layer is not the "
        found += "labelled picture, which has another size or is zoomed or turned"
        expected = "labels of pictures that show what the layer shows"
        todo = "label the 16-bit pictures, or take the plain pictures as data"
        problems.append(Problem(where, "labels-dropped", found, expected, todo))
    return problems


def _span(kelvin: Iterable[float]) -> str:
    celsius = sorted(k - ZERO_C_K for k in kelvin)
    low, high = f"{celsius[0]:,.1f}", f"{celsius[-1]:,.1f}"
    return low if low == high else f"{low} to {high}"
