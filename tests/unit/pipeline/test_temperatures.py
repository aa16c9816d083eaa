"""`infrablend temperatures` turns radiometric pictures into 16-bit pictures with a scale."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.formats.cameras.raw_temperatures import read_temperatures
from tests.command_line import run as invoke
from tests.command_line import said
from tests.flights import counts, flight, plain_jpeg, with_exif, with_xmp

run = partial(said, "temperatures")


def test_flir_layers_become_centikelvin_with_the_cameras_settings(tmp_path: Path) -> None:
    text = run(flight(tmp_path / "in", 2, "flir"), "--out", tmp_path / "out")
    assert "centikelvin (FLIR's Planck constants)" in text
    image = api.read_dataset(tmp_path / "out").images[0]
    assert image.capture.radiometry is not None and image.capture.radiometry.scale is not None
    assert (image.capture.pitch_deg, image.capture.altitude_m, image.capture.radiometry.emissivity) == (60.0, 50.0, 1.0)
    assert image.capture.altitude_from == "take-off"
    wanted = read_temperatures(next((tmp_path / "in").glob("*_0001_*"))).apparent_k
    assert wanted is not None
    assert np.abs(image.capture.radiometry.scale.kelvin(np.array(Image.open(image.path))) - wanted).max() <= 0.0051


def test_dji_layers_stay_counts_unless_a_scale_is_given(tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 2)
    text = run(source, "--out", tmp_path / "a")
    assert "counts without a scale" in text and "DJI does not publish" in text
    image = api.read_dataset(tmp_path / "a").images[0]
    assert image.capture.radiometry is None and (np.array(Image.open(image.path)) == counts(0)).all()
    remark = next(p for p in api.read_dataset(tmp_path / "a").problems if p.code == "image-counts")
    assert "Run infrablend temperatures again with --slope and --offset" in str(remark)
    assert "centikelvin" not in str(remark)
    cold = api.read_dataset(tmp_path / "a", api.Reading(options={"unit": "counts", "slope": "0.001"}))
    (implausible,) = [p for p in cold.problems if p.code == "temperature-implausible"]
    assert "Run infrablend temperatures again with --slope" in str(implausible)
    run(source, "--out", tmp_path / "b", "--slope", "0.02", "--offset", "-20")
    scale = api.read_dataset(tmp_path / "b").images[0].capture.radiometry
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
    assert image.capture.radiometry is not None and image.capture.radiometry.scale is not None
    scale = image.capture.radiometry.scale
    assert (scale.slope_k, scale.offset_k) == pytest.approx((0.01, 133.15))


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
        (("--slope", "0.1"), "--slope and --offset: found one of them, expected both"),
        (("--converted", "x"), "--converted and --converted-unit: found one of them"),
        (("--converted", "nowhere", "--converted-unit", "celsius"), "--converted nowhere: found no such folder"),
        (("--converted", ".", "--converted-unit", "celsius"), "no temperatures in 1 picture(s)"),
        (("--spot", "x"), "expected FILE:X,Y=DEGREES"),
        (("--spot", "DJI_0001_T.JPG:5,5=20"), "--spot: 1 temperature(s) at 1 count(s); expected two counts"),
        (("--spot", "DJI_0001_T.JPG:5,5=20"), f"found count {np.median(counts(0)[4:7, 4:7]):g} for 20 degrees"),
        (("--spot", "nobody.JPG:5,5=20", "--spot", "DJI_0001_T.JPG:9,9=20"), "found 0 pictures"),
        (("--spot", "DJI_0001_T.JPG:900,5=20"), "outside the radiometric layer"),
        (("--slope", "0.1", "--offset", "0", "--spot", "DJI_0001_T.JPG:5,5=20"), "expected one source"),
    ],
)
def test_scales_that_do_not_fit_are_refused(arguments: tuple[str, ...], words: str, tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 1)
    assert words in run(source, "--out", tmp_path / "o", *arguments, code=2) and not (tmp_path / "o").exists()


def test_pictures_without_a_layer_are_counted_and_the_rest_is_written(tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 2, "flir")
    plain_jpeg(source / "plain.jpg")
    plain_jpeg(source / "IMG_0001.jpg", exif={271: "Apple", 272: "iPhone"})
    ended = invoke("temperatures", source, "--out", tmp_path / "out", "--json")
    report = json.loads(ended.stdout)
    assert ended.exit_code == 1 and report["pictures"] == 2 and report["ok"] is False
    assert [p["code"] for p in report["problems"] if p["severity"] == "error"] == ["raw-missing"]
    (left_out,) = [p["found"] for p in report["problems"] if p["code"] == "flight-left-out"]
    assert left_out.startswith("1 picture(s) left out: of another camera (Apple iPhone)")


def labelled(folder: Path, name: str) -> None:
    (folder / "classes.txt").write_text("deer\n")
    (folder / name).with_suffix(".txt").write_text("0 0.5 0.5 0.2 0.1\n")


def test_labels_are_carried_over_where_the_layer_shows_the_same(tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 2)
    labelled(source, "DJI_0002_T.JPG")
    run(source, "--out", tmp_path / "out")
    (given,) = [i.instances[0] for i in api.read_dataset(source).images if i.instances]
    (image,) = [i for i in api.read_dataset(tmp_path / "out").images if i.instances]
    assert (image.name, image.instances[0].category) == ("DJI_0002_T.png", "deer")
    assert image.instances[0].box_xyxy.tolist() == given.box_xyxy.tolist()


@pytest.mark.parametrize("how", ["zoom", "turned"])
def test_labels_of_zoomed_and_turned_pictures_are_an_error(how: str, tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 2)
    labelled(source, "DJI_0002_T.JPG")
    with_exif(source / "DJI_0002_T.JPG", **({"detail": {0xA404: 2.0}} if how == "zoom" else {"main": {0x0112: 3}}))
    ended = invoke("temperatures", source, "--out", tmp_path / "out", "--json")
    report = json.loads(ended.stdout)
    assert (ended.exit_code, report["pictures"]) == (1, 2)
    (lost,) = [p for p in report["problems"] if p["severity"] == "error"]
    assert lost["code"] == "labels-dropped" and lost["found"].startswith("1 label(s) of 1 picture(s) left out")
    assert not any(i.instances for i in api.read_dataset(tmp_path / "out").images)


def test_what_reading_the_pictures_found_is_reported(tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 2, pitch_deg=None, altitude_m=None)
    with_xmp(source / "DJI_0001_T.JPG", b'<!DOCTYPE x [<!ENTITY e "a">]><x>&e;</x>')
    text = run(source, "--out", tmp_path / "out")
    assert "XMP with a document type" in text
    assert "camera pitch missing in 2 of 2 pictures" in text and "height above the ground missing in 2 of 2" in text
    assert "read as plain pictures" not in text
    missing = [p.found for p in api.read_dataset(tmp_path / "out").problems if p.code == "flight-missing"]
    assert [m.split(" missing")[0] for m in missing] == ["camera pitch", "height above the ground"]


def test_a_scale_that_is_not_needed_is_a_warning(tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 2, "flir")
    text = run(source, "--out", tmp_path / "out", "--slope", "0.1", "--offset", "0")
    assert "--slope and --offset not used for 2 of 2 picture(s)" in text


def test_spots_name_their_counts_and_warn_of_edges(tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 1)
    level = counts(0).astype(float)
    y, x = np.unravel_index(np.argmin(level[1:-1, 1:-1]), (126, 158))
    spots = [f"DJI_0001_T.JPG:{x + 1},{y + 1}=-10", "DJI_0001_T.JPG:40,50=900"]
    text = run(source, "--out", tmp_path / "out", "--spot", spots[0], "--spot", spots[1])
    square = level[49:52, 39:42]
    assert f"count {np.median(square):g}, median of 3 x 3 px with {square.min():.0f} to {square.max():.0f}" in text
    assert "K apart" in text and "a uniform surface" in text
