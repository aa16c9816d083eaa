"""Measure how close together the objects of a class are, and how far their boxes overlap.

`bench/spacing.py DATA... [--category Car] [--split train]` prints, by range of pitch: boxes; quantiles of the distance
from the middle of a box to that of the nearest other one, over the box's longer side (100 if there is none); quantiles
of the largest share of a box that another one covers; the share of boxes at the picture's edge; and quantiles of the
longer side.
"""

from __future__ import annotations

import numpy as np
from data_options import data_parser
from numpy.typing import NDArray

from infrablend.core.dataset import ImageRecord
from infrablend.formats.detection import read

PITCH_BELOW_DEG = (35.0, 55.0, np.inf)
AT_EDGE_PX = 1.0
ALONE = 100.0


def main() -> None:
    """Print a line per dataset and range of pitch."""
    options = data_parser(__doc__).parse_args()
    for data in options.data:
        images = [
            i for i in read(data).images if i.split == options.split and i.capture.pitch_deg is not None and i.size_wh
        ]
        rows = np.concatenate([np.empty((0, 5)), *(spacing(i, options.category) for i in images)])
        low = 0.0
        for high in PITCH_BELOW_DEG:
            of = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
            if len(of):
                print(
                    f"{data}, pitch {low:g} to {high:g}: {len(of)} boxes, "
                    f"distance 10/25/50/75 %: {_quantiles(of[:, 1], (10, 25, 50, 75))}, "
                    f"covered 50/75/90 %: {_quantiles(of[:, 2], (50, 75, 90))}, "
                    f"at the edge: {of[:, 3].mean():.2f}, "
                    f"longer side 5/50/95 %, px: {_quantiles(of[:, 4], (5, 50, 95))}"
                )
            low = high


def spacing(image: ImageRecord, category: str) -> NDArray[np.float64]:
    """Return (n, 5): pitch, distance to the nearest, covered share, whether at the edge, longer side, px."""
    boxes = np.array([i.box_xyxy for i in image.instances if i.category == category]).reshape(-1, 4)
    w, h = image.size_wh
    rows = []
    for k, box in enumerate(boxes):
        others = np.delete(boxes, k, axis=0)
        sides = box[2:] - box[:2]
        shared = np.clip(np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2]), 0, None)
        away = np.linalg.norm((others[:, :2] + others[:, 2:] - box[:2] - box[2:]) / 2, axis=1) / sides.max()
        at_edge = (box[:2] <= AT_EDGE_PX).any() or (box[2:] >= np.array([w, h]) - AT_EDGE_PX).any()
        covered = shared.prod(axis=1).max(initial=0) / sides.prod()
        rows.append([image.capture.pitch_deg or 0.0, away.min(initial=ALONE), covered, float(at_edge), sides.max()])
    return np.array(rows).reshape(-1, 5)


def _quantiles(values: NDArray[np.float64], percent: tuple[int, ...]) -> str:
    return "/".join(f"{v:.2g}" if v < 10 else f"{v:.0f}" for v in np.percentile(values, percent))


if __name__ == "__main__":
    main()
