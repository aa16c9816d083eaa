"""Fits a sensor profile to the pictures of a dataset and plots the fit.

Annotated objects are read for the local share of the camera and the looseness of the boxes.
"""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import os
import statistics
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from infrablend.annotation.looseness import tighten_image
from infrablend.annotation.measured_looseness import (
    MIN_BOXES,
    BoxExtent,
    BoxFigures,
    box_extent,
    looseness,
    looseness_against,
)
from infrablend.compositing.fitting import LAGS, MIN_EDGES, Fit, Survey, SurveySummary, chain_readings, fit_profile
from infrablend.compositing.object_contrast import (
    TIMES,
    LocalShareBound,
    ObjectContrast,
    bound_local_share,
    eight_bit,
    object_contrast,
)
from infrablend.config.sensor_profile import SensorProfile, find_profile
from infrablend.core.arguments import require_whole
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.file_names import real_path
from infrablend.core.files import read_regular, write_bytes, write_json
from infrablend.core.output_checks import require_apart, require_no_foreign
from infrablend.core.tasks import OnProgress, paced
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures.images import IN_COLOUR, Background, load_background
from infrablend.pipeline.datasets.origin import count_loosened, loosened_before
from infrablend.pipeline.plans.backgrounds import require_one_depth
from infrablend.report.profile_plots import draw_profile

# Percentiles of the used range of levels without a few stray pixels, as in `compositing.mapping.measure_levels`.
LEVEL_PERCENT = (0.05, 99.9)
# Smallest span from the darkest to the brightest level that counts as contrast, by bit depth.
LEAST_SPAN = {8: 8, 16: 64}
BOX_MARGIN_PX = 2
PROFILE_FILE = "profile.json"
PLOT_FILE = "profile.png"


@dataclass(frozen=True)
class ProfileReport:
    """Fitted profile and its comparison with the pictures.

    Attributes:
        profile: Fitted profile.
        path: JSON file of the profile, to use as `sensor.profile`.
        plot: PNG file of the plots.
        columns: Column titles of the comparison: pictures, fitted profile, optionally a shipped profile.
        rows: Rows of the comparison: quantity, and one text per column.
        problems: Pictures that were left out, with reasons.
        objects: Figures of the annotated objects, see `object_figures`.
    """

    profile: SensorProfile
    path: Path
    plot: Path
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]
    problems: tuple[Problem, ...]
    objects: ObjectFigures

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "profile": self.profile.model_dump(mode="json"),
            "path": str(self.path),
            "plot": str(self.plot),
            "columns": list(self.columns),
            "rows": {what: list(cells) for what, cells in self.rows},
            "problems": [p.to_json() for p in self.problems],
        }


def profile_dataset(
    dataset: Dataset,
    out: Path,
    *,
    count: int = 64,
    name: str | None = None,
    against: str | None = None,
    rendered: Dataset | None = None,
    on_progress: OnProgress | None = None,
) -> ProfileReport:
    """Fit a sensor profile to the pictures of a dataset, and write the profile and its plots.

    Args:
        dataset: Dataset as read. Annotated objects are excluded from edges and noise, but not from the levels; the
            camera's local share and the looseness of the boxes are measured on them alone.
        out: Folder to write `profile.json` and `profile.png` into.
        count: Number of pictures to fit the camera to, evenly spread over the dataset.
        name: Name of the profile; by default that of the dataset folder.
        against: Name of a shipped profile to compare with.
        rendered: A run, read as a dataset, whose inserted objects have exact boxes to compare the annotated ones with.
        on_progress: Called after each picture.

    Raises:
        ArgumentError: `count` is below 1.
        DatasetError: No picture is usable, bit depths are mixed, contrast is too low, or there are too few clean edges;
            or `rendered` has no inserted objects, or not their exact boxes.
        RecipeError: There is no shipped profile named `against`.
        OutputError: `out` cannot be written.
    """
    require_whole("count", count, 1)
    require_apart(dataset.root, out)
    _require_own_profile(out)
    if rendered is not None:
        _require_exact(rendered)
    reference = None if against is None else find_profile(against)
    total = len(dataset.images)
    images = [dataset.images[i * total // min(count, total)] for i in range(min(count, total))]
    problems: list[Problem] = []
    usable, levels, histogram, bits = _levels(dataset, images, problems)
    scale = 1.0 if bits == 8 else (levels[1] - levels[0]) / 220.0
    survey = Survey(levels, len(usable), scale)
    annotated = annotated_pictures(dataset)
    inserted = [] if rendered is None else annotated_pictures(rendered, inserted=True)
    tick = _counter(len(usable) + len(annotated) + len(inserted), on_progress)
    for image in usable:
        picture = load_background(image.path, image.size_wh)
        survey.add(picture.pixels, _unannotated(image, picture), jpeg_quality(picture))
        tick()
    objects = object_figures(
        read_objects(dataset, annotated, levels, on_picture=tick),
        None if rendered is None else read_objects(rendered, inserted, levels, inserted=True, on_picture=tick),
    )
    problems += [] if rendered is None else _not_compared(rendered, objects)
    name = name or real_path(dataset.root).name or "pictures"
    edges = len(survey.edges)
    if edges < MIN_EDGES:
        raise DatasetError(
            f"{dataset.root}: {edges} clean edges in {survey.read} picture(s); expected at least {MIN_EDGES} steps of "
            "more than 35 levels between two flat areas. Use more pictures (--count), or scenes with roofs or roads",
            problems,
        )
    fit = fit_profile(survey, name, f"Fitted to {survey.read} of {total} pictures of {name}.")
    fit = replace(fit, profile=fit.profile.model_copy(update={"measured": {**fit.profile.measured, **objects}}))
    of_reference = None if reference is None else chain_readings(reference)
    plot = draw_profile(fit, histogram, against, of_reference)
    path = write_json(out / PROFILE_FILE, fit.profile.model_dump(mode="json"))
    columns, rows = _table(fit, survey, reference, of_reference)
    plot_path = write_bytes(out / PLOT_FILE, plot)
    return ProfileReport(fit.profile, path, plot_path, columns, rows, tuple(problems), objects)


def _counter(total: int, on_progress: OnProgress | None) -> Callable[[], None]:
    report = paced(on_progress)
    done = itertools.count(1)

    def tick() -> None:
        if report is not None:
            report(next(done), total)

    return tick


def pictures_taken_by(dataset: Dataset, time: str) -> Dataset:
    """Return the dataset with only the pictures known to be taken by `day` or by `night`.

    Raises:
        DatasetError: There are no such pictures.
    """
    chosen = tuple(i for i in dataset.images if i.capture.time_of_day == time)
    if not chosen:
        raise DatasetError(f"{dataset.root}: none of {len(dataset.images)} picture(s) is known to be taken by {time}")
    return replace(dataset, images=chosen)


def _levels(
    dataset: Dataset, images: Sequence[ImageRecord], problems: list[Problem]
) -> tuple[list[ImageRecord], tuple[float, float], NDArray[np.int64], int]:
    """Return the usable pictures, their range of levels, the histogram of levels, and the bit depth."""
    usable = []
    histogram = np.zeros(65536, np.int64)
    depths = set()
    for image, picture in _load(images, problems):
        usable.append(image)
        depths.add(picture.bit_depth)
        histogram += np.bincount(picture.pixels.ravel(), minlength=65536)
    if not usable:
        raise DatasetError(f"{dataset.root}: none of {len(images)} picture(s) can be used", problems)
    require_one_depth(dataset.root, depths)
    bits = depths.pop()
    low, high = (float(np.searchsorted(np.cumsum(histogram), p / 100 * histogram.sum())) for p in LEVEL_PERCENT)
    if high - low < LEAST_SPAN[bits]:
        raise DatasetError(
            f"{dataset.root}: no contrast: all but 0.1 % of the pixels are between {low:g} and {high:g}; expected a "
            f"span of at least {LEAST_SPAN[bits]} levels. Check that these are the camera's pictures",
            problems,
        )
    return usable, (low, high), histogram[: 2**bits], bits


def _load(images: Sequence[ImageRecord], problems: list[Problem]) -> Iterator[tuple[ImageRecord, Background]]:
    for image in images:
        try:
            picture = load_background(image.path, image.size_wh)
        except DatasetError as error:
            problems.extend(error.problems)
            continue
        if any(p.code == IN_COLOUR for p in picture.problems):
            found = "a colour picture, e.g. with a palette"
            expected = "grey levels of a thermal camera"
            problems.append(Problem(image.path.name, "profile-colour", found, expected, "export it as white-hot"))
            continue
        yield image, picture


def _unannotated(image: ImageRecord, picture: Background) -> NDArray[np.bool_] | None:
    """Return an (h, w) mask of the pixels without annotation; None for a picture without annotations."""
    if not image.instances:
        return None
    free = np.ones(picture.pixels.shape, np.bool_)
    for i in image.instances:
        x0, y0, x1, y1 = i.box_xyxy
        top = max(int(y0) - BOX_MARGIN_PX, 0)
        left = max(int(x0) - BOX_MARGIN_PX, 0)
        free[top : max(int(np.ceil(y1)) + BOX_MARGIN_PX, 0), left : max(int(np.ceil(x1)) + BOX_MARGIN_PX, 0)] = False
    return free


def jpeg_quality(picture: Background) -> int | None:
    """Return the quality (1 to 100) whose quantisation table is closest to that of the file; None if it is not JPEG."""
    if not picture.quantization:
        return None
    table = np.array(picture.quantization[0])
    return min(range(1, 101), key=lambda q: (int(np.abs(_quality_table(q) - table).sum()), -q))


@functools.cache
def _quality_table(quality: int) -> NDArray[np.int64]:
    file = io.BytesIO()
    Image.new("L", (8, 8)).save(file, "JPEG", quality=quality)
    tables: Mapping[int, Any] = Image.open(file).quantization
    return np.array(tables[0])


def _table(
    fit: Fit, survey: Survey, reference: SensorProfile | None, of_reference: SurveySummary | None
) -> tuple[tuple[str, ...], tuple[tuple[str, tuple[str, ...]], ...]]:
    chains = [(fit.found, None), (fit.chain, fit.profile)]
    columns = ["pictures", "fitted"]
    if reference is not None and of_reference is not None:
        chains.append((of_reference, reference))
        columns.append(reference.name)

    def number(value: float | None, digits: int = 2) -> str:
        return "-" if value is None else f"{value:.{digits}f}"

    def level(p: SensorProfile | None) -> str:
        levels = survey.levels if p is None else p.levels
        return "-" if levels is None else f"{levels[0]:g} to {levels[1]:g}"

    def quality(p: SensorProfile | None) -> str:
        return "" if p is None else "none" if p.codec_quality is None else str(p.codec_quality)

    files = str(round(statistics.median(survey.qualities))) if survey.qualities else "no JPEG"
    rows = [
        ("levels", [level(p) for _, p in chains]),
        ("edge sigma, px", [number(r.sigma_px) for r, _ in chains]),
        ("overshoot, bright side, %", [number(100 * r.overshoot[0], 1) for r, _ in chains]),
        ("overshoot, dark side, %", [number(100 * r.overshoot[1], 1) for r, _ in chains]),
        ("noise, levels", [number(r.noise_grey) for r, _ in chains]),
        *(
            (
                f"noise correlation at {lag} px",
                [number(r.correlations[lag - 1] if r.correlations else None) for r, _ in chains],
            )
            for lag in LAGS
        ),
        ("blockiness", [number(fit.found.blockiness, 3), *("" for _ in chains[1:])]),
        ("JPEG quality of the files", [files, *("" for _ in chains[1:])]),
        ("psf_sigma_px", ["" if p is None else number(p.psf_sigma_px) for _, p in chains]),
        ("halo_gain", ["" if p is None else number(p.halo_gain) for _, p in chains]),
        ("halo_radius_px", ["" if p is None else number(p.halo_radius_px) for _, p in chains]),
        ("noise_grey", ["" if p is None else number(p.noise_grey) for _, p in chains]),
        ("noise_grain_px", ["" if p is None else number(p.noise_grain_px) for _, p in chains]),
        ("codec_quality", [quality(p) for _, p in chains]),
    ]
    return tuple(columns), tuple((what, tuple(cells)) for what, cells in rows)


def _require_exact(rendered: Dataset) -> None:
    if not any(o.inserted for image in rendered.images for o in image.instances):
        todo = "give a run of `infrablend generate` that inserts the annotated classes"
        none = Problem("--rendered", "nothing-inserted", "no inserted object", "a run with inserted objects", todo)
        raise DatasetError(f"{rendered.root}: no exact boxes to compare with", [none])
    if not count_loosened(rendered) and (enlarged := sum(loosened_before(rendered, rendered).values())):
        found = f"{enlarged} boxes that are enlarged or fitted"
        todo = "give a run with coco in output.formats, or with exact boxes"
        unknown = Problem("--rendered", "boxes-enlarged", found, "the exact boxes", todo)
        raise DatasetError(f"{rendered.root}: the exact boxes of inserted objects are not known", [unknown])


def _not_compared(rendered: Dataset, objects: ObjectFigures) -> list[Problem]:
    """Return a warning if a run has too few inserted objects to correct the looseness of some annotated class."""
    given = Counter(o.category for i in rendered.images for o in i.instances if o.inserted)
    lacking = [c for c, boxes in objects["box_looseness"].items() if not boxes.get("against_rendered")]
    if not lacking:
        return []
    found = "the run does not correct the boxes of " + ", ".join(f"{c} ({given[c]} inserted)" for c in lacking)
    expected = f"about {4 * MIN_BOXES} inserted objects of each class, as large as the annotated ones"
    todo = "give a larger run of these classes, at the same time of day"
    return [Problem("--rendered", "too-few-rendered", found, expected, todo, "warning")]


def _require_own_profile(out: Path) -> None:
    path = out / PROFILE_FILE
    plot = out / PLOT_FILE
    try:
        own = path.is_file() and bool(SensorProfile.model_validate_json(read_regular(path)))
    except (OSError, ValueError):
        own = False
    foreign = [p for p in (path, plot) if os.path.lexists(p) and not own]
    require_no_foreign(foreign, out, "the profile", "an earlier profile", "--out")


MAX_PICTURES = 1000
"""Largest number of annotated pictures that are read, evenly spread."""


@dataclass
class ObjectReadings:
    """Readings of objects.

    Attributes:
        contrasts: Contrast of each object.
        extents: Box and visible extent of each object that has one.
    """

    contrasts: list[ObjectContrast] = field(default_factory=list)
    extents: list[BoxExtent] = field(default_factory=list)


def annotated_pictures(dataset: Dataset, *, inserted: bool = False) -> list[ImageRecord]:
    """Return the pictures to read objects from: those with annotated objects, or those with inserted ones."""
    found = [i for i in dataset.images if any(o.inserted == inserted for o in i.instances)]
    count = min(len(found), MAX_PICTURES)
    return [found[k * len(found) // count] for k in range(count)]


def read_objects(
    dataset: Dataset,
    images: Sequence[ImageRecord],
    levels: tuple[float, float],
    *,
    inserted: bool = False,
    on_picture: Callable[[], None] | None = None,
) -> ObjectReadings:
    """Measure the annotated objects, or the inserted ones, of pictures; pictures that cannot be read are left out.

    Args:
        dataset: Dataset of the pictures; regions to ignore are no objects.
        images: Pictures to read.
        levels: Darkest and brightest level, for 16-bit pictures.
        inserted: Whether to measure inserted objects instead of annotated ones, in the boxes that `labels.loosen`
            starts from.
        on_picture: Called after each picture.
    """
    ignored = {c.name for c in dataset.categories if c.ignore}
    found = ObjectReadings()
    for given in images:
        # Enlarged boxes of inserted objects say nothing about those of annotators.
        image = tighten_image(given, fitted=True) if inserted else given
        with contextlib.suppress(DatasetError):  # the problems of pictures are reported where the camera is fitted
            picture = eight_bit(load_background(image.path, image.size_wh).pixels, levels)
            key = f"{image.split}/{image.id}"
            level = float(np.median(picture))
            for o in image.instances:
                if o.inserted != inserted or o.category in ignored or o.truncated:
                    continue
                if (contrast := object_contrast(picture, o, image.instances)) is None:
                    continue
                time = image.capture.time_of_day or "unknown"
                of_object = ObjectContrast(o.category, key, time, contrast, level)
                found.contrasts.append(of_object)
                if (extent := box_extent(picture, o, image.instances, of_object)) is not None:
                    found.extents.append(extent)
        if on_picture is not None:
            on_picture()
    return found


class ObjectFigures(TypedDict):
    """Figures of a dataset's annotated objects, as plain JSON values; see `object_figures`."""

    local_share: dict[str, LocalShareBound]
    box_looseness: dict[str, BoxFigures]


def object_figures(annotated: ObjectReadings, rendered: ObjectReadings | None = None) -> ObjectFigures:
    """Return the figures of a dataset's annotated objects as plain JSON values.

    Args:
        annotated: Readings of annotated objects.
        rendered: Readings of inserted objects of the same classes, in boxes without a margin.

    Returns:
        `local_share` by time of day (see `bound_local_share`) and `box_looseness` by class: `by_time` (see `looseness`,
        and `against_rendered` from `looseness_against`), and the figures of the time with the smallest factor, because
        parts that cannot be seen make the extent smaller, never larger. Without times and classes that have too few
        objects.
    """
    by_daytime = {time: [c for c in annotated.contrasts if c.time_of_day == time] for time in TIMES}
    share = {time: bound for time, of in by_daytime.items() if (bound := bound_local_share(of)) is not None}
    boxes: dict[str, BoxFigures] = {}
    for category in sorted({e.category for e in annotated.extents}):
        by_time = {time: found for time in TIMES if (found := _looseness(annotated, rendered, category, time))}
        if by_time:
            least = min(by_time.values(), key=lambda of: float((of.get("against_rendered") or of)["factor"]))
            boxes[category] = {**least, "by_time": by_time}
    return {"local_share": share, "box_looseness": boxes}


def _looseness(
    annotated: ObjectReadings, rendered: ObjectReadings | None, category: str, time: str
) -> BoxFigures | None:
    drawn, exact = (
        [e for e in (of.extents if of else ()) if (e.category, e.time_of_day) == (category, time)]
        for of in (annotated, rendered)
    )
    figures = looseness(drawn)
    if figures is None or rendered is None:
        return None if figures is None else {**figures}
    return {**figures, "against_rendered": looseness_against(drawn, exact)}
