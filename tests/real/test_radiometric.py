"""Real radiometric pictures: facts equal to ExifTool's, temperatures equal to another program's."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.thermal_reference import object_kelvin

from infrablend.formats.cameras.header_facts import CameraFacts, read_facts
from infrablend.formats.cameras.raw_temperatures import read_temperatures

pytestmark = pytest.mark.realdata
TAGS = (
    "GimbalPitchDegree", "GimbalRollDegree", "RelativeAltitude", "LRFTargetDistance", "DateTimeOriginal", "FOV",
    "FieldOfView", "FocalLength", "FocalLengthIn35mmFormat", "DigitalZoomRatio", "GPSLatitude", "GPSLongitude",
    "ImageWidth", "ImageHeight",
)  # fmt: skip
# What no program finds in these files: the pictures have no XMP, and two have no known lens.
LACKING = {"DJI_XT2.jpg": set[str](), "M2EA_DJI_0001_R.JPG": {"hfov_deg"}, "XTS_DJI_0001_R.jpg": {"hfov_deg"}}


@pytest.fixture
def folder(real_data: Path) -> Path:
    if not (real_data / "radiometric").is_dir():
        pytest.skip("NEEDS REAL DATA: the folder radiometric")
    return real_data / "radiometric"


@pytest.fixture
def exiftool(folder: Path) -> dict[str, dict[str, Any]]:
    """Return what ExifTool prints for every picture."""
    if shutil.which("exiftool") is None:
        pytest.skip("NEEDS exiftool: apt-get install libimage-exiftool-perl")
    command = ["exiftool", "-json", "-n", *(f"-{t}" for t in TAGS), *map(str, pictures(folder))]
    printed = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return {Path(p["SourceFile"]).name: p for p in printed}


def pictures(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.suffix.lower() == ".jpg")


def same(facts: CameraFacts, name: str, printed: object, sign: float = 1.0) -> bool:
    value = facts.value(name)
    if value is None or printed is None:
        return value is None and printed is None
    return math.isclose(value, sign * float(str(printed)), abs_tol=1e-6)


def test_facts_are_those_that_exiftool_prints(folder: Path, exiftool: dict[str, dict[str, Any]]) -> None:
    assert len(exiftool) == 11
    for path in pictures(folder):
        facts, printed = read_facts(path), exiftool[path.name]
        assert not facts.problems and facts.raw
        assert facts.size_wh == (printed["ImageWidth"], printed["ImageHeight"])
        assert same(facts, "pitch_deg", printed.get("GimbalPitchDegree"), -1.0)
        assert same(facts, "roll_deg", printed.get("GimbalRollDegree"))
        assert same(facts, "altitude_m", printed.get("RelativeAltitude"))
        assert same(facts, "latitude_deg", printed.get("GPSLatitude"))
        assert same(facts, "longitude_deg", printed.get("GPSLongitude"))
        when = str(facts.facts["captured"].value).replace("-", ":", 2).replace("T", " ")
        assert when[:19] == printed["DateTimeOriginal"].replace("-", ":")[:19]


def test_fields_of_view_are_those_of_exiftool_apart_from_its_film(
    folder: Path, exiftool: dict[str, dict[str, Any]]
) -> None:
    """ExifTool's FOV takes the 35 mm equivalent for that of a film 36 mm wide, and knows no digital zoom."""
    for path in pictures(folder):
        facts, printed = read_facts(path), exiftool[path.name]
        ours, w, h = facts.value("hfov_deg"), printed["ImageWidth"], printed["ImageHeight"]
        zoom = max(1.0, printed.get("DigitalZoomRatio", 1.0))
        if ours is None:
            assert "hfov_deg" in LACKING[path.name] and "FocalLengthIn35mmFormat" not in printed
            continue
        unzoomed = 2 * math.atan(math.tan(math.radians(ours) / 2) * zoom)
        if f35 := printed.get("FocalLengthIn35mmFormat"):
            assert printed["FOV"] == pytest.approx(math.degrees(2 * math.atan(18 / f35)), abs=1e-3)
            diagonal = 2 * math.atan(math.tan(unzoomed / 2) * math.hypot(w, h) / w)
            assert math.tan(diagonal / 2) == pytest.approx(math.hypot(36, 24) / 2 / f35, rel=1e-5)
        elif printed.get("FieldOfView"):
            assert math.degrees(unzoomed) == pytest.approx(printed["FieldOfView"], abs=1e-3)
        else:
            assert path.name == "DJI_XT2.jpg"  # 17 um pixels behind 19 mm
            assert math.tan(unzoomed / 2) == pytest.approx(640 * 0.017 / 2 / printed["FocalLength"], rel=1e-4)


def test_every_layer_is_read(folder: Path) -> None:
    for path in pictures(folder):
        raw = read_temperatures(path)
        assert raw.counts.shape in ((512, 640), (480, 640), (320, 240))
        assert raw.maker == ("FLIR" if "FLIR" in path.name or "XT2" in path.name else "DJI")
        # Neighbours differ little: bytes and rows are in their places.
        assert np.abs(np.diff(raw.counts.astype(int), axis=0)).mean() < 0.15 * np.ptp(raw.counts)


def test_temperatures_are_those_of_another_program(folder: Path) -> None:
    if find_spec("flyr") is None:
        pytest.skip("NEEDS flyr: pip install flyr")
    import flyr

    for name in ("FLIR.jpg", "FLIR_T640.jpg"):  # flyr does not read DJI's XT2
        raw = read_temperatures(folder / name)
        assert raw.camera is not None and raw.camera.planck is not None
        ours = object_kelvin(raw.counts, raw.camera.planck, raw.camera.settings)
        theirs = flyr.unpack(str(folder / name)).kelvin
        assert np.quantile(np.abs(ours - theirs), 0.999) <= 0.1
