"""`infrablend temperatures` turns radiometric pictures into 16-bit pictures with a scale."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from infrablend import api
from infrablend.cli.app import build_app
from infrablend.formats.rjpeg.temperatures import read_temperatures
from tests.flights import counts, flight, plain_jpeg


def run(*arguments: object) -> str:
    result = CliRunner().invoke(build_app(), ["temperatures", *map(str, arguments)], env={"COLUMNS": "200"})
    assert result.exit_code == 0, result.output
    return result.output


def test_flir_layers_become_centikelvin_with_the_cameras_settings(tmp_path: Path) -> None:
    text = run(flight(tmp_path / "in", 2, "flir"), "--out", tmp_path / "out")
    assert "centikelvin (FLIR's Planck constants)" in text
    image = api.read_dataset(tmp_path / "out").images[0]
    assert image.radiometry is not None and image.radiometry.scale is not None
    assert (image.pitch_deg, image.altitude_m, image.radiometry.emissivity) == (60.0, 50.0, 1.0)
    assert image.extra["altitude_from"] == "take-off"
    wanted = read_temperatures(next((tmp_path / "in").glob("*_0001_*"))).apparent_k
    assert wanted is not None
    assert np.abs(image.radiometry.scale.kelvin(np.array(Image.open(image.path))) - wanted).max() <= 0.0051


def test_dji_layers_stay_counts_unless_a_scale_is_given(tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 2)
    text = run(source, "--out", tmp_path / "a")
    assert "counts without a scale" in text and "DJI does not publish" in text
    image = api.read_dataset(tmp_path / "a").images[0]
    assert image.radiometry is None and (np.array(Image.open(image.path)) == counts(0)).all()
    run(source, "--out", tmp_path / "b", "--slope", "0.02", "--offset", "-20")
    scale = api.read_dataset(tmp_path / "b").images[0].radiometry
    assert scale is not None and scale.scale is not None and scale.scale.slope_k == 0.02


def test_a_scale_is_fitted_to_two_spots(tmp_path: Path) -> None:
    level = counts(0).astype(float)
    (y0, x0), (y1, x1) = (np.unravel_index(f(level), level.shape) for f in (np.argmin, np.argmax))
    spots = [
        f"DJI_0001_T.JPG:{x},{y}={np.median(level[y - 1 : y + 2, x - 1 : x + 2]) * 0.01 - 140}"
        for x, y in ((x0, max(y0, 1)), (x1, max(y1, 1)))
    ]
    source = flight(tmp_path / "in", 1)
    run(source, "--out", tmp_path / "out", "--spot", spots[0], "--spot", spots[1])
    (image,) = api.read_dataset(tmp_path / "out").images
    assert image.radiometry is not None and image.radiometry.scale is not None
    assert image.radiometry.scale.slope_k == pytest.approx(0.01) and image.radiometry.scale.offset_k == pytest.approx(
        133.15
    )


def test_another_programs_temperatures_are_taken(tmp_path: Path) -> None:
    source, converted = flight(tmp_path / "in", 1), tmp_path / "converted"
    converted.mkdir()
    celsius = np.full((128, 160), 12.5, np.float32)
    Image.fromarray(celsius).save(converted / "DJI_0001_T.tif")
    run(source, "--out", tmp_path / "out", "--converted", converted, "--converted-unit", "celsius")
    assert (np.array(Image.open(tmp_path / "out/images/train/DJI_0001_T.png")) == 28_565).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--slope", "0.1"), "expected both"),
        (("--spot", "x"), "expected FILE:X,Y=DEGREES"),
        (("--spot", "DJI_0001_T.JPG:5,5=20"), "expected two counts"),
        (("--spot", "nobody.JPG:5,5=20", "--spot", "DJI_0001_T.JPG:9,9=20"), "found 0 pictures"),
        (("--spot", "DJI_0001_T.JPG:900,5=20"), "outside the radiometric layer"),
        (("--slope", "0.1", "--offset", "0", "--spot", "DJI_0001_T.JPG:5,5=20"), "expected one source"),
    ],
)
def test_scales_that_do_not_fit_are_refused(arguments: tuple[str, ...], words: str, tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 1)
    result = CliRunner().invoke(build_app(), ["temperatures", str(source), "--out", str(tmp_path / "o"), *arguments])
    assert result.exit_code == 2 and words in " ".join(result.output.split()) and not (tmp_path / "o").exists()


def test_pictures_without_a_layer_are_counted_and_the_rest_is_written(tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 2, "flir")
    plain_jpeg(source / "plain.jpg")
    plain_jpeg(source / "IMG_0001.jpg", exif={271: "Apple", 272: "iPhone"})
    command = ["temperatures", str(source), "--out", str(tmp_path / "out"), "--json"]
    result = CliRunner().invoke(build_app(), command)
    report = json.loads(result.stdout)
    assert result.exit_code == 1 and report["pictures"] == 2 and report["ok"] is False
    assert [p["code"] for p in report["problems"] if p["severity"] == "error"] == ["raw-missing"]
    (left_out,) = [p["found"] for p in report["problems"] if p["code"] == "flight-left-out"]
    assert left_out.startswith("1 picture(s) left out: of another camera (Apple iPhone)")
