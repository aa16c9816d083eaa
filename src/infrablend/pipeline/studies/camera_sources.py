"""What the labels of a sequence, and the sources beside them, say of its camera.

`describe_camera` puts values, intervals and verdicts beside each other; `doubts` turns contradictions into warnings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.camera_fit import CameraFit, size_ratios, turn_angles
from infrablend.core.dataset import ImageRecord
from infrablend.errors import Problem
from infrablend.pipeline.studies.labelled_camera import LEAST_BOXES, SeenBoxes, SeenLines, Turns, sized_boxes
from infrablend.sampling.calibration import PRIORS

Verdict = Literal["used", "agrees", "contradicts"]

LEVEL_RAD = math.radians(25.0)
"""Upright lines are looked for in pictures of cameras that look down by less than this."""

# A normal value is within so many standard errors in 95 of 100 cases.
_WIDE = 1.96
# Labels tell the pitch if they do to this, for a lens that is given.
_TOLD_PITCH_RAD = math.radians(4.0)
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


@dataclass(frozen=True, eq=False)
class FittedCamera:
    """Boxes of a sequence and the camera that they agree with, for one way in which it may turn.

    Attributes:
        turns: How it turns.
        seen: The boxes.
        fit: The camera.
    """

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


def describe_camera(
    name: str,
    images: Sequence[ImageRecord],
    used: FittedCamera,
    labels: FittedCamera,
    lens: CameraValue | None,
    lines: SeenLines,
) -> tuple[CameraEstimate, list[ImageRecord]]:
    """Return the camera of one sequence as all sources tell it, and the pictures where it is known, which state it.

    Args:
        name: Name of the sequence.
        images: Its pictures.
        used: The camera that is taken.
        labels: The camera that labels alone give.
        lens: The lens, where something other than labels tells it.
        lines: Upright lines and horizons of the pictures.
    """
    focal_px = used.fit.focal_px
    known = _known(images, used)
    pitch = {k: i.capture.pitch_deg for k, i in known.items() if i.capture.pitch_deg is not None}
    values = [*_lens_values(used, lens, images[0])]
    values += _pitch_values(images, used, labels, pitch)
    middle = float(np.median([*pitch.values()]))
    if middle < math.degrees(LEVEL_RAD):
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
    return estimate, [*known.values()]


def _known(images: Sequence[ImageRecord], used: FittedCamera) -> dict[int, ImageRecord]:
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


def _lens_values(used: FittedCamera, lens: CameraValue | None, image: ImageRecord) -> Iterator[CameraValue]:
    if lens is not None:
        yield lens
        return
    width = used.seen.boxes.size_wh[0]
    value = 2 * math.atan(width / 2 / used.fit.focal_px)
    half = _WIDE * math.degrees(math.sin(value) * used.fit.focal_sd)
    source = "labels" if used.fit.focal_sd < _TOLD_LENS else "assumed"
    yield CameraValue("hfov_deg", source, math.degrees(value), half, "used")


def _pitch_values(
    images: Sequence[ImageRecord], used: FittedCamera, labels: FittedCamera, pitch: Mapping[int, float]
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
    images: Sequence[ImageRecord], used: FittedCamera, known: Mapping[int, ImageRecord], lines: SeenLines
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
    if abs(float(np.median([i.capture.pitch_deg or 0.0 for i in known.values()]))) < math.degrees(LEVEL_RAD):
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


def _sizes(images: Sequence[ImageRecord], used: FittedCamera) -> dict[str, ClassSizes]:
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


def doubts(estimate: CameraEstimate) -> list[Problem]:
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
