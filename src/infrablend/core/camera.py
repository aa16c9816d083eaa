"""The pinhole camera: position, direction, projection.

World: Z up, metres. Camera axes as in OpenCV: x right, y down, z forward. Pixel (column j, row i) covers
[j, j+1) x [i, i+1), origin at the top left corner of the image.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from infrablend.core.mesh import FloatArray

BLENDER_FOCAL_LENGTH_MM = 50.0
BLENDER_SENSOR_WIDTH_MM = 36.0


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
        p, r = self.pitch_rad, self.roll_rad
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
