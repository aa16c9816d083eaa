"""The pinhole camera: position, direction, projection; and the camera angles of drones and datasets, converted to ours.

World: Z up, metres. Camera axes as in OpenCV: x right, y down, z forward. Pixel (column j, row i) covers
[j, j+1) x [i, i+1), origin at the top left corner of the image. Pitch counts below the horizon (90 straight down); this
is the only place that knows other conventions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from infrablend.core.mesh import FloatArray

STRAIGHT_DOWN_DEG = 90.0

# Gimbals overshoot their stop: DJI reports up to -90.9 for a camera that looks straight down.
_OVERSHOOT_DEG = 2.0
# Gimbals roll by at most about this angle; a larger one is a turned mount, or the other way to write a pitch past 90.
_MOST_ROLL_DEG = 45.0
# From this pitch on, turning the camera about its axis only turns the ground in the picture.
_FROM_ABOVE_DEG = 80.0


@dataclass(frozen=True)
class CameraSpec:
    """A camera that looks at the scene origin.

    It is in the vertical plane through -Y at `distance_m` from the origin, so the world's +Y points away from it (up in
    the image) and +X to the right.

    Attributes:
        distance_m: Distance from the camera to the scene origin.
        pitch_rad: Depression angle of the optical axis: 0 level, pi/2 straight down, negative looking up.
        roll_rad: Rotation about the optical axis; positive turns the camera clockwise as seen from behind it, so the
            picture's content turns counter-clockwise.
        focal_length_mm: Focal length of the lens.
        sensor_width_mm: Width of the sensor, which the image's width covers.
        size_wh: Image size in pixels.
    """

    distance_m: float
    pitch_rad: float
    roll_rad: float
    focal_length_mm: float
    sensor_width_mm: float
    size_wh: tuple[int, int]

    @property
    def focal_px(self) -> float:
        """Focal length in pixels; pixels are square, the sensor width spans the image width."""
        return self.focal_length_mm / self.sensor_width_mm * self.size_wh[0]

    @cached_property
    def position_m(self) -> FloatArray:
        """(3,) camera centre in the world."""
        p = self.pitch_rad
        return self.distance_m * np.array([0.0, -np.cos(p), np.sin(p)])

    @cached_property
    def world_to_camera(self) -> FloatArray:
        """(3, 3) rotation; rows are the camera's x, y, z axes in world coordinates."""
        p = self.pitch_rad
        r = self.roll_rad
        right = np.array([1.0, 0.0, 0.0])
        forward = np.array([0.0, np.cos(p), -np.sin(p)])
        down = np.cross(forward, right)
        return np.stack([np.cos(r) * right + np.sin(r) * down, -np.sin(r) * right + np.cos(r) * down, forward])

    def to_camera(self, points_m: FloatArray) -> FloatArray:
        """Return (N, 3) world points in camera coordinates, metres; the third column is the depth."""
        return np.asarray((points_m - self.position_m) @ self.world_to_camera.T)

    def project(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return pixel positions (N, 2) of world points (N, 3), and their depths (N,) in metres.

        Positions at depth <= 0 are NaN.
        """
        xyz = self.to_camera(points_m)
        depth = xyz[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = xyz[:, :2] / depth[:, None] * self.focal_px + np.array(self.size_wh) / 2
        xy[depth <= 0] = np.nan
        return xy, depth


def object_to_world(
    vertices_m: FloatArray,
    position_m: NDArray[np.float64] | tuple[float, float, float],
    yaw_rad: float,
    scale: float = 1.0,
) -> FloatArray:
    """Return the (V, 3) vertices turned by `yaw_rad` about +Z (counter-clockwise from above), scaled, moved."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(scale * (vertices_m @ turn.T) + np.asarray(position_m, np.float64))


def pitch_of_gimbal(gimbal_deg: float) -> float:
    """Return the angle below the horizon for a gimbal's pitch, which is negative below the horizon (DJI, AirData).

    An overshoot of at most 2 degrees counts as straight down. Larger angles are returned as they are, above 90: the
    camera looks back under the aircraft, which callers refuse.

    >>> pitch_of_gimbal(-90.0), pitch_of_gimbal(-30.5), pitch_of_gimbal(12.0)
    (90.0, 30.5, -12.0)
    """
    pitch_deg = 0.0 - gimbal_deg
    return STRAIGHT_DOWN_DEG if STRAIGHT_DOWN_DEG < pitch_deg <= STRAIGHT_DOWN_DEG + _OVERSHOOT_DEG else pitch_deg


def pitch_of_tilt(tilt_deg: float) -> float:
    """Return the angle below the horizon for a tilt away from straight down, in any number of turns (BAMBI).

    >>> pitch_of_tilt(0.0), pitch_of_tilt(25.0), pitch_of_tilt(359.0)
    (90.0, 65.0, 89.0)
    """
    return STRAIGHT_DOWN_DEG - abs((tilt_deg + 180.0) % 360.0 - 180.0)


def roll_of_gimbal(gimbal_deg: float) -> float:
    """Return the roll of the camera, in (-180, 180], for a gimbal's roll in any number of turns (DJI, AirData).

    Both are positive clockwise as seen from behind the camera: the right edge of the picture points further down, so
    the horizon in the picture is turned counter-clockwise.

    >>> roll_of_gimbal(10.0), roll_of_gimbal(-180.0), roll_of_gimbal(350.0)
    (10.0, 180.0, -10.0)
    """
    return 180.0 - (180.0 - gimbal_deg) % 360.0 if not -180.0 < gimbal_deg <= 180.0 else gimbal_deg


def is_plausible_roll(roll_deg: float, pitch_deg: float | None) -> bool:
    """Return whether a camera can have a gimbal's roll, or is seen so far from above that any roll is only a heading.

    A larger roll at a flatter pitch leaves open whether the picture is upside down: some cameras turn it upright.
    """
    return abs(roll_deg) <= _MOST_ROLL_DEG or (pitch_deg is not None and pitch_deg >= _FROM_ABOVE_DEG)


def fov_of_width(width: float, focal_length: float) -> float:
    """Return the field of view, degrees, across a width in the unit of the focal length."""
    return math.degrees(2 * math.atan(width / 2 / focal_length))
