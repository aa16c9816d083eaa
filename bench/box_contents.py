"""Compare sizes, shapes and levels of objects by time of day and pitch: real ones, or a run with `labels.mode: new`.

`bench/box_contents.py DATA... [--category Car] [--split train]` prints, per dataset, time of day and range of pitches,
the quartiles, over boxes that are large enough and off the border, of: the longer side in pixels; the same times the
stated height in metres; width over height; and the 5 % quantile, the middle and the 95 % quantile of the levels in the
box, minus the median of the ring around it (`realism.contrasts`).
"""

from __future__ import annotations

from collections import defaultdict

import cv2
import numpy as np
from data_options import data_parser

from infrablend.core.dataset import ImageRecord
from infrablend.formats.detection import read
from infrablend.realism.contrasts import object_contrast

BELOW_DEG = (35.0, 45.0, 65.0, np.inf)
COLUMNS = ("longer side, px", "times height", "width/height", "5 %", "middle", "95 %")


def main() -> None:
    """Print a line per dataset, time of day and range of pitches."""
    options = data_parser(__doc__).parse_args()
    rows: dict[tuple[str, float, str], list[tuple[float, ...]]] = defaultdict(list)
    for data in options.data:
        for image in read(data).images:
            if image.split == options.split:
                below = next(limit for limit in BELOW_DEG if (image.capture.pitch_deg or 0) < limit)
                found = _rows(image, options.category)
                rows[image.capture.time_of_day or "unknown", below, str(data)] += found
    for (when, below, name), found in sorted(rows.items()):
        if found:
            quartiles = np.percentile(np.array(found), (25, 50, 75), axis=0).T
            text = "; ".join(
                f"{c} {'/'.join(f'{v:.4g}' for v in np.round(q, 2))}" for c, q in zip(COLUMNS, quartiles, strict=True)
            )
            print(f"{when}, pitch below {below:g}, {name}: {len(found)} boxes; {text}")


def _rows(image: ImageRecord, category: str) -> list[tuple[float, ...]]:
    picture = np.asarray(cv2.imread(str(image.path), cv2.IMREAD_GRAYSCALE), np.uint8)
    out = []
    for instance in image.instances:
        contrast = object_contrast(picture, instance, image.instances) if instance.category == category else None
        if contrast is not None:
            w, h = instance.box_xyxy[2:] - instance.box_xyxy[:2]
            levels = (level - contrast.ring for level in (contrast.low, contrast.middle, contrast.high))
            out.append((max(w, h), max(w, h) * (image.capture.altitude_m or np.nan), w / h, *levels))
    return out


if __name__ == "__main__":
    main()
