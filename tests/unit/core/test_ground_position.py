"""Pixels meet the ground where the camera saw it, within ellipses that hold the truth as often as they state."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from infrablend.core.camera import CameraSpec
from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord
from infrablend.core.ground_position import (
    LEAST_DEPRESSION_DEG,
    LocalFrame,
    Pose,
    PoseErrors,
    StatedError,
    ellipse,
    footprint,
    ground_of_pixels,
    ground_pixel_m,
    pixels_of_ground,
    pose_of,
    position_covariance,
)

FRAME = LocalFrame(-1.43, -48.47)
SIZE = (640, 512)
ERRORS = {"position_m": 1.5, "height_m": 2, "yaw_deg": 3, "pitch_deg": 0.5, "roll_deg": 0.5, "hfov_share": 0.02,
          "pixel_px": 1}  # fmt: skip
PIXELS = np.array([[320, 256], [0.5, 0.5], [639.5, 511.5], [12, 400], [500, 30], [320, 500]])


def a_pose(pitch: float = 90, height: float = 50, yaw: float = 0, roll: float = 0, **errors: float) -> Pose:
    camera = FRAME.to_degrees(120.0, -35.0)
    stated = {name: StatedError(value, "test") for name, value in {**ERRORS, **errors}.items()}
    return Pose(SIZE, 45.0, pitch, roll, yaw, height, float(camera[0]), float(camera[1]), stated)


def projected(pose: Pose, en: np.ndarray) -> np.ndarray:
    """Return the pixels of places on the ground by `core.camera`, whose camera looks along +Y."""
    yaw = math.radians(pose.yaw_deg)
    spec = CameraSpec(
        pose.height_m / math.sin(math.radians(pose.pitch_deg)), math.radians(pose.pitch_deg),
        math.radians(pose.roll_deg), 1.0, 2 * math.tan(math.radians(pose.hfov_deg) / 2), pose.size_wh,
    )  # fmt: skip
    right = np.array([math.cos(yaw), -math.sin(yaw)])
    ahead = np.array([math.sin(yaw), math.cos(yaw)])
    from_camera = en - FRAME.to_metres(pose.latitude_deg, pose.longitude_deg)
    to_axis = pose.height_m / math.tan(math.radians(pose.pitch_deg))
    return spec.project(np.column_stack([from_camera @ right, from_camera @ ahead - to_axis, np.zeros(len(en))]))[0]


@pytest.mark.parametrize(("pitch", "height"), [(90, 50), (45, 80), (60, 30)])
@pytest.mark.parametrize("yaw", [0, 37, 90, 180, -75, 300])
@pytest.mark.parametrize("roll", [0, 10, -30, 180])
def test_positions_of_exact_poses_are_exact(pitch: float, height: float, yaw: float, roll: float) -> None:
    pose = a_pose(pitch, height, yaw, roll)
    en = ground_of_pixels(pose, FRAME, PIXELS)
    seen = np.isfinite(en[:, 0])
    assert seen.sum() >= 4
    assert projected(pose, en[seen]) == pytest.approx(PIXELS[seen], abs=1e-6)
    assert pixels_of_ground(pose, FRAME, en[seen]) == pytest.approx(PIXELS[seen], abs=1e-6)


def test_straight_down_the_upper_edge_is_where_yaw_points() -> None:
    pose = a_pose(yaw=90)
    en = ground_of_pixels(pose, FRAME, np.array([[320, 256], [320, 0], [640, 256]]))
    g = 50 / pose.focal_px
    assert en[0] == pytest.approx([120, -35], abs=1e-3)
    assert en[1:] - en[0] == pytest.approx(np.array([[256 * g, 0], [0, -320 * g]]), abs=1e-6)


def test_metres_become_degrees_and_back() -> None:
    en = np.array([[0, 0], [1500, -800], [-4000, 3000]])
    degrees = FRAME.to_degrees(en[:, 0], en[:, 1])
    assert FRAME.to_metres(degrees[:, 0], degrees[:, 1]) == pytest.approx(en, abs=2e-3)
    # A minute of latitude is a nautical mile, at the equator a little less (WGS 84: 1842.9 m).
    assert FRAME.to_metres(FRAME.latitude_deg + 1 / 60, FRAME.longitude_deg)[1] == pytest.approx(1842.9, abs=0.1)


def test_flat_rays_reach_no_ground() -> None:
    pose = a_pose(pitch=20, height=40)
    rows = np.arange(0, 513.0, 8)
    en = ground_of_pixels(pose, FRAME, np.column_stack([np.full_like(rows, 320), rows]))
    depression = 20 + np.degrees(np.arctan((rows - 256) / pose.focal_px))
    assert (np.isfinite(en[:, 0]) == (depression >= LEAST_DEPRESSION_DEG)).all()
    away = np.linalg.norm(en - FRAME.to_metres(pose.latitude_deg, pose.longitude_deg), axis=1)
    assert np.nanmax(away) <= 40 / math.tan(math.radians(LEAST_DEPRESSION_DEG))
    assert np.isnan(position_covariance(pose, FRAME, np.array([[320.0, 0.0]]))).all()
    assert np.isnan(ground_pixel_m(pose, np.array([[320.0, 0.0]]))).all()
    assert np.isnan(pixels_of_ground(pose, FRAME, np.array([[120.0, -200.0]]))).all()


def test_a_footprint_ends_at_the_reach() -> None:
    assert footprint(a_pose(), FRAME) == pytest.approx(
        ground_of_pixels(a_pose(), FRAME, np.array([[0, 0], [640, 0], [640, 512], [0, 512]]))
    )
    oblique = footprint(a_pose(pitch=20, height=40), FRAME) - [120, -35]
    away = np.linalg.norm(oblique, axis=1)
    assert away.max() == pytest.approx(40 / math.tan(math.radians(LEAST_DEPRESSION_DEG)), rel=1e-4)
    # As the share of the ground in sight, by points of a grid that project into the picture.
    x, y = np.meshgrid(np.arange(-150, 150.5, 1), np.arange(0, 160.5, 1))
    grid = np.column_stack([x.ravel(), y.ravel()])
    xy = pixels_of_ground(a_pose(pitch=20, height=40), FRAME, grid + [120, -35])
    inside = ((xy >= 0) & (xy <= SIZE)).all(axis=1) & (np.linalg.norm(grid, axis=1) <= away.max())
    area = 0.5 * abs(np.sum(oblique[:, 0] * np.roll(oblique[:, 1], -1) - np.roll(oblique[:, 0], -1) * oblique[:, 1]))
    assert area == pytest.approx(inside.sum(), rel=0.02)
    assert len(footprint(a_pose(pitch=-40), FRAME)) == 0


def test_ground_pixels_grow_with_the_distance() -> None:
    assert ground_pixel_m(a_pose(), PIXELS) == pytest.approx(np.full(len(PIXELS), 50 / a_pose().focal_px))
    middle = ground_pixel_m(a_pose(pitch=30), np.array([[320.0, 256.0]]))
    assert middle == pytest.approx([50 / math.sin(math.radians(30)) / a_pose().focal_px])


@pytest.mark.parametrize(("pitch", "height", "yaw_error", "along_across"), [
    (90, 50, 2, (1.6, 1.6)), (45, 80, 2, (2.9, 3.3)), (45, 80, 5, (2.9, 7.2)), (30, 80, 2, (4.7, 5.3)),
    (20, 80, 2, (8.3, 8.1)),
])  # fmt: skip
def test_errors_are_those_of_the_closed_forms(
    pitch: float, height: float, yaw_error: float, along_across: tuple[float, float]
) -> None:
    """The table of the search-theory notes: 0.5 degrees of pitch and roll, 2 m of height, 1.5 m of position."""
    pose = a_pose(pitch, height, yaw=0, yaw_deg=yaw_error, hfov_share=0, pixel_px=0)
    covariance = position_covariance(pose, FRAME, np.array([[320.0, 256.0]]))[0]
    assert np.sqrt(np.diag(covariance))[::-1] == pytest.approx(along_across, abs=0.06)


def tilted(yaw: float, pitch: float, roll: float, tilt: float) -> dict[str, float]:
    """Return yaw, pitch and roll of a camera of these that is turned about its lower axis, clockwise from above."""
    y, p, r, t = np.radians([yaw, pitch, roll, tilt])
    level = np.array([np.cos(y), -np.sin(y), 0])
    ahead = np.array([np.sin(y) * np.cos(p), np.cos(y) * np.cos(p), -np.sin(p)])
    right = np.cos(r) * level + np.sin(r) * np.cross(ahead, level)
    ahead, right = np.cos(t) * ahead + np.sin(t) * right, np.cos(t) * right - np.sin(t) * ahead
    y = np.arctan2(ahead[0], ahead[1])
    level = np.array([np.cos(y), -np.sin(y), 0])
    turned = np.degrees([y, np.arcsin(-ahead[2]), np.arctan2(right @ np.cross(ahead, level), right @ level)])
    return dict(zip(("yaw_deg", "pitch_deg", "roll_deg"), turned.tolist(), strict=True))


@pytest.mark.parametrize(("pitch", "height", "yaw_error", "pixel"), [
    (90, 50, 3, (320.0, 256.0)), (90, 50, 12, (40.0, 470.0)), (45, 80, 5, (600.0, 100.0)), (30, 60, 5, (40.0, 470.0))
])  # fmt: skip
def test_ellipses_hold_the_truth_as_often_as_they_state(
    pitch: float, height: float, yaw_error: float, pixel: tuple[float, float]
) -> None:
    truth = a_pose(pitch, height, yaw=40, yaw_deg=yaw_error)
    sigma = {name: stated.value for name, stated in truth.errors.items()}
    place = ground_of_pixels(truth, FRAME, np.array([pixel]))[0]
    at = FRAME.to_metres(truth.latitude_deg, truth.longitude_deg)
    rng = np.random.default_rng(7)
    held = 0
    draws = 500
    for _ in range(draws):
        noise = rng.standard_normal(10)
        latitude, longitude = FRAME.to_degrees(*(at + sigma["position_m"] * noise[:2]))
        stated = replace(
            truth,
            latitude_deg=float(latitude),
            longitude_deg=float(longitude),
            height_m=truth.height_m + sigma["height_m"] * noise[2],
            **tilted(
                truth.yaw_deg + sigma["yaw_deg"] * noise[3],
                truth.pitch_deg + sigma["pitch_deg"] * noise[4],
                truth.roll_deg + sigma["roll_deg"] * noise[5],
                sigma["roll_deg"] * noise[9],
            ),
            hfov_deg=truth.hfov_deg * (1 + sigma["hfov_share"] * noise[6]),
        )
        seen = np.array([pixel]) + sigma["pixel_px"] * noise[7:9]
        off = ground_of_pixels(stated, FRAME, seen)[0] - place
        shape = ellipse(position_covariance(stated, FRAME, seen)[0])
        azimuth = math.radians(shape.azimuth_deg)
        along = off @ [math.sin(azimuth), math.cos(azimuth)]
        across = off @ [math.cos(azimuth), -math.sin(azimuth)]
        held += (along / shape.major_m) ** 2 + (across / shape.minor_m) ** 2 <= 1
    # Chance is 0.013.
    assert 0.85 <= held / draws <= 0.95


def test_an_ellipse_has_its_axes_and_its_direction() -> None:
    turn = np.radians(30)
    long, short = np.array([np.sin(turn), np.cos(turn)]), np.array([np.cos(turn), -np.sin(turn)])
    shape = ellipse(9 * np.outer(long, long) + 4 * np.outer(short, short))
    assert (shape.major_m, shape.minor_m) == pytest.approx((3 * math.sqrt(4.605), 2 * math.sqrt(4.605)), rel=1e-3)
    assert shape.azimuth_deg == pytest.approx(30)
    assert ellipse(np.eye(2), 0.95).major_m == pytest.approx(math.sqrt(5.991), rel=1e-3)


def an_image(**facts: object) -> ImageRecord:
    known = {"pitch_deg": 90.0, "altitude_m": 30.0, "hfov_deg": 45.0, "latitude_deg": 1.0, "longitude_deg": 2.0,
             "yaw_deg": 64.0, "roll_deg": 0.0, "altitude_from": "take-off"}  # fmt: skip
    return ImageRecord("a", Path("a.jpg"), "train", SIZE, (), Capture(**{**known, **facts}))


def test_a_pose_names_what_it_lacks() -> None:
    assert pose_of(an_image(hfov_deg=None, latitude_deg=None)) == "latitude_deg, hfov_deg"
    assert pose_of(an_image(altitude_m=0.0)) == "altitude_m above 0"
    assert pose_of(replace(an_image(), size_wh=None)) == "size of the picture"


def test_straight_down_the_heading_of_the_aircraft_counts() -> None:
    nadir = pose_of(an_image(pitch_deg=86.0, flight_yaw_deg=55.0, roll_deg=180.0))
    assert isinstance(nadir, Pose)
    assert (nadir.yaw_deg, nadir.roll_deg) == (55.0, 0.0)
    assert nadir.errors["yaw_deg"] == StatedError(3.0, "heading of the aircraft")
    oblique = pose_of(an_image(pitch_deg=60.0, flight_yaw_deg=55.0, roll_deg=-2.0))
    assert isinstance(oblique, Pose)
    assert (oblique.yaw_deg, oblique.roll_deg) == (64.0, -2.0)
    without = pose_of(an_image(yaw_deg=None, flight_yaw_deg=55.0))
    assert isinstance(without, Pose)
    assert without.yaw_deg == 55.0
    assert pose_of(an_image(yaw_deg=None)) == "yaw_deg"


def test_errors_follow_from_what_states_the_value() -> None:
    nadir = pose_of(an_image())
    assert isinstance(nadir, Pose)
    assert nadir.errors["yaw_deg"] == StatedError(12.0, "gimbal yaw near straight down")
    oblique = pose_of(an_image(pitch_deg=60.0, altitude_from="laser", roll_deg=None))
    assert isinstance(oblique, Pose)
    assert [oblique.errors[name].value for name in ("yaw_deg", "height_m", "roll_deg")] == [5.0, 1.0, 1.0]
    given = pose_of(an_image(), PoseErrors(yaw_deg=1.0))
    assert isinstance(given, Pose)
    assert given.errors["yaw_deg"] == StatedError(1.0, "given")
    assert given.errors["pitch_deg"] == nadir.errors["pitch_deg"]
