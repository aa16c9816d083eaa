"""Measure the grey of the ground around real cars, and around inserted ones before and after they were there.

    .venv/bin/python bench/ground_around.py DATA

Prints quartiles of each band's median less that of the ground 3 to 5 m away, levels of 8 bit; see object_look.py.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from object_look import _FOCAL_PX, measure

from infrablend import api
from infrablend.core.boxes import boxes_mask
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.formats.pictures.images import load_background
from infrablend.formats.read_write import Reading

_EVEN_GREY = 14.0
_ALONE_M = 4.0


def main() -> None:
    """Print the table."""
    data = Path(sys.argv[1])
    frames = api.frames("hit-uav-cars", data, reading=Reading(splits=("train",)))
    for time in ("day", "night"):
        found: dict[str, list[dict[str, float]]] = defaultdict(list)
        ids = [k for k in frames.ids if frames.backgrounds[k].capture.time_of_day == time]
        for k in ids:
            image = frames.backgrounds[k]
            picture = load_background(image.path).pixels.astype(np.float32)
            for titles, facts in _around(image, picture, image.instances, inserted=False):
                for title in titles:
                    found[title].append(facts)
        for frame in frames.iterate(list(np.random.default_rng(0).permutation(ids)[:140]), 0):
            before = load_background(frames.backgrounds[frame.id].path).pixels.astype(np.float32)
            for title, picture in (("inserted", np.asarray(frame.pixels, np.float32)), ("before", before)):
                found[title] += [f for _, f in _around(frame.image, picture, frame.labels, inserted=True)]
        for title, some in found.items():
            bands = [name for name in some[0] if name.startswith("rim")]
            quartiles = [np.nanpercentile([facts[name] for facts in some], (25, 50, 75)) for name in bands]
            cells = (f"{name[4:]}: {q[0]:.0f} {q[1]:.0f} {q[2]:.0f}" for name, q in zip(bands, quartiles, strict=True))
            print(f"{time:6}{title:12}{len(some):5}  " + "   ".join(cells))


def _around(
    image: ImageRecord, picture: NDArray[np.float32], labels: Sequence[Instance], *, inserted: bool
) -> list[tuple[list[str], dict[str, float]]]:
    capture = image.capture
    assert capture.altitude_m is not None and capture.pitch_deg is not None
    px_per_m = _FOCAL_PX * np.sin(np.radians(capture.pitch_deg)) / capture.altitude_m
    found = []
    for n, label in enumerate(labels):
        if label.category != "Car" or label.inserted is not inserted:
            continue
        others = [o.box_xyxy for k, o in enumerate(labels) if k != n]
        facts = measure(picture, label.box_xyxy, others, px_per_m)
        if facts is None:
            continue
        covered = boxes_mask(others, picture.shape) if others else np.zeros(picture.shape, bool)
        outside = (~boxes_mask([label.box_xyxy], picture.shape)).astype(np.uint8)
        away = cv2.distanceTransform(outside, cv2.DIST_L2, 3) / px_per_m
        low, high = np.percentile(picture[(away > 3) & (away <= 5) & ~covered], (25, 75))
        alone = not covered.any() or away[covered].min() > _ALONE_M
        titles = ["all", "alone" if alone else "not alone", *(["even"] if high - low < _EVEN_GREY else [])]
        found.append((titles, facts))
    return found


if __name__ == "__main__":
    main()
