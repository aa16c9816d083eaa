"""What a picture shows behind its inserts: ground, sky, or things that stand above the horizon.

Behind a drone at or above the horizon is sky, 10 to 60 K colder than the ground; taking it for ground would make the
drone as faint as a stone on a meadow. Trees, roofs and walls above the horizon are neither: their own level is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.camera import CameraSpec
from infrablend.core.scene import Weather
from infrablend.imaging.skyline import find_skyline
from infrablend.thermal.sky import sky_radiance

Kind = Literal["ground", "sky", "skyline"]
# The sky counts if this share of the picture shows it.
_LEAST_SKY = 0.01
_LEAST_PIXELS = 50

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Behind:
    """Levels and places of what is behind a picture's inserts; a level is None where the picture shows none of it.

    Attributes:
        ground_grey: Median level of the ground.
        sky_grey: Median level of the sky.
        sky_radiance: Mean radiance of that sky by the weather, W m^-2 sr^-1; 0 without sky.
        skyline_grey: Median level of what stands above the horizon: trees, roofs.
        sky: (h, w) pixels of the sky.
        land: (h, w) pixels of ground and skyline.
        elevation_rad: (h, w) elevation above the horizon; None for a camera without a known horizon.
        step_grey: Rise of the level from the sky to the land below the skyline; 0 if unknown.
    """

    ground_grey: float | None
    sky_grey: float | None
    sky_radiance: float
    skyline_grey: float | None
    sky: Mask
    land: Mask
    elevation_rad: NDArray[np.float32] | None = None
    step_grey: float = 0.0

    def kind_at(self, box_xyxy: NDArray[np.float64]) -> Kind:
        """Return what most of a box covers."""
        if self.sky_grey is None or self.elevation_rad is None:
            return "ground"
        h, w = self.sky.shape
        x0, y0 = (int(max(np.floor(v), 0)) for v in box_xyxy[:2])
        x1, y1 = min(int(np.ceil(box_xyxy[2])), w), min(int(np.ceil(box_xyxy[3])), h)
        part = (slice(min(y0, h - 1), max(y1, y0 + 1)), slice(min(x0, w - 1), max(x1, x0 + 1)))
        if 2 * np.count_nonzero(self.land[part]) < self.land[part].size:
            return "sky"
        return "skyline" if float(self.elevation_rad[part].mean()) > 0 else "ground"


def look_behind(
    picture: NDArray[np.float32], free: Mask, scale: float, camera: CameraSpec | None, weather: Weather
) -> Behind:
    """Find ground, sky and skyline of a picture.

    `picture` has (h, w) levels, hot is bright; `free` are the pixels outside all labels' boxes, `scale` levels per
    8-bit level. Without a camera whose horizon is known, all is ground.
    """
    everywhere = np.ones(picture.shape, np.bool_)
    level = _median(picture, free)
    # A level of 0 is a level; only too few free pixels call for the whole picture.
    level = _median(picture, everywhere) if level is None else level
    all_ground = Behind(level, None, 0.0, None, ~everywhere, everywhere)
    if camera is None or not sees_horizon(camera):
        return all_ground
    elevation = elevations(camera)
    found = find_skyline(picture, scale)
    above = elevation > 0
    sky = found.sky
    land = found.land | ~above
    sky = sky & ~land
    if np.count_nonzero(sky) < _LEAST_SKY * sky.size:
        return all_ground
    seen = sky & free
    radiance = sky_radiance(
        weather.air_k,
        weather.dew_point_k,
        np.pi / 2 - elevation[seen][:: max(1, np.count_nonzero(seen) // 2000)].astype(np.float64),
        weather.cloud,
        weather.cloud_base_k,
    )
    return Behind(
        ground_grey=_median(picture, land & ~above & free),
        sky_grey=_median(picture, seen),
        sky_radiance=float(radiance.mean()) if radiance.size else 0.0,
        skyline_grey=_median(picture, land & above & free),
        sky=sky,
        land=land,
        elevation_rad=elevation,
        step_grey=found.step_grey,
    )


def sees_horizon(camera: CameraSpec) -> bool:
    """Return whether the ray of any pixel points above the horizon; then that of a pixel in a corner does."""
    w, h = camera.size_wh
    right, down, ahead = camera.world_to_camera.T[2]
    return bool((abs(right) * (w - 1) + abs(down) * (h - 1)) / (2 * camera.focal_px) + ahead > 0)


def elevations(camera: CameraSpec) -> NDArray[np.float32]:
    """Return the (h, w) elevation of each pixel's ray above the horizon, radians."""
    w, h = camera.size_wh
    f = camera.focal_px
    x, y = (np.arange(w) + 0.5 - w / 2) / f, (np.arange(h) + 0.5 - h / 2) / f
    up = camera.world_to_camera.T[2]
    z = up[0] * x[None, :] + up[1] * y[:, None] + up[2]
    return np.asarray(np.arcsin(z / np.sqrt(x[None, :] ** 2 + y[:, None] ** 2 + 1)), np.float32)


def _median(picture: NDArray[np.float32], mask: Mask) -> float | None:
    values = picture[mask]
    return float(np.median(values)) if values.size >= _LEAST_PIXELS else None
