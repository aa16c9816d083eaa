"""Tests of the scale of 16-bit pictures."""

from __future__ import annotations

import numpy as np
import pytest

from infrablend.core.temperature import TemperatureScale


def test_centikelvin_reads_and_writes_hundredths_of_a_kelvin() -> None:
    scale = TemperatureScale.of_unit("centikelvin")
    assert scale is not None
    assert scale.kelvin(np.array([32_410], np.uint16)) == pytest.approx(324.1)
    assert scale.counts(np.array([324.104, 324.096, -1.0, 900.0])).tolist() == [32_410, 32_410, 0, 65_535]


def test_all_counts_survive_the_way_to_kelvin_and_back() -> None:
    every = np.arange(65_536, dtype=np.uint16)
    for scale in (TemperatureScale(0.01, 0.0, "centikelvin"), TemperatureScale(0.04), TemperatureScale(-0.013, 400.0)):
        assert (scale.counts(scale.kelvin(every)) == every).all()


def test_counts_have_a_scale_only_when_one_is_stated() -> None:
    assert TemperatureScale.of_unit("counts") is None
    assert TemperatureScale.of_unit("counts", 0.04) == TemperatureScale(0.04, 0.0, "counts")  # TLinear, low resolution
    assert TemperatureScale.of_unit("decikelvin") == TemperatureScale(0.1, 0.0, "decikelvin")


@pytest.mark.parametrize(
    ("unit", "slope", "offset", "message"),
    [
        ("kelvin", None, None, "one of centikelvin"),
        ("centikelvin", 0.04, None, "expected 0.01"),
        ("counts", None, 273.15, "without a slope"),
        ("counts", 0.0, None, "not 0"),
        ("counts", float("nan"), None, "not 0"),
    ],
)
def test_a_scale_that_makes_no_sense_is_refused(
    unit: str, slope: float | None, offset: float | None, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        TemperatureScale.of_unit(unit, slope, offset)


def test_json_restores_a_scale_and_refuses_other_values() -> None:
    scale = TemperatureScale(0.04, 12.5)
    assert TemperatureScale.from_json(scale.to_json()) == scale
    with pytest.raises(ValueError, match="expected numbers"):
        TemperatureScale.from_json({"slope_k": "0.01"})
