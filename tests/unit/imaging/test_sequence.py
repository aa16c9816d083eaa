"""The movement of a camera over a known scene: a large picture of which each frame shows a part."""

import functools
from collections import Counter

import cv2
import numpy as np
import pytest

from infrablend.imaging.camera_path import BRIDGE, follow_camera, moment_from_json, moment_to_json
from infrablend.imaging.camera_shift import View, find_shift, moved

SIZE_WH = (320, 256)
MIDDLE = np.array([[SIZE_WH[0] / 2, SIZE_WH[1] / 2]])


@functools.cache
def scene(seed=0, width=1400, height=700):
    """Return blobs and edges of many sizes, as trees and roofs have."""
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width), np.float32)
    for sigma in (2, 5, 14):
        layer = cv2.GaussianBlur(rng.normal(0, 1, (height, width)).astype(np.float32), (0, 0), sigma)
        total += layer / layer.std()
    return total / total.std()


def frame(where, at_xy, angle_deg=0.0, gain=1.0, offset=0.0, noise=1.0, seed=0):
    """Return the view of a part of a scene: its middle at `at_xy`, turned, with grain."""
    matrix = cv2.getRotationMatrix2D((float(at_xy[0]), float(at_xy[1])), angle_deg, 1.0)
    matrix[:, 2] += MIDDLE[0] - at_xy
    shown = cv2.warpAffine(where, matrix, SIZE_WH, flags=cv2.INTER_CUBIC)
    grain = np.random.default_rng([seed, 9]).normal(0, noise, shown.shape)
    levels = gain * (110 + 32 * shown) + offset + grain
    grey = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    return View(grey, np.zeros(grey.shape, bool)), np.vstack([matrix, [0, 0, 1]])


def path(n, step=(6.3, 1.7)):
    return [(260 + step[0] * k, 300 + step[1] * np.sin(k / 5) * 8) for k in range(n)]


def worst(moments, matrices):
    """Return by how many px the estimate is off, at the middle and the corners of the frames of the first span."""
    points = np.array([MIDDLE[0], (0, 0), SIZE_WH], float)
    home, half = matrices[0], 0.5  # OpenCV has the middle of the first pixel at 0
    return max(
        float(
            np.linalg.norm(
                moved(points, m.to_first) - moved(points - half, home @ np.linalg.inv(t)) - half, axis=1
            ).max()
        )
        for m, t in zip(moments, matrices, strict=True)
    )


def test_a_pan_with_roll_is_followed_to_a_fraction_of_a_pixel_and_says_how_certain_it_is():
    found = [frame(scene(), at, 0.05 * k, seed=k) for k, at in enumerate(path(60))]
    moments = follow_camera([v for v, _ in found])
    assert Counter(m.state for m in moments) == {"first": 1, "followed": 59}
    assert {m.span for m in moments} == {0}
    off = worst(moments, [t for _, t in found])
    assert off < 0.3 and off < 3 * moments[-1].error_px
    assert all(0 < m.error_px < 0.3 for m in moments[1:])


def test_a_camera_that_turns_is_followed_and_keys_hold_it():
    where = scene()
    found = [
        frame(where, (350 + 20 * np.sin(k / 9), 330 + 15 * np.cos(k / 7)), 40 * np.sin(k / 30), seed=k)
        for k in range(100)
    ]
    moments = follow_camera([v for v, _ in found])
    assert Counter(m.state for m in moments) == {"first": 1, "followed": 99}
    assert worst(moments, [t for _, t in found]) < 0.3
    home, turned = found[0], found[47]
    shift = find_shift(home[0], turned[0], turned[1] @ np.linalg.inv(home[1]) @ np.diag([1.02, 1.02, 1]))
    assert shift is not None and shift.fitting > 0.8 * shift.corners and shift.error_px < 0.15


def test_there_and_back_ends_where_it_began():
    there = [frame(scene(), at, seed=k) for k, at in enumerate(path(70))]
    views = [v for v, _ in there] + [v for v, _ in reversed(there[:-1])]
    last = follow_camera(views)[-1]
    assert last.span == 0 and float(np.linalg.norm(moved(MIDDLE, last.to_first) - MIDDLE)) < 0.3


def test_levels_follow_the_gain_of_the_camera():
    gains = [1.0] * 10 + [0.6] * 10
    found = [
        frame(scene(), at, gain=g, offset=40 * (1 - g), seed=k)
        for k, (at, g) in enumerate(zip(path(20), gains, strict=True))
    ]
    moments = follow_camera([v for v, _ in found])
    assert moments[9].gain == pytest.approx(1.0, abs=0.03)
    assert moments[-1].gain == pytest.approx(0.6, abs=0.03)
    assert moments[-1].gain * 128 + moments[-1].offset == pytest.approx(0.6 * 128 + 16, abs=2)


def test_a_frozen_frame_stays_where_it_is():
    found = [frame(scene(), at, seed=k) for k, at in enumerate(path(12))]
    views = [v for v, _ in found]
    views[6:6] = [views[5], views[5]]
    moments = follow_camera(views)
    assert [m.state for m in moments[5:9]] == ["followed", "frozen", "frozen", "followed"]
    assert np.array_equal(moments[6].to_first, moments[5].to_first)


def test_another_scene_begins_a_span_and_nothing_is_bridged_in_silence():
    one = [frame(scene(1), at, seed=k)[0] for k, at in enumerate(path(8))]
    other = [frame(scene(2), at, seed=k)[0] for k, at in enumerate(path(8))]
    moments = follow_camera(one + other)
    assert moments[8].state == "cut" and [m.span for m in moments] == [0] * 8 + [1] * 8


@pytest.mark.parametrize("gap", [1, BRIDGE, BRIDGE + 2])
def test_a_short_gap_is_bridged_and_a_long_one_stays_lost(gap):
    found = [frame(scene(), at, seed=k) for k, at in enumerate(path(20, (2.0, 0.3)))]
    views = [v for v, _ in found]
    for k in range(8, 8 + gap):
        plain = np.random.default_rng(k).normal(90, 1, views[k].grey.shape)
        views[k] = View(np.rint(plain).astype(np.uint8), views[k].blocked | True)
    states = [m.state for m in follow_camera(views)][8 : 8 + gap]
    assert set(states) == ({"bridged"} if gap <= BRIDGE else {"lost"})


def test_sky_alone_is_lost_rather_than_guessed():
    views = [View(np.full((256, 320), 90, np.uint8) + np.uint8(k), np.zeros((256, 320), bool)) for k in range(0, 60, 6)]
    assert {m.state for m in follow_camera(views)} == {"lost"}
    assert follow_camera([]) == []


def test_a_flock_does_not_outvote_the_background():
    where, views, truth = scene(), [], []
    rng = np.random.default_rng(5)
    birds = rng.uniform((30, 30), (120, 110), (90, 2))
    for k, at in enumerate(path(24, (5.0, 0.5))):
        view, matrix = frame(where, at, seed=k)
        grey = view.grey.copy()
        for x, y in birds + (1.5 * k, 0.8 * k):
            cv2.circle(grey, (round(x), round(y)), 2, 255, -1)
        views.append(View(grey, view.blocked))
        truth.append(matrix)
    assert worst(follow_camera(views), truth) < 1.0


def test_a_slanted_plane_needs_more_than_a_similarity():
    where = scene()
    flat, _ = frame(where, (500, 350), noise=0)
    tilt = np.array([[1.02, 0.03, -6], [0.0, 1.05, -4], [0, 2.2e-4, 1]], float)
    tilted = View(cv2.warpPerspective(flat.grey, tilt, SIZE_WH, flags=cv2.INTER_CUBIC), flat.blocked)
    shift = find_shift(flat, tilted, np.eye(3))
    assert shift is not None
    inner = np.array([(x, y) for x in (60, 160, 260) for y in (50, 128, 200)], float)
    assert np.linalg.norm(moved(inner, shift.matrix) - moved(inner, tilt), axis=1).max() < 0.5


def test_pictures_of_another_size_are_another_camera():
    views = [frame(scene(), at, seed=k)[0] for k, at in enumerate(path(8))]
    small = [View(np.ascontiguousarray(v.grey[:200, :300]), v.blocked[:200, :300]) for v in views[4:]]
    assert [m.span for m in follow_camera(views[:4] + small)] == [0] * 4 + [1] * 4


def test_moments_survive_json():
    moments = follow_camera([frame(scene(), at, seed=k)[0] for k, at in enumerate(path(5))])
    for m in moments:
        back = moment_from_json({"frame": 3, **moment_to_json(m)})
        assert (back.state, back.span, back.fitting) == (m.state, m.span, m.fitting)
        assert np.allclose(back.to_first, m.to_first, rtol=1e-7, atol=1e-6)


def test_the_copy_of_a_lost_frame_is_bridged_to_the_same_place():
    views = [frame(scene(), at, seed=k)[0] for k, at in enumerate(path(6))]
    blank = View(np.full_like(views[0].grey, 90), views[0].blocked)
    moments = follow_camera([*views[:2], blank, blank, *views[4:]])
    assert [m.state for m in moments] == ["first", "followed", "bridged", "frozen", "followed", "followed"]
    np.testing.assert_array_equal(moments[2].to_first, moments[3].to_first)


def test_a_lost_frame_between_two_sizes_is_no_reason_to_compare_them():
    views = [frame(scene(), at, seed=k)[0] for k, at in enumerate(path(4))]
    small = [View(v.grey[:200, :280].copy(), v.blocked[:200, :280].copy()) for v in views]
    blank = View(np.full_like(small[0].grey, 90), small[0].blocked)
    moments = follow_camera([*views[:2], blank, *small[2:]])
    assert [m.span for m in moments] == [0, 0, -1, 1, 1]
