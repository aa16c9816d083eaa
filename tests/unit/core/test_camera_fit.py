"""The camera that boxes of known size agree with, in scenes whose camera is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from infrablend.core.camera import CameraSpec
from infrablend.core.camera_fit import CameraFit, SizedBoxes, axes_of, fit_camera, size_ratios, turn_angles
from infrablend.core.ground_plane import at_height, ground_z_m
from infrablend.core.mesh import FloatArray
from infrablend.core.reference_sizes import REFERENCES, expected_sides

SIZE_WH = (640, 512)
FOCAL_PX = 900.0


def seen_boxes(
    pitch_deg: float,
    height_m: float,
    seed: int,
    *,
    count: int = 80,
    noise: float = 0.05,
    wrong: float = 0.15,
    roll_deg: float = 0.0,
    stated: tuple[float, float] = (0.0, 1.0),
) -> SizedBoxes:
    """Return boxes of people on level ground: sizes with noise, and some of half or one and a half times the size."""
    rng = np.random.default_rng(seed)
    axes = axes_of(np.radians([pitch_deg]), np.radians([roll_deg]))
    reference = REFERENCES["person"]
    boxes: list[FloatArray] = []
    while len(boxes) < count:
        middle = rng.uniform((-280, -200), (280, 200))
        ray = np.array([*middle / FOCAL_PX, 1.0])
        down = -float(ray @ axes[0, :, 2])
        if down < 0.02:
            continue
        place = ray * (height_m - reference.size_m[2] / 2) / down
        sides = expected_sides(place[None], axes, FOCAL_PX, reference.corners(shaped=True))[0].mean(axis=0)
        scale = rng.choice([0.5, 1.5]) if rng.random() < wrong else math.exp(rng.normal(0, noise))
        if sides[1] * scale > 6:
            boxes.append(np.concatenate([middle - scale * sides / 2, middle + scale * sides / 2]))
    n = len(boxes)
    zero = np.zeros(n, np.int64)
    turned = np.tile(np.eye(3), (n, 1, 1))
    pitch, height = stated
    stated_rad = np.full(n, math.radians(pitch))
    return SizedBoxes(
        np.full(n, "person"), np.array(boxes), np.arange(n), zero, turned, stated_rad, np.zeros(n),
        np.full(n, height), SIZE_WH,
    )  # fmt: skip


def is_within(value: float, true: float, sd: float) -> bool:
    """Return whether an estimate is right to four of its standard errors, which fails once in 16,000 times."""
    return abs(value - true) < 4 * sd


@pytest.mark.parametrize(("pitch_deg", "height_m"), [(4.0, 5.0), (15.0, 12.0), (40.0, 40.0)])
def test_camera_is_found_among_outliers(pitch_deg: float, height_m: float) -> None:
    fit = fit_camera(seen_boxes(pitch_deg, height_m, 1), FOCAL_PX)
    assert is_within(fit.pitch_rad[0], math.radians(pitch_deg), fit.pitch_sd[0])
    assert is_within(math.log(fit.factor / height_m), 0.0, fit.factor_sd)
    # 80 sizes to 5 % and the edges of boxes: far better than these.
    assert fit.pitch_sd[0] < math.radians(3.0) and fit.factor_sd < 0.12
    assert np.median(np.abs(fit.ratios)) < 0.08


def test_sizes_are_right_though_the_lens_is_unknown() -> None:
    boxes = seen_boxes(5.0, 6.0, 2, noise=0.04, wrong=0.0)
    fit = fit_camera(boxes)
    row = fit.focal_px * math.tan(fit.pitch_rad[0])
    assert abs(row - FOCAL_PX * math.tan(math.radians(5.0))) < 12
    assert abs(math.log(fit.factor / 6.0)) < 4 * fit.factor_sd
    assert abs(np.median(size_ratios(boxes, fit))) < 0.02
    # Nothing tells the lens there, and that is said.
    assert fit.focal_sd > 0.15


def test_boxes_of_one_row_do_not_tell_the_pitch() -> None:
    boxes = seen_boxes(30.0, 30.0, 3, count=300, wrong=0.0)
    middle = boxes.boxes[:, 1::2].mean(axis=1)
    fit = fit_camera(boxes.part(np.abs(middle) < 15), FOCAL_PX)
    assert fit.pitch_sd[0] > math.radians(4.0)


def test_stated_pitch_and_height_are_corrected() -> None:
    fit = fit_camera(seen_boxes(30.0, 46.0, 4, stated=(30.0, 40.0)), FOCAL_PX)
    assert is_within(fit.pitch_rad[0], 0.0, fit.pitch_sd[0])
    assert is_within(math.log(fit.factor / 1.15), 0.0, fit.factor_sd)
    held = fit_camera(seen_boxes(30.0, 46.0, 4, stated=(30.0, 40.0)), FOCAL_PX, np.zeros(1))
    assert held.pitch_sd[0] == 0 and held.factor_sd <= fit.factor_sd


def test_roll_is_found() -> None:
    fit = fit_camera(seen_boxes(6.0, 6.0, 5, roll_deg=3.0, wrong=0.0, noise=0.02), FOCAL_PX, roll_rad=np.radians([3.0]))
    assert is_within(fit.roll_rad[0], math.radians(3.0), fit.roll_sd[0])


def test_axes_are_those_of_the_camera() -> None:
    camera = CameraSpec(10.0, 0.3, 0.1, 36.0, 36.0, SIZE_WH)
    assert np.allclose(axes_of(np.array([0.3]), np.array([0.1]))[0], camera.world_to_camera, atol=1e-12)


def test_turned_pictures_have_the_angles_of_their_camera() -> None:
    angles = np.radians([[8.0, 2.0], [3.0, -4.0]])
    first, second = axes_of(angles[:1, 0], angles[:1, 1])[0], axes_of(angles[1:, 0], angles[1:, 1])[0]
    lens = np.diag([FOCAL_PX, FOCAL_PX, 1.0])
    # From the pixels of the second to those of the first: by the second's rays in the world.
    turned = lens @ first @ second.T @ np.linalg.inv(lens)
    pitch, roll = turn_angles(angles[:1, 0], angles[:1, 1], turned[None], FOCAL_PX)
    assert np.allclose([pitch[0], roll[0]], angles[1], atol=1e-9)


def test_same_boxes_give_the_same_camera() -> None:
    boxes = seen_boxes(10.0, 8.0, 6)
    one, other = fit_camera(boxes, FOCAL_PX), fit_camera(boxes, FOCAL_PX)
    assert isinstance(one, CameraFit)
    assert one.factor == other.factor and one.pitch_rad[0] == other.pitch_rad[0]


def test_expected_sides_are_those_of_projected_cuboids() -> None:
    camera = at_height(CameraSpec(1.0, 0.5, 0.0, 50.0, 36.0, SIZE_WH), 10.0)
    corners = REFERENCES["car"].corners(shaped=False)
    middle = np.array([1.0, 2.0, ground_z_m(camera, 10.0) + 0.725])
    xy, _ = camera.project(corners + middle)
    sides = expected_sides(
        camera.to_camera(middle[None]), camera.world_to_camera, camera.focal_px, corners, np.array([0.0])
    )
    assert np.allclose(sides[0, 0], np.ptp(xy, axis=0), rtol=1e-12)
    shaped = REFERENCES["car"].corners(shaped=True)
    assert np.allclose(np.ptp(shaped, axis=0), REFERENCES["car"].size_m) and len(shaped) == 16
