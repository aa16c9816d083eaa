"""Yaw, ground pixel and lens from pairs of pictures: exact ones, noise, contradictions, and what tells nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from infrablend.imaging.overlap import Link, Overlap, Place, fit_overlap, neighbours, seen_middle

SIZE = (640, 512)
HFOV = 45.0
HEIGHT = 30.0
SHARE = 2 * math.tan(math.radians(HFOV) / 2) / SIZE[0]  # metres per pixel and metre of height


def survey(strips: int = 3, each: int = 6, tilt_deg: float = 0.0) -> list[Place]:
    """Return true places: strips to and fro, heights that vary."""
    found = []
    for row in range(strips):
        for column in range(each):
            x = column if row % 2 == 0 else each - 1 - column
            height = HEIGHT + 0.5 * math.sin(row + 2 * column)
            found.append(Place(6.0 * x, -7.0 * row, (80.0 if row % 2 == 0 else -100.0) + column, height, tilt_deg))
    return found


def links_of(places: Sequence[Place]) -> list[Link]:
    """Return exact movements between neighbours."""
    return [Link(a, b, matrix(places[a], places[b]), 0.2) for a, b in neighbours(places, SIZE, HFOV)]


def matrix(one: Place, other: Place) -> np.ndarray:
    """Return the movement of pixels between two pictures of flat ground."""

    def to_ground(p: Place) -> np.ndarray:
        a, g = math.radians(p.yaw_deg), SHARE * p.height_m
        right, up = np.array([math.cos(a), -math.sin(a)]), np.array([math.sin(a), math.cos(a)])
        found = np.eye(3)
        found[:2, :2] = g * np.column_stack([right, -up])
        ahead = p.height_m * math.tan(math.radians(p.tilt_deg)) * up
        middle = (np.array(SIZE) - 1) / 2
        found[:2, 2] = np.array([p.east_m, p.north_m]) + ahead - found[:2, :2] @ middle
        return found

    return np.asarray(np.linalg.inv(to_ground(other)) @ to_ground(one))


def stated(places: Sequence[Place], yaw_error: float, noise_m: float = 0.0, seed: int = 0) -> list[Place]:
    rng = np.random.default_rng(seed)
    off = noise_m * rng.standard_normal((len(places), 2))
    return [
        replace(p, east_m=p.east_m + e, north_m=p.north_m + n, yaw_deg=p.yaw_deg + yaw_error)
        for p, (e, n) in zip(places, off.tolist(), strict=True)
    ]


def fitted(places: Sequence[Place], links: Sequence[Link]) -> Overlap:
    found = fit_overlap(places, links, SIZE)
    assert isinstance(found, Overlap)
    return found


@pytest.mark.parametrize("tilt_deg", [0.0, 3.0])
@pytest.mark.parametrize("error", [0.0, 10.0, -170.0])
def test_exact_pairs_give_exact_values(error: float, tilt_deg: float) -> None:
    true = survey(tilt_deg=tilt_deg)
    found = fitted(stated(true, error), links_of(true))
    # The direction of the tilt is that of the first result, so a little of it remains.
    assert found.yaw_error_deg == pytest.approx(error, abs=1e-6 if tilt_deg == 0 else 0.05)
    assert found.pixel_share == pytest.approx(SHARE, rel=1e-6 if tilt_deg == 0 else 1e-3)
    assert found.hfov_deg(SIZE[0]) == pytest.approx(HFOV, abs=1e-4 if tilt_deg == 0 else 0.05)
    assert found.ground_pixel_m == pytest.approx(SHARE * np.median([p.height_m for p in true]), rel=1e-3)
    assert found.left_out == 0 and found.pictures == 18


def test_errors_are_as_large_as_stated() -> None:
    true = survey(4, 8)
    links = links_of(true)
    off = []
    for seed in range(40):
        found = fitted(stated(true, 5.0, 0.4, seed), links)
        assert 0.25 < found.residual_m < 0.55
        yaw = (found.yaw_error_deg - 5) / found.yaw_sigma_deg
        pixel = (found.pixel_share / SHARE - 1) / found.pixel_sigma
        off.append((yaw, pixel))
    # 80 numbers of unit variance: their mean square is 1 to 0.16; neighbouring errors that look alike make it smaller.
    assert 0.4 < float((np.array(off) ** 2).mean()) < 1.5


def test_wrong_pairs_and_positions_are_left_out() -> None:
    true = survey()
    links = links_of(true)
    for k in range(0, len(links), 6):  # such as a fixed pattern, which does not move
        links[k] = replace(links[k], matrix=np.eye(3))
    places = stated(true, 10.0, 0.05)
    places[7] = replace(places[7], east_m=places[7].east_m + 20)
    found = fitted(places, links)
    assert found.yaw_error_deg == pytest.approx(10, abs=0.5) and found.pixel_share == pytest.approx(SHARE, rel=0.01)
    assert found.left_out >= len(range(0, len(links), 6))


def test_the_lens_holds_the_error_of_the_height() -> None:
    true = survey()
    found = fitted(stated(true, 0.0, 0.3), links_of(true))
    exact, loose = (found.hfov_sigma_deg(640, h) for h in (0.0, 1.0))
    expected = math.degrees(math.sin(math.radians(found.hfov_deg(640)))) / HEIGHT
    assert loose == pytest.approx(math.hypot(exact, expected), rel=0.02)


def test_what_tells_nothing_is_said() -> None:
    true = survey()
    tilted = [replace(p, tilt_deg=45.0) for p in true]
    assert "18 pictures do not look straight down" in str(fit_overlap(tilted, links_of(true), SIZE))
    assert "expected at least 4" in str(fit_overlap(true, links_of(true)[:1], SIZE))
    assert "expected at least 4" in str(fit_overlap(true, [], SIZE))
    rng = np.random.default_rng(1)
    elsewhere = [replace(p, east_m=float(rng.uniform(0, 40)), north_m=float(rng.uniform(0, 40))) for p in true]
    assert isinstance(fit_overlap(elsewhere, links_of(true), SIZE), str)


def test_neighbours_are_near_and_those_in_a_row_first() -> None:
    true = survey()
    pairs = list(neighbours(true, SIZE, HFOV))
    assert pairs[:15] == sorted(pairs[:15]) or all(b - a == 1 for a, b in pairs[:15])
    short = SHARE * 512 * HEIGHT
    for a, b in pairs:
        apart = math.hypot(true[a].east_m - true[b].east_m, true[a].north_m - true[b].north_m)
        assert apart < 0.62 * short
    assert any(b - a > 3 for a, b in pairs)  # across strips


def test_pictures_show_the_middle_of_others_where_their_places_say() -> None:
    true = survey()
    for a, b in neighbours(true, SIZE, HFOV):
        x, y, _ = matrix(true[a], true[b]) @ [(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2, 1]
        assert seen_middle(true[a], true[b], SIZE, HFOV) == pytest.approx((x + 0.5, y + 0.5), abs=1e-6)
