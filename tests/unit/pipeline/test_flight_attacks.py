"""Own pictures with wrong, lying or missing values, through the command line: right values, or a named problem."""

from __future__ import annotations

import json
import struct
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from infrablend.formats.cameras.jpeg_segments import APP1
from infrablend.formats.cameras.xmp import EXTENDED
from infrablend.lab.world.rjpeg_writing import PLANCK, segment_bytes
from tests.command_line import said
from tests.flights import SIZE_WH, flight, shot, with_xmp

SHAPE = SIZE_WH[::-1]


def inspected(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the facts by field (source and lowest value), and the texts of the problems by code."""
    data = json.loads(said("inspect", "--json", folder))
    facts = {r["field"]: (r["source"], r["lowest"]) for r in data["notes"]["flight"]["facts"]}
    return facts, {p["code"]: p["found"] for p in data["problems"]}


extracted = partial(said, "temperatures")


# ---- Headers


@pytest.mark.parametrize("captured", ["0001-01-01T00:00:00", "9999-12-31T23:59:59", "0001-01-01T00:00:00+14:00"])
def test_clocks_at_the_ends_of_the_calendar(captured: str, tmp_path: Path) -> None:
    for k, longitude in enumerate((-170.0, 170.0)):
        shot(tmp_path / f"DJI_000{k}_T.JPG", captured=datetime(9999, 12, 31, 23, 59, 59), place=(10.0, longitude))
    assert inspected(tmp_path)[0]["captured"][1] == "9999-12-31T23:59:59"
    rows = [f"DJI_000{k}_T.JPG,45,{captured}" for k in range(2)]
    (tmp_path / "metadata.csv").write_text("\n".join(["file,hfov_deg,captured", *rows]) + "\n")
    assert inspected(tmp_path)[0]["captured"][1] == captured


@pytest.mark.parametrize("value", ["nan", "inf", "1e999", "47.3 m", "1,5", "\u0663", "--1", "5/0", "1_0"])
def test_texts_that_are_no_numbers_are_named(value: str, tmp_path: Path) -> None:
    path = shot(tmp_path / "DJI_0001_T.JPG", altitude_m=None)
    with_xmp(path, dji_packet("RelativeAltitude", value))
    facts, problems = inspected(tmp_path)
    assert facts["altitude_m"] == ("", None) and problems["flight-value"].startswith("XMP drone-dji:RelativeAltitude")


def test_fractions_are_numbers(tmp_path: Path) -> None:
    with_xmp(shot(tmp_path / "DJI_0001_T.JPG"), dji_packet("RelativeAltitude", "475/10"))
    assert inspected(tmp_path)[0]["altitude_m"][1] == 47.5


def test_a_laser_beyond_its_reach_is_left_out(tmp_path: Path) -> None:
    shot(tmp_path / "DJI_0001_T.JPG", laser_m=1e9)
    facts, problems = inspected(tmp_path)
    assert facts["altitude_m"] == ("XMP drone-dji:RelativeAltitude", 50.0) and "flight-laser" in problems


def test_the_place_0_0_is_none(tmp_path: Path) -> None:
    path = shot(tmp_path / "DJI_0001_T.JPG", place=None)
    with_xmp(path, dji_packet("GpsLatitude", "0.000000", 'd:GpsLongitude="0.000000"'))
    assert inspected(tmp_path)[0]["latitude_deg"] == ("", None)


def test_too_much_extended_xmp_leaves_the_standard_packet(tmp_path: Path) -> None:
    path = shot(tmp_path / "DJI_0001_T.JPG")
    chunk = EXTENDED + b"A" * 32 + struct.pack(">II", 2**21, 0) + b"x" * 60_000
    data = path.read_bytes()
    path.write_bytes(data[:2] + segment_bytes(APP1, chunk) * 20 + data[2:])
    facts, problems = inspected(tmp_path)
    assert facts["pitch_deg"][1] == 60.0 and "extended XMP" in problems["xmp-too-large"]


def dji_packet(name: str, value: str, more: str = "") -> bytes:
    rdf = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
    space = "http://www.dji.com/drone-dji/1.0/"
    text = f'<r:RDF xmlns:r="{rdf}"><r:Description xmlns:d="{space}" d:{name}="{value}" {more}/></r:RDF>'
    return text.encode()


# ---- FLIR's record


def flir_record(path: Path, **values: float) -> None:
    """Overwrite numbers of the camera record of a made-up FLIR file."""
    places = {"emissivity": 0x20, "distance_m": 0x24, "air_k": 0x2C, "humidity": 0x3C, "b": 0x5C}
    data = path.read_bytes()
    start = data.index(struct.pack("<f", PLANCK.b)) - 0x5C
    for name, value in values.items():
        at = start + places[name]
        data = data[:at] + struct.pack("<f", value) + data[at + 4 :]
    path.write_bytes(data)


@pytest.mark.parametrize("value", [np.nan, 0.0, -5.0, np.inf])
def test_settings_that_nobody_made_are_unknown(value: float, tmp_path: Path) -> None:
    flir_record(shot(tmp_path / "in" / "a.jpg", "flir"), emissivity=value, air_k=value)
    extracted(tmp_path / "in", "--out", tmp_path / "out")
    (image,) = json.loads((tmp_path / "out/annotations/instances_train.json").read_text())["images"]
    assert "humidity" in str(image) and "air_k" not in str(image) and "emissivity" not in str(image)


@pytest.mark.parametrize("value", [0.0, -1428.0, np.nan, np.inf])
def test_wrong_planck_constants_leave_counts(value: float, tmp_path: Path) -> None:
    flir_record(shot(tmp_path / "in" / "a.jpg", "flir"), b=value)
    text = extracted(tmp_path / "in", "--out", tmp_path / "out")
    assert "counts without a scale" in text and "lack the constants" in text and "DJI" not in text


def test_temperatures_that_no_scene_has_are_said(tmp_path: Path) -> None:
    flir_record(shot(tmp_path / "in" / "a.jpg", "flir"), b=14.28)
    assert "with a median of" in extracted(tmp_path / "in", "--out", tmp_path / "out")


# ---- Scales from users and other programs


@pytest.mark.parametrize(("slope", "offset"), [(0.04, 0), (10, 0), (0.01, -1000), (1e-9, 0)])
def test_a_stated_scale_that_gives_no_scene_is_said(slope: float, offset: float, tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 1)
    text = extracted(source, "--slope", slope, "--offset", offset, "--out", tmp_path / "out")
    assert "a median between -43 and 67 degrees Celsius" in text


def test_a_falling_scale_and_a_spot_below_absolute_zero_are_refused(tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 1)
    extracted(source, "--slope", "-0.01", "--offset", "400", "--out", tmp_path / "out", code=2)
    spots = ("--spot", "DJI_0001_T.JPG:5,5=-300", "--spot", "DJI_0001_T.JPG:90,9=20")
    assert "expected a temperature" in extracted(source, *spots, "--out", tmp_path / "out", code=2)


def converted(folder: Path, values: NDArray[Any], unit: str = "celsius", code: int = 0, **save: Any) -> str:
    """Write values as the converted file of a made-up picture, and extract its temperatures."""
    (folder / "tiff").mkdir(exist_ok=True)
    Image.fromarray(values).save(folder / "tiff" / "DJI_0001_T.tif", **save)
    options = ("--converted", folder / "tiff", "--converted-unit", unit, "--out", folder / "out", "--overwrite")
    return extracted(flight(folder / "in", 1), *options, code=code)


def celsius(value: float, shape: tuple[int, int] = SHAPE) -> NDArray[np.float32]:
    return np.full(shape, value, np.float32)


def test_missing_values_of_converted_files_are_counted(tmp_path: Path) -> None:
    values = celsius(20.0)
    values[:3] = -9999
    values[3, :5] = np.nan
    values[4, :7] = 700.0
    text = converted(tmp_path, values)
    assert f"{3 * SIZE_WH[0] + 12} pixel(s) of 1 picture(s) without a temperature below 655 K" in text
    assert "20.0 to 20.0 degrees Celsius" in text


@pytest.mark.parametrize(
    ("values", "unit", "words"),
    [
        (celsius(293.15), "celsius", "a median of 566.3 K in the unit celsius"),
        (celsius(20.0), "kelvin", "a median of 20.0 K"),
        (np.full(SHAPE, 2930, np.uint16), "centikelvin", "a median of 29.3 K"),
        (celsius(20.0, (90, 333)), "celsius", "not of the shape of the layer of 160x128"),
        (celsius(np.nan), "celsius", "a median of nan K"),
        (np.full((*SHAPE, 3), 20, np.uint8), "celsius", "3 channels"),
    ],
)
def test_converted_files_that_do_not_fit_are_named(values: NDArray[Any], unit: str, words: str, tmp_path: Path) -> None:
    text = converted(tmp_path, values, unit, code=2)
    assert words in text and "state the unit of the files" in text


def test_pages_of_converted_files_are_not_chosen_from(tmp_path: Path) -> None:
    page = Image.fromarray(celsius(20.0))
    assert "2 pages" in converted(tmp_path, celsius(20.0), code=2, save_all=True, append_images=[page])


def test_pictures_of_one_name_take_the_converted_file_of_their_folder(tmp_path: Path) -> None:
    tiffs = tmp_path / "tiff"
    for k, name in enumerate(("100MEDIA", "101MEDIA")):
        shot(tmp_path / "in" / name / "DJI_0001_T.JPG", number=k)
    tiffs.mkdir()
    Image.fromarray(celsius(20.0)).save(tiffs / "DJI_0001_T.tif")
    options = (tmp_path / "in", "--converted", tiffs, "--converted-unit", "celsius", "--out", tmp_path / "out")
    assert "other pictures have the same name" in extracted(*options, code=2)
    for k, name in enumerate(("100MEDIA", "101MEDIA")):
        (tiffs / name).mkdir()
        Image.fromarray(celsius(20.0 + k)).save(tiffs / name / "DJI_0001_T.tif")
    extracted(*options, "--overwrite")
    levels = [int(np.asarray(Image.open(p))[0, 0]) for p in sorted((tmp_path / "out/images/train").iterdir())]
    assert levels == [29_315, 29_415]


def test_temperatures_are_not_written_into_the_folder_that_they_come_from(tmp_path: Path) -> None:
    source = flight(tmp_path / "in", 1, "flir")
    extracted(source, "--out", source / "out", code=2)
    assert not (source / "out").exists()
