"""What must not matter: a detector's figures on the same pictures with other borders, places, scales and levels.

A change says how a picture is laid out for the network. Detections are mapped back by the layout, so that labels stay
as they are. A crop alone makes another picture, and its labels are those of the cut picture.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import clip_boxes
from infrablend.core.rle_masks import Mask
from infrablend.core.rng import stream
from infrablend.detection.detection_source import DetectionSource
from infrablend.detection.matching import SIZE_BINS, match_all
from infrablend.detection.predict import FittedPicture, fit_picture
from infrablend.detection.tiles import PAD_GREY
from infrablend.detection.truth import Case, Truth, compared
from infrablend.lab.evaluation.evaluation_record import StressedFigures, StressFacts, StressRow
from infrablend.lab.evaluation.evaluation_settings import EvaluationSettings
from infrablend.lab.evaluation.precision import drawn_figures
from infrablend.lab.evaluation.small_targets import FOUND_IOU, as_one_class, found_and_named


@dataclass(frozen=True)
class Change:
    """A change of pictures that must not matter; called as `fit_picture` is, to prepare a changed picture.

    Attributes:
        name: What is changed, in words.
        border_px: Grey around the picture for the network, exact on the left and above, elsewhere up to its stride;
            None for that of an evaluation.
        shift_xy: How far the picture moves in that grey, px.
        window: What is kept of the picture: x0, y0, x1, y1 as shares of its width and height.
        scale: Factor of the size that the network sees.
        levels: What becomes of (h, w, c) grey levels, which are rounded and clipped after it.
    """

    name: str
    border_px: int | None = None
    shift_xy: tuple[int, int] = (0, 0)
    window: tuple[float, ...] = (0.0, 0.0, 1.0, 1.0)
    scale: float = 1.0
    levels: Callable[[NDArray[np.uint8]], NDArray[Any]] = np.asarray

    def __call__(self, pixels: NDArray[np.uint8], image_size: int, stride: int) -> FittedPicture:
        """Return a changed picture, prepared for the network."""
        height, width = pixels.shape[:2]
        x0, y0, x1, y1 = window_px(self.window, (width, height))
        kept = np.rint(self.levels(pixels[y0:y1, x0:x1])).clip(0, 255).astype(np.uint8)
        # Objects in a crop keep their size for the network.
        scale = self.scale * (image_size or max(height, width)) / max(height, width)
        plain = fit_picture(kept, round(max(kept.shape[:2]) * scale), stride)
        w, h = (round(size * scale) for size, scale in zip(plain.size_wh, plain.scale_xy, strict=True))
        x, y = plain.pad_xy
        border = plain.pad_xy if self.border_px is None else (self.border_px, self.border_px)
        left, top = (b + s for b, s in zip(border, self.shift_xy, strict=True))
        full = (math.ceil((size + 2 * b) / stride) * stride for size, b in zip((h, w), border[::-1], strict=True))
        padded = np.full((*full, kept.shape[2]), PAD_GREY, np.uint8)
        padded[top : top + h, left : left + w] = plain.pixels[y : y + h, x : x + w]
        return replace(plain, pixels=padded, pad_xy=(left, top))


def window_px(window: tuple[float, ...], size_wh: tuple[int, int]) -> tuple[int, ...]:
    """Return the edges x0, y0, x1, y1 of a crop of a picture, px."""
    return tuple(round(share * side) for share, side in zip(window, 2 * size_wh, strict=True))


def list_changes(seed: int) -> list[Change]:
    """Return the changes in the order of the table; `seed` is that of the noise."""

    def add_noise(levels: NDArray[np.uint8]) -> NDArray[np.float64]:
        # Of its own for each picture, in whatever order pictures are read; the same in all channels.
        rng = stream(seed, "stress", zlib.crc32(levels.tobytes()))
        return levels + rng.normal(0.0, 3.0, (*levels.shape[:2], 1))

    return [
        *(Change(f"border {b} px", border_px=b) for b in (0, 8, 16, 32, 64)),
        # The smallest border of an evaluation is 8 px, so that these move a picture without cutting it.
        *(Change(f"shift {x:+d}, {y:+d} px", shift_xy=(x, y)) for x, y in ((4, 0), (0, 4), (8, 8), (-7, -3))),
        Change("an eighth cropped left and above", window=(0.125, 0.125, 1.0, 1.0)),
        Change("an eighth cropped right and below", window=(0.0, 0.0, 0.875, 0.875)),
        Change("an eighth cropped on all sides", window=(0.125, 0.125, 0.875, 0.875)),
        *(Change(f"scale {s:g}", scale=s) for s in (0.8, 1.25)),
        Change("gain 0.7", levels=lambda levels: 0.3 * np.median(levels) + 0.7 * levels),
        Change("gain 1.4", levels=lambda levels: 1.4 * levels - 0.4 * np.median(levels)),
        Change("offset -20 levels", levels=lambda levels: levels - 20.0),
        Change("offset +20 levels", levels=lambda levels: levels + 20.0),
        Change("noise of sigma 3", levels=add_noise),
        Change("inverted grey (not trained for)", levels=lambda levels: 255.0 - levels),
    ]


def crop_labels(truth: Truth, window: tuple[float, ...]) -> Truth:
    """Return the labels in a crop, without objects outside; those that its edges cut become regions to ignore."""
    x0, y0, x1, y1 = window_px(window, truth.size_wh)
    origin = np.array([x0, y0], np.float64)
    bounds = truth.boxes_xyxy
    if truth.corners_xy is not None:
        bounds = np.concatenate([truth.corners_xy.min(axis=1), truth.corners_xy.max(axis=1)], axis=1)
    # What the picture's own edge cuts is cut before and after.
    before = clip_boxes(bounds, truth.size_wh) - np.tile(origin, 2)
    after = clip_boxes(bounds - np.tile(origin, 2), (x1 - x0, y1 - y0))
    is_whole = (after == before).all(axis=1)
    ignore = truth.ignore | ~is_whole
    kept = np.flatnonzero(truth.ignore | is_whole | (after[:, 2:] > after[:, :2]).all(axis=1))
    kept = kept[np.argsort(ignore[kept], kind="stable")]  # objects come first
    return Truth(
        truth.key,
        (x1 - x0, y1 - y0),
        truth.boxes_xyxy[kept] - np.tile(origin, 2),
        truth.classes[kept],
        ignore[kept],
        None if truth.corners_xy is None else truth.corners_xy[kept] - origin,
        truth.masks and tuple(Mask.from_array(truth.masks[k].to_array()[y0:y1, x0:x1]) for k in kept),
    )


def stress_facts(
    case: Case,
    source: DetectionSource,
    class_of: NDArray[np.int64],
    settings: EvaluationSettings,
    confidence: float,
    on_image: Callable[[int, int], None] | None = None,
) -> StressFacts:
    """Return the figures of a detector without and under each change.

    Args:
        case: Labels and detections on the pictures as they are.
        source: The detector.
        class_of: Index of the evaluated class for each of the detector's classes; -1 for none.
        settings: Image size of the detector, and seed of the noise.
        confidence: Least score of the detections that find, name and alarm.
        on_image: Called with the number of finished and of all pictures, over all changes.
    """
    regions = sum(int(truth.ignore.sum()) for truth in case.labels)
    changes = list_changes(settings.seed)
    rows: list[StressedFigures] = [
        {"change": "none", "objects_cut": 0, "objects_outside": 0, "classes": _rows(case, confidence)}
    ]
    for number, change in enumerate(changes):
        show = on_image and _of_all(on_image, number, len(changes))
        found = source.on(case.images, settings.image_size, show, [], change).images
        labels = [crop_labels(truth, change.window) for truth in case.labels]
        its = _rows(replace(case, labels=labels, found=compared(found, labels, class_of, case.task)), confidence)
        cut = sum(int(truth.ignore.sum()) for truth in labels) - regions
        outside = rows[0]["classes"]["all"]["objects"] - its["all"]["objects"] - cut
        rows.append({"change": change.name, "objects_cut": cut, "objects_outside": outside, "classes": its})
    return {"confidence": confidence, "iou": FOUND_IOU, "changes": rows}


def _of_all(on_image: Callable[[int, int], None], number: int, changes: int) -> Callable[[int, int], None]:
    return lambda done, total: on_image(number * total + done, changes * total)


def _rows(case: Case, confidence: float) -> dict[str, StressRow]:
    """Return the row of `all` and of each class; AP of `all` is the mean of the classes that have objects."""
    once = np.ones((1, len(case.images)), np.int32)
    sizes = {"all": SIZE_BINS["all"]}
    at_found = match_all(case, sizes, ious=np.array([FOUND_IOU]))
    of_all = match_all(as_one_class(case), sizes, ious=np.array([FOUND_IOU]))
    map10 = drawn_figures(at_found, once)[0, :, 0]
    map50 = drawn_figures(match_all(case, sizes, ious=np.array([0.5])), once)[0, :, 0]
    rows: dict[str, StressRow] = {}
    for k, (m, (name, of)) in enumerate(
        zip((*of_all, *at_found), found_and_named(case, confidence).items(), strict=True)
    ):
        wrong = ~m.right[0, 0] & ~m.neutral[0, 0] & (m.scores >= confidence)
        rows[name] = {
            "objects": of["objects"],
            "map50": float(map50[k]) if of["objects"] else None,
            "map10": float(map10[k]) if of["objects"] else None,
            "found": of["found"] / of["objects"] if of["objects"] else None,
            "named": of["named"] / of["found"] if of["found"] else None,
            "false_alarms": float(wrong.sum() / len(case.images)),
        }
    return rows
