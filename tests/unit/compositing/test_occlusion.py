"""Structures of a background that stay in front of inserted objects."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from infrablend.compositing.occlusion import Occluder, Scenery, Wanted, front_matte, put_behind, restore_front
from infrablend.compositing.overlay import Layer, compose

HW = (160, 200)


def noisy(picture: np.ndarray, seed: int = 0) -> np.ndarray:
    grain = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 5, HW), (0, 0), 1.0)
    return np.clip(cv2.GaussianBlur(picture, (0, 0), 0.8) + grain, 0, 255).round().astype(np.uint8)


def branches(seed: int = 1) -> np.ndarray:
    """Even ground, and bright branches in all directions over its right half."""
    rng = np.random.default_rng(seed)
    picture = np.full(HW, 80.0)
    for x, y, turn, length in zip(
        rng.uniform(100, 200, 90), rng.uniform(0, 160, 90), rng.uniform(0, np.pi, 90), rng.uniform(15, 40, 90),
        strict=True,
    ):  # fmt: skip
        dx, dy = length / 2 * np.cos(turn), length / 2 * np.sin(turn)
        ends = [(int(x + s * dx), int(y + s * dy)) for s in (-1, 1)]
        cv2.line(picture, ends[0], ends[1], float(rng.uniform(120, 180)), 2)
    return noisy(picture)


def body() -> np.ndarray:
    """A body of 30 x 14 px."""
    share = np.zeros((14, 30), np.float32)
    cv2.ellipse(share, (15, 7), (14, 6), 0, 0, 360, 1, -1)
    return share


@pytest.mark.parametrize("aim", [0.45, 0.6, 0.75])
def test_the_visible_share_is_what_was_asked_for(aim: float) -> None:
    scenery, found = Scenery(branches()), []
    for y in range(10, 140, 16):
        occluder = scenery.find(body(), (140, y), Wanted(aim, 0.35, 0.8))
        if occluder is not None:
            hidden = front_matte({0: occluder}, scenery, body()[None], (140, y))[y : y + 14, 140:170]
            visible = float((body() * (1 - hidden)).sum() / body().sum())
            assert visible == pytest.approx(occluder.visible, abs=1e-3)
            assert 0.35 <= visible <= 0.8
            found.append(visible)
    assert len(found) >= 4
    # Thresholds stop at the least strength of a structure, so that more may stay visible than was asked for.
    assert min(abs(v - aim) for v in found) < 0.05


@pytest.mark.parametrize(
    "picture",
    [
        np.full(HW, 90.0),
        np.where(np.arange(HW[1]) < 155, 60.0, 150.0) * np.ones(HW),  # the edge of a roof
        np.where(abs(np.arange(HW[1]) - 155) < 3, 150.0, 60.0) * np.ones(HW),  # a kerb
        80 + 40 * cv2.GaussianBlur(np.random.default_rng(0).normal(0, 30, HW), (0, 0), 15),  # mottled ground
    ],
    ids=["even", "edge", "line", "mottled"],
)
def test_nothing_is_invented(picture: np.ndarray) -> None:
    scenery = Scenery(noisy(picture))
    for y in range(10, 140, 8):
        assert scenery.find(body(), (140, y), Wanted(0.6, 0.35, 0.8)) is None


def test_a_wire_hides_what_flies() -> None:
    picture = np.where(abs(np.arange(HW[1]) - 155) < 3, 150.0, 60.0) * np.ones(HW)
    occluder = Scenery(noisy(picture)).find(body(), (140, 50), Wanted(0.75, 0.35, 0.9), lines=True)
    assert occluder is not None
    assert occluder.bright and 0.35 <= occluder.visible <= 0.9


def test_inverted_and_sixteen_bit_pictures_hide_the_same() -> None:
    picture = branches()
    wanted, places = Wanted(0.6, 0.35, 0.8), [(140, y) for y in range(10, 140, 16)]
    plain = [Scenery(picture).find(body(), p, wanted) for p in places]
    black_hot = [Scenery(255 - picture).find(body(), p, wanted) for p in places]
    wide = [Scenery(picture.astype(np.uint16) * 20 + 7000, 20.0).find(body(), p, wanted) for p in places]
    assert any(plain)
    for a, b, c in zip(plain, black_hot, wide, strict=True):
        assert (a is None) == (b is None) == (c is None)
        if a is not None and b is not None and c is not None:
            assert a.bright and not b.bright and c.bright
            assert b.visible == pytest.approx(a.visible, abs=0.01)
            assert c.visible == pytest.approx(a.visible, abs=0.01)


def first_occluder(scenery: Scenery) -> tuple[Occluder, int]:
    for y in range(10, 140, 8):
        if found := scenery.find(body(), (140, y), Wanted(0.5, 0.35, 0.8)):
            return found, y
    raise AssertionError


def test_what_is_in_front_keeps_its_values_and_has_soft_edges() -> None:
    background = branches()
    scenery = Scenery(background)
    occluder, y = first_occluder(scenery)
    front = front_matte({0: occluder}, scenery, body()[None], (140, y))
    soft = cv2.GaussianBlur(np.pad(body(), 3), (0, 0), 0.8)
    layer = put_behind(Layer((137, y - 3), soft * 230, soft), front)
    picture = restore_front(compose(background, layer), background, front)
    assert_array_equal(picture[front >= 1], background[front >= 1])
    assert (front >= 1).any()
    assert ((front > 0.1) & (front < 0.9)).any()
    within = np.zeros(HW, np.bool_)
    within[y : y + 14, 140:170] = body() > 0
    assert (picture[within & (front == 0)] > 150).all()


def test_the_record_gives_the_same_matte() -> None:
    scenery = Scenery(branches())
    occluder, y = first_occluder(scenery)
    again = Occluder.from_json(json.loads(json.dumps({"object": 3, **occluder.to_json()})))
    assert again == occluder
    front = [front_matte({0: o}, Scenery(branches()), body()[None], (140, y)) for o in (occluder, again)]
    assert_array_equal(front[0], front[1])


def test_the_occluder_of_one_object_is_not_in_front_of_another() -> None:
    scenery = Scenery(branches())
    occluder, y = first_occluder(scenery)
    other = np.zeros_like(body())
    other[:, 20:] = 1
    coverage = np.stack([body() * (1 - other), other])
    front = front_matte({0: occluder}, scenery, coverage, (140, y))
    assert not front[y : y + 14, 160:170].any()
    assert front[y : y + 14, 140:160].any()
