"""Band radiance of a blackbody, 8 to 14 um.

Cameras measure radiance in a band, not temperature. Over the tens of kelvin of a scene the two are not proportional:
a line through ground and ground + 15 K is 9 K off at ground + 50 K.

Raw counts of FLIR's cameras follow its published conversion: `S(T) = R1 / (R2 (exp(B / T) - F)) - O`. Temperatures are
those that a black body of the same signal has: air, reflections and emissivity stay in them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

PLANCK_J_S = 6.62607015e-34
LIGHT_M_S = 299_792_458.0
BOLTZMANN_J_K = 1.380649e-23
STEFAN_BOLTZMANN_W_M2_K4 = 5.670374419e-8
SECOND_RADIATION_M_K = PLANCK_J_S * LIGHT_M_S / BOLTZMANN_J_K
ZERO_C_K = 273.15

BAND_M = (8e-6, 14e-6)


def band_radiance(temperature_k: ArrayLike, band_m: tuple[float, float] = BAND_M, terms: int = 8) -> Array:
    """Return L, W m^-2 sr^-1, the radiance of a blackbody at T kelvin between two wavelengths in metres.

    Planck's law integrated term by term (an exact series): with x = c2 / (lambda T),
    S(x) = sum_n exp(-n x) (x^3/n + 3 x^2/n^2 + 6 x/n^3 + 6/n^4) and
    L = 2 k^4 T^4 / (h^3 c^2) * (S(x_long) - S(x_short)).

    Args:
        temperature_k: T > 0, any shape.
        band_m: Short and long wavelength.
        terms: Terms of the series; 8 are exact to 1e-9 up to 500 K in this band, longer wavelengths and heat need more.

    Raises:
        ValueError: A temperature is not positive and finite.
    """
    t = np.asarray(temperature_k, np.float64)
    if not (np.isfinite(t).all() and (t > 0).all()):
        raise ValueError("temperature_k must be positive and finite (kelvin)")
    n = np.arange(1, terms + 1, dtype=np.float64).reshape((-1,) + (1,) * t.ndim)

    def tail(wavelength_m: float) -> Array:
        x = SECOND_RADIATION_M_K / (wavelength_m * t)
        return np.asarray(np.sum(np.exp(-n * x) * (x**3 / n + 3 * x**2 / n**2 + 6 * x / n**3 + 6 / n**4), axis=0))

    factor = 2 * BOLTZMANN_J_K**4 * t**4 / (PLANCK_J_S**3 * LIGHT_M_S**2)
    return np.asarray(factor * (tail(band_m[1]) - tail(band_m[0])))


@lru_cache(maxsize=256)
def radiance_at(temperature_k: float) -> float:
    """Return `band_radiance` of one temperature, which a frame asks for many times."""
    return float(band_radiance(temperature_k))


def band_radiance_slope(temperature_k: ArrayLike) -> Array:
    """Return dL/dT, W m^-2 sr^-1 K^-1, by central difference; relative error below 1e-7 from 200 to 500 K."""
    t = np.asarray(temperature_k, np.float64)
    h = 1e-2
    return (band_radiance(t + h) - band_radiance(t - h)) / (2 * h)


UNIT_K = 300.0
UNIT_W_M2_SR = float(band_radiance(UNIT_K))
"""Radiance that shaders in Blender use as their unit, which keeps values near one."""


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
