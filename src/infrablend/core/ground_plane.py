"""The ground plane under a camera: where pixels meet it, and how high the camera is above it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from infrablend.core.camera import CameraSpec
from infrablend.core.mesh import FloatArray

# Ground farther away than this counts as the horizon.
FARTHEST_M = 5_000.0


def at_height(camera: CameraSpec, height_m: float) -> CameraSpec:
    """Return the camera at this height above a ground plane that its optical axis meets at the scene's origin.

    If the camera looks up, or so level that the axis meets the ground beyond `FARTHEST_M`, the origin is put at that
    distance instead, and the ground is below it (`ground_z_m`).
    """
    down = math.sin(camera.pitch_rad)
    return replace(camera, distance_m=height_m / down if down > height_m / FARTHEST_M else FARTHEST_M)


def ground_z_m(camera: CameraSpec, height_m: float) -> float:
    """Return the ground plane's height in the world, metres: 0 if the optical axis meets it within `FARTHEST_M`."""
    z = float(camera.position_m[2]) - height_m
    return 0.0 if abs(z) < 1e-9 * FARTHEST_M else z


def ground_point(camera: CameraSpec, u: float, v: float, z_m: float) -> FloatArray | None:
    """Return the (3,) point where the ray through pixel (u, v) meets the plane at `z_m`; None above the horizon."""
    ray = pixel_ray(camera, u, v)
    if ray[2] >= 0:
        return None
    t = (z_m - float(camera.position_m[2])) / float(ray[2])
    return np.asarray(camera.position_m + t * ray) if 0 < t <= FARTHEST_M else None


def pixel_ray(camera: CameraSpec, u: float, v: float) -> FloatArray:
    """Return the (3,) unit direction in the world through pixel position (u, v)."""
    w, h = camera.size_wh
    ray = np.array([(u - w / 2) / camera.focal_px, (v - h / 2) / camera.focal_px, 1.0])
    turned = camera.world_to_camera.T @ ray
    return np.asarray(turned / np.linalg.norm(turned))
