"""Compare the boxes of a detector with drawn ones: is the detector trained on boxes of the right size and place?

`bench/box_fit.py EVALUATION DATA [--category Car] [--split val] [--confidence 0.25]` reads the predictions of
`infrablend evaluate`. By size of the drawn box and by pitch, it prints how much wider and higher drawn boxes are than
those of the detections that meet them (IoU of at least 0.3; factor and pixels), and how far their middle is to the
right and below, as a share of the box; all medians. Then it prints the AP50 and AP75 of all detections with their boxes
enlarged by factors, and by margins.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_iou
from infrablend.formats.detection import read

MEET = 0.3
LONGEST_BELOW_PX = (24, 32, 48, 64, 96, np.inf)
PITCH_BELOW_DEG = (35, 55, 75, np.inf)
FACTORS = (0.9, 0.95, 1.0, 1.05, 1.1, 1.15, 1.2)
MARGINS_PX = (-2, -1, 0, 1, 2, 3)
RECALLS = np.linspace(0, 1, 101)

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
    predictions = json.loads((options.evaluation / "predictions.json").read_bytes())
    classes = {c["id"] for c in predictions["categories"] if c["name"] == options.category}
    names = {i["id"]: Path(i["file_name"]).name for i in predictions["images"]}
    found: dict[str, list[list[float]]] = defaultdict(list)
    for p in predictions["annotations"]:
        if p["category_id"] in classes:
            x, y, w, h = p["bbox"]
            found[names[p["image_id"]]].append([p["score"], x, y, x + w, y + h])
    pictures: list[tuple[Boxes, Boxes]] = []
    rows: list[list[float]] = []
    for image in read(options.data).images:
        if image.split != options.split:
            continue
        detected = np.array(sorted(found[image.path.name], reverse=True)).reshape(-1, 5)
        drawn = np.array([i.box_xyxy for i in image.instances if i.category == options.category]).reshape(-1, 4)
        pictures.append((detected, drawn))
        sure = detected[detected[:, 0] >= options.confidence, 1:]
        if not len(sure):
            continue
        for box in drawn:
            shares = box_iou(box[None], sure)[0]
            if shares.max() >= MEET:
                rows.append([image.pitch_deg or 0, *box, *sure[int(shares.argmax())]])
    table = np.array(rows).reshape(-1, 9)
    _print_groups(table, (table[:, 3:5] - table[:, 1:3]).max(axis=1), LONGEST_BELOW_PX, "longer side below")
    _print_groups(table, table[:, 0], PITCH_BELOW_DEG, "pitch below")
    for text, ways in (
        ("enlarged by", {f: (f, 0.0) for f in FACTORS}),
        ("with margin px", {m: (1.0, float(m)) for m in MARGINS_PX}),
    ):
        scores = {by: [average_precision(pictures, iou, *way) for iou in (0.5, 0.75)] for by, way in ways.items()}
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


def average_precision(pictures: list[tuple[Boxes, Boxes]], least_iou: float, factor: float, margin_px: float) -> float:
    """Return the AP (101 points) of detections whose boxes are enlarged first by a factor and then by a margin."""
    scores: list[float] = []
    right: list[bool] = []
    objects = 0
    for detected, drawn in pictures:
        objects += len(drawn)
        middle, half = (detected[:, 1:3] + detected[:, 3:5]) / 2, (detected[:, 3:5] - detected[:, 1:3]) / 2
        half = half * factor + margin_px
        shares = box_iou(np.hstack([middle - half, middle + half]), drawn)
        taken = np.zeros(len(drawn), np.bool_)
        for k in range(len(detected)):
            free = np.where(taken, 0, shares[k]) if len(drawn) else np.zeros(1)
            best = int(free.argmax())
            hit = bool(free[best] >= least_iou)
            if hit:
                taken[best] = True
            scores.append(detected[k, 0])
            right.append(hit)
    order = np.argsort(-np.array(scores), kind="stable")
    hits = np.cumsum(np.array(right)[order])
    precision = np.maximum.accumulate((hits / np.arange(1, len(hits) + 1))[::-1])[::-1]
    at = np.searchsorted(hits / max(objects, 1), RECALLS)
    return float(np.where(at < len(precision), precision[np.minimum(at, len(precision) - 1)], 0).mean())


if __name__ == "__main__":
    main()
