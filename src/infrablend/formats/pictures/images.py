"""Decode one background picture safely, and write a picture of the same kind."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image, JpegImagePlugin
from PIL.TiffImagePlugin import PHOTOMETRIC_INTERPRETATION

from infrablend.core.dataset import ImageRecord
from infrablend.core.files import or_lfs_pointer, write_bytes
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures.listing import JPEG_SUFFIXES, MAX_PIXELS, READABLE, open_picture

PixelMode = Literal["L", "RGB", "I;16"]
SaveKind = Literal["same", "png"]

# EXIF's orientations of pictures whose width is the height when they are shown.
_ON_ITS_SIDE = (5, 6, 7, 8)
_SUFFIXES = {
    "JPEG": JPEG_SUFFIXES, "PNG": (".png",), "BMP": (".bmp",), "TIFF": (".tif", ".tiff"), "WEBP": (".webp",),
}  # fmt: skip


REFUSED_COLOUR = "grey levels computed from them do not follow temperature, so generate refuses them"
_LOOKED_AT = 3
# WebP has no grey: a decoder rounds the green of a grey level in another way than red and blue.
_WEBP_ROUNDING = 1
IN_COLOUR = "image-colour"
"""Code of the warning about a picture in colour."""
COLOURS = "in colour (visible light, or thermal with a palette)"
COLOUR_REMEDY = "leave visible pictures out, and export thermal ones in white-hot grey"


@dataclass(frozen=True, eq=False)
class Background:
    """A decoded picture, and everything needed to write a similar one.

    Attributes:
        path: Where it came from.
        pixels: (h, w) grey levels, uint8, or uint16 for a 16-bit picture, read-only.
        mode: Mode of the file: `L`, `RGB` (written back with three equal channels), `I;16`.
        bit_depth: 8 or 16, of one channel.
        file_type: `JPEG`, `PNG`, `BMP`, `TIFF` or `WEBP`.
        quantization: The JPEG's own quantisation tables, 64 numbers each; empty for other types.
        subsampling: The JPEG's chroma subsampling: 0 is 4:4:4, 1 is 4:2:2, 2 is 4:2:0; -1 unknown or grey.
        problems: Warnings: what was converted or left out.
    """

    path: Path
    pixels: NDArray[np.uint8] | NDArray[np.uint16]
    mode: PixelMode
    bit_depth: int
    file_type: str
    quantization: tuple[tuple[int, ...], ...] = ()
    subsampling: int = -1
    problems: tuple[Problem, ...] = ()

    def __post_init__(self) -> None:
        self.pixels.setflags(write=False)

    @property
    def size_wh(self) -> tuple[int, int]:
        """Return width and height in px."""
        return int(self.pixels.shape[1]), int(self.pixels.shape[0])


def load_background(path: Path, expected_wh: tuple[int, int] | None = None) -> Background:
    """Decode a picture completely.

    Colour whose three channels differ is converted to grey (ITU-R 601), alpha and palette are dropped, each with a
    warning in `problems`; 16-bit pictures keep their values.

    Raises:
        DatasetError: With one `Problem`: `image-missing`, `image-unreadable`, `image-truncated`, `image-too-large`,
            `image-frames`, `image-mode`, `image-size`, `image-exif-turned` (of a TIFF).
    """
    where = path.name
    if not path.is_file():
        raise _refuse(path, "image-missing", "no such file", "a picture file", "restore or unlist it")
    try:
        picture = open_picture(path)
    except Image.DecompressionBombError as error:
        raise _refuse(path, "image-too-large", str(error), f"at most {MAX_PIXELS} px", "scale it down") from error
    except Exception as error:  # PIL's decoders raise what they like on broken headers
        found = "no picture that can be read"
        raise _refuse(path, "image-unreadable", found, READABLE, "replace or remove it") from error
    with picture:
        if picture.format == "TIFF" and _orientation(picture) != 1:  # Pillow turns such pixels, or scrambles them
            found = "a TIFF whose Orientation (tag 274) says that it is turned"
            todo = "turn the pixels, as with `mogrify -auto-orient`, and its labels, if they are of the stored pixels"
            raise _refuse(path, "image-exif-turned", found, "no Orientation, or 1", todo)
        size_wh = (int(picture.width), int(picture.height))
        if size_wh[0] * size_wh[1] > MAX_PIXELS:
            found = f"{size_wh[0]}x{size_wh[1]} px"
            raise _refuse(path, "image-too-large", found, f"at most {MAX_PIXELS} px", "scale it down")
        if expected_wh is not None and size_wh != tuple(expected_wh):
            found = f"{size_wh[0]}x{size_wh[1]} px"
            expected = f"{expected_wh[0]}x{expected_wh[1]} px as annotated"
            raise _refuse(path, "image-size", found, expected, "correct the annotation or replace the picture")
        # Cameras put a preview behind the picture (MPO): Pillow opens the first frame, which is the picture.
        file_type = "JPEG" if picture.format == "MPO" else str(picture.format)
        if file_type != "JPEG":
            _require_one_frame(picture, path)
        deep_colour = picture.mode in ("LA", "RGB", "RGBA") and _sixteen_bits(picture)
        try:
            picture.load()
        except Exception as error:  # OSError for truncation, but decoders raise SyntaxError, ValueError, zlib.error
            found = f"cannot be decoded: {error or type(error).__name__}"
            raise _refuse(path, "image-truncated", found, "a complete picture", "fetch it again") from error
        pixels, mode, problems = _grey(picture, path)
        if deep_colour:
            found = "16-bit colour or alpha, read in 8 bits"
            expected = "16-bit grey, or 8 bits"
            problems.append(Problem(where, "image-depth", found, expected, severity="warning"))
        if _orientation(picture) != 1:
            found = "EXIF says the picture is turned; pixels are taken as stored"
            problems.append(Problem(where, "image-exif-turned", found, "no EXIF orientation", severity="warning"))
        quantization: tuple[tuple[int, ...], ...] = ()
        subsampling = -1
        if file_type == "JPEG":
            tables: dict[int, Any] = picture.quantization
            quantization = tuple(tuple(int(v) for v in tables[k]) for k in sorted(tables))
            subsampling = int(JpegImagePlugin.get_sampling(picture))
        bit_depth = 16 if pixels.dtype == np.uint16 else 8
        return Background(path, pixels, mode, bit_depth, file_type, quantization, subsampling, tuple(problems))


def some_in_colour(paths: Sequence[Path]) -> dict[Path, bool]:
    """Return whether pictures are in colour, of a few that are spread over those given and can be read."""
    found = {}
    for path in paths[:: max(1, len(paths) // _LOOKED_AT)][:_LOOKED_AT]:
        with suppress(DatasetError):  # reported by what reads the picture
            found[path] = any(p.code == IN_COLOUR for p in load_background(path).problems)
    return found


def size_problem(image: ImageRecord, where: str, size_wh: tuple[int, int] | None) -> Problem | None:
    """Return the problem of a picture whose labels state another size than its header.

    Args:
        image: The picture with the size that its labels state.
        where: Name of the picture in the problem.
        size_wh: The size in its header; None if that cannot be read, which is another problem.
    """
    said = image.size_wh
    if said is None or size_wh is None or size_wh == said:
        return None
    found = f"{size_wh[0]}x{size_wh[1]} px"
    expected = f"{said[0]}x{said[1]} px as annotated"
    todo = "correct the annotation or replace the picture"
    if size_wh == said[::-1]:
        with open_picture(image.path) as picture:
            turned = _orientation(picture) in _ON_ITS_SIDE
        if turned:
            found += " as stored, turned by its EXIF to be shown; the labels were made on the turned picture"
            todo = "turn the pixels, as with `mogrify -auto-orient`"
        else:
            found += ", width and height swapped"
    return Problem(where, "image-size", found, expected, todo)


def _require_one_frame(picture: Any, path: Path) -> None:
    """Check that a file that is no JPEG has one frame; DatasetError if it has more, or they cannot be read."""
    try:
        frames = int(getattr(picture, "n_frames", 1))
    except Exception as error:  # Pillow reads the directories of all frames of a TIFF file to count them
        found = "a second frame that cannot be read"
        raise _refuse(path, "image-unreadable", found, "one picture", "replace or remove it") from error
    if frames != 1:
        raise _refuse(path, "image-frames", f"{frames} frames", "one picture", "split the file")


def _sixteen_bits(picture: Any) -> bool:
    """Return whether a picture that is not decoded yet has 16 bits per channel in its file."""
    return any(";16" in str(tile[-1]) for tile in picture.tile)


def _orientation(picture: Any) -> Any:
    """Return EXIF's orientation, 1 for upright; also where EXIF is damaged, which does not concern the pixels."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return picture.getexif().get(0x0112, 1)
    except Exception:  # Pillow raises what it likes on broken directories
        return 1


def is_turned(path: Path) -> bool:
    """Return whether EXIF says that a picture is to be turned to be shown; False for one that cannot be read."""
    try:
        with open_picture(path) as picture:
            return bool(_orientation(picture) != 1)
    except Exception:  # reported by what reads the picture
        return False


def _refuse(path: Path, code: str, found: str, expected: str, todo: str) -> DatasetError:
    problem = or_lfs_pointer(Problem(path.name, code, found, expected, todo), path)
    return DatasetError(f"{path}: {problem.found}", [problem])


def _grey(picture: Any, path: Path) -> tuple[NDArray[np.uint8] | NDArray[np.uint16], PixelMode, list[Problem]]:
    """Return the grey levels, the mode to write back, and warnings on conversions."""
    problems: list[Problem] = []

    def warn(code: str, found: str, expected: str, todo: str = "") -> None:
        problems.append(Problem(path.name, code, found, expected, todo, "warning"))

    mode = str(picture.mode)
    is_webp = picture.format == "WEBP"  # what `convert` returns does not know it
    white_is_zero = picture.format == "TIFF" and _white_is_zero(picture, path)
    if mode == "L":
        return np.array(picture, np.uint8), "L", problems
    if mode.startswith("I;16"):
        levels = np.array(picture).astype(np.uint16)
        return (65535 - levels if white_is_zero else levels), "I;16", problems
    if mode == "I":
        values = np.array(picture)
        if values.min(initial=0) < 0 or values.max(initial=0) > 65535:
            found = f"32-bit values {values.min()} to {values.max()}"
            raise _refuse(path, "image-mode", found, "8 or 16 bits per pixel", "convert it")
        return values.astype(np.uint16), "I;16", problems
    if mode in ("LA", "RGBA"):
        if picture.getextrema()[-1] != (255, 255):
            warn("image-alpha", "an alpha channel, dropped", "an opaque picture")
        picture = picture.convert("L" if mode == "LA" else "RGB")
    elif mode in ("P", "1"):
        warn("image-palette", f"mode {mode}, read and written as RGB", "grey or RGB")
        picture = picture.convert("RGB")
    elif mode != "RGB":
        raise _refuse(path, "image-mode", f"mode {mode}", "8-bit grey or RGB, or 16-bit grey", "convert it")
    if picture.mode == "L":
        return np.array(picture, np.uint8), "L", problems
    rgb = np.array(picture, np.uint8)
    if is_webp and np.ptp(rgb, axis=2).max(initial=0) <= _WEBP_ROUNDING:
        return np.ascontiguousarray(rgb[..., 0]), "RGB", problems
    grey = grey_of_rgb(rgb)
    if grey.ndim == 2:
        return grey, "RGB", problems
    found = f"{COLOURS}; converted to grey levels, which do not follow temperature"
    warn(IN_COLOUR, found, "a thermal picture in grey", COLOUR_REMEDY)
    return np.array(picture.convert("L"), np.uint8), "RGB", problems


def _white_is_zero(picture: Any, path: Path) -> bool:
    """Return whether a TIFF's level 0 is white: Pillow inverts such pictures of up to 8 bits, but not those of 16.

    Raises:
        DatasetError: The file does not say what 0 is, so that hot and cold cannot be told apart.
    """
    photometric = picture.tag_v2.get(PHOTOMETRIC_INTERPRETATION)
    if photometric is None:
        found = "a TIFF that does not say whether 0 is black or white (no PhotometricInterpretation, tag 262)"
        raise _refuse(path, "image-mode", found, "1 (0 is black) or 0", "state it, as with tiffset -s 262 1 FILE")
    return bool(photometric == 0)


def grey_of_rgb(rgb: NDArray[Any]) -> NDArray[Any]:
    """Return (h, w) the grey levels of (h, w, 3) three equal channels; other colour as it is."""
    if (rgb[..., 0] == rgb[..., 1]).all() and (rgb[..., 0] == rgb[..., 2]).all():
        return np.ascontiguousarray(rgb[..., 0])
    return rgb


def output_suffix(path: Path, kind: SaveKind) -> str:
    """Return the suffix of the picture that `save_image` writes for one read from `path`: its own, or `.png`."""
    return ".png" if kind == "png" else path.suffix


def encode_image(pixels: NDArray[np.uint8] | NDArray[np.uint16], like: Background, kind: SaveKind = "same") -> bytes:
    """Return a file's bytes for (h, w) pixels: mode, size and bit depth of `like`, and its type or PNG.

    JPEG uses the source's own quantisation tables and subsampling; no date, no metadata: same pixels, same bytes.

    Raises:
        ValueError: Shape or dtype differ from `like.pixels`.
    """
    if pixels.shape != like.pixels.shape or pixels.dtype != like.pixels.dtype:
        raise ValueError(
            f"pixels are {pixels.shape} {pixels.dtype}, must be like the background: "
            f"{like.pixels.shape} {like.pixels.dtype}"
        )
    data: NDArray[Any] = np.repeat(pixels[..., None], 3, axis=2) if like.mode == "RGB" else pixels
    picture = Image.fromarray(np.ascontiguousarray(data))
    file_type = "PNG" if kind == "png" else like.file_type
    options: dict[str, object] = {}
    if file_type == "JPEG":
        options = {"qtables": [list(t) for t in like.quantization]}
        if like.mode == "RGB" and like.subsampling >= 0:
            options["subsampling"] = like.subsampling
    elif file_type == "PNG":
        options = {"compress_level": 6}
    elif file_type == "WEBP":  # the file does not tell its quality
        options = {"lossless": True}
    out = io.BytesIO()
    picture.save(out, file_type, **options)
    return out.getvalue()


def decode_image(data: bytes) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return the (h, w) grey levels of a picture file's bytes that `encode_image` returned."""
    with Image.open(io.BytesIO(data)) as picture:
        picture.load()
        return _grey(picture, Path())[0]


def png_bytes(pixels: NDArray[np.uint8] | NDArray[np.uint16], compress_level: int = 6) -> bytes:
    """Return a PNG file's bytes for (h, w) grey or (h, w, 3) colour pixels; same pixels, same bytes."""
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "PNG", compress_level=compress_level)
    return out.getvalue()


def save_image(
    path: Path,
    pixels: NDArray[np.uint8] | NDArray[np.uint16],
    like: Background,
    kind: SaveKind = "same",
) -> Path:
    """Write `encode_image(...)` atomically.

    Raises:
        ValueError: Shape, dtype or the path's suffix do not fit.
        OutputError: The file cannot be written; what was there stays.
    """
    suffixes = _SUFFIXES["PNG" if kind == "png" else like.file_type]
    # A picture may have a wrong suffix in its dataset; `same` keeps it.
    if path.suffix.lower() not in suffixes and not (kind == "same" and path.suffix == like.path.suffix):
        raise ValueError(f"{path.name}: suffix must be one of {', '.join(suffixes)}")
    return write_bytes(path, encode_image(pixels, like, kind))
