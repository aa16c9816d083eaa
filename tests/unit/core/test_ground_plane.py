"""The direction of roads and kerbs on the ground is found in pictures from any angle."""

import math

import cv2
import numpy as np
import pytest

from infrablend.core.camera import CameraSpec
from infrablend.core.ground_plane import at_height, find_ground_edges, ground_point, ground_z_m

WH = (640, 512)


def lines_of(*picture, **more):
    edges = find_ground_edges(*picture, **more)
    return None if edges is None else edges.lines()


def camera(pitch_deg):
    return at_height(CameraSpec(1.0, math.radians(pitch_deg), 0.0, 115.875, 36.0, WH), 80)


def street(view, yaw_deg, across=0.3, noise=3.0):
    """A picture of ground with kerbs every 6 m along a direction, and a few weaker ones across."""
    ground_z = ground_z_m(view, 80)
    v, u = np.mgrid[0 : WH[1], 0 : WH[0]]
    corners = [(0, 0), (WH[0], 0), (WH[0], WH[1]), (0, WH[1])]
    points = [ground_point(view, *corner, ground_z) for corner in corners]
    to_ground = cv2.getPerspectiveTransform(np.float32(corners), np.float32([p[:2] for p in points]))
    xy = cv2.perspectiveTransform(np.stack([u, v], axis=-1).reshape(-1, 1, 2).astype(np.float32), to_ground)
    x, y = xy.reshape(*WH[::-1], 2).transpose(2, 0, 1)
    turn = math.radians(yaw_deg)
    side, along = y * math.cos(turn) - x * math.sin(turn), x * math.cos(turn) + y * math.sin(turn)
    grey = 120 + 40 * (side % 6 < 1.2) + across * 40 * (along % 11 < 1)
    grain = np.random.default_rng(0).normal(0, noise, grey.shape)
    return np.clip(cv2.GaussianBlur(grey, (0, 0), 1) + grain, 0, 255).astype(np.uint8)


def apart_deg(lines, yaw_deg):
    return abs((math.degrees(lines.yaw_rad) - yaw_deg + 45) % 90 - 45)


@pytest.mark.parametrize("pitch", [30, 60, 90])
@pytest.mark.parametrize("yaw", [0, 20, 45, 130])
def test_kerbs_give_their_direction_on_the_ground(pitch, yaw):
    view = camera(pitch)
    found = lines_of(street(view, yaw), view, ground_z_m(view, 80))
    assert apart_deg(found, yaw) < 3
    assert found.clarity > 0.4
    assert abs(found.yaw_rad) <= math.pi / 4 + 1e-9


def test_crossing_streets_count_as_one_direction():
    view = camera(60)
    found = lines_of(street(view, 25, across=1.0), view, ground_z_m(view, 80))
    assert apart_deg(found, 25) < 3


def test_edges_of_objects_texts_and_margins_do_not_count():
    view = camera(90)
    picture = street(view, 0)
    left_out = np.zeros(picture.shape, np.bool_)
    left_out[:, :330] = True
    turned = street(view, 40)
    mixed = np.where(left_out, turned, picture)
    seen = lines_of(mixed, view, ground_z_m(view, 80), margin=left_out)
    boxed = lines_of(mixed, view, ground_z_m(view, 80), [np.array([0.0, 0, 330, 512])])
    assert apart_deg(seen, 0) < 1 and apart_deg(boxed, 0) < 1
    assert apart_deg(lines_of(mixed, view, ground_z_m(view, 80)), 0) > 3


def test_pictures_without_lines_give_none():
    view = camera(60)
    even = np.full(WH[::-1], 120, np.uint8)
    assert lines_of(even, view, ground_z_m(view, 80)) is None
    grain = np.random.default_rng(0).integers(100, 140, WH[::-1]).astype(np.uint8)
    assert lines_of(grain, view, ground_z_m(view, 80)).clarity < 0.05
    up = camera(-30)
    assert lines_of(street(view, 0), up, ground_z_m(up, 80)) is None


def test_16_bit_pictures_give_the_same_direction():
    view = camera(60)
    picture = street(view, 25)
    deep = (picture.astype(np.uint16) * 40) + 9000
    one, other = (lines_of(p, view, ground_z_m(view, 80)) for p in (picture, deep))
    assert one.yaw_rad == pytest.approx(other.yaw_rad, abs=1e-3)


def test_gradients_are_whole_numbers_that_no_processor_rounds():
    view = camera(60)
    edges = find_ground_edges(street(view, 20), view, ground_z_m(view, 80))
    below = edges.weight[edges.weight < edges.weight.max()]
    assert len(below) > 1000 and (below == np.rint(below)).all()
