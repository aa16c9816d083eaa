"""The setting of a scene: random draws, the weather over it, and the camera above it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from infrablend.core.camera import CameraSpec
from infrablend.core.capture import TimeOfDay
from infrablend.core.mesh import FloatArray
from infrablend.thermal.radiometry import ZERO_C_K

T = TypeVar("T")

SIZE_WH = (640, 512)
# HIT-UAV's measured effective focal length; 36 mm is the nominal sensor width of the camera type.
FOCAL_PX = 2060.0
SENSOR_WIDTH_MM = 36.0


class Draws:
    """Draws from a random generator; the order of the calls fixes the scene."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draw from `rng`, usually the frame's own stream."""
        self._rng = rng

    def uniform(self, low: float, high: float) -> float:
        """Return a number from [low, high)."""
        return float(self._rng.uniform(low, high))

    def normal(self, mean: float, deviation: float) -> float:
        """Return a normally distributed number."""
        return float(self._rng.normal(mean, deviation))

    def share(self) -> float:
        """Return a number from [0, 1)."""
        return float(self._rng.random())

    def chance(self, probability: float) -> bool:
        """Return True with a given probability."""
        return bool(self._rng.random() < probability)

    def integer(self, low: int, high: int | None = None) -> int:
        """Return a whole number from [low, high), or from [0, low) if `high` is None."""
        return int(self._rng.integers(low, high))

    def one_of(self, options: Sequence[T]) -> T:
        """Return one of the options, all equally likely."""
        return options[int(self._rng.integers(len(options)))]


@dataclass(frozen=True)
class Weather:
    """Air, sky and sun of one scene.

    Attributes:
        night: Whether the sun is down.
        air_k: Air temperature.
        clear_sky: How clear the sky is, 1 without any haze; a clear sky cools what faces it at night.
        sun: Unit vector towards the sun, or None at night.
        solar: Strength of the sun, about 1 on a bright day; 0 at night.
    """

    night: bool
    air_k: float
    clear_sky: float
    sun: tuple[float, float, float] | None
    solar: float

    @property
    def sky_drop_k(self) -> float:
        """Air temperature minus apparent temperature of the sky overhead, in kelvin."""
        return 48 * self.clear_sky


def draw_weather(draws: Draws, time_of_day: TimeOfDay) -> Weather:
    """Draw the weather of a cool season."""
    u = draws.uniform
    night = time_of_day == "night"
    air_k = ZERO_C_K + (u(5, 16) if night else u(10, 20))
    clear_sky = u(0.35, 1.0)
    if night:
        return Weather(night, air_k, clear_sky, None, 0.0)
    height = math.radians(u(28, 62))
    azimuth = u(0, 2 * math.pi)
    sun = (math.cos(height) * math.cos(azimuth), math.cos(height) * math.sin(azimuth), math.sin(height))
    return Weather(night, air_k, clear_sky, sun, u(0.6, 1.1))


def world_camera(
    pitch_deg: float, altitude_m: float, size_wh: tuple[int, int] = SIZE_WH, focal_px: float = FOCAL_PX
) -> CameraSpec:
    """Return a camera at `altitude_m` above ground, looking down at `pitch_deg` (90 is straight down).

    `focal_px` is the focal length in pixels of a picture 640 wide, that of HIT-UAV by default. `size_wh` changes the
    number of pixels, but not the horizontal field of view.
    """
    pitch = math.radians(pitch_deg)
    return CameraSpec(
        distance_m=altitude_m / math.sin(pitch),
        pitch_rad=pitch,
        roll_rad=0.0,
        focal_length_mm=focal_px / SIZE_WH[0] * SENSOR_WIDTH_MM,
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
