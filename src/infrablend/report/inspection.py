"""Summarise a dataset as figures and charts: splits, classes, sizes, coverage, sequences, leakage, problems."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import SPLITS, Dataset, ImageRecord, Instance, boxes_of
from infrablend.core.files import write_bytes
from infrablend.core.format_table import FORMATS
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import FormatModule
from infrablend.formats.image_groups import Leakage, leakage
from infrablend.formats.pictures.images import load_background
from infrablend.formats.pictures.listing import read_size
from infrablend.formats.pictures.temperature_scale import describe_scales
from infrablend.imaging.overlap import OverlapValue
from infrablend.imaging.surfaces import find_surfaces
from infrablend.report.charts import legend, matrix, panels, plot_text, png_bytes, stacked_bars

QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
# More distinct values than this are grouped into bins.
MAX_DISTINCT = 12
UNKNOWN = "unknown"


@dataclass(frozen=True, eq=False)
class Inspection:
    """Figures on one dataset, without a verdict.

    Attributes:
        root: Folder of the dataset.
        format: Name of the format.
        reason: Why the format was detected.
        splits: Number of `images`, `objects`, `ignore_regions` and images `without_objects` per split.
        classes: Number of objects per class and split.
        ignored: Classes that are regions to ignore.
        sizes_px: Square roots of box areas per class, px, ascending.
        coverage: Number of images per (pitch, altitude), both as text; `unknown` if not known.
        pitches: Pitches or their bins in order, `unknown` last.
        altitudes: Altitudes or their bins in order, `unknown` last.
        time_of_day: Number of images by day, by night and unknown, per split.
        labels: Number of objects with an oriented box, a mask, a track or a flag.
        sequences: Number of images per sequence.
        dates: Number of images per date of capture.
        tracks: Number of objects per track, over all sequences.
        picture_sizes: Number of images per size, as annotated, else from the file's header.
        temperatures: Number of images per temperature scale; empty if no image has one and none is stated.
        decoded: Number of images per bit depth and mode, grey levels, and the mean share of each kind of surface; empty
            without decoding.
        leakage: Neighbouring images in different splits.
        remarks: Known facts about this published dataset that its files do not contain.
        problems: Errors and warnings.
        notes: Notes of the reader.
        overlap: Yaw, ground pixel and lens that follow from the overlap of pictures, or in words why none do; None if
            no positions are stated.
    """

    root: Path
    format: str
    reason: str
    splits: Mapping[str, Mapping[str, int]]
    classes: Mapping[str, Mapping[str, int]]
    ignored: tuple[str, ...]
    sizes_px: Mapping[str, NDArray[np.float64]]
    coverage: Mapping[tuple[str, str], int]
    pitches: tuple[str, ...]
    altitudes: tuple[str, ...]
    time_of_day: Mapping[str, Mapping[str, int]]
    labels: Mapping[str, int]
    sequences: Mapping[str, int]
    dates: Mapping[str, int]
    tracks: Mapping[str, int]
    picture_sizes: Mapping[str, int]
    temperatures: Mapping[str, int]
    decoded: Mapping[str, Mapping[str, float]]
    leakage: tuple[Leakage, ...]
    remarks: tuple[str, ...]
    problems: tuple[Problem, ...]
    notes: Mapping[str, Any] = field(default_factory=dict)
    overlap: Sequence[OverlapValue] | str | None = None

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "root": str(self.root),
            "format": self.format,
            "reason": self.reason,
            "splits": {k: dict(v) for k, v in self.splits.items()},
            "classes": {
                name: {"objects": dict(of), "ignore": name in self.ignored, "sqrt_area_px": self.quantiles(name)}
                for name, of in self.classes.items()
            },
            "coverage": [
                {"pitch": p, "altitude": a, "images": self.coverage[p, a]}
                for p in self.pitches
                for a in self.altitudes
                if (p, a) in self.coverage
            ],
            "time_of_day": {k: dict(v) for k, v in self.time_of_day.items()},
            "labels": dict(self.labels),
            "sequences": dict(self.sequences),
            "dates": dict(self.dates),
            "tracks": {"count": len(self.tracks), "objects": sum(self.tracks.values())},
            "picture_sizes": dict(self.picture_sizes),
            "temperatures": dict(self.temperatures),
            "decoded": dict(self.decoded),
            "leakage": [one.to_json() for one in self.leakage],
            "remarks": list(self.remarks),
            "problems": [p.to_json() for p in self.problems],
            "notes": dict(self.notes),
            "overlap": self.overlap,
        }

    def quantiles(self, name: str) -> dict[str, float]:
        """Return quantiles of the square roots of a class's box areas, px, by the text of each; empty without boxes."""
        values = self.sizes_px[name]
        if not len(values):
            return {}
        return {f"{q:g}": round(float(v), 2) for q, v in zip(QUANTILES, np.quantile(values, QUANTILES), strict=True)}


def inspect_dataset(dataset: Dataset, reason: str = "", *, decode: bool = False) -> Inspection:
    """Return the figures on a dataset.

    Args:
        dataset: Dataset to inspect.
        reason: Why its format was detected.
        decode: Whether to decode every picture, for bit depth, channels, grey levels and broken files.
    """
    images = dataset.images
    present = [s for s in SPLITS if any(i.split == s for i in images)]
    ignored = {c.name for c in dataset.categories if c.ignore}
    names = [c.name for c in dataset.categories]
    names += sorted({o.category for i in images for o in i.instances} - set(names))
    objects: Counter[tuple[str, str]] = Counter((o.category, i.split) for i in images for o in i.instances)
    sizes: dict[str, list[float]] = {n: [] for n in names}
    for image in images:
        for o in image.instances:
            x0, y0, x1, y1 = o.box_xyxy
            sizes[o.category].append(float(np.sqrt((x1 - x0) * (y1 - y0))))
    pitch_of, pitches = _binned([i.capture.pitch_deg for i in images], "°")
    altitude_of, altitudes = _binned([i.capture.altitude_m for i in images], " m")
    decoded, more = _decode(images) if decode else ({}, [])
    problems = [*dataset.problems, *more]
    sizes_known = [_size(i, problems) for i in images]
    return Inspection(
        root=dataset.root,
        format=dataset.format,
        reason=reason,
        splits={
            s: {
                "images": sum(i.split == s for i in images),
                "objects": sum(n for (name, of), n in objects.items() if of == s and name not in ignored),
                "ignore_regions": sum(n for (name, of), n in objects.items() if of == s and name in ignored),
                "without_objects": sum(i.split == s and not i.instances for i in images),
            }
            for s in present
        },
        classes={n: {s: objects[n, s] for s in present} for n in names},
        ignored=tuple(n for n in names if n in ignored),
        sizes_px={n: np.sort(np.array(v, np.float64)) for n, v in sizes.items()},
        coverage=Counter(zip(pitch_of, altitude_of, strict=True)),
        pitches=pitches,
        altitudes=altitudes,
        time_of_day={
            s: _counted(
                (i.capture.time_of_day or UNKNOWN for i in images if i.split == s), (*get_args(TimeOfDay), UNKNOWN)
            )
            for s in present
        },
        labels=_label_kinds(images),
        sequences=_counted(i.capture.sequence for i in images if i.capture.sequence is not None),
        dates=_counted(i.capture.captured[:10] for i in images if i.capture.captured is not None),
        tracks=_counted(
            f"{i.capture.sequence or ''}/{o.track_id}" for i in images for o in i.instances if o.track_id is not None
        ),
        picture_sizes=_counted(f"{s[0]}x{s[1]}" if s else UNKNOWN for s in sizes_known),
        temperatures=describe_scales(dataset),
        decoded=decoded,
        leakage=leakage(images),
        remarks=tuple(
            text for known in FORMATS if (told := FormatModule.load(known.module).remarks) for text in told(dataset)
        ),
        problems=tuple(sorted(problems, key=lambda p: (p.severity, p.code, p.where))),
        notes=dataset.notes,
    )


def _counted(items: Iterable[str], order: Sequence[str] = ()) -> dict[str, int]:
    counts = Counter(items)
    return {k: counts[k] for k in (*order, *sorted(set(counts) - set(order))) if counts[k]}


def _binned(values: Sequence[float | None], unit: str) -> tuple[list[str], tuple[str, ...]]:
    """Return the text of each value and all texts in order; many distinct values are grouped into bins."""
    known = sorted({v for v in values if v is not None})
    few = len(known) <= MAX_DISTINCT
    width = 10.0
    while not few and len({v // width for v in known}) > MAX_DISTINCT:
        width *= 2

    def text(v: float) -> str:
        return f"{v:g}{unit}" if few else f"{v // width * width:g} to {(v // width + 1) * width:g}{unit}"

    texts = [UNKNOWN if v is None else text(v) for v in values]
    order = [*map(text, known), *([UNKNOWN] if UNKNOWN in texts else [])]
    return texts, tuple(dict.fromkeys(order))


def _label_kinds(images: Sequence[ImageRecord]) -> dict[str, int]:
    objects = [o for i in images for o in i.instances]
    kinds: dict[str, Callable[[Instance], bool]] = {
        "boxes": lambda o: True,
        "oriented_boxes": lambda o: o.corners_xy is not None,
        "masks": lambda o: o.mask is not None,
        "truncated": lambda o: o.truncated is True,
        "difficult": lambda o: o.difficult is True,
        "visibility": lambda o: o.visibility is not None,
        "tracked": lambda o: o.track_id is not None,
        "inserted": lambda o: o.inserted,
    }
    return {name: n for name, test in kinds.items() if (n := sum(test(o) for o in objects)) or name == "boxes"}


def _size(image: ImageRecord, problems: list[Problem]) -> tuple[int, int] | None:
    if image.size_wh is not None:
        return image.size_wh
    size_wh, problem = read_size(image.path, f"{image.split}/{image.name}")
    problems += [problem] if problem is not None else []
    return size_wh


def _decode(images: Sequence[ImageRecord]) -> tuple[dict[str, Mapping[str, float]], list[Problem]]:
    """Return figures on the pixels; one picture is in memory at a time."""
    kinds: Counter[str] = Counter()
    levels: list[tuple[int, int]] = []
    surfaces: Counter[str] = Counter()
    sums = 0.0
    pixels = 0
    problems: list[Problem] = []
    for image in images:
        try:
            picture = load_background(image.path, image.size_wh)
        except DatasetError as error:
            problems += error.problems
            continue
        problems += picture.problems
        channels = 3 if picture.mode == "RGB" else 1
        kinds[f"{picture.file_type}, {picture.bit_depth} bit, {channels} channel{'s' if channels > 1 else ''}"] += 1
        levels.append((int(picture.pixels.min()), int(picture.pixels.max())))
        sums += float(picture.pixels.sum(dtype=np.float64))
        pixels += picture.pixels.size
        surfaces.update(find_surfaces(picture.pixels, boxes_of(image.instances)).shares_of_kinds())
    found: dict[str, float] = {}
    if levels:
        lows, highs = zip(*levels, strict=True)
        found = {"lowest": min(lows), "mean": round(sums / pixels, 2), "highest": max(highs)}
    mean = {kind: round(share / len(levels), 3) for kind, share in surfaces.most_common()}
    return {"pictures": dict(sorted(kinds.items())), "grey_levels": found, "surfaces": mean}, problems


# -- charts ----------------------------------------------------------------------------------------------------


def write_charts(facts: Inspection, path: Path) -> Path:
    """Draw counts per class, sizes per class, pitch over altitude, day and night as one PNG; same facts, same bytes.

    Raises:
        OutputError: The file cannot be written.
    """
    figure, (counts, sizes, coverage, times) = panels(2, 2, (13, 9))
    names = list(facts.classes)
    splits = list(facts.splits)
    stacked_bars(counts, _plain(names), {s: [facts.classes[n][s] for n in names] for s in splits})
    counts.set(title="Objects by class", xlabel="objects")
    legend(counts)

    with_boxes = [n for n in names if len(facts.sizes_px[n])]
    if with_boxes:
        sizes.boxplot([facts.sizes_px[n] for n in with_boxes], whis=(5, 95), showfliers=False, widths=0.6)
        sizes.set_xticks(
            range(1, len(with_boxes) + 1), [plot_text(n) for n in _plain(with_boxes)], rotation=45, ha="right"
        )
        sizes.set_yscale("log")
    sizes.set(title="Box size by class (5, 25, 50, 75, 95 %)", ylabel="square root of area, px")

    grid = np.array([[facts.coverage.get((p, a), 0) for a in facts.altitudes] for p in facts.pitches])
    if grid.size:
        texts = [str(n or "") for n in grid.flat]
        matrix(coverage, grid / max(grid.max(), 1), texts, facts.pitches, facts.altitudes)
    coverage.set(title="Images by pitch and altitude", xlabel="altitude", ylabel="pitch below the horizon")

    kinds = [k for k in (*get_args(TimeOfDay), UNKNOWN) if any(k in of for of in facts.time_of_day.values())]
    stacked_bars(times, kinds, {s: [facts.time_of_day[s].get(k, 0) for k in kinds] for s in splits})
    times.set(title="Images by time of day", xlabel="images")
    return write_bytes(path, png_bytes(figure))


def _plain(names: Sequence[str]) -> list[str]:
    return [n[:40] for n in names]
