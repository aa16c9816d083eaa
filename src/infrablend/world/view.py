"""The camera over the virtual world, and the ground that it sees."""

from __future__ import annotations

import math

import numpy as np

from infrablend.core.camera import CameraSpec
from infrablend.core.mesh import FloatArray

SIZE_WH = (640, 512)
# HIT-UAV's measured effective focal length; 36 mm is the nominal sensor width of the camera type.
FOCAL_PX = 2060.0
SENSOR_WIDTH_MM = 36.0


def world_camera(pitch_deg: float, altitude_m: float, size_wh: tuple[int, int] = SIZE_WH) -> CameraSpec:
    """Return HIT-UAV's camera at `altitude_m` above ground, looking down at `pitch_deg` (90 is straight down).

    `size_wh` changes the number of pixels, but not the horizontal field of view.
    """
    pitch = math.radians(pitch_deg)
    return CameraSpec(
        distance_m=altitude_m / math.sin(pitch),
        pitch_rad=pitch,
        roll_rad=0.0,
        focal_length_mm=FOCAL_PX / SIZE_WH[0] * SENSOR_WIDTH_MM,
        sensor_width_mm=SENSOR_WIDTH_MM,
        size_wh=size_wh,
    )


def ground_points(camera: CameraSpec, pixels_xy: FloatArray) -> FloatArray:
    """Return (N, 2) world x and y where the rays through (N, 2) pixel positions meet the ground."""
    w, h = camera.size_wh
    rays = np.stack(
        [
            (pixels_xy[:, 0] - w / 2) / camera.focal_px,
            (pixels_xy[:, 1] - h / 2) / camera.focal_px,
            np.ones(len(pixels_xy)),
        ],
        axis=1,
    )
    world = rays @ camera.world_to_camera
    eye = camera.position_m
    return np.asarray(eye[:2] - world[:, :2] * (eye[2] / world[:, 2])[:, None])
