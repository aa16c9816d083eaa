"""The same thing in several pictures counts once: still and walking things, herds, classes, and what stays open."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from infrablend.pipeline.flights.same_object import FlightCount, PlacedSighting, assign, count_objects

AREA = 20_000.0


def seen(
    picture: int, x: float, y: float, *, sigma: float = 0.3, size: float = 1.0, of: str = "deer"
) -> PlacedSighting:
    return PlacedSighting(f"{picture:03d}", 2.0 * picture, np.array([x, y]), sigma**2 * np.eye(2), size, of)


def members(found: FlightCount) -> list[tuple[int, ...]]:
    return [o.sightings for o in found.objects]


def herd(at: Sequence[tuple[float, float]], pictures: int, sigma: float, seed: int = 0) -> list[PlacedSighting]:
    rng = np.random.default_rng(seed)
    return [
        seen(p, *(np.array(xy) + sigma * rng.standard_normal(2)), sigma=sigma) for p in range(pictures) for xy in at
    ]


def test_assign_finds_the_least_sum() -> None:
    rng = np.random.default_rng(0)
    for n, m in ((1, 1), (2, 3), (3, 3), (4, 6)):
        for _ in range(30):
            cost = rng.normal(size=(n, m))
            best = min(itertools.permutations(range(m), n), key=lambda p: sum(cost[k, c] for k, c in enumerate(p)))
            assert assign(cost) == list(best)
    assert assign(np.zeros((0, 0))) == []


@pytest.mark.parametrize("speed", [0.0, 1.6])
def test_what_stands_still_counts_once(speed: float) -> None:
    at = [(0.0, 0.0), (4.0, 0.0), (0.0, 5.0), (40.0, 2.0)]
    found = count_objects(herd(at, 6, 0.3), AREA, speed)
    assert members(found) == [(k, k + 4, k + 8, k + 12, k + 16, k + 20) for k in range(4)]
    assert found.expected == 4 and found.fewest == 4
    for thing, place in zip(found.objects, at, strict=True):
        assert np.hypot(*(thing.place_m - place)) < 4 * 0.3 / math.sqrt(6)
        assert thing.covariance_m2[0, 0] == pytest.approx(0.3**2 / 6)
        assert thing.moves is (None if speed == 0 else False) and thing.speed_m_s == 0


def test_two_boxes_of_one_picture_are_two_things_however_near() -> None:
    found = count_objects([seen(0, 0, 0), seen(0, 0.1, 0), seen(1, 0.05, 0)], AREA, 0.0)
    assert len(found.objects) == 2 and sorted(len(o.sightings) for o in found.objects) == [1, 2]


def test_a_chain_of_neighbours_is_no_object() -> None:
    # Each 0.8 m from the next, as far as the gate; the ends are 4 m apart.
    found = count_objects([seen(k, 0.8 * k, 0) for k in range(6)], AREA, 0.0)
    assert len(found.objects) >= 2
    for thing in found.objects:
        assert max(thing.sightings) - min(thing.sightings) <= 2


def test_own_errors_decide_how_far_apart_one_thing_may_be() -> None:
    apart = [seen(0, 0, 0), seen(1, 1.5, 0)]
    assert len(count_objects(apart, AREA, 0.0).objects) == 2
    loose = [replace(s, covariance_m2=np.eye(2)) for s in apart]
    assert len(count_objects(loose, AREA, 0.0).objects) == 1


def test_class_and_size_decide_where_places_do_not() -> None:
    first = [seen(0, 0, 0, of="deer", sigma=0.5), seen(0, 0.3, 0, of="boar", sigma=0.5)]
    crossed = [seen(1, 0.3, 0, of="deer", sigma=0.5), seen(1, 0, 0, of="boar", sigma=0.5)]
    assert members(count_objects(first + crossed, AREA, 0.0)) == [(0, 2), (1, 3)]
    first = [seen(0, 0, 0, size=2.0, sigma=0.5), seen(0, 0.3, 0, size=1.0, sigma=0.5)]
    crossed = [seen(1, 0.3, 0, size=2.0, sigma=0.5), seen(1, 0, 0, size=1.0, sigma=0.5)]
    assert members(count_objects(first + crossed, AREA, 0.0)) == [(0, 2), (1, 3)]
    alone = [seen(0, 0, 0, of="deer"), seen(1, 0.1, 0, of="boar")]  # no gate
    assert len(count_objects(alone, AREA, 0.0).objects) == 1


def test_what_walks_is_followed_and_told_from_what_stands() -> None:
    walker = [seen(k, 2.0 * k, 0.0, sigma=0.2) for k in range(5)]  # 1 m/s
    stone = [seen(k, 5.0, 6.0, sigma=0.2) for k in range(5)]
    found = count_objects([*walker, *stone], AREA)
    assert members(found) == [(0, 1, 2, 3, 4), (5, 6, 7, 8, 9)]
    moving, still = found.objects
    assert moving.moves is True and moving.speed_m_s == pytest.approx(1.0, abs=0.1)
    assert moving.place_m == pytest.approx([8.0, 0.0], abs=0.5)
    assert still.moves is False and still.speed_m_s == 0
    assert count_objects(walker[:1], AREA).objects[0].moves is None
    # Faster than things go: others.
    assert len(count_objects([seen(k, 10.0 * k, 0.0) for k in range(3)], AREA, 1.6).objects) == 3


def test_without_times_nothing_is_taken_to_walk() -> None:
    walker = [replace(seen(k, 2.0 * k, 0.0), time_s=None) for k in range(3)]
    found = count_objects(walker, AREA)
    assert len(found.objects) == 3 and {o.moves for o in found.objects} == {None} and found.expected == 3


def test_what_was_lost_and_may_have_walked_there_is_a_range() -> None:
    lost = [seen(k, 1.5 * k, 0.0, sigma=0.2) for k in range(3)]
    again = [seen(k, 1.5 * (k - 12) + 5, 16.0, sigma=0.2) for k in range(12, 15)]  # 20 s later, off its way
    found = count_objects(lost + again, AREA)
    assert len(found.objects) == found.most == 2 and found.fewest == 1 and 1 < found.expected < 2
    assert count_objects(lost + again, AREA, 0.0).fewest == 6  # as nothing walks


def test_a_dense_herd_is_ambiguous() -> None:
    rng = np.random.default_rng(1)
    at = [(float(x), float(y)) for x, y in rng.uniform(0, 6, (20, 2))]
    dense = count_objects(herd(at, 3, 0.8), 3 * 36.0, 0.0)
    assert any(o.ambiguous for o in dense.objects) and dense.most > len(dense.objects)
    sparse = count_objects(herd([(9 * x, 9 * y) for x, y in at[:5]], 3, 0.3), AREA, 0.0)
    assert sparse.most == len(sparse.objects) == 5 and not any(o.ambiguous for o in sparse.objects)


def test_the_order_of_sightings_does_not_matter() -> None:
    all_seen = herd([(0, 0), (1.2, 0), (0, 1.5), (7, 7)], 5, 0.3)
    shuffled = [all_seen[k] for k in np.random.default_rng(2).permutation(len(all_seen))]
    one, other = count_objects(all_seen, AREA), count_objects(shuffled, AREA)
    assert len(one.objects) == len(other.objects) and one.expected == other.expected
    groups = [
        {(s.picture, *s.place_m) for k in o.sightings for s in [v[k]]}
        for v, c in ((all_seen, one), (shuffled, other))
        for o in c.objects
    ]
    assert all(g in groups[len(one.objects) :] for g in groups[: len(one.objects)])


def test_no_sightings_are_no_objects() -> None:
    found = count_objects([], AREA)
    assert (found.objects, found.expected, found.fewest, found.most) == ((), 0, 0, 0)
