"""Compare how real and inserted cars stand to one another: distances, and angles between the two nearest.

    .venv/bin/python bench/rows.py DATA

Distances are between centres of boxes, metres on level ground by the stated height and pitch.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from infrablend import api
from infrablend.core.capture import Capture
from infrablend.core.dataset import Instance
from infrablend.core.mesh import FloatArray
from infrablend.formats.read_write import Reading

_FOCAL_PX = 2060.0  # HIT-UAV
_NEAR_M = 9.0


def main() -> None:
    """Print the table."""
    data = Path(sys.argv[1])
    frames = api.frames("hit-uav-cars", data, reading=Reading(splits=("train",)))
    for time in ("day", "night"):
        ids = [k for k in frames.ids if frames.backgrounds[k].capture.time_of_day == time]
        real = [_neighbours(frames.backgrounds[k].instances, frames.backgrounds[k].capture, False) for k in ids]
        some = list(np.random.default_rng(0).permutation(ids)[:100])
        inserted = [_neighbours(f.labels, f.image.capture, True) for f in frames.iterate(some, 0)]
        for title, found in (("real", real), ("inserted", inserted)):
            nearest, second, angles = (np.concatenate(column) for column in zip(*found, strict=True))
            print(
                f"{time} {title}: {len(nearest)} cars, nearest {np.percentile(nearest, (25, 50, 75)).round(1)} m, "
                f"second {np.percentile(second, (25, 50, 75)).round(1)} m, {len(angles)} with two in {_NEAR_M:g} m, "
                f"between them {np.mean(angles > 150):.2f}, at their end {np.mean(angles < 30):.2f}"
            )


def _neighbours(labels: Sequence[Instance], capture: Capture, inserted: bool) -> tuple[FloatArray, ...]:
    """Return the distances of each car's nearest and second nearest, and the angles between those that are near."""
    boxes = np.array([o.box_xyxy for o in labels if o.category == "Car" and o.inserted is inserted]).reshape(-1, 4)
    if len(boxes) < 2:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    sine = np.sin(np.radians(capture.pitch_deg))
    metres = capture.altitude_m / (_FOCAL_PX * sine)
    centres = (boxes[:, :2] + boxes[:, 2:]) / 2 * metres * (1, 1 / sine)
    away = np.linalg.norm(centres[:, None] - centres, axis=2)
    np.fill_diagonal(away, np.inf)
    order = np.argsort(away, axis=1)
    sorted_m = np.sort(away, axis=1)
    angles = []
    for k in np.flatnonzero(sorted_m[:, 1] <= _NEAR_M):
        u, v = centres[order[k, :2]] - centres[k]
        angles.append(np.degrees(np.arccos(np.clip(u @ v / np.linalg.norm(u) / np.linalg.norm(v), -1, 1))))
    return sorted_m[:, 0], sorted_m[np.isfinite(sorted_m[:, 1]), 1], np.array(angles)


if __name__ == "__main__":
    main()
