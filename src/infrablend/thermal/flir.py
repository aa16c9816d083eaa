"""FLIR's published conversion between raw counts and temperatures.

The detector's signal is `S(T) = R1 / (R2 (exp(B / T) - F)) - O`. What the camera measures of an object of emissivity
`e` through a window of transmission `w`, half-way through air whose halves have a transmission of `t` each, is

    S = t w t (e S(object) + (1 - e) S(reflected)) + t w (1 - t) S(air) + t (1 - w) S(window) + (1 - t) S(air).

This is the formula of Minkina and Dudzik ("Infrared Thermography", 2009) that other open programs use as well. Treating
the air as one layer where there is no window, as FLIR's manuals do, gives temperatures that differ by 0.1 K at 1 m and
0.4 K at 20 m, because FLIR's transmission depends on the square root of the distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infrablend.thermal.radiometry import ZERO_C_K


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
class Atmosphere:
    """Constants of the transmission of air, as FLIR names them; the defaults are those of every known camera."""

    alpha1: float = 0.006569
    alpha2: float = 0.01262
    beta1: float = -0.002276
    beta2: float = -0.00667
    x: float = 1.9

    def transmission(self, distance_m: float, air_k: float, humidity: float) -> float:
        """Return the share of radiation that passes through air; `humidity` is relative, from 0 to 1."""
        c = air_k - ZERO_C_K
        water = humidity * np.exp(1.5587 + 0.06939 * c - 2.7816e-4 * c**2 + 6.8455e-7 * c**3)
        far, wet = np.sqrt(distance_m), np.sqrt(water)
        first = self.x * np.exp(-far * (self.alpha1 + self.beta1 * wet))
        second = (1 - self.x) * np.exp(-far * (self.alpha2 + self.beta2 * wet))
        return float(np.clip(first + second, 0.01, 1.0))


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


def object_kelvin(
    counts: NDArray[np.uint16], planck: Planck, settings: ObjectSettings, atmosphere: Atmosphere
) -> NDArray[np.float64]:
    """Return the (h, w) temperatures of the objects, kelvin: emissivity, reflection and air taken out."""
    e, w = settings.emissivity, settings.window_transmission
    t = atmosphere.transmission(settings.distance_m / 2, settings.air_k, settings.humidity)
    through = t * w * t
    foreign = (
        through * (1 - e) * planck.counts(settings.reflected_k)
        + (t * w * (1 - t) + 1 - t) * planck.counts(settings.air_k)
        + t * (1 - w) * planck.counts(settings.window_k)
    )
    return planck.kelvin((counts.astype(np.float64) - foreign) / (through * e))


def apparent_kelvin(counts: NDArray[np.uint16], planck: Planck) -> NDArray[np.float64]:
    """Return the (h, w) apparent temperatures at the sensor, kelvin: those of black bodies that give the counts."""
    return planck.kelvin(counts.astype(np.float64))
