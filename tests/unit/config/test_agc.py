"""Tests of the automatic gain control: 8-bit pictures from 16-bit ones."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from infrablend.config.agc import Agc, FixedAgc, LinearAgc, PlateauAgc, agc_from_json, parse_agc
from infrablend.core.temperature import TemperatureScale

CENTIKELVIN = TemperatureScale(0.01, 0.0, "centikelvin")
ALL: list[Agc] = [
    LinearAgc(mode="linear"),
    PlateauAgc(mode="plateau"),
    FixedAgc(mode="fixed", low_c=0.0, high_c=40.0),
]


def scene() -> NDArray[np.uint16]:
    """Even ground with a small hot body, in centikelvin."""
    rng = np.random.default_rng(1)
    kelvin = 288 + rng.normal(0, 0.5, (128, 160))
    kelvin[60:68, 70:76] = 310
    return np.asarray(np.rint(kelvin * 100), np.uint16)


@pytest.mark.parametrize("agc", ALL, ids=lambda a: a.mode)
def test_warmer_pixels_are_never_darker(agc: Agc) -> None:
    picture = scene()
    shown = agc.apply(picture, CENTIKELVIN)
    assert shown.dtype == np.uint8 and shown.shape == picture.shape
    order = np.argsort(picture.ravel(), kind="stable")
    assert (np.diff(shown.ravel()[order].astype(int)) >= 0).all()


def test_a_linear_agc_spans_its_percentiles() -> None:
    picture = np.arange(20_000, 30_000, dtype=np.uint16).reshape(100, 100)
    shown = LinearAgc(mode="linear", low_percentile=10.0, high_percentile=90.0).apply(picture)
    assert (shown[:10] == 0).all() and (shown[-10:] == 255).all()
    assert shown[50, 0] == pytest.approx(127.5, abs=1)


def test_a_fixed_range_shows_equal_temperatures_equally_in_every_unit() -> None:
    agc = FixedAgc(mode="fixed", low_c=0.0, high_c=51.0)
    kelvin = np.full((4, 4), 273.15 + 20)
    for scale in (CENTIKELVIN, TemperatureScale(0.04), TemperatureScale(-0.02, 500.0)):
        assert (agc.apply(scale.counts(kelvin), scale) == 100).all()
    with pytest.raises(ValueError, match="needs a temperature scale"):
        agc.apply(scene())


def test_a_low_plateau_leaves_levels_for_rare_temperatures() -> None:
    """Equalisation gives even ground all levels; the plateau keeps some for the small hot body."""
    picture = scene()
    ground = picture < 29_500
    spread = {
        percent: float(
            PlateauAgc(mode="plateau", plateau_percent=percent, outlier_percent=0.0).apply(picture)[ground].std()
        )
        for percent in (0.005, 100.0)
    }
    assert spread[0.005] < 0.7 * spread[100.0]


def test_the_largest_gain_keeps_the_noise_of_even_pictures_low() -> None:
    rng = np.random.default_rng(2)
    flat = np.asarray(np.rint(28_800 + rng.normal(0, 4, (128, 160))), np.uint16)
    shown = PlateauAgc(mode="plateau", max_gain=0.5).apply(flat)
    assert shown.std() < 4 * 0.6
    assert np.median(shown) == pytest.approx(127, abs=2)  # the midpoint


def test_a_flat_picture_is_shown_without_a_failure() -> None:
    for agc in ALL:
        assert len(np.unique(agc.apply(np.full((32, 32), 29_000, np.uint16), CENTIKELVIN))) == 1


def test_texts_name_an_agc_or_say_what_is_wrong() -> None:
    assert parse_agc("linear") == LinearAgc(mode="linear")
    assert parse_agc("{mode: fixed, low_c: 0, high_c: 40}") == ALL[2]
    for agc in ALL:
        assert agc_from_json(agc.model_dump()) == agc
        assert agc.describe()
    for wrong in ("square", "{mode: fixed}", "[1]", "{mode: fixed, low_c: 9, high_c: 1}", "{mode: linear, top: 1}"):
        with pytest.raises(ValueError, match=r"mode|low_c|top"):
            parse_agc(wrong)
