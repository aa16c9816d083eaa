"""Tests of the temperature scales of 16-bit datasets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend.core.temperature import TemperatureScale
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.pictures.temperature_scale import describe_scales
from infrablend.formats.read_write import Reading


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    for name in ("a.png", "b.tiff"):
        Image.fromarray(np.full((32, 40), 29_000, np.uint16)).save(tmp_path / name)
    return tmp_path


def test_16_bit_pictures_without_a_stated_scale_are_only_counts(flight: Path) -> None:
    dataset = dataset_folder.read(flight)
    assert [p.code for p in dataset.problems if "counts" in p.code] == ["image-counts"]
    assert describe_scales(dataset) == {}
    accepted = dataset_folder.read(flight, Reading(options={"unit": "counts"}))
    assert not [p for p in accepted.problems if p.code == "image-counts"]
    assert describe_scales(accepted) == {"counts without a scale": 2}


def test_a_stated_scale_is_on_every_16_bit_picture(flight: Path) -> None:
    dataset = dataset_folder.read(flight, Reading(options={"unit": "counts", "slope": "0.04", "offset": "0"}))
    assert {i.capture.radiometry.scale for i in dataset.images if i.capture.radiometry} == {TemperatureScale(0.04)}
    assert describe_scales(dataset) == {"0.04 K per count, 0 = 0 K (stated)": 2}


@pytest.mark.parametrize(
    "options", [{"unit": "celsius"}, {"slope": "0.04"}, {"unit": "counts", "slope": "much"}, {"unit": "", "slope": "1"}]
)
def test_a_scale_that_makes_no_sense_is_a_named_problem(flight: Path, options: dict[str, str]) -> None:
    with pytest.raises(DatasetError) as caught:
        dataset_folder.read(flight, Reading(options=options))
    assert [p.code for p in caught.value.problems] == ["option-value"]
