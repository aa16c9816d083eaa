"""FLIR's published conversion between raw counts and temperatures: `S(T) = R1 / (R2 (exp(B / T) - F)) - O`.

Temperatures are those that a black body of the same signal has: air, reflections and emissivity stay in them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Planck:
    """Constants of one camera's conversion, as FLIR names them."""

    r1: float
    b: float
    f: float
    o: float
    r2: float

    def kelvin(self, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the temperature, kelvin, of a black body that gives these counts; NaN where there is none."""
        with np.errstate(divide="ignore", invalid="ignore"):
            found = self.b / np.log(self.r1 / (self.r2 * (counts + self.o)) + self.f)
        return np.asarray(np.where(np.isfinite(found) & (found > 0), found, np.nan))

    def counts(self, kelvin: float | NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the counts that a black body of a temperature gives."""
        return np.asarray(self.r1 / (self.r2 * (np.exp(self.b / np.asarray(kelvin, np.float64)) - self.f)) - self.o)


@dataclass(frozen=True)
class ObjectSettings:
    """What the camera was told about the scene.

    Attributes:
        emissivity: Emissivity of the object, above 0 to 1.
        distance_m: Distance to the object.
        reflected_k: Apparent temperature of what the object reflects.
        air_k: Temperature of the air.
        humidity: Relative humidity, 0 to 1.
        window_k: Temperature of a window in front of the lens.
        window_transmission: Transmission of that window; 1 without one.
    """

    emissivity: float = 1.0
    distance_m: float = 0.0
    reflected_k: float = 293.15
    air_k: float = 293.15
    humidity: float = 0.5
    window_k: float = 293.15
    window_transmission: float = 1.0
