"""Shares and their intervals: coverage, clusters, weights by size."""

from __future__ import annotations

import numpy as np
import pytest

from infrablend.detection.recall import difference, weighted_share, weights_of_sizes, wilson


def clustered(rng: np.random.Generator, clusters: int, each: int, share: float) -> tuple[np.ndarray, list[str]]:
    """Draw objects of pictures that are found together: each picture has a recall of its own."""
    recalls = rng.beta(share * 3, (1 - share) * 3, clusters)
    found = rng.random((clusters, each)) < recalls[:, None]
    return found.ravel(), [str(k) for k in range(clusters) for _ in range(each)]


def test_intervals_of_clustered_objects_hold_the_true_share() -> None:
    rng = np.random.default_rng(0)
    held = narrow = 0
    for _ in range(400):
        share = weighted_share(*clustered(rng, 60, 8, 0.75))
        assert share.low is not None and share.high is not None
        held += share.low <= 0.75 <= share.high
        low, high = wilson(float(share.value or 0), share.count)
        narrow += low <= 0.75 <= high
    assert 0.92 <= held / 400 <= 0.98
    assert narrow / 400 < 0.85  # as if the objects of a picture were independent


def test_independent_objects_have_wilsons_interval() -> None:
    found = np.arange(200) < 150
    share = weighted_share(found, [str(k) for k in range(200)])
    assert share.effective == pytest.approx(200, rel=0.01)
    assert (share.low, share.high) == pytest.approx(wilson(0.75, 200), abs=1e-3)


def test_a_share_of_one_is_not_certain() -> None:
    share = weighted_share(np.ones(40, np.bool_), [str(k // 10) for k in range(40)])
    assert share.value == 1.0
    assert share.high == 1.0
    assert share.low == pytest.approx(wilson(1.0, 4)[0])


def test_no_objects_have_no_share() -> None:
    share = weighted_share(np.zeros(0, np.bool_), [])
    assert (share.value, share.low, share.count) == (None, None, 0)
    assert share.half_width == np.inf
    assert difference(share, share) is None


def test_weights_give_inserted_objects_the_sizes_of_real_ones() -> None:
    rng = np.random.default_rng(1)
    real = rng.uniform(10, 20, 400)
    inserted = rng.uniform(5, 60, 4000)  # most are larger than real ones, and found more often
    weights, left_out = weights_of_sizes(inserted, ["day"] * 4000, real, ["day"] * 400)
    assert left_out == 0
    assert weights.sum() == pytest.approx(400)
    assert (weights[(inserted < real.min()) | (inserted > real.max())] == 0).all()
    found = rng.random(4000) < np.clip(inserted / 40, 0, 1)
    share = weighted_share(found, [str(k) for k in range(4000)], weights)
    assert share.value == pytest.approx(np.mean(np.clip(real / 40, 0, 1)), abs=0.05)
    assert found.mean() > 0.6


def test_real_objects_that_no_inserted_one_is_like_are_counted() -> None:
    weights, left_out = weights_of_sizes(
        np.array([12.0, 14.0]), ["day", "day"], np.array([12.0, 13.0, 14.0, 12.0]), ["day", "day", "day", "night"]
    )
    assert left_out == 1
    assert weights.tolist() == [1.5, 1.5]


def test_the_difference_has_the_errors_of_both() -> None:
    one = weighted_share(np.arange(400) < 300, [str(k) for k in range(400)])
    other = weighted_share(np.arange(100) < 70, [str(k) for k in range(100)])
    found = difference(one, other)
    assert found is not None
    value, low, high = found
    assert value == pytest.approx(0.05)
    assert high - low == pytest.approx(np.hypot(2 * one.half_width, 2 * other.half_width), rel=0.05)


def test_looks_at_the_same_objects_and_pictures_widen_the_interval() -> None:
    rng = np.random.default_rng(3)
    held = 0
    for _ in range(300):
        of_object = rng.beta(2.0, 1.0, 60)
        of_picture = rng.normal(0, 0.15, 20)
        looks = [(k, p) for k in range(60) for p in rng.choice(20, 4, replace=False)]
        found = np.array([rng.random() < np.clip(of_object[k] + of_picture[p], 0, 1) for k, p in looks])
        share = weighted_share(found, [str(p) for _, p in looks], None, [f"t{k}" for k, _ in looks])
        assert share.low is not None
        assert share.high is not None
        held += share.low <= 0.66 <= share.high
    assert held / 300 >= 0.9
