"""Masks from foreign files: run lengths that would make pycocotools read out of bounds are refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from infrablend.core.rle_masks import Mask, run_lengths


@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 2**32))
def test_run_lengths_are_those_of_the_mask(h: int, w: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    bits = rng.random((h, w)) < rng.choice([0.02, 0.5, 0.98])
    mask = Mask.from_array(bits)
    lengths = run_lengths(mask.counts)
    column = np.repeat(np.arange(len(lengths)) % 2 == 1, lengths)
    assert (bits == column.reshape(w, h).T).all()
    assert Mask.from_coco(mask.to_coco(), (h, w)) == mask
    assert Mask.from_coco({"size": [h, w], "counts": lengths.tolist()}, (h, w)) == mask


@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 4), st.integers(0, 2**31))
def test_the_box_is_around_all_pixels(h: int, w: int, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pixels = np.zeros((h, w), np.bool_)
    pixels[rng.integers(0, h, count), rng.integers(0, w, count)] = True
    at = np.argwhere(pixels)
    box = Mask.from_array(pixels).box_xyxy
    if not len(at):
        assert box is None
    else:
        assert box is not None
        assert box.tolist() == [*at.min(axis=0)[::-1], *(at.max(axis=0)[::-1] + 1)]


def test_long_runs() -> None:
    bits = np.zeros((512, 640), np.bool_)
    bits[100:400, 50] = bits[:, 300:500] = True
    assert run_lengths(Mask.from_array(bits).counts).sum() == 512 * 640


@pytest.mark.parametrize(
    ("value", "match"),
    [
        ({"size": [4, 4], "counts": "~~~~"}, "not valid COCO"),
        ({"size": [4, 4], "counts": "01"}, "do not fill"),
        ({"size": [4, 4], "counts": "ooooooooo0"}, "too large"),
        ({"size": [4, 4], "counts": "o"}, "not valid COCO"),
        ({"size": [4, 4], "counts": ""}, "do not fill"),
        ({"size": [4, 4], "counts": [9, 9]}, "do not fill"),
        ({"size": [4, 4], "counts": [-1, 17]}, "at least 0"),
        ({"size": [4, 4], "counts": [16.0]}, "whole numbers"),
        ({"size": [10**9, 10**9], "counts": "01"}, "size"),
        ({"size": [4, 4]}, "neither"),
        ("0", "neither"),
    ],
)
def test_invalid_run_lengths(value: object, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Mask.from_coco(value, (4, 4))


@pytest.mark.parametrize("far", [1e9, 1e308, -1e5, float("nan"), float("inf")])
def test_polygons_that_reach_far(far: float) -> None:
    with pytest.raises(ValueError, match="outside"):
        Mask.from_rings([[0, 0, 3, 0, 3, far]], (4, 4))
    assert Mask.from_rings([[0, 0, 3, 0, 3, 3, 0, 3]], (4, 4)).area_px == 9
    for rings in ([[0, 0, 1]], [[]], [7], []):
        with pytest.raises(ValueError, match="polygon"):
            Mask.from_rings(rings, (4, 4))


def test_the_union_has_the_pixels_of_all() -> None:
    arrays = [np.random.default_rng(k).random((9, 7)) < 0.2 for k in range(4)]
    assert Mask.union([Mask.from_array(a) for a in arrays]) == Mask.from_array(np.logical_or.reduce(arrays))
