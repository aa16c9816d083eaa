"""Reference formulas for rendered pictures and material tables."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infrablend.thermal.radiometry import ObjectSettings, Planck, band_radiance

Array = NDArray[np.float64]

_KELVIN = np.arange(150.0, 700.1, 0.25)
_RADIANCE = band_radiance(_KELVIN, terms=20)


def apparent_temperature(radiance: ArrayLike) -> Array:
    """Return the temperature of the blackbody with this 8 to 14 um radiance: a table in ln L against 1/T."""
    return np.asarray(1.0 / np.interp(np.log(radiance), np.log(_RADIANCE), 1.0 / _KELVIN))


def object_kelvin(counts: NDArray[np.uint16], planck: Planck, camera: ObjectSettings) -> Array:
    """Return temperatures of objects as Minkina and Dudzik (2009) do: emissivity, reflection, window, air taken out."""
    c, e, w = camera.air_k - 273.15, camera.emissivity, camera.window_transmission
    wet = np.sqrt(camera.humidity * np.exp(1.5587 + 0.06939 * c - 2.7816e-4 * c**2 + 6.8455e-7 * c**3))
    far = np.sqrt(camera.distance_m / 2)
    t = 1.9 * np.exp(far * (0.002276 * wet - 0.006569)) - 0.9 * np.exp(far * (0.00667 * wet - 0.01262))
    reflected, air, window = (planck.counts(k) for k in (camera.reflected_k, camera.air_k, camera.window_k))
    foreign = t * w * t * (1 - e) * reflected + (t * w * (1 - t) + 1 - t) * air + t * (1 - w) * window
    return planck.kelvin((counts - foreign) / (t * w * t * e))


def leaving_radiance(emissivity: ArrayLike, own: ArrayLike, mirrored: ArrayLike) -> Array:
    """Return eps L(T) + (1 - eps) L_env."""
    e = np.asarray(emissivity, np.float64)
    return np.asarray(e * np.asarray(own) + (1 - e) * np.asarray(mirrored))


def fresnel_emissivity(n: float, k: float, angle_rad: ArrayLike) -> Array:
    """Return eps(theta) of a smooth opaque surface of complex index n + i k, unpolarised, by Fresnel's equations."""
    theta = np.asarray(angle_rad, np.float64)
    m = complex(n, k)
    cos = np.cos(theta)
    q = np.sqrt(m * m - np.sin(theta) ** 2 + 0j)
    r_s = (cos - q) / (cos + q)
    r_p = (m * m * cos - q) / (m * m * cos + q)
    return np.asarray(1 - (np.abs(r_s) ** 2 + np.abs(r_p) ** 2) / 2)
