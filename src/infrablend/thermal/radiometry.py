"""Band radiance of a blackbody, 8 to 14 um.

Cameras measure radiance in a band, not temperature. Over the tens of kelvin of a scene the two are not proportional:
a line through ground and ground + 15 K is 9 K off at ground + 50 K.
"""

from __future__ import annotations

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
