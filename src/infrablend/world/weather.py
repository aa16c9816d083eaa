"""The weather over a scene: air, sky and sun, from which all temperatures are derived."""

from __future__ import annotations

import math
from dataclasses import dataclass

from infrablend.core.capture import TimeOfDay
from infrablend.world.draws import Draws


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
    air_k = 273.15 + (u(5, 16) if night else u(10, 20))
    clear_sky = u(0.35, 1.0)
    if night:
        return Weather(night, air_k, clear_sky, None, 0.0)
    height, azimuth = math.radians(u(28, 62)), u(0, 2 * math.pi)
    sun = (math.cos(height) * math.cos(azimuth), math.cos(height) * math.sin(azimuth), math.sin(height))
    return Weather(night, air_k, clear_sky, sun, u(0.6, 1.1))
