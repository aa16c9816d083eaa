"""Radiometric layers: both makers, both byte orders, PNG or raw, and scales for counts."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from infrablend.core.temperature import TemperatureScale
from infrablend.errors import DatasetError
from infrablend.formats.cameras import flir_block
from infrablend.formats.cameras.jpeg_segments import APP3, APP4, read_header
from infrablend.formats.cameras.raw_temperatures import fit_scale, read_converted, read_temperatures
from infrablend.lab.world.rjpeg_writing import PLANCK, Maker, segment_bytes
from infrablend.thermal.radiometry import ObjectSettings
from tests.flights import SIZE_WH, counts, plain_jpeg, shot

SETTINGS = ObjectSettings(0.93, 20.0, 263.15, 278.15, 0.4, 285.0, 0.97)


def test_flir_counts_become_kelvin_as_published(tmp_path: Path) -> None:
    raw = read_temperatures(shot(tmp_path / "a.jpg", "flir", settings=SETTINGS))
    assert (raw.counts == counts(0)).all() and raw.apparent_k is not None
    for y, x in ((0, 0), (60, 80), (127, 159)):
        kelvin = raw.apparent_k[y, x]
        signal = PLANCK.r1 / (PLANCK.r2 * (math.exp(PLANCK.b / kelvin) - PLANCK.f)) - PLANCK.o
        assert signal == pytest.approx(raw.counts[y, x], abs=0.05)


def rewritten(path: Path, change: Any) -> Path:
    """Replace the FFF block of a made-up FLIR file by `change(block)`, in two segments in the wrong order."""
    header = read_header(path)
    segments = header.find(0xE1, flir_block.SIGNATURE)
    block = change(header.read(segments, skip=8))
    data = path.read_bytes()
    for s in segments:
        data = data.replace(segment_bytes(0xE1, header.read([s])), b"")
    half = len(block) // 2
    chunks = [flir_block.SIGNATURE + bytes((1, k, 1)) + c for k, c in enumerate((block[:half], block[half:]))]
    inserted = b"".join(segment_bytes(0xE1, c) for c in reversed(chunks))
    path.write_bytes(data[:2] + inserted + data[2:])
    return path


def raw_record(header: bytes, body: bytes) -> Any:
    """Return a change that replaces the raw record of a block."""

    def change(block: bytes) -> bytes:
        offset, length = (int.from_bytes(block[at : at + 4], "big") for at in (0x4C, 0x50))
        record = header + body
        assert len(record) <= length
        return block[:offset] + record.ljust(length, b"\0") + block[offset + length :]

    return change


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("kind", ["raw", "png", "swapped png"])
def test_both_byte_orders_and_png(order: str, kind: str, tmp_path: Path) -> None:
    w, h = SIZE_WH
    wanted = counts(3)
    head = np.array([2, w, h], f"{order}u2").tobytes().ljust(0x20, b"\0")
    if kind == "raw":
        body = wanted.astype(f"{order}u2").tobytes()
    else:
        buffer = io.BytesIO()
        Image.fromarray(wanted.byteswap() if "swapped" in kind else wanted).save(buffer, "PNG")
        body = buffer.getvalue()
    path = rewritten(shot(tmp_path / "a.jpg", "flir"), raw_record(head, body))
    assert (read_temperatures(path).counts == wanted).all()


@pytest.mark.parametrize("marker", [APP3, APP4])
def test_dji_counts_are_kept_and_have_no_scale(marker: int, tmp_path: Path) -> None:
    path = plain_jpeg(tmp_path / "a.jpg", (320, 256))
    wanted = np.arange(320 * 256).reshape(256, 320).astype("<u2")
    data, jpeg = wanted.tobytes(), path.read_bytes()
    chunks = b"".join(segment_bytes(marker, data[k : k + 60_000]) for k in range(0, len(data), 60_000))
    path.write_bytes(jpeg[:2] + chunks + jpeg[2:])
    raw = read_temperatures(path)
    assert (raw.counts == wanted).all() and raw.apparent_k is None and raw.maker == "DJI"


def cut(block: bytes) -> bytes:
    return block[:-30_000]


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (cut, "raw-missing"),
        (lambda b: b"GGG\0" + b[4:], "flir-header"),
        (lambda b: b[:0x14] + b"\xff\xff\xff\xff" + b[0x18:], "flir-header"),
        (lambda b: b[:0x1C] + b"\xff\xff\xff\xff" + b[0x20:], "flir-records"),
        (lambda b: b[:0x18] + b"\xff\xff\xff\xff" + b[0x1C:], "flir-records"),
        (raw_record(np.array([2, 60_000, 60_000], "<u2").tobytes(), b""), "raw-size"),
        (raw_record(np.array([2, 4100, 4100], "<u2").tobytes().ljust(32, b"\0"), b"\x89PNG\r\n"), "raw-size"),
        (raw_record(np.array([2, 640, 512], "<u2").tobytes(), b""), "raw-truncated"),
        (raw_record(np.array([2, 160, 128], "<u2").tobytes().ljust(32, b"\0"), b"\x89PNG\r\n"), "raw-unreadable"),
    ],
)
def test_blocks_that_lie_are_named(change: Any, code: str, tmp_path: Path) -> None:
    path = rewritten(shot(tmp_path / "a.jpg", "flir"), change)
    with pytest.raises(DatasetError) as caught:
        read_temperatures(path)
    assert [p.code for p in caught.value.problems] == [code]


def test_a_missing_segment_of_the_block_is_named(tmp_path: Path) -> None:
    path = shot(tmp_path / "a.jpg", "flir")
    data = path.read_bytes()
    path.write_bytes(data.replace(flir_block.SIGNATURE + bytes((1, 0, 0)), flir_block.SIGNATURE + bytes((1, 0, 3))))
    with pytest.raises(DatasetError, match="1 of 4 FLIR segments"):
        read_temperatures(path)


@pytest.mark.parametrize("maker", ["dji", "flir"])
def test_a_picture_without_a_layer_is_named(maker: Maker, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no radiometric layer"):
        read_temperatures(shot(tmp_path / "a.jpg", maker, raw=False))


def test_a_scale_is_fitted_to_stated_temperatures() -> None:
    scale = fit_scale([(15_000, 280.0), (16_000, 300.0)])
    assert scale.slope_k == pytest.approx(0.02) and scale.kelvin(np.array([15_500])) == pytest.approx(290.0)
    for pairs in ([(15_000, 280.0)], [(15_000, 280.0), (15_000, 290.0)], [(15_000, 300.0), (16_000, 280.0)]):
        with pytest.raises(ValueError, match="expected"):
            fit_scale(pairs)


@pytest.mark.parametrize(("unit", "value"), [("celsius", 20.0), ("kelvin", 293.15), ("centikelvin", 29_315)])
def test_other_programs_files_are_read_in_the_stated_unit(unit: str, value: float, tmp_path: Path) -> None:
    kind = np.uint16 if unit == "centikelvin" else np.float32
    Image.fromarray(np.full((4, 5), value, kind)).save(tmp_path / "a.tif")
    assert read_converted(tmp_path / "a.tif", unit, (5, 4)) == pytest.approx(np.full((4, 5), 293.15), abs=1e-4)
    with pytest.raises(DatasetError, match="decikelvin"):
        read_converted(tmp_path / "a.tif", "decikelvin", (5, 4))


def test_other_programs_files_with_white_as_zero_are_inverted(tmp_path: Path) -> None:
    Image.fromarray(np.full((4, 5), 65535 - 29_315, np.uint16)).save(tmp_path / "a.tif", tiffinfo={262: 0})
    assert read_converted(tmp_path / "a.tif", "centikelvin", (5, 4)) == pytest.approx(np.full((4, 5), 293.15))


def test_the_scale_of_a_flir_layer_is_fine_enough() -> None:
    scale = TemperatureScale(0.01, 0.0, "centikelvin")
    kelvin = np.linspace(230.0, 400.0, 1000)
    assert np.abs(scale.kelvin(scale.counts(kelvin)) - kelvin).max() <= 0.0051
