"""Light that leaves surfaces towards the camera, in both looks, without light that other surfaces send.

The formulas are those of the node groups in `blender.materials` and `blender.physical`. In the physical look a smooth
surface mirrors one direction of the sky or the ground, a rough one (refractive index 1) scatters the light of the whole
half-space in front of it. The blur that `roughness` gives to the mirror image is left out.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from infrablend.core.mesh import FloatArray
from infrablend.core.scene import Appearance, Weather
from infrablend.thermal.radiometry import ZERO_C_K, band_radiance
from infrablend.thermal.sky import sky_radiance

# Temperatures of the table of radiances; interpolation is good to 2e-5 from 200 K.
_TABLE_K = np.arange(100.0, 2000.0, 0.5)
# Upward components of directions, and of normals, for which the light of the surroundings is computed once per scene.
_RINGS = (np.arange(1024) + 0.5) / 512 - 1
_NORMALS = np.linspace(-1, 1, 129)


class Points(NamedTuple):
    """Points on surfaces, (N,) each.

    Attributes:
        celsius: Temperature.
        emissivity: Emissivity seen straight on.
        ior: Refractive index, from the side that the camera sees.
        cosine: Cosine of the angle between the normal and the line of sight, at least 0.
        normal_up: Upward component of the normal on the camera's side.
        mirrored_up: Upward component of the direction that a mirror would show.
    """

    celsius: FloatArray
    emissivity: FloatArray
    ior: FloatArray
    cosine: FloatArray
    normal_up: FloatArray
    mirrored_up: FloatArray


class ArtisticLook:
    """Levels, 0 black to 1 white: a surface mirrors one uniform level."""

    def __init__(self, look: Appearance) -> None:
        """Take the limits of the grey scale, and the temperature of the surroundings."""
        self._cold_c = look.cold_k - ZERO_C_K
        self._span_k = look.hot_k - look.cold_k
        self._mirrored = min(max((look.surroundings_k - look.cold_k) / self._span_k, 0.0), 1.0)

    def light(self, at: Points) -> FloatArray:
        """Return the level (N,) that each point shows."""
        emissivity = np.clip(at.emissivity * (1 - fresnel(at.cosine, at.ior)), 0, 1)
        own = np.clip((at.celsius - self._cold_c) / self._span_k, 0, 1)
        return np.asarray(self._mirrored + emissivity * (own - self._mirrored))


class PhysicalLook:
    """Radiance, W m^-2 sr^-1: a surface mirrors the sky and the ground."""

    def __init__(self, weather: Weather) -> None:
        """Compute the light of the surroundings for all directions."""
        ground = float(band_radiance(weather.ground_k))
        zenith_rad = np.arccos(np.abs(_RINGS))
        sky = sky_radiance(weather.air_k, weather.dew_point_k, zenith_rad, weather.cloud, weather.cloud_base_k)
        self._from = np.where(_RINGS > 0, sky, ground)
        self._on = _shares_of_rings() @ self._from

    def light(self, at: Points) -> FloatArray:
        """Return the radiance (N,) that each point shows."""
        straight_on = 1 - ((at.ior - 1) / (at.ior + 1)) ** 2
        emissivity = np.clip(at.emissivity * (1 - fresnel(at.cosine, at.ior)) / straight_on, 0, 1)
        own = np.interp(at.celsius + ZERO_C_K, _TABLE_K, _table_radiance())
        smooth = np.abs(at.ior - 1) > 1e-4
        around = np.empty(len(smooth))
        around[smooth] = np.interp(at.mirrored_up[smooth], _RINGS, self._from)
        around[~smooth] = np.interp(at.normal_up[~smooth], _NORMALS, self._on)
        return np.asarray(around + emissivity * (own - around))


def fresnel(cosine: FloatArray, ior: FloatArray) -> FloatArray:
    """Return the share of unpolarised light that a smooth dielectric reflects at an angle of incidence."""
    square = ior * ior - 1 + cosine * cosine
    g = np.sqrt(np.maximum(square, 0))
    a = (g - cosine) / np.maximum(g + cosine, 1e-30)
    b = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1)
    return np.where(square > 0, 0.5 * a * a * (1 + b * b), 1.0)


@cache
def _table_radiance() -> FloatArray:
    return band_radiance(_TABLE_K)


@cache
def _shares_of_rings() -> FloatArray:
    """Return (normals, rings) the share that each ring of directions has in the light on a surface.

    A ring at the height z has the cosines m z + sqrt(1 - m^2) sqrt(1 - z^2) cos(azimuth) with a normal whose upward
    component is m; they are integrated in closed form over the azimuths at which they are positive.
    """
    m = _NORMALS[:, None]
    z = _RINGS
    level = m * z
    wave = np.sqrt(1 - m * m) * np.sqrt(1 - z * z)
    limit = np.arccos(np.clip(-level / np.maximum(wave, 1e-12), -1, 1))
    light = np.maximum(level * limit + wave * np.sin(limit), 0)
    return np.asarray(light / light.sum(axis=1, keepdims=True))
