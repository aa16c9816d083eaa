"""Probability of detection by cell: looks, dependence, strips, sectors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord
from infrablend.core.ground_position import LocalFrame
from infrablend.detection.sightings import Sighting
from infrablend.formats.maps.search_sectors import Sector
from infrablend.pipeline.flights.corrected_counts import LookShares
from infrablend.pipeline.flights.flight_poses import find_poses
from infrablend.pipeline.flights.search_map import (
    AreaFigures,
    Dependence,
    SearchMap,
    area_figures,
    cumulate,
    find_dependence,
    find_strips,
    map_detection,
    map_features,
)

HOME = LocalFrame(48.0, 11.0)
# 50 m up with 46.2 degrees: 42.7 m across 640 px, 34.1 m down 512 px; a pixel covers 6.7 cm.
WIDTH_M, HEIGHT_M = 42.66, 34.13


def picture(k: int, east: float, north: float, yaw: float = 0.0) -> ImageRecord:
    latitude, longitude = HOME.to_degrees(east, north).tolist()
    capture = Capture(
        pitch_deg=90.0, altitude_m=50.0, hfov_deg=46.2, latitude_deg=latitude, longitude_deg=longitude, yaw_deg=yaw,
        sequence="flight", frame=k, time_of_day="day",
    )  # fmt: skip
    return ImageRecord(f"p{k}", Path(f"p{k}.png"), "train", (640, 512), (), capture)


def mapped(pictures: list[ImageRecord], *rest: Any) -> SearchMap | None:
    return map_detection(pictures, find_poses(pictures).known, *rest)


def trials(found: int, of: int, ground: str = "6-8 cm") -> list[Sighting]:
    conditions = {"time": "day", "ground pixel": ground}
    return [Sighting(f"p{k}", f"p{k}", 20.0, 0.9 if k < found else 0.0, 0.0, conditions) for k in range(of)]


def test_one_picture_has_the_share_found_in_one_look() -> None:
    found = mapped([picture(0, 0, 0)], LookShares(trials(80, 100), 0.25), Dependence(0.5, "assumed"), 1.0)
    assert found is not None
    assert found.pod == pytest.approx(np.full(len(found.pod), 0.8))
    assert len(found.pod) == pytest.approx(WIDTH_M * HEIGHT_M, rel=0.06)
    assert (found.low < 0.8).all()
    assert (found.high > 0.8).all()
    assert found.sweep_width_m is None


@pytest.mark.parametrize(("rho", "pod"), [(0.0, 1 - 0.2**2), (1.0, 0.8)])
def test_overlapping_pictures_cumulate_by_their_dependence(rho: float, pod: float) -> None:
    pictures = [picture(0, 0, 0), picture(1, 0, 0)]
    found = mapped(pictures, LookShares(trials(80, 100), 0.25), Dependence(rho, "measured"), 1.0)
    assert found is not None
    assert (found.looks == 2).all()
    assert found.searched_m2 == pytest.approx(2 * WIDTH_M * HEIGHT_M, rel=0.001)
    assert found.pod == pytest.approx(np.full(len(found.pod), pod))


def test_the_sweep_width_of_a_strip_is_its_width_times_the_share() -> None:
    # Pictures that just touch: every place is seen once.
    pictures = [picture(k, 0, HEIGHT_M * k) for k in range(5)]
    found = mapped(pictures, LookShares(trials(60, 100), 0.25), Dependence(0.5, "assumed"), 1.0)
    assert found is not None
    assert found.track_m == pytest.approx(4 * HEIGHT_M, rel=0.01)
    assert found.sweep_width_m == pytest.approx(0.6 * WIDTH_M, rel=0.05)


def test_a_sector_counts_what_no_picture_shows_as_nothing() -> None:
    found = mapped([picture(0, 0, 0)], LookShares(trials(80, 100), 0.25), Dependence(0.5, "assumed"), 1.0)
    assert found is not None
    corners = np.array([[0.0, -10], [60, -10], [60, 10], [0, 10]])  # 21.3 of 60 m are photographed
    ring = HOME.to_degrees(*corners.T)
    figures = area_figures(found, Sector("east", (ring,)))
    assert figures.area_m2 == pytest.approx(1200, rel=0.06)
    assert figures.photographed == pytest.approx(WIDTH_M / 2 / 60, abs=0.03)
    assert figures.pod == pytest.approx(0.8 * figures.photographed)
    assert figures.low < figures.pod < figures.high
    whole = area_figures(found)
    assert (whole.photographed, whole.pod) == (1.0, pytest.approx(0.8))


def test_cells_of_conditions_without_inserts_take_the_share_of_all() -> None:
    shares = LookShares([*trials(80, 100, "12-16 cm"), *trials(0, 3)], 0.25)
    found = mapped([picture(0, 0, 0)], shares, Dependence(0.5, "assumed"), 2.0)
    assert found is not None
    assert found.pod == pytest.approx(np.full(len(found.pod), 80 / 103))


def test_pictures_without_a_pose_are_left_out_and_counted() -> None:
    without = ImageRecord("q", Path("q.png"), "train", (640, 512), (), Capture(pitch_deg=90.0))
    shares = LookShares(trials(80, 100), 0.25)
    assert mapped([without], shares, Dependence(0.5, "assumed")) is None
    found = mapped([picture(0, 0, 0), without], shares, Dependence(0.5, "assumed"))
    assert found is not None
    assert found.without_pose == 1


def test_dependence_is_measured_where_objects_are_seen_twice() -> None:
    rng = np.random.default_rng(0)

    def looks(rho: float) -> list[Sighting]:
        sightings = []
        for track in range(3000):
            hard = rng.random() < 0.3
            for look in range(2):
                seen = not hard if rng.random() < rho else rng.random() >= 0.3
                conditions = {"time": "day"}
                sightings.append(Sighting(f"p{look}", "c", 20.0, 0.9 * seen, 0.0, conditions, f"t{track}"))
        return sightings

    for rho in (0.0, 0.7, 1.0):
        found = find_dependence(looks(rho), 0.25)
        assert found.origin == "measured"
        # Each look follows the object with probability rho, so both do with its square.
        assert found.rho == pytest.approx(rho**2, abs=0.05)
    assert find_dependence(trials(50, 100), 0.25).origin == "assumed"


def test_strips_end_where_the_course_turns() -> None:
    there = [picture(k, 0, 20.0 * k) for k in range(4)]
    back = [picture(4 + k, 30, 60 - 20.0 * k) for k in range(4)]
    places = np.array([(0, 20.0 * k) for k in range(4)] + [(30, 60 - 20.0 * k) for k in range(4)])
    strips = find_strips([*there, *back], places)
    assert [s for s in strips if len(s) > 2] == [[0, 1, 2, 3], [4, 5, 6, 7]]


def test_cumulated_looks_never_lose() -> None:
    p = np.array([0.3, 0.8, 0.5])
    values = [cumulate(p, rho) for rho in (0.0, 0.3, 0.6, 1.0)]
    assert values == sorted(values, reverse=True)
    assert values[-1] == pytest.approx(0.8)


def test_cells_are_areas_of_a_map() -> None:
    found = mapped([picture(0, 0, 0)], LookShares(trials(80, 100), 0.25), Dependence(0.5, "assumed"), 5.0)
    assert found is not None
    features = map_features(found)
    assert len(features) == len(found.pod)
    assert features[0].properties["pod"] == 0.8
    assert features[0].outline.shape == (4, 2)


def test_small_sectors_and_far_ones_have_their_own_figures() -> None:
    pictures = [picture(k, 0, HEIGHT_M * k) for k in range(5)]
    found = mapped(pictures, LookShares(trials(60, 100), 0.25), Dependence(0.5, "assumed"), 2.0)
    assert found is not None

    def figures(west: float, south: float, width: float, height: float) -> AreaFigures:
        corners = np.array(
            [[west, south], [west + width, south], [west + width, south + height], [west, south + height]]
        )
        return area_figures(found, Sector("s", (HOME.to_degrees(*corners.T),)))

    gully = figures(-5, 20, 0.3, 60)
    assert gully.area_m2 == pytest.approx(18, rel=0.05)
    assert (gully.photographed, gully.pod) == (pytest.approx(1.0), pytest.approx(0.6))
    far = figures(2000, 0, 50, 50)
    assert (far.photographed, far.pod, far.coverage) == (0, 0, 0)
    half = figures(-20, 0, 40, 2 * HEIGHT_M)  # the track is in it for half of its length
    assert half.coverage == pytest.approx(0.6 * WIDTH_M * 2 * HEIGHT_M / (40 * 2 * HEIGHT_M), rel=0.06)


def test_a_curved_track_is_no_straight_strip() -> None:
    angles = np.radians(np.arange(0, 360, 10))
    places = 100 * np.column_stack([np.cos(angles), np.sin(angles)])
    pictures = [picture(k, *place) for k, place in enumerate(places.tolist())]
    found = mapped(pictures, LookShares(trials(60, 100), 0.25), Dependence(1.0, "measured"), 5.0)
    assert found is not None
    assert found.track_m == pytest.approx(2 * np.pi * 100, rel=0.06)


def test_cells_larger_than_the_flight_give_no_map() -> None:
    shares = LookShares(trials(80, 100), 0.25)
    assert mapped([picture(0, 0, 0)], shares, Dependence(0.5, "assumed"), 1000.0) is None
