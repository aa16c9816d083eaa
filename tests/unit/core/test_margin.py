"""Black margins are found, and dark scenes are not taken for them."""

import cv2
import numpy as np
import pytest

from infrablend.imaging.margin import find_margin, on_margin

SHAPE = (480, 640)


def scene(level=90.0, noise=4.0, seed=0):
    """Noisy ground with warmer spots."""
    rng = np.random.default_rng(seed)
    spots = cv2.GaussianBlur(rng.normal(0, 300, SHAPE), (0, 0), 15)
    return np.clip(level + spots + rng.normal(0, noise, SHAPE), 0, 255).astype(np.uint8)


def outside(shape=SHAPE):
    """What an undistorted picture leaves black: caps above and below, a thin one on the left."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    bow = ((x - shape[1] / 2) / shape[1]) ** 2
    return (y < 40 - 30 * bow) | (y > shape[0] - 45 + 30 * bow) | (x < 12 - 40 * (y / shape[0] - 0.5) ** 2)


def with_margin(picture, where):
    return np.where(where, 0, picture).astype(picture.dtype)


@pytest.mark.parametrize("quality", [None, 95, 60])
def test_margins_are_found_after_a_codec(quality):
    where = outside()
    picture = with_margin(scene(), where)
    if quality is not None:
        stored = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        picture = cv2.imdecode(stored, cv2.IMREAD_GRAYSCALE)
    found = find_margin(picture)
    assert found[where].mean() > 0.999
    far = cv2.dilate(where.astype(np.uint8), np.ones((31, 31))) == 0
    assert not found[far].any()
    assert on_margin(found, np.array([300.0, 20, 320, 60]))
    assert not on_margin(found, np.array([300.0, 200, 320, 240]))


def test_sixteen_bits_and_rotated_pictures():
    turn = cv2.getRotationMatrix2D((320, 240), 15, 1)
    turned = cv2.warpAffine(scene().astype(np.uint16) * 100 + 200, turn, SHAPE[::-1])
    found = find_margin(turned, 100.0)
    assert found[turned == 0].all()
    assert not found[240, 320]


def test_dark_scenes_have_no_margin():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    corner = np.hypot(x / 640, y / 480)
    rng = np.random.default_rng(1)
    # A dark, noisy corner; one that fades into black; a black road that crosses the picture's edge.
    noisy = np.clip(80 * corner - 8 + rng.normal(0, 2.5, SHAPE), 0, 255).astype(np.uint8)
    fading = np.clip(60 * (corner - 0.4), 0, 255).astype(np.uint8)
    road = np.where((y > 300) & (y < 330), 0, scene()).astype(np.uint8)
    for picture in (scene(), noisy, fading, road, np.zeros(SHAPE, np.uint8), np.full(SHAPE, 120, np.uint8)):
        assert find_margin(picture) is None
    assert not on_margin(None, np.array([0.0, 0, 9, 9]))
