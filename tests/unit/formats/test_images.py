"""Decoding and encoding pictures: kept values, refused files, conversions with a warning."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend.errors import DatasetError
from infrablend.formats.pictures import images as module
from infrablend.formats.pictures.images import encode_image, load_background, output_suffix, save_image
from infrablend.formats.pictures.listing import JPEG_SUFFIXES, PICTURE_SUFFIXES, UNREAD_SUFFIXES


def ramp(dtype: type = np.uint8) -> np.ndarray:
    values = np.add.outer(np.arange(48) * 3, np.arange(64)).astype(dtype)
    return values * 200 if dtype == np.uint16 else values


def save(path: Path, pixels: np.ndarray, **options: object) -> Path:
    Image.fromarray(pixels).save(path, **options)
    return path


def refused(path: Path, **options: object) -> str:
    with pytest.raises(DatasetError) as caught:
        load_background(path, **options)  # type: ignore[arg-type]
    (problem,) = caught.value.problems
    assert problem.where == path.name and problem.found and problem.expected and problem.todo
    return problem.code


@pytest.mark.parametrize("subsampling", [0, 1, 2])
@pytest.mark.parametrize("quality", [40, 90])
def test_jpeg_keeps_tables_subsampling_mode_and_size(tmp_path: Path, quality: int, subsampling: int) -> None:
    for name, pixels in (("l.jpg", ramp()), ("rgb.jpg", np.repeat(ramp()[..., None], 3, axis=2))):
        source = load_background(save(tmp_path / name, pixels, quality=quality, subsampling=subsampling))
        again = load_background(save_image(tmp_path / f"again_{name}", source.pixels, source))
        assert (again.mode, again.size_wh, again.bit_depth) == (source.mode, (64, 48), 8)
        assert again.quantization == source.quantization and again.quantization
        assert again.subsampling == source.subsampling == (subsampling if source.mode == "RGB" else -1)
        assert source.problems == ()


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tif"])
def test_lossless_types_come_back_bit_for_bit(tmp_path: Path, suffix: str) -> None:
    source = load_background(save(tmp_path / f"a{suffix}", ramp()))
    again = load_background(save_image(tmp_path / f"b{suffix}", source.pixels, source))
    assert (again.pixels == ramp()).all() and again.file_type == source.file_type


@pytest.mark.parametrize("lossless", [True, False])
def test_webp_of_grey_levels_is_grey(tmp_path: Path, lossless: bool) -> None:
    """WebP has no grey: a decoder's green may differ by one from red and blue."""
    source = load_background(save(tmp_path / "a.webp", ramp(), lossless=lossless))
    assert (source.mode, source.file_type, source.problems) == ("RGB", "WEBP", ())
    assert np.abs(source.pixels.astype(int) - ramp()).max() <= (0 if lossless else 8)
    again = load_background(save_image(tmp_path / "b.webp", source.pixels, source))
    assert (again.pixels == source.pixels).all()
    colour = np.stack([ramp(), ramp() + 9, ramp()], axis=2)
    assert [p.code for p in load_background(save(tmp_path / "c.webp", colour)).problems] == ["image-colour"]


@pytest.mark.parametrize("suffix", JPEG_SUFFIXES)
def test_jpeg_has_several_suffixes(tmp_path: Path, suffix: str) -> None:
    source = load_background(save(tmp_path / f"a{suffix}", ramp(), format="JPEG"))
    assert save_image(tmp_path / f"b{suffix}", source.pixels, source).is_file()


def test_every_kind_of_picture_that_pillow_opens_is_read_or_named() -> None:
    Image.init()
    # Icons, drawings, documents, and what is a video or a table for us.
    others = {
        "AVIF": ".avifs", "BLP": ".blp", "BUFR": ".bufr", "CUR": ".cur", "DCX": ".dcx", "DDS": ".dds",
        "EPS": ".ps .eps", "FLI": ".fli .flc", "FTEX": ".ftc .ftu", "GBR": ".gbr", "GRIB": ".grib", "HDF5": ".h5 .hdf",
        "ICNS": ".icns", "ICO": ".ico", "IPTC": ".iim", "MPEG": ".mpg .mpeg", "MSP": ".msp", "PALM": ".palm",
        "PCD": ".pcd", "PDF": ".pdf", "PIXAR": ".pxr", "SGI": ".rgba", "WMF": ".wmf .emf", "XBM": ".xbm",
        "XPM": ".xpm",
    }  # fmt: skip
    known = {*PICTURE_SUFFIXES, *UNREAD_SUFFIXES, *" ".join(others.values()).split()}
    assert set(Image.registered_extensions()) - known == set()


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_sixteen_bits_are_kept(tmp_path: Path, suffix: str) -> None:
    source = load_background(save(tmp_path / f"a{suffix}", ramp(np.uint16)))
    assert (source.mode, source.bit_depth, source.pixels.dtype) == ("I;16", 16, np.uint16)
    again = load_background(save_image(tmp_path / f"b{suffix}", source.pixels, source))
    assert (again.pixels == ramp(np.uint16)).all() and again.bit_depth == 16


def photometric(path: Path, value: int | None) -> Path:
    """State another PhotometricInterpretation in a TIFF file, or none."""
    data = bytearray(path.read_bytes())
    (directory,) = struct.unpack_from("<I", data, 4)
    (entries,) = struct.unpack_from("<H", data, directory)
    for at in range(directory + 2, directory + 2 + 12 * entries, 12):
        if struct.unpack_from("<H", data, at) == (262,):
            struct.pack_into(*(("<H", data, at, 263) if value is None else ("<H", data, at + 8, value)))
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("compression", [None, "tiff_lzw"])
@pytest.mark.parametrize(("dtype", "white"), [(np.uint8, 255), (np.uint16, 65535)])
def test_white_is_zero_is_hot_is_zero_in_any_depth(
    tmp_path: Path, dtype: type, white: int, compression: str | None
) -> None:
    """github.com/python-pillow/Pillow/issues/4804: Pillow inverts 8 bits, but not 16."""
    stored = ramp(dtype)
    source = load_background(photometric(save(tmp_path / "a.tif", stored, compression=compression), 0))
    assert (source.pixels == white - stored).all() and source.problems == ()
    again = load_background(save_image(tmp_path / "b.tif", source.pixels, source))
    assert (again.pixels == source.pixels).all()


def test_a_tiff_whose_zero_is_unknown_or_that_is_no_grey_is_refused(tmp_path: Path) -> None:
    for dtype in (np.uint8, np.uint16):
        assert refused(photometric(save(tmp_path / "a.tif", ramp(dtype)), None)) == "image-mode"
    for value in (2, 3, 5):
        assert refused(photometric(save(tmp_path / "a.tif", ramp(np.uint16)), value)) == "image-unreadable"


def test_png_on_request_is_lossless_and_the_same_bytes(tmp_path: Path) -> None:
    source = load_background(save(tmp_path / "a.jpg", np.repeat(ramp()[..., None], 3, axis=2), quality=75))
    assert output_suffix(source.path, "png") == ".png" and output_suffix(source.path, "same") == ".jpg"
    again = load_background(save_image(tmp_path / "b.png", source.pixels, source, "png"))
    assert (again.pixels == source.pixels).all() and again.mode == "RGB"
    assert encode_image(source.pixels, source, "png") == (tmp_path / "b.png").read_bytes()


def test_real_colour_is_converted_with_a_warning(tmp_path: Path) -> None:
    rgb = np.stack([ramp(), ramp() // 2, ramp() // 3], axis=2)
    found = load_background(save(tmp_path / "a.png", rgb))
    assert [p.code for p in found.problems] == ["image-colour"] and found.problems[0].severity == "warning"
    assert (found.pixels == np.array(Image.fromarray(rgb).convert("L"))).all() and found.mode == "RGB"


def test_alpha_and_palette_are_dropped_with_a_warning(tmp_path: Path) -> None:
    rgba = np.dstack([ramp(), ramp(), ramp(), ramp()])
    assert [p.code for p in load_background(save(tmp_path / "a.png", rgba)).problems] == ["image-alpha"]
    Image.fromarray(ramp()).convert("P").save(tmp_path / "p.png")
    assert [p.code for p in load_background(tmp_path / "p.png").problems] == ["image-palette"]


@pytest.mark.parametrize("name", ["a.jpg", "a.png"])
@pytest.mark.parametrize("share", [0.3, 0.9])
def test_truncated_files_are_refused(tmp_path: Path, name: str, share: float) -> None:
    rng = np.random.default_rng(1)
    path = save(tmp_path / name, rng.integers(0, 255, (200, 300), dtype=np.uint8))
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    assert refused(path) == "image-truncated"


def test_non_pictures_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_text("not a picture")
    (tmp_path / "empty.png").write_bytes(b"")
    assert refused(tmp_path / "a.jpg") == "image-unreadable"
    assert refused(tmp_path / "empty.png") == "image-unreadable"
    assert refused(tmp_path / "absent.jpg") == "image-missing"
    assert refused(tmp_path) == "image-missing"
    Image.fromarray(ramp()).save(tmp_path / "b.jpg", "GIF")  # an unsupported format
    assert refused(tmp_path / "b.jpg") == "image-unreadable"


def test_a_damaged_png_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "a.png", ramp())
    data = bytearray(path.read_bytes())
    data[data.index(b"IDAT") + 8] ^= 0xFF
    path.write_bytes(bytes(data))
    assert refused(path) == "image-truncated"


def test_another_size_than_annotated_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "a.png", ramp())
    assert load_background(path, (64, 48)).size_wh == (64, 48)
    assert refused(path, expected_wh=(640, 512)) == "image-size"


def bomb(path: Path, side: int) -> Path:
    """A PNG whose header claims side x side pixels."""
    head = side.to_bytes(4, "big") * 2 + bytes([8, 0, 0, 0, 0])
    out = io.BytesIO(b"")
    out.write(b"\x89PNG\r\n\x1a\n")
    for kind, body in ((b"IHDR", head), (b"IDAT", zlib.compress(b"\0" * 1000)), (b"IEND", b"")):
        crc = zlib.crc32(kind + body).to_bytes(4, "big")
        out.write(len(body).to_bytes(4, "big") + kind + body + crc)
    path.write_bytes(out.getvalue())
    return path


@pytest.mark.parametrize("side", [12_000, 50_000])
def test_decompression_bombs_are_refused_unread(tmp_path: Path, side: int) -> None:
    assert refused(bomb(tmp_path / "a.png", side)) == "image-too-large"


def test_our_own_limit_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_PIXELS", 1000)
    assert refused(save(tmp_path / "a.png", ramp())) == "image-too-large"


def test_a_second_frame_that_is_damaged_is_named(tmp_path: Path) -> None:
    data = bytearray(save(tmp_path / "a.tif", ramp()).read_bytes())
    (directory,) = struct.unpack_from("<I", data, 4)
    (entries,) = struct.unpack_from("<H", data, directory)
    struct.pack_into("<I", data, directory + 2 + 12 * entries, len(data))  # the next frame, without any entry
    (tmp_path / "a.tif").write_bytes(data + bytes(6))
    assert refused(tmp_path / "a.tif") == "image-unreadable"


def test_animations_and_strange_modes_are_refused(tmp_path: Path) -> None:
    frames = [Image.fromarray(ramp()), Image.fromarray(ramp() + 1)]
    frames[0].save(tmp_path / "a.tif", save_all=True, append_images=frames[1:])
    assert refused(tmp_path / "a.tif") == "image-frames"
    Image.new("CMYK", (8, 8)).save(tmp_path / "c.jpg")
    assert refused(tmp_path / "c.jpg") == "image-mode"
    Image.new("F", (8, 8)).save(tmp_path / "f.tif")
    assert refused(tmp_path / "f.tif") == "image-mode"


def test_exif_rotation_is_reported(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(ramp()).save(tmp_path / "a.jpg", exif=exif)
    found = load_background(tmp_path / "a.jpg", (64, 48))
    assert [p.code for p in found.problems] == ["image-exif-turned"]


@pytest.mark.parametrize("compression", [None, "tiff_lzw"])
def test_turned_tiff_is_refused(tmp_path: Path, compression: str | None) -> None:
    """Pillow turns its pixels while it decodes them, and scrambles those of compressed ones."""
    for turn, name in ((1, "a.tif"), (3, "b.tif")):
        Image.fromarray(ramp()).save(tmp_path / name, tiffinfo={274: turn}, compression=compression)
    assert (load_background(tmp_path / "a.tif").pixels == ramp()).all()
    assert refused(tmp_path / "b.tif") == "image-exif-turned"


def test_pixels_must_be_like_the_background(tmp_path: Path) -> None:
    source = load_background(save(tmp_path / "a.png", ramp()))
    with pytest.raises(ValueError, match="like the background"):
        encode_image(ramp()[:-1], source)
    with pytest.raises(ValueError, match="like the background"):
        encode_image(ramp(np.uint16), source)
    with pytest.raises(ValueError, match="suffix"):
        save_image(tmp_path / "b.jpg", source.pixels, source)
    with pytest.raises(ValueError, match="read-only"):
        source.pixels[0, 0] = 1
