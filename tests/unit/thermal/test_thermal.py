"""Physics, compared with published and independently computed values."""

import numpy as np
import pytest

from infrablend.thermal.radiometry import STEFAN_BOLTZMANN_W_M2_K4, band_radiance, band_radiance_slope
from infrablend.thermal.sky import clear_sky_emissivity, sky_radiance, transmittance
from tests.thermal_reference import apparent_temperature, fresnel_emissivity, leaving_radiance

PAINT = (1.5, 0.02)


@pytest.mark.parametrize(
    ("kelvin", "radiance"),
    [
        (200.0, 6.01175), (233.15, 15.18932), (263.15, 29.13736), (273.15, 35.15196), (293.15, 49.37290),
        (300.0, 54.93346), (310.15, 63.83165), (333.15, 86.93204), (373.15, 136.77834), (473.15, 311.42940),
    ],
)  # fmt: skip
def test_band_radiance(kelvin, radiance):
    assert band_radiance(kelvin) == pytest.approx(radiance, abs=1e-4)


def test_band_radiance_is_the_integral_of_plancks_law():
    from infrablend.thermal.radiometry import BOLTZMANN_J_K, LIGHT_M_S, PLANCK_J_S

    wavelength = np.linspace(8e-6, 14e-6, 20_001)
    planck = (
        2 * PLANCK_J_S * LIGHT_M_S**2 / wavelength**5
        / np.expm1(PLANCK_J_S * LIGHT_M_S / (wavelength * BOLTZMANN_J_K * 300))
    )  # fmt: skip
    step = wavelength[1] - wavelength[0]
    assert band_radiance(300.0) == pytest.approx((planck.sum() - (planck[0] + planck[-1]) / 2) * step, rel=1e-7)


def test_the_whole_spectrum_gives_sigma_t4():
    whole = band_radiance(300.0, (1e-7, 1e-2), terms=2000)
    assert whole == pytest.approx(STEFAN_BOLTZMANN_W_M2_K4 * 300**4 / np.pi, rel=1e-4)


def test_other_bands_and_slope():
    assert band_radiance(300.0, (7.5e-6, 13.5e-6)) == pytest.approx(55.49, abs=0.01)
    assert band_radiance(300.0, (8e-6, 12e-6)) == pytest.approx(38.50, abs=0.01)
    assert band_radiance_slope(300.0) == pytest.approx(0.83782, abs=1e-5)
    assert (np.diff(band_radiance(np.linspace(150, 700, 500))) > 0).all()


def test_temperatures_must_be_positive():
    with pytest.raises(ValueError, match="positive"):
        band_radiance([300, -1])


@pytest.mark.parametrize(
    ("index", "angles"),
    [
        (
            (1.5, 0.02),
            {0: 0.960, 40: 0.954, 50: 0.942, 60: 0.911, 65: 0.879, 70: 0.829, 75: 0.747, 80: 0.612, 85: 0.387},
        ),
        ((1.218, 0.051), {0: 0.990, 60: 0.961, 80: 0.697}),
        ((1.7, 0.8), {0: 0.858, 60: 0.796, 85: 0.325}),
        ((6, 15), {0: 0.088, 60: 0.106, 85: 0.264}),
        ((25.3, 89.8), {0: 0.012, 80: 0.033}),
    ],
)
def test_emissivity_against_angle(index, angles):
    n, k = index
    for degrees, expected in angles.items():
        assert fresnel_emissivity(n, k, np.radians(degrees)) == pytest.approx(expected, abs=1e-3), degrees


def test_emissivity_falls_towards_grazing_angles():
    paint = fresnel_emissivity(*PAINT, np.radians(np.linspace(0, 89.9, 900)))
    assert (paint >= 0).all()
    assert (paint <= 1).all()
    assert (np.diff(paint) <= 1e-12).all()


def test_sky():
    air, dew = 288.15, 278.15
    assert sky_radiance(air, dew, 0.0) == pytest.approx(8.55, abs=0.05)
    assert sky_radiance(air, dew, np.radians(60)) == pytest.approx(15.49, abs=0.05)
    assert sky_radiance(air, dew, np.radians(75)) == pytest.approx(25.14, abs=0.05)
    assert apparent_temperature(sky_radiance(air, dew, 0.0)) == pytest.approx(273.15 - 62, abs=1)
    angles = np.radians(np.linspace(0, 120, 200))
    radiance = sky_radiance(air, dew, angles)
    assert (np.diff(radiance) >= -1e-12).all()
    assert radiance.max() <= band_radiance(air)
    assert radiance[-1] > 0.95 * band_radiance(air)
    assert clear_sky_emissivity(dew) == pytest.approx(0.741, abs=1e-3)
    overcast = sky_radiance(air, dew, 0.0, cloud=1.0)
    assert apparent_temperature(overcast) == pytest.approx(air - 7, abs=1e-3)
    with pytest.raises(ValueError, match="above"):
        sky_radiance(280, 281, 0.0)


@pytest.mark.parametrize(
    ("celsius", "humidity", "distance", "tau"),
    [(20, 0.5, 100, 0.9375), (0, 0.8, 60, 0.966), (10, 0.5, 130, 0.946), (20, 0.8, 260, 0.864), (30, 0.8, 10, 0.969)],
)
def test_transmittance(celsius, humidity, distance, tau):
    assert transmittance(distance, 273.15 + celsius, humidity) == pytest.approx(tau, abs=6e-4)


def test_transmittance_falls_with_everything():
    assert transmittance(0, 290, 0.5) == pytest.approx(1)
    assert (np.diff(transmittance(np.linspace(0, 500, 100), 290, 0.5)) < 0).all()
    assert transmittance(100, 290, 0.8) < transmittance(100, 290, 0.3)
    assert transmittance(100, 300, 0.5) < transmittance(100, 280, 0.5)
    with pytest.raises(ValueError, match="percentage"):
        transmittance(100, 290, 50)


def test_transmittance_is_positive_and_never_rises_where_it_is_valid():
    distance = np.linspace(0, 1000, 501)
    for celsius in range(-20, 41):
        for humidity in np.linspace(0, 1, 11):
            tau = transmittance(distance, 273.15 + celsius, humidity)
            assert tau.min() >= 0.2, (celsius, humidity)
            assert tau.max() <= 1 + 1e-12, (celsius, humidity)
            assert (np.diff(tau) <= 0).all(), (celsius, humidity)
            if celsius <= 30:  # the floor is for hotter air only
                assert (np.diff(tau) < 0).all(), (celsius, humidity)


def test_upward_panels_look_colder_than_they_are():
    """Clear night, air 10 C, dew point 0 C: the zenith's reflection takes 2.5-2.7 K at eps 0.95, 8.0-8.2 K at 0.85."""
    air = 283.15
    own, sky = band_radiance(air), sky_radiance(air, 273.15, 0.0)
    for emissivity, low, high in ((0.95, 2.5, 2.7), (0.85, 8.0, 8.2)):
        assert low < air - apparent_temperature(leaving_radiance(emissivity, own, sky)) < high


def test_air_pulls_towards_its_own_temperature():
    """A +20 K target reads about +18.9 K at 130 m (10 C, 70 %)."""
    air = 283.15
    tau = transmittance(130, air, 0.7)
    seen = apparent_temperature(leaving_radiance(tau, band_radiance(air + 20), band_radiance(air)))
    assert seen - air == pytest.approx(18.9, abs=0.15)
