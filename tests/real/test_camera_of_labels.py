"""Cameras of CAMEL's sequences from half of their labels, against a plane through the sizes of the other half."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from infrablend import api
from infrablend.core.camera_fit import axes_of
from infrablend.core.dataset import ImageRecord, KnownClass, known_class
from infrablend.core.mesh import FloatArray
from infrablend.core.reference_sizes import REFERENCES, alike_headings, expected_sides
from infrablend.pipeline.studies.estimate_camera import estimate_camera
from infrablend.pipeline.studies.labelled_camera import find_turns, still

SIZE_WH = (336, 256)
# A box is on a plane through sizes if it is off by less than this share.
NEAR = 0.15


def expected_height(image: ImageRecord, box: FloatArray, kind: KnownClass) -> float:
    """Return the height of the box around an object whose feet are where a box ends, px."""
    c = image.capture
    assert c.pitch_deg is not None and c.roll_deg is not None and c.hfov_deg is not None and c.altitude_m is not None
    focal_px = SIZE_WH[0] / 2 / np.tan(np.radians(c.hfov_deg) / 2)
    axes = axes_of(np.radians([c.pitch_deg]), np.radians([c.roll_deg]))
    up = axes[0, :, 2]
    ray = np.array([(box[0] + box[2] - SIZE_WH[0]) / 2 / focal_px, (box[3] - SIZE_WH[1] / 2) / focal_px, 1.0])
    down = max(-float(ray @ up), 1e-3)
    reference = REFERENCES[kind]
    middle = ray * c.altitude_m / down + up * reference.size_m[2] / 2
    sides = expected_sides(middle[None], axes, focal_px, reference.corners(shaped=True))
    if not reference.turns:
        return float(sides[0, :, 1].mean())
    return float(sides[0, alike_headings(sides, box[None, 2] - box[None, 0], box[None, 3] - box[None, 1])[0], 1])


def sizes_by_place(places: FloatArray, heights: FloatArray) -> FloatArray:
    """Return the heights of a plane over places in the picture from which most boxes differ by less than `NEAR`."""
    terms = np.column_stack([places, np.ones(len(places))])
    rng = np.random.default_rng(0)
    best, most = np.zeros(3), -1
    for chosen in rng.integers(0, len(places), (3000, 3)):
        if np.linalg.cond(terms[chosen]) > 1e4:
            continue
        plane = np.linalg.solve(terms[chosen], heights[chosen])
        near = int((np.abs(terms @ plane - heights) < NEAR * heights).sum())
        # Sizes grow downwards; sideways they change by the roll alone.
        if plane[1] > 3 * abs(plane[0]) and near > most:
            best, most = plane, near
    return terms @ best


# The camera of 13 is held by hand, so that its boxes have no common rows: it is compared with the boxes themselves. In
# 15 a parked car, which is one place of many, is a quarter smaller than the camera says.
@pytest.mark.parametrize(
    ("sequence", "kind", "largest"), [("7", "person", 0.20), ("13", "person", None), ("15", "car", 0.25)]
)
def test_sizes_are_those_of_real_boxes(real_data: Path, sequence: str, kind: KnownClass, largest: float | None) -> None:
    data = api.read_dataset(real_data / "camel")
    real = [i for i in data.images if i.capture.sequence == sequence]
    half = tuple(replace(i, instances=i.instances if k % 2 else ()) for k, i in enumerate(real))
    known = estimate_camera(replace(data, images=half)).dataset.images
    turns = find_turns(real, SIZE_WH, lambda: None) or still(len(real))
    middle = np.array(SIZE_WH) / 2
    found = []
    for k, turned in enumerate(turns.turned):
        if k % 2 or known[k].capture.pitch_deg is None:
            continue
        for label in real[k].instances:
            box = label.box_xyxy
            whole = box[:2].min() > 1 and box[2] < SIZE_WH[0] - 1 and box[3] < SIZE_WH[1] - 1 and box[3] - box[1] >= 6
            if known_class(label.category) != kind or not whole:
                continue
            # Where the feet are in the first picture of the span, so that rows can be compared.
            there = turned @ [(box[0] + box[2]) / 2 - middle[0], box[3] - middle[1], 1.0]
            expected = expected_height(known[k], box, kind)
            found.append((*there[:2] / there[2], box[3] - box[1], expected))
    columns, rows, heights, expected_px = np.array(found).T
    places = np.column_stack([columns, rows])
    assert len(heights) >= 30
    if largest is None:
        error = np.abs(expected_px / heights - 1)
        assert np.quantile(error, 0.9) <= 0.20
    else:
        fitted = sizes_by_place(places, heights)
        near = np.abs(fitted - heights) < NEAR * heights
        assert near.sum() >= 30
        error = np.abs(expected_px / fitted - 1)[near]
        assert error.max() <= largest
    assert np.median(error) <= 0.08
