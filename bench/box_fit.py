"""Compare the boxes of a detector with drawn ones: is the detector trained on boxes of the right size and place?

`bench/box_fit.py EVALUATION DATA [--category Car] [--split val] [--confidence 0.25]` reads the predictions of
`infrablend evaluate`. By size of the drawn box and by pitch, it prints how much wider and higher drawn boxes are than
those of the detections that meet them (IoU of at least 0.3; factor and pixels), and how far their middle is to the
right and below, as a share of the box; all medians. Then it prints the AP50 and AP75 of all detections with their boxes
enlarged by factors, and by margins.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from predicted import predicted

from infrablend.core.boxes import box_iou
from infrablend.evaluation.detections import Detections
from infrablend.evaluation.matching import IOUS, match_all
from infrablend.evaluation.precision import average_precisions
from infrablend.evaluation.truth import Truth, image_key
from infrablend.formats.detection import read

MEET = 0.3
LONGEST_BELOW_PX = (24, 32, 48, 64, 96, np.inf)
PITCH_BELOW_DEG = (35, 55, 75, np.inf)
FACTORS = (0.9, 0.95, 1.0, 1.05, 1.1, 1.15, 1.2)
MARGINS_PX = (-2, -1, 0, 1, 2, 3)

Boxes = NDArray[np.float64]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("evaluation", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("--category", default="Car")
    parser.add_argument("--split", default="val")
    parser.add_argument("--confidence", type=float, default=0.25)
    options = parser.parse_args()
    found = predicted(options.evaluation, options.category)
    truths: list[Truth] = []
    rows: list[list[float]] = []
    for image in read(options.data).images:
        key = image_key(image)
        if image.split != options.split or key not in found or image.size_wh is None:
            continue
        drawn = np.array([i.box_xyxy for i in image.instances if i.category == options.category]).reshape(-1, 4)
        nothing = np.zeros(len(drawn), np.int64)
        truths.append(Truth(key, image.size_wh, drawn, nothing, nothing.astype(np.bool_)))
        sure = found[key].boxes_xyxy[found[key].scores >= options.confidence]
        if not len(sure):
            continue
        for box in drawn:
            shares = box_iou(box[None], sure)[0]
            if shares.max() >= MEET:
                rows.append([image.capture.pitch_deg or 0, *box, *sure[int(shares.argmax())]])
    table = np.array(rows).reshape(-1, 9)
    _print_groups(table, (table[:, 3:5] - table[:, 1:3]).max(axis=1), LONGEST_BELOW_PX, "longer side below")
    _print_groups(table, table[:, 0], PITCH_BELOW_DEG, "pitch below")
    for text, ways in (
        ("enlarged by", {f: (f, 0.0) for f in FACTORS}),
        ("with margin px", {m: (1.0, float(m)) for m in MARGINS_PX}),
    ):
        scores = {by: average_precision(truths, found, *way) for by, way in ways.items()}
        print(f"AP50, AP75 {text}: " + ", ".join(f"{by:g}: {a:.3f} {b:.3f}" for by, (a, b) in scores.items()))


def _print_groups(table: Boxes, value: Boxes, limits: tuple[float, ...], title: str) -> None:
    below = 0.0
    for limit in limits:
        rows = table[(value >= below) & (value < limit)]
        below = limit
        if len(rows):
            drawn, detected = (rows[:, k + 2 : k + 4] - rows[:, k : k + 2] for k in (1, 5))
            moved = ((rows[:, 1:3] + rows[:, 3:5]) - (rows[:, 5:7] + rows[:, 7:9])) / 2 / drawn
            text = [np.median(v, axis=0).round(2).tolist() for v in (drawn / detected, drawn - detected, moved)]
            print(f"{title} {limit:g}: {len(rows)} boxes, factor {text[0]}, px {text[1]}, moved {text[2]}")


def average_precision(
    truths: Sequence[Truth], found: Mapping[str, Detections], factor: float, margin_px: float
) -> list[float]:
    """Return AP50 and AP75 of detections whose boxes are enlarged first by a factor and then by a margin."""
    enlarged = {key: _enlarged(of, factor, margin_px) for key, of in found.items()}
    only = np.zeros(1 + max((int(of.classes.max(initial=0)) for of in found.values()), default=0), np.int64)
    (matches,) = match_all(truths, enlarged, only, 1, "detect", {"all": (0.0, np.inf)})
    wanted = [int(np.argmin(np.abs(IOUS - iou))) for iou in (0.5, 0.75)]
    return [float(v) for v in average_precisions(matches, thresholds=wanted)[0]]


def _enlarged(of: Detections, factor: float, margin_px: float) -> Detections:
    middle = (of.boxes_xyxy[:, :2] + of.boxes_xyxy[:, 2:]) / 2
    half = (of.boxes_xyxy[:, 2:] - of.boxes_xyxy[:, :2]) / 2 * factor + margin_px
    return replace(of, boxes_xyxy=np.hstack([middle - half, middle + half]))


if __name__ == "__main__":
    main()
