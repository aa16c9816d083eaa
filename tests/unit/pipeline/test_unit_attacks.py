"""16-bit pictures with a mistaken unit, without a scene, or in colour: said before anything is made of them."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from infrablend import api
from tests.command_line import said
from tests.run_files import records

pytestmark = pytest.mark.long

SHAPE = (128, 160)


def centikelvin(seed: int = 0, level: float = 28_800.0) -> NDArray[np.uint16]:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 400, SHAPE), (0, 0), 6)
    return np.asarray(np.clip(level + noise, 0, 65_535), np.uint16)


def data(folder: Path, *pictures: NDArray[np.uint16]) -> Path:
    folder.mkdir()
    for k, counts in enumerate(pictures):
        Image.fromarray(counts).save(folder / f"{k}.png")
    rows = [f"{k}.png,60,25,night,45" for k in range(len(pictures))]
    (folder / "metadata.csv").write_text("\n".join(["file,pitch_deg,altitude_m,time_of_day,hfov_deg", *rows]))
    return folder


def scale(*values: str) -> list[str]:
    return [w for v in values for w in ("--set", f"data.{v}")]


@pytest.mark.parametrize(
    ("values", "medians"),
    [
        (("unit=decikelvin",), "2,8"),
        (("unit=counts", "slope=0.04", "offset=0"), "1,15"),
        (("unit=counts", "slope=0.001", "offset=0"), "28.8"),
        (("unit=counts", "slope=0.01", "offset=-1000"), "-712"),
    ],
)
def test_a_mistaken_unit_is_refused_before_anything_is_made(
    values: tuple[str, ...], medians: str, tmp_path: Path
) -> None:
    source = data(tmp_path / "in", centikelvin(0), centikelvin(1))
    options = ["--set", "matching.mode=radiometric", "--set", "labels.mode=new", *scale(*values)]
    text = said("generate", "hit-uav-car", "--data", source, "--out", tmp_path / "out", *options, code=2)
    assert f"temperatures of no scene: medians of {medians}" in text and "check the unit" in text.lower()
    assert not (tmp_path / "out").exists()
    read = [w for v in values for w in ("--read", v)]
    for command in ("inspect", "check"):
        assert "temperatures of no scene" in said(command, source, *read)


def test_raw_counts_taken_for_centikelvin_are_refused_unless_the_sky_is_that_cold(tmp_path: Path) -> None:
    # 185 K, -88 degrees Celsius: what counts of DJI become.
    source = data(tmp_path / "in", centikelvin(0, 18_500), centikelvin(1, 18_500))
    stated = ["--set", "data.unit=centikelvin"]
    options = ["--set", "matching.mode=radiometric", "--set", "labels.mode=new", *stated]
    text = said("generate", "hit-uav-car", "--data", source, "--out", tmp_path / "out", *options, code=2)
    assert "between -43 and 67 degrees Celsius in pictures of the ground" in text
    assert "state their pitch (0 or less) in metadata.csv" in text
    assert "temperatures of no scene" in said("inspect", source, "--read", "unit=centikelvin")
    up = [*options, "--set", "camera.pitch={fixed_deg: -20}", "--plan"]
    assert "of no scene" not in said("generate", "drone-sky", "--data", source, "--out", tmp_path / "out", *up)
    table = source / "metadata.csv"
    table.write_text(table.read_text().replace(",60,", ",-20,"))
    assert "of no scene" not in said("inspect", source, "--read", "unit=centikelvin")
    assert "of no scene" in said("inspect", source, "--read", "unit=decikelvin")


def test_a_stated_scale_that_replaces_the_files_own_is_reported(tmp_path: Path) -> None:
    source = data(tmp_path / "in", centikelvin(0))
    own = tmp_path / "own"
    said("convert", source, own, "--to", "coco", "--read", "unit=centikelvin")
    other = [w for v in ("unit=counts", "slope=0.02", "offset=-290") for w in ("--read", v)]
    text = said("inspect", own, *other)
    assert "1 picture(s) in their own files (centikelvin) is replaced by the stated one (0.02 K per count" in text
    assert "replaced by none" in said("inspect", own, "--read", "unit=counts")
    assert "replaced" not in said("inspect", own, "--read", "unit=centikelvin") + said("inspect", own)


@pytest.mark.parametrize("level", [0, 65_535])
def test_an_empty_picture_fails_alone(level: int, tmp_path: Path) -> None:
    source = data(tmp_path / "in", centikelvin(0), np.full(SHAPE, level, np.uint16))
    fields = {
        "matching.mode": "radiometric", "data.unit": "centikelvin", "environment.air_temperature_c": 12.0,
        "camera.calibrate": False, "empty_share": 1.0,
    }  # fmt: skip
    execution = api.Execution(renderer="flat", in_process=True)
    result = api.generate("hit-uav-car", source, tmp_path / "out", settings=fields, execution=execution)
    assert len(records(tmp_path / "out")) == 1
    assert [p.code for p in result.problems if p.severity == "error"] == ["temperature-implausible"]


def png(samples: NDArray[np.uint16], kind: int) -> bytes:
    def chunk(name: bytes, body: bytes) -> bytes:
        return len(body).to_bytes(4, "big") + name + body + zlib.crc32(name + body).to_bytes(4, "big")

    head = SHAPE[1].to_bytes(4, "big") + SHAPE[0].to_bytes(4, "big") + bytes((16, kind, 0, 0, 0))
    lines = b"".join(b"\0" + row.astype(">u2").tobytes() for row in samples)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b"")


@pytest.mark.parametrize(("channels", "kind"), [(2, 4), (3, 2), (4, 6)])
def test_16_bit_colour_is_not_cut_to_8_bits_in_silence(channels: int, kind: int, tmp_path: Path) -> None:
    counts = centikelvin()
    layers: list[Any] = [counts] * channels
    if channels in (2, 4):
        layers[-1] = np.full_like(counts, 65_535)
    source = tmp_path / "in"
    source.mkdir()
    (source / "a.png").write_bytes(png(np.stack(layers, 2), kind))
    assert "16-bit colour or alpha, read in 8 bits" in said("check", source)


def test_objects_in_16_bits_are_not_compared_with_real_ones_in_8(tmp_path: Path, write_tiny_hit_uav: Any) -> None:
    source = data(tmp_path / "in", centikelvin(0))
    fields = {
        "matching.mode": "radiometric", "data.unit": "centikelvin", "camera.calibrate": False,
        "placement.where": "anywhere",
    }  # fmt: skip
    execution = api.Execution(renderer="flat", in_process=True)
    api.generate("hit-uav-car", source, tmp_path / "out", settings=fields, execution=execution)
    real = write_tiny_hit_uav(tmp_path / "real", ("normal_json",))
    text = said("realism", tmp_path / "out", "--against", source, "--real", real, "--no-steps", code=2)
    assert "8-bit pictures, and 16-bit ones in the run" in text
