"""What a surface emits and mirrors at an angle, and how warm it gets.

Emissivity and reflectance add up to one (opaque, Kirchhoff). Rough and hairy surfaces (fur, cloth, grass, soil) are
cavities: their emissivity is constant, without a Fresnel rim.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infrablend.thermal.radiometry import STEFAN_BOLTZMANN_W_M2_K4

Array = NDArray[np.float64]


def fresnel_emissivity(n: float, k: float, angle_rad: ArrayLike) -> Array:
    """eps(theta) in [0, 1] of a smooth opaque surface of complex index n + i k, unpolarised.

    Dielectrics (paint, plastic: 1.5, 0.02) are flat to about 50 degrees and collapse beyond 70; metals are low and rise
    a little towards grazing. Fresnel's equations with q = sqrt(m^2 - sin^2 theta).

    Args:
        n, k: Refractive index and extinction near 10 um; n > 0, k >= 0.
        angle_rad: Angle from the normal, 0 to pi/2.
    """
    theta = np.asarray(angle_rad, np.float64)
    m = complex(n, k)
    cos = np.cos(theta)
    q = np.sqrt(m * m - np.sin(theta) ** 2 + 0j)
    r_s = (cos - q) / (cos + q)
    r_p = (m * m * cos - q) / (m * m * cos + q)
    return np.asarray(1 - (np.abs(r_s) ** 2 + np.abs(r_p) ** 2) / 2)


def hemispherical_emissivity(n: float, k: float, steps: int = 2000) -> float:
    """Cosine-weighted mean of `fresnel_emissivity` over the hemisphere."""
    theta = (np.arange(steps) + 0.5) * (np.pi / 2 / steps)
    weight = np.sin(2 * theta)
    return float((fresnel_emissivity(n, k, theta) * weight).sum() / weight.sum())


def leaving_radiance(emissivity: ArrayLike, own: ArrayLike, mirrored: ArrayLike) -> Array:
    """Radiance that leaves a surface: eps L(T) + (1 - eps) L_env, all in W m^-2 sr^-1.

    In surroundings of its own temperature it is L(T) whatever eps is (isothermal cavity).
    """
    e = np.asarray(emissivity, np.float64)
    return np.asarray(e * np.asarray(own) + (1 - e) * np.asarray(mirrored))


def convection_w_m2_k(wind_m_s: ArrayLike) -> Array:
    """h_c, W m^-2 K^-1: heat carried off by air at wind v; 5.7 + 3.8 v below 5 m/s, 6.47 v^0.78 above."""
    v = np.asarray(wind_m_s, np.float64)
    return np.asarray(np.where(v < 5, 5.7 + 3.8 * v, 6.47 * v**0.78))


def steady_excess_k(
    air_k: float,
    emissivity: float,
    *,
    sun_absorbed_w_m2: float = 0.0,
    heat_w_m2: float = 0.0,
    sky_emissivity: float = 1.0,
    sky_view: float = 1.0,
    wind_m_s: float = 1.0,
) -> float:
    """Surface minus air temperature, K, of a thin insulated panel in balance.

    dT = (aS + eps (L_down - sigma Ta^4) + q) / (h_c + 4 eps sigma Ta^3), L_down = (F e0 + 1 - F) sigma Ta^4. Linear
    in dT: good to a few per cent up to 40 K. Massive ground (asphalt, concrete) does not follow it: it stays
    2 to 6 K above air for hours after sunset.

    Args:
        air_k: Air temperature Ta, K.
        emissivity: eps of the surface.
        sun_absorbed_w_m2: a S, absorbed sunlight.
        heat_w_m2: q, heat from inside.
        sky_emissivity: Broadband e0 of the sky (`sky.clear_sky_emissivity`).
        sky_view: F, share of the hemisphere that is sky; the rest is at air temperature.
        wind_m_s: Wind v.
    """
    black = STEFAN_BOLTZMANN_W_M2_K4 * air_k**4
    down = (sky_view * sky_emissivity + 1 - sky_view) * black
    gain = sun_absorbed_w_m2 + emissivity * (down - black) + heat_w_m2
    loss = float(convection_w_m2_k(wind_m_s)) + 4 * emissivity * STEFAN_BOLTZMANN_W_M2_K4 * air_k**3
    return gain / loss
