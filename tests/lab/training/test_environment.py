"""Non-maximum suppression: confident boxes suppress overlapping ones, and equal scores keep their order."""

from __future__ import annotations

import numpy as np
import pytest

from infrablend.core.rng import stream
from infrablend.detection.ultralytics_environment import kept_indices


def one_by_one(boxes: np.ndarray, scores: np.ndarray, threshold: float) -> list[int]:
    """The definition."""
    kept: list[int] = []
    for k in sorted(range(len(boxes)), key=lambda k: -scores[k]):
        for j in kept:
            low, high = np.maximum(boxes[j, :2], boxes[k, :2]), np.minimum(boxes[j, 2:], boxes[k, 2:])
            shared = np.prod(np.maximum(high - low, 0))
            areas = [np.prod(boxes[i, 2:] - boxes[i, :2]) for i in (j, k)]
            if shared / (sum(areas) - shared) > threshold:
                break
        else:
            kept.append(k)
    return kept


@pytest.mark.parametrize("number", [0, 1, 63, 64, 65, 400])
@pytest.mark.parametrize("threshold", [0.3, 0.7])
def test_most_confident_boxes_stay(number: int, threshold: float) -> None:
    rng = stream(0, "suppression", str(number))
    centres, sizes = rng.uniform(0, 100, (number, 2)), rng.uniform(5, 50, (number, 2))
    boxes = np.concatenate([centres - sizes / 2, centres + sizes / 2], axis=1).astype(np.float32)
    scores = rng.choice(np.linspace(0.1, 0.9, 40), number).astype(np.float32)  # many are equal
    assert kept_indices(boxes, scores, threshold).tolist() == one_by_one(boxes, scores, threshold)


def test_first_of_equal_detections_stays_and_empty_boxes_suppress_nothing() -> None:
    boxes = np.array([[0, 0, 10, 10], [0, 0, 10, 10], [5, 5, 5, 5], [5, 5, 5, 5]], np.float32)
    assert kept_indices(boxes, np.full(4, 0.5, np.float32), 0.7).tolist() == [0, 2, 3]
