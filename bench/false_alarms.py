"""Count what a detector finds, misses and takes for objects, in pictures with and without the class.

`bench/false_alarms.py EVALUATION DATA [--category Car] [--split val] [--confidence 0.5]` reads the predictions of
`infrablend evaluate` and prints, by time of day and range of pitch: objects, those found (IoU of at least 0.5),
detections that overlap a further object by 0.3 to 0.5 (loose), and false ones in pictures with the class and in others.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_iou
from infrablend.core.dataset import ImageRecord
from infrablend.detection.detections import Detections, read_predictions
from infrablend.detection.truth import image_key
from infrablend.formats.detection import read

FOUND, LOOSE = 0.5, 0.3
BELOW_DEG = (35.0, 65.0, np.inf)


def main() -> None:
    """Print a line per time of day and range of pitch, and one for all pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("evaluation", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("--category", default="Car")
    parser.add_argument("--split", default="val")
    parser.add_argument("--confidence", type=float, default=0.5)
    options = parser.parse_args()
    found = predicted(options.evaluation, options.category)
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for image in read(options.data).images:
        if image.split == options.split:
            of = found.get(image_key(image))
            ordered = [] if of is None else list(of.boxes_xyxy[of.scores >= options.confidence])
            below = next(limit for limit in BELOW_DEG if (image.capture.pitch_deg or 0) < limit)
            seen = count(image, options.category, ordered)
            counts[f"{image.capture.time_of_day or 'unknown'}, pitch below {below:g}"] += seen
            counts["all"] += seen
    for group, seen in sorted(counts.items()):
        print(
            f"{group}: {seen['objects']} objects, {seen['found']} found, {seen['loose']} loose, "
            f"{seen['false_beside']} false in pictures with {options.category}, {seen['false_elsewhere']} in others"
        )


def predicted(evaluation: Path, category: str) -> dict[str, Detections]:
    """Return the detections of a class, the surest first, by `<split>/<name>` of the picture."""
    predictions = read_predictions(evaluation / "predictions.json")
    number = predictions.classes.index(category)
    return {key: of.take(np.flatnonzero(of.classes == number)) for key, of in predictions.images.items()}


def count(image: ImageRecord, category: str, ordered: list[NDArray[np.float64]]) -> Counter[str]:
    """Count the detections of one picture, the surest first; each object is found once."""
    left = [i.box_xyxy for i in image.instances if i.category == category]
    seen = Counter({"objects": len(left)})
    where = "false_beside" if left else "false_elsewhere"
    for box in ordered:
        shares = box_iou(box[None], np.array(left).reshape(-1, 4))[0]
        most = shares.max(initial=0)
        if most >= FOUND:
            seen["found"] += 1
            left.pop(int(shares.argmax()))
        elif most >= LOOSE:
            seen["loose"] += 1
        else:
            seen[where] += 1
    return seen


if __name__ == "__main__":
    main()
