"""What is known of the camera of one sequence: its labels of known size, its movement, its horizon, its lines."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from infrablend.core.camera_fit import SizedBoxes, turn_angles
from infrablend.core.dataset import ImageRecord, Instance, known_class
from infrablend.core.mesh import FloatArray
from infrablend.formats.pictures.images import load_background
from infrablend.imaging.camera_path import MOST_ERROR_PX, follow_camera
from infrablend.imaging.skyline import find_skyline
from infrablend.imaging.upright_lines import find_upright_lines
from infrablend.pipeline.plans.sequence_motion import sequence_views

LEAST_BOXES = 8
"""Fewer boxes in different places tell nothing of a camera."""
# Boxes of a span, beside which its pitch is not known.
_LEAST_OF_SPAN = 3
# A box in the place of another, but for this share of its height, says nothing new: the same person or parked car.
_SAME_PLACE = 0.4
_LEAST_PX = 6.0
_EDGE_PX = 1.0
# A camera moves if the middle of some picture does by this share of its height.
_STILL = 0.01
# Pictures in which lines and horizon are looked for.
_SAMPLES = 12


@dataclass(frozen=True, eq=False)
class Turns:
    """How the camera turns through a sequence.

    Attributes:
        spans: (pictures,) numbers of the spans; -1 where the movement is not known.
        turned: (pictures, 3, 3) from a picture's pixels to those of the first of its span, both from the middle.
    """

    spans: NDArray[np.int64]
    turned: FloatArray

    @property
    def count(self) -> int:
        """Number of spans."""
        return int(self.spans.max(initial=-1)) + 1


@dataclass(frozen=True, eq=False)
class SeenBoxes:
    """Boxes of known size, and why others were left out.

    Attributes:
        boxes: The boxes.
        pictures: (n,) numbers of their pictures.
        spans: Spans of the sequence by their numbers in the boxes.
        left_out: Numbers of others, by reason.
    """

    boxes: SizedBoxes
    pictures: NDArray[np.int64]
    spans: NDArray[np.int64]
    left_out: Counter[str]


def still(count: int) -> Turns:
    """Return that the camera does not turn through so many pictures."""
    return Turns(np.zeros(count, np.int64), np.tile(np.eye(3), (count, 1, 1)))


def find_turns(images: Sequence[ImageRecord], size_wh: tuple[int, int], on_picture: Callable[[], None]) -> Turns | None:
    """Return how the camera turns through pictures in their order, from their background; None if it is still."""
    numbered = [replace(image, capture=replace(image.capture, frame=k)) for k, image in enumerate(images)]
    moments = follow_camera(sequence_views(numbered, on_picture))
    middle = np.array([[1, 0, size_wh[0] / 2], [0, 1, size_wh[1] / 2], [0, 0, 1]])
    turned = np.linalg.inv(middle) @ np.array([m.to_first for m in moments]) @ middle
    spans = np.array([m.span if m.error_px <= MOST_ERROR_PX else -1 for m in moments])
    moved = np.abs(turned[:, :2, 2] / turned[:, 2:, 2]).max()
    return Turns(spans, turned) if spans.max(initial=0) > 0 or moved > _STILL * size_wh[1] else None


def sized_boxes(
    images: Sequence[ImageRecord], size_wh: tuple[int, int], turns: Turns, *, every: bool = False
) -> SeenBoxes:
    """Return the boxes of known size, one of each place, or `every` one; those that the picture's edge cuts are not."""
    left_out: Counter[str] = Counter()
    kept: list[tuple[int, Instance, FloatArray]] = []
    places: dict[tuple[str, int], list[FloatArray]] = {}
    for number, image in enumerate(images):
        for label in image.instances:
            if (kind := known_class(label.category)) is None or label.inserted:
                continue
            span = int(turns.spans[number])
            reason = _unfit(label, size_wh) or ("in pictures whose movement is not known" if span < 0 else None)
            box = label.box_xyxy - np.tile(np.array(size_wh) / 2, 2)
            before = places.setdefault((kind, span), [])
            middle = turns.turned[number] @ [*(box[:2] + box[2:]) / 2, 1.0]
            there = np.array([*middle[:2] / middle[2], box[3] - box[1]])
            if reason is None and before and not every and _is_near(there, np.array(before)):
                reason = "in the place of another"
            if reason is not None:
                left_out[reason] += 1
                continue
            before.append(there)
            kept.append((number, label, box))
    spans = np.array([turns.spans[number] for number, _, _ in kept], np.int64)
    many = np.bincount(spans, minlength=turns.count) >= _LEAST_OF_SPAN
    left_out["of few in a part of the sequence"] += int((~many[spans]).sum())
    return _joined([k for k, span in zip(kept, spans, strict=True) if many[span]], images, size_wh, turns, left_out)


def _joined(
    kept: Sequence[tuple[int, Instance, FloatArray]],
    images: Sequence[ImageRecord],
    size_wh: tuple[int, int],
    turns: Turns,
    left_out: Counter[str],
) -> SeenBoxes:
    """Return the boxes as arrays; spans are numbered anew by those that have any."""
    pictures = np.array([number for number, _, _ in kept], np.int64)
    tracks = [(known_class(o.category), k if o.track_id is None else o.track_id) for k, (_, o, _) in enumerate(kept)]
    numbers = {track: k for k, track in enumerate(dict.fromkeys(tracks))}
    captures = [images[number].capture for number in pictures]
    spans, of_boxes = np.unique(turns.spans[pictures], return_inverse=True)
    boxes = SizedBoxes(
        np.array([known_class(o.category) or "" for _, o, _ in kept], np.str_),
        np.array([box for _, _, box in kept]).reshape(-1, 4),
        np.array([numbers[track] for track in tracks], np.int64),
        of_boxes,
        turns.turned[pictures],
        np.radians([c.pitch_deg or 0.0 for c in captures]),
        np.radians([c.roll_deg or 0.0 for c in captures]),
        np.array([c.altitude_m or 1.0 for c in captures]),
        size_wh,
    )
    return SeenBoxes(boxes, pictures, spans, +left_out)


def _unfit(label: Instance, size_wh: tuple[int, int]) -> str | None:
    x0, y0, x1, y1 = label.box_xyxy
    w, h = size_wh
    if label.is_crowd:
        return "crowds"
    if label.truncated or min(x0, y0) <= _EDGE_PX or x1 >= w - _EDGE_PX or y1 >= h - _EDGE_PX:
        return "cut by the picture's edge"
    return f"lower than {_LEAST_PX:g} px" if y1 - y0 < _LEAST_PX else None


def _is_near(there: FloatArray, others: FloatArray) -> bool:
    return bool((np.abs(others - there).max(axis=1) < _SAME_PLACE * there[2]).any())


@dataclass(frozen=True, eq=False)
class SeenLines:
    """What some pictures show beside labels, each with the number of its picture.

    Attributes:
        rolls: Roll by upright lines, radians.
        slopes: Tangent of the pitch over the focal length in pixels, by upright lines.
        horizons: Row of the horizon, from the middle of the picture, px.
    """

    rolls: dict[int, float]
    slopes: dict[int, float]
    horizons: dict[int, float]


def find_lines(images: Sequence[ImageRecord]) -> SeenLines:
    """Return upright lines and horizons of some of the pictures."""
    found = SeenLines({}, {}, {})
    for k in np.unique(np.linspace(0, len(images) - 1, _SAMPLES).astype(int)).tolist():
        background = load_background(images[k].path, images[k].size_wh)
        levels = background.pixels.astype(np.float32)
        unit = 1.0 if background.pixels.dtype == np.uint8 else max(float(np.ptp(levels)) / 255, 1.0)
        if (lines := find_upright_lines(np.clip((levels - levels.min()) / unit, 0, 255).astype(np.uint8))) is not None:
            found.rolls[k] = lines.roll_rad
            found.slopes[k] = lines.pitch_per_px
        if (row := find_skyline(levels, unit).horizon_px) is not None:
            found.horizons[k] = row - levels.shape[0] / 2
    return found


def rolls_of_spans(lines: SeenLines, turns: Turns, spans: Sequence[int], focal_px: float) -> FloatArray:
    """Return (spans,) the roll of each span's first picture by upright lines; NaN where none shows any."""
    zero = np.zeros(len(turns.spans))
    by_turning = turn_angles(zero, zero, turns.turned, focal_px)[1]
    told = [[roll - by_turning[k] for k, roll in lines.rolls.items() if turns.spans[k] == span] for span in spans]
    return np.array([np.median(of) if of else math.nan for of in told])
