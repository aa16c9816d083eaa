"""Radiometric JPEG files are recognised by their segments, and their temperatures are not passed over in silence."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from infrablend import api
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.formats.radiometric import camera_of_radiometric, radiometric_warnings
from tests.samples import SAMPLES, picture

FLIR = (0xE1, b"FLIR\0\1\0\0" + bytes(200))
DJI = (0xE3, bytes(40_000))


def with_segment(path: Path, marker: int, data: bytes) -> Path:
    """Insert an APPn segment behind the start of a JPEG file."""
    jpeg = path.read_bytes()
    segment = bytes([0xFF, marker]) + (len(data) + 2).to_bytes(2, "big") + data
    path.write_bytes(jpeg[:2] + segment + jpeg[2:])
    return path


@pytest.mark.parametrize(("segment", "camera"), [(FLIR, "FLIR"), (DJI, "DJI")])
def test_a_folder_of_radiometric_pictures_gets_a_hint(segment: tuple[int, bytes], camera: str, tmp_path: Path) -> None:
    for n in range(20):
        with_segment(picture(tmp_path / f"{n:02}.jpg", n), *segment)
    (found,) = api.inspect(tmp_path).problems
    assert (found.code, found.severity) == ("image-radiometric", "warning")
    assert (
        f"({camera}; 8 of 8 looked at)" in found.found and "temperatures in these files are not used yet" in found.todo
    )


def test_other_pictures_get_none(tmp_path: Path) -> None:
    plain = picture(tmp_path / "plain.jpg", 1)
    exif = with_segment(picture(tmp_path / "exif.jpg", 2), 0xE1, b"Exif\0\0" + bytes(100))
    few = with_segment(picture(tmp_path / "few.jpg", 3), 0xE3, bytes(100))
    png, broken = picture(tmp_path / "a.png", 4), tmp_path / "broken.jpg"
    broken.write_bytes(b"\xff\xd8FLIR\0")
    assert [camera_of_radiometric(p) for p in (plain, exif, few, png, broken)] == [None] * 5


def test_pictures_of_public_datasets_are_not_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("infrablend.formats.radiometric.camera_of_radiometric", lambda path: pytest.fail(str(path)))
    for name in ("birdsai", "monet", "wisard"):
        api.read_dataset(SAMPLES[name](tmp_path / name))


def test_pipes_are_not_opened(tmp_path):
    """A pipe among the pictures would make the reader wait for ever."""
    os.mkfifo(tmp_path / "a.jpg")
    image = ImageRecord("a", tmp_path / "a.jpg", "train", (8, 8), None, None, None, ())
    assert radiometric_warnings(Dataset(tmp_path, "folder", (), (image,))) == []
