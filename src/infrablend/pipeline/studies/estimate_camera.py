"""Estimates pitch, roll, height and lens of the cameras of a dataset, from what its pictures and labels show.

Labelled people, cars and two-wheelers tell most: see `core.camera_fit`. What the data state, the horizon, upright lines
and the overlap of flights are sources beside them, and it is said where they contradict each other.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.camera_fit import CameraFit, fit_camera, size_ratios, turn_angles
from infrablend.core.capture import FACTS
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.files import write_text
from infrablend.core.output_checks import require_outside_datasets
from infrablend.core.tasks import OnProgress, paced
from infrablend.errors import ArgumentError, DatasetError, OutputError, Problem
from infrablend.formats.pictures.listing import read_size
from infrablend.formats.values import csv_text
from infrablend.pipeline.studies.flight_overlap import glance_at_overlap
from infrablend.pipeline.studies.labelled_camera import (
    LEAST_BOXES,
    SeenBoxes,
    SeenLines,
    Turns,
    find_lines,
    find_turns,
    rolls_of_spans,
    sized_boxes,
    still,
)
from infrablend.report.ground_preview import data_ground_sheet
from infrablend.sampling.calibration import PRIORS

Verdict = Literal["used", "agrees", "contradicts"]

# A normal value is within so many standard errors in 95 of 100 cases.
_WIDE = 1.96
# Labels tell the pitch if they do to this, for a lens that is given.
_TOLD_PITCH_RAD = math.radians(4.0)
# Upright lines are looked for in pictures of cameras that look down by less than this.
_LEVEL_RAD = math.radians(25.0)
# A camera that turns is believed if sizes then scatter less by this share.
_LESS_SCATTER = 0.8
# Standard errors of a stated pitch, and of one by the row where sky and ground seem to meet.
_STATED_SD_DEG = 1.0
_SKYLINE_SD_DEG = 1.0
# Logarithm of a size ratio beyond which a box is no such object on this ground.
_OUTLYING = math.log(1.25)
# Standard error of the pitch by upright lines, and size by which two classes contradict each other.
_LINES_SD_DEG = 2.0
_CLASSES_APART = 0.15
# The lens is told by labels if its error is less than this, as it is in fits of known cameras.
_TOLD_LENS = 0.15


@dataclass(frozen=True)
class CameraSettings:
    """What is known of a camera beside the data.

    Attributes:
        hfov_deg: Field of view across the picture's width, degrees [default: as the data state it].

    Raises:
        ArgumentError: It is no field of view.
    """

    hfov_deg: float | None = None

    def __post_init__(self) -> None:
        if self.hfov_deg is not None and not 0.1 <= self.hfov_deg <= 170:
            raise ArgumentError(f"hfov_deg: found {self.hfov_deg:g}, expected 0.1 to 170 degrees")


AS_STATED = CameraSettings()


@dataclass(frozen=True)
class CameraValue:
    """What one source says of one value.

    Attributes:
        name: `pitch_deg`, `roll_deg`, `altitude_m` or `hfov_deg`: the median of the pictures.
        source: Where it comes from.
        value: The value.
        half: Half of its interval of 95 %.
        verdict: `used`, or whether it `agrees` with the one that is used or `contradicts` it.
    """

    name: str
    source: str
    value: float
    half: float
    verdict: Verdict = "agrees"


@dataclass(frozen=True)
class ClassSizes:
    """Sizes of the boxes of a class, as shares of the sizes that the camera gives.

    Attributes:
        boxes: Number of boxes.
        objects: Number of objects, where tracks tell which are the same; else of boxes.
        offset: Median of how much larger they are.
        error: Median of how far they are from the expected size.
        outlying: Boxes of another size by more than a quarter: sitting, hidden in part, on a roof, vans.
    """

    boxes: int
    objects: int
    offset: float
    error: float
    outlying: int


@dataclass(frozen=True)
class CameraEstimate:
    """The camera of one sequence.

    Attributes:
        name: Name of the sequence; empty for a dataset without any.
        pictures: Number of its pictures.
        known: Number of those whose camera is known.
        turns: Whether the camera turns from picture to picture.
        values: What each source says.
        sizes: Sizes of the boxes by class.
        left_out: Numbers of boxes that were left out, by reason.
    """

    name: str
    pictures: int
    known: int
    turns: bool
    values: tuple[CameraValue, ...]
    sizes: Mapping[str, ClassSizes]
    left_out: Mapping[str, int]


@dataclass(frozen=True)
class CameraReport:
    """The cameras of a dataset.

    Attributes:
        cameras: Each of them.
        written: Files that were written.
        problems: Sequences whose camera is not known, and what contradicts each other.
        dataset: The dataset, whose pictures state what was found.
    """

    cameras: tuple[CameraEstimate, ...]
    written: tuple[Path, ...]
    problems: tuple[Problem, ...]
    dataset: Dataset = field(repr=False)

    @property
    def ok(self) -> bool:
        """Whether the camera of each sequence is known."""
        return not any(p.severity == "error" for p in self.problems)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "cameras": [asdict(camera) for camera in self.cameras],
            "written": [str(path) for path in self.written],
            "problems": [p.to_json() for p in self.problems],
        }


def estimate_camera(
    dataset: Dataset,
    out: Path | None = None,
    settings: CameraSettings = AS_STATED,
    *,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> CameraReport:
    """Estimate the camera of each sequence, or of all pictures that state the same where there are none.

    Args:
        dataset: Dataset with labels, or pictures that state pitch and height.
        out: CSV file to write what was found of each picture to, as a table that `--metadata` takes; a picture of the
            ground is written beside it.
        settings: What is known beside the data.
        overwrite: Replace an earlier table.
        on_progress: Called after each picture.

    Raises:
        DatasetError: No camera is known.
        OutputError: `out` exists, or cannot be written.
    """
    if out is not None:
        require_outside_datasets(dataset.root, out)
        if out.exists() and not overwrite:
            raise OutputError(f"{out}: exists; nothing was touched. Give another file, or --overwrite")
    groups = _groups(dataset)
    progress = paced(on_progress)
    total = len(dataset.images)
    done = 0

    def read() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(min(done, total), total)

    cameras = []
    problems: list[Problem] = []
    stating: dict[tuple[str, str], ImageRecord] = {}
    for name, images in groups.items():
        try:
            found = _estimate(name, images, settings, read)
        except DatasetError as error:
            problems += error.problems
            continue
        cameras.append(found.estimate)
        problems += found.problems
        stating |= {(i.split, i.id): i for i in found.images}
    if not cameras:
        raise DatasetError(f"{dataset.root}: no camera is known", problems)
    known = replace(dataset, images=tuple(stating.get((i.split, i.id), i) for i in dataset.images))
    written = () if out is None else _write(known, [*stating.values()], out)
    return CameraReport(tuple(cameras), written, tuple(problems), known)


def _groups(dataset: Dataset) -> dict[str, list[ImageRecord]]:
    """Return the pictures of each camera: of one sequence, or with the same stated pitch and height, and of one size.

    Raises:
        DatasetError: The size of a picture cannot be read.
    """
    found: dict[tuple[str, tuple[int, int]], list[ImageRecord]] = {}
    problems = []
    for image in dataset.images:
        size_wh, problem = (image.size_wh, None) if image.size_wh else read_size(image.path, image.name)
        if size_wh is None:
            problems += [problem] if problem else []
            continue
        capture = image.capture
        name = capture.sequence or ", ".join(
            f"{name.partition('_')[0]} {value:g}"
            for name in ("pitch_deg", "altitude_m")
            if (value := getattr(capture, name)) is not None
        )
        found.setdefault((name or "all pictures", size_wh), []).append(replace(image, size_wh=size_wh))
    if problems:
        raise DatasetError(f"{dataset.root}: pictures that cannot be read", problems)
    sizes = Counter(name for name, _ in found)
    return {name if sizes[name] == 1 else f"{name}, {w}x{h}": of for (name, (w, h)), of in found.items()}


@dataclass(frozen=True)
class _Found:
    """An estimate, the pictures of known cameras, which state it, and what contradicts it."""

    estimate: CameraEstimate
    images: list[ImageRecord]
    problems: list[Problem]


@dataclass(frozen=True, eq=False)
class _Fitted:
    """Boxes of a sequence and the camera that they agree with, for one way in which it may turn."""

    turns: Turns
    seen: SeenBoxes
    fit: CameraFit

    @property
    def scatter(self) -> float:
        """Median difference of boxes from the size that they should have."""
        return float(np.median(np.abs(self.fit.ratios)))

    @property
    def told(self) -> NDArray[np.bool_]:
        """(spans,) whether labels tell the pitch, for the lens that was taken."""
        by_lens = np.abs(np.sin(2 * self.fit.pitch_rad)) / 2 * self.fit.focal_sd
        return np.asarray(self.fit.pitch_sd**2 - by_lens**2 < _TOLD_PITCH_RAD**2)


def _estimate(name: str, images: list[ImageRecord], settings: CameraSettings, read: Callable[[], None]) -> _Found:
    """Return the camera of one sequence.

    Raises:
        DatasetError: It is not known.
    """
    size_wh = images[0].size_wh
    assert size_wh is not None
    stated = all(i.capture.pitch_deg is not None for i in images)
    turning = None
    if stated or images[0].capture.sequence is None or len(images) == 1:
        for _ in images:
            read()
    else:
        turning = find_turns(images, size_wh, read)
    lens = _stated_lens(images, settings)
    focal_px = None if lens is None else size_wh[0] / 2 / math.tan(math.radians(lens.value) / 2)
    lines = find_lines(images)
    ways = [still(len(images)), *([] if turning is None else [turning])]
    tried = [fitted for turns in ways if (fitted := _fitted(images, size_wh, turns, lines, focal_px)) is not None]
    if not tried:
        raise _too_few(name, sized_boxes(images, size_wh, ways[-1]))
    best = tried[-1] if tried[-1].scatter < _LESS_SCATTER * tried[0].scatter else tried[0]
    labels = best
    if stated:
        held = np.zeros(len(best.fit.pitch_rad))
        best = replace(best, fit=fit_camera(best.seen.boxes, focal_px, held))
    elif not best.told.any():
        raise _not_told(name, best)
    return _described(name, images, best, labels, lens, lines)


def _fitted(
    images: Sequence[ImageRecord], size_wh: tuple[int, int], turns: Turns, lines: SeenLines, focal_px: float | None
) -> _Fitted | None:
    """Return the camera that boxes agree with; None if there are too few of them."""
    seen = sized_boxes(images, size_wh, turns)
    if len(seen.boxes) < LEAST_BOXES:
        return None
    fit = fit_camera(seen.boxes, focal_px)
    rolls = rolls_of_spans(lines, turns, seen.spans.tolist(), fit.focal_px)
    level = abs(float(np.median(fit.pitch_rad)) + float(np.median(seen.boxes.pitch_rad))) < _LEVEL_RAD
    if level and np.isfinite(rolls).any():
        fit = fit_camera(seen.boxes, focal_px, roll_rad=rolls)
    return _Fitted(turns, seen, fit)


def _stated_lens(images: Sequence[ImageRecord], settings: CameraSettings) -> CameraValue | None:
    """Return the field of view that is given, stated, or told by the overlap of a flight; None without any."""
    if settings.hfov_deg is not None:
        return CameraValue("hfov_deg", "given", settings.hfov_deg, 0.0, "used")
    if stated := [i.capture.hfov_deg for i in images if i.capture.hfov_deg is not None]:
        return CameraValue("hfov_deg", "stated", float(np.median(stated)), 0.0, "used")
    overlap = glance_at_overlap(images)
    for value in overlap if isinstance(overlap, list) else ():
        if value["name"] == "hfov_deg":
            half = (value["high"] - value["low"]) / 2
            return CameraValue("hfov_deg", "overlap", value["value"], half, "used")
    return None


def _too_few(name: str, seen: SeenBoxes) -> DatasetError:
    left_out = ", ".join(f"{n} {reason}" for reason, n in seen.left_out.items())
    found = f"{len(seen.boxes)} boxes of people, cars or bicycles in different places"
    found += f" ({left_out} left out)" if left_out else ""
    todo = "label more, over all of the ground that is seen; or state pitch, height and lens in metadata.csv"
    problem = Problem(name, "labels-few", found, f"at least {LEAST_BOXES}", todo)
    return DatasetError(f"{name}: too few labels", [problem])


def _not_told(name: str, fitted: _Fitted) -> DatasetError:
    fit = fitted.fit
    rows = fitted.seen.boxes.boxes[:, 3]
    error = math.degrees(float(fit.pitch_sd.min()))
    found = (
        f"{len(rows)} boxes, with their feet in rows over {np.ptp(rows):.0f} px, tell the pitch to {error:.0f} degrees"
    )
    found += f"; only the height over the focal length, {1000 * fit.factor / fit.focal_px:.3g} mm per px, follows"
    todo = "state pitch_deg in metadata.csv (90 for a camera that looks straight down)"
    expected = "boxes whose size changes from row to row: not those of a camera that looks straight down"
    return DatasetError(f"{name}: no pitch", [Problem(name, "pitch-untold", found, expected, todo)])


def _described(
    name: str,
    images: Sequence[ImageRecord],
    used: _Fitted,
    labels: _Fitted,
    lens: CameraValue | None,
    lines: SeenLines,
) -> _Found:
    """Return the estimate, beside what the other sources say, and the pictures that state it."""
    focal_px = used.fit.focal_px
    known = _known(images, used)
    pitch = {k: i.capture.pitch_deg for k, i in known.items() if i.capture.pitch_deg is not None}
    values = [*_lens_values(used, lens, images[0])]
    values += _pitch_values(images, used, labels, pitch)
    middle = float(np.median([*pitch.values()]))
    if middle < math.degrees(_LEVEL_RAD):
        by_row = {k: -math.degrees(math.atan(row / focal_px)) for k, row in lines.horizons.items()}
        by_lines = {k: math.degrees(math.atan(slope * focal_px)) for k, slope in lines.slopes.items()}
        values += _beside("pitch_deg", "horizon", pitch, middle, by_row, _SKYLINE_SD_DEG)
        values += _beside("pitch_deg", "upright lines", pitch, middle, by_lines, _LINES_SD_DEG)
    values += _height_and_roll(images, used, known, lines)
    sizes = _sizes(images, used)
    estimate = CameraEstimate(
        name,
        len(images),
        len(known),
        used.turns.count > 1 or bool(np.ptp(used.turns.turned, axis=0).any()),
        tuple(_judged(values)),
        sizes,
        dict(used.seen.left_out),
    )
    return _Found(estimate, [*known.values()], _doubts(estimate))


def _known(images: Sequence[ImageRecord], used: _Fitted) -> dict[int, ImageRecord]:
    """Return the pictures whose camera is known, by their numbers, with pitch, roll, height and lens."""
    fit = used.fit
    told = used.told | (fit.pitch_sd == 0)
    numbers = {span: k for k, span in enumerate(used.seen.spans.tolist()) if told[k]}
    chosen = [k for k, span in enumerate(used.turns.spans.tolist()) if span in numbers]
    spans = np.array([numbers[int(used.turns.spans[k])] for k in chosen])
    captures = [images[k].capture for k in chosen]
    stated = [np.radians([getattr(c, name) or 0.0 for c in captures]) for name in ("pitch_deg", "roll_deg")]
    pitches, rolls = turn_angles(
        fit.pitch_rad[spans] + stated[0], fit.roll_rad[spans] + stated[1], used.turns.turned[chosen], fit.focal_px
    )
    hfov = math.degrees(2 * math.atan(used.seen.boxes.size_wh[0] / 2 / fit.focal_px))
    known = {}
    for k, capture, pitch, roll in zip(chosen, captures, np.degrees(pitches), np.degrees(rolls), strict=True):
        facts = replace(
            capture,
            pitch_deg=round(float(pitch), 2),
            roll_deg=round(float(roll), 2),
            altitude_m=round(fit.factor * (capture.altitude_m or 1.0), 2),
            altitude_from="labels",
            hfov_deg=round(hfov, 2),
        )
        known[k] = replace(images[k], capture=facts)
    return known


def _lens_values(used: _Fitted, lens: CameraValue | None, image: ImageRecord) -> Iterator[CameraValue]:
    if lens is not None:
        yield lens
        return
    width = used.seen.boxes.size_wh[0]
    value = 2 * math.atan(width / 2 / used.fit.focal_px)
    half = _WIDE * math.degrees(math.sin(value) * used.fit.focal_sd)
    source = "labels" if used.fit.focal_sd < _TOLD_LENS else "assumed"
    yield CameraValue("hfov_deg", source, math.degrees(value), half, "used")


def _pitch_values(
    images: Sequence[ImageRecord], used: _Fitted, labels: _Fitted, pitch: Mapping[int, float]
) -> Iterator[CameraValue]:
    """Yield the pitch by labels, and the stated one, which is used where it is known."""
    middle = float(np.median([*pitch.values()]))
    offset = math.degrees(float(np.median(labels.fit.pitch_rad)))
    half = _WIDE * math.degrees(float(np.median(labels.fit.pitch_sd)))
    stated = [i.capture.pitch_deg for i in images if i.capture.pitch_deg is not None]
    if used is labels:
        yield CameraValue("pitch_deg", "labels", middle, half, "used")
    else:
        yield CameraValue("pitch_deg", "stated", float(np.median(stated)), _WIDE * _STATED_SD_DEG, "used")
        yield CameraValue("pitch_deg", "labels", middle + offset, half)


def _height_and_roll(
    images: Sequence[ImageRecord], used: _Fitted, known: Mapping[int, ImageRecord], lines: SeenLines
) -> Iterator[CameraValue]:
    fit = used.fit
    heights = [i.capture.altitude_m for i in known.values() if i.capture.altitude_m is not None]
    height = float(np.median(heights))
    yield CameraValue("altitude_m", "labels", height, _WIDE * fit.factor_sd * height, "used")
    if stated := [i.capture.altitude_m for i in images if i.capture.altitude_m is not None]:
        yield CameraValue("altitude_m", "stated", float(np.median(stated)), _WIDE * PRIORS["take-off"].sd * height)
    rolls = {k: i.capture.roll_deg for k, i in known.items() if i.capture.roll_deg is not None}
    middle = float(np.median([*rolls.values()]))
    half = _WIDE * math.degrees(float(np.median(fit.roll_sd)))
    yield CameraValue("roll_deg", "labels", middle, half, "used")
    by_lines = {k: math.degrees(roll) for k, roll in lines.rolls.items()}
    if abs(float(np.median([i.capture.pitch_deg or 0.0 for i in known.values()]))) < math.degrees(_LEVEL_RAD):
        yield from _beside("roll_deg", "upright lines", rolls, middle, by_lines, 0.5)


def _beside(
    name: str, source: str, known: Mapping[int, float], middle: float, told: Mapping[int, float], sd: float
) -> Iterator[CameraValue]:
    """Yield what another source says, as the difference in pictures where both are known."""
    apart = np.array([value - known[k] for k, value in told.items() if k in known])
    if len(apart):
        error = 1.48 * float(np.median(np.abs(apart - np.median(apart)))) / math.sqrt(len(apart))
        yield CameraValue(name, source, middle + float(np.median(apart)), _WIDE * math.hypot(error, sd))


def _judged(values: Sequence[CameraValue]) -> Iterator[CameraValue]:
    """Yield the values with verdicts: intervals that do not meet contradict each other."""
    used = {v.name: v for v in values if v.verdict == "used"}
    for v in values:
        by = used[v.name]
        if v.verdict == "agrees" and abs(v.value - by.value) > math.hypot(v.half, by.half):
            v = replace(v, verdict="contradicts")
        yield replace(v, value=round(v.value, 2), half=round(v.half, 2))


def _sizes(images: Sequence[ImageRecord], used: _Fitted) -> dict[str, ClassSizes]:
    """Return sizes of all boxes by class, also of those in the place of another."""
    every = sized_boxes(images, used.seen.boxes.size_wh, used.turns, every=True)
    spans = every.spans[every.boxes.spans]
    kept = np.isin(spans, used.seen.spans)
    boxes = replace(every.boxes, spans=np.searchsorted(used.seen.spans, spans)).part(kept)
    ratios = size_ratios(boxes, used.fit)
    found = {}
    for kind in np.unique(boxes.kinds).tolist():
        of = ratios[boxes.kinds == kind]
        offset = math.expm1(float(np.median(of)))
        error = math.expm1(float(np.median(np.abs(of))))
        objects = len(np.unique(boxes.objects[boxes.kinds == kind]))
        outlying = int((np.abs(of) > _OUTLYING).sum())
        found[kind] = ClassSizes(len(of), objects, round(offset, 3), round(error, 3), outlying)
    return found


def _doubts(estimate: CameraEstimate) -> list[Problem]:
    """Return warnings about sources that contradict the estimate, and about what nothing tells."""
    found = []
    for v in estimate.values:
        used = next(u for u in estimate.values if u.name == v.name and u.verdict == "used")
        if v.verdict == "contradicts":
            text = f"{v.name} {v.value:g} +- {v.half:g} by {v.source}, {used.value:g} +- {used.half:g} by {used.source}"
            todo = "look at the picture that --out writes; the latter is used"
            found.append(Problem(estimate.name, "sources-contradict", text, "the same by both", todo, "warning"))
        if v.source == "assumed":
            text = f"no lens is stated or told: {v.value:g} degrees are assumed, within {v.half:g}"
            todo = "give --hfov; sizes of upright objects hardly depend on it, pitch and lengths along the view do"
            found.append(Problem(estimate.name, "lens-assumed", text, "a field of view", todo, "warning"))
    apart = [s.offset for s in estimate.sizes.values() if s.objects >= LEAST_BOXES]
    if apart and max(apart) - min(apart) > _CLASSES_APART:
        text = ", ".join(f"{kind} {s.offset:+.0%}" for kind, s in estimate.sizes.items())
        todo = "look at the picture that --out writes: other objects, or ground of another height"
        expected = "sizes that agree"
        found.append(Problem(estimate.name, "classes-contradict", text, expected, todo, "warning"))
    if estimate.known < estimate.pictures:
        text = f"the movement of the camera is not known in {estimate.pictures - estimate.known} of {estimate.pictures}"
        todo = "they stay without a pitch, and generate leaves them out"
        found.append(Problem(estimate.name, "pictures-untold", f"{text} pictures", "details", todo, "warning"))
    return found


def _write(dataset: Dataset, images: Sequence[ImageRecord], out: Path) -> tuple[Path, ...]:
    """Write the table of the pictures whose camera is known, and the ground under some of them beside it."""
    rows = [(i.name, i.capture.to_json()) for i in images]
    columns = [name for name in FACTS if any(name in facts for _, facts in rows)]
    lines = [(name, *(facts.get(column, "") for column in columns)) for name, facts in rows]
    table = write_text(out, csv_text(("file", *columns), lines))
    return table, data_ground_sheet(replace(dataset, images=tuple(images)), out.with_suffix(".png"))
