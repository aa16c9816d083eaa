"""Tiles cover a picture, and each place belongs to one of them, or to two near a seam."""

from __future__ import annotations

from itertools import pairwise
from math import inf

import numpy as np
import pytest

from infrablend.detection.seams import Window, joined, windows

SIZES = [(640, 512), (641, 640), (1280, 1024), (3000, 700), (64, 48)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("side", [352, 640, 560])
def test_tiles_cover_the_picture_with_their_overlap(size: tuple[int, int], side: int) -> None:
    tiles = windows(size, (side, side), 96)
    covered = np.zeros(size[::-1], np.int64)
    for tile in tiles:
        x, y = tile.origin_xy
        covered[max(y, 0) : y + side, max(x, 0) : x + side] += 1
    assert covered.min() >= 1
    for axis in (0, 1):
        origins = sorted({t.origin_xy[axis] for t in tiles})
        assert all(a + side - b >= 96 for a, b in pairwise(origins))
        # As whole pictures are padded: whole strides apart, from half a border outside.
        assert len({o % 32 for o in origins}) == 1
    if max(size) <= side:
        assert len(tiles) == 1


@pytest.mark.parametrize("size", SIZES)
def test_every_place_has_an_owner_that_shows_its_surroundings(size: tuple[int, int]) -> None:
    side = 352
    tiles = windows(size, (side, side), 96)
    x, y = np.meshgrid(np.arange(0.5, size[0], 3), np.arange(0.5, size[1], 3))
    centres = np.stack([x.ravel(), y.ravel()], axis=1)
    boxes = np.concatenate([centres, centres], axis=1)
    owners = np.array([t.owns(boxes) for t in tiles])
    assert (owners.sum(axis=0) >= 1).all()
    # An object up to half as large as the overlap is whole in each tile that keeps it, so no piece of it is kept.
    reach = 96 / 4
    for tile, owned in zip(tiles, owners, strict=True):
        own = centres[owned]
        low = np.maximum(np.array(tile.origin_xy), 0)
        high = np.minimum(np.array(tile.origin_xy) + side, size)
        assert ((own - reach >= low) | (own < reach)).all()
        assert ((own + reach <= high) | (own > np.array(size) - reach)).all()


def test_the_same_object_in_two_tiles_is_one_and_neighbours_stay() -> None:
    left, right = Window((0, 0), (-inf, -inf, 116, inf)), Window((96, 0), (100, -inf, inf, inf))
    boxes = np.array([[100, 50, 112, 80], [101, 50, 113, 81], [110, 50, 122, 80], [100, 50, 112, 80]], np.float64)
    scores = np.array([0.6, 0.8, 0.5, 0.4])
    classes = np.array([0, 0, 0, 1])
    # The first two are one person in two tiles, the third stands beside it, the fourth is another class.
    assert joined(boxes, scores, classes, np.array([0, 1, 1, 0]), [left, right]).tolist() == [1, 2, 3]
    # Within a tile, the network's own suppression decides.
    assert joined(boxes, scores, classes, np.array([0, 0, 0, 0]), [left, right]).tolist() == [1, 0, 2, 3]


def test_the_higher_score_stays_whichever_tile_keeps_more() -> None:
    left, right = Window((0, 0), (-inf, -inf, 116, inf)), Window((96, 0), (100, -inf, inf, inf))
    # Both tiles would keep the first; the second has its middle beyond what the left one keeps.
    boxes = np.array([[99, 50, 129, 80], [104, 50, 134, 80]], np.float64)
    for scores, kept in ((np.array([0.6, 0.8]), [1]), (np.array([0.8, 0.6]), [0])):
        assert joined(boxes, scores, np.zeros(2, np.int64), np.array([0, 1]), [left, right]).tolist() == kept


def test_objects_that_are_apart_stay() -> None:
    rng = np.random.default_rng(0)
    tiles = windows((8000, 6000), (672, 672), 96)
    boxes, owner = [], []
    for n, tile in enumerate(tiles):
        corner = rng.uniform(0, 660, (100, 2)) + tile.origin_xy
        found = np.concatenate([corner, corner + 12], axis=1)
        boxes.append(found[tile.owns(found)])
        owner += [n] * len(boxes[-1])
    every = np.concatenate(boxes)
    kept = joined(every, rng.uniform(0, 1, len(every)), np.zeros(len(every), np.int64), np.array(owner), tiles)
    assert 0.98 * len(every) < len(kept) <= len(every)
