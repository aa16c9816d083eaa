"""Temperatures of one radiometric JPEG: raw counts, and kelvin where the camera's own conversion is published.

DJI's raw layer has 16-bit counts in segments APP3, or APP4 in files of the XT S. Their conversion to temperatures is
DJI's secret. They rise with temperature, and that is all that is known: a scale has to come from the user.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL.TiffImagePlugin import PHOTOMETRIC_INTERPRETATION

from infrablend.core.temperature import Radiometry, TemperatureScale, describe_plausible, implausible_median
from infrablend.errors import DatasetError
from infrablend.formats.cameras.flir_block import MAX_LAYER_PIXELS, SIGNATURE, CameraRecord, FlirBlock
from infrablend.formats.cameras.jpeg_segments import APP1, APP3, APP4, JpegHeader, Segment, bad_file, read_header
from infrablend.formats.pictures.listing import open_picture

CONVERTED_UNITS: dict[str, tuple[float, float]] = {
    "celsius": (1.0, 273.15), "kelvin": (1.0, 0.0), "decikelvin": (0.1, 0.0), "centikelvin": (0.01, 0.0),
}  # fmt: skip
"""Units of other programs' files: kelvin per unit, and kelvin of 0."""


# DJI's cameras store two bytes per pixel; other programs put at most a few hundred bytes into these segments.
_LEAST_DJI_BYTES = 32_768
_DJI_SIZES_WH = ((640, 512), (1280, 1024), (640, 480), (336, 256), (320, 256), (160, 120), (640, 360), (384, 288))
_FACTS = ("air_k", "humidity", "reflected_k", "emissivity", "distance_m")


@dataclass(frozen=True, eq=False)
class RawTemperatures:
    """Raw layer of one picture.

    Attributes:
        maker: `DJI` or `FLIR`.
        counts: (h, w) raw counts of the detector.
        camera: Constants and settings of a FLIR camera; None for DJI, or where the file lacks them.
    """

    maker: str
    counts: NDArray[np.uint16]
    camera: CameraRecord | None = None

    @property
    def apparent_k(self) -> NDArray[np.float64] | None:
        """(h, w) apparent temperatures at the sensor, kelvin; None where only counts are known."""
        if self.camera is None or self.camera.planck is None:
            return None
        return self.camera.planck.kelvin(self.counts.astype(np.float64))

    def facts(self, scale: TemperatureScale | None, source: str) -> Radiometry:
        """Return a scale together with what the file states about the air and the objects."""
        if self.camera is None:
            return Radiometry(scale, source)
        stated = {n: getattr(self.camera.settings, n) for n in _FACTS if n in self.camera.stated}
        return Radiometry(scale, source, **stated)


def read_temperatures(path: Path) -> RawTemperatures:
    """Return the raw layer of a radiometric JPEG.

    FLIR's counts come with the constants of their conversion. DJI's conversion is not published: its counts have no
    scale of their own.

    Raises:
        DatasetError: With one problem: the file has no raw layer (`raw-missing`), or a damaged one.
    """
    header = read_header(path)
    if header.find(APP1, SIGNATURE):
        block = FlirBlock(header)
        return RawTemperatures("FLIR", block.counts(), block.camera())
    if dji_segments(header):
        return RawTemperatures("DJI", _dji_counts(header))
    raise bad_file(header.path, "raw-missing", "no radiometric layer", "a radiometric JPEG of DJI or FLIR")


def fit_scale(pairs: list[tuple[float, float]]) -> TemperatureScale:
    """Return the scale through (count, kelvin) pairs, by least squares.

    Raises:
        ValueError: There are fewer than two different counts, or temperature does not rise with the counts.
    """
    if len({c for c, _ in pairs}) < 2:
        raise ValueError(f"{len(pairs)} temperature(s) at {len({c for c, _ in pairs})} count(s); expected two counts")
    counts, kelvin = np.array(pairs, np.float64).T
    slope, offset = np.polyfit(counts, kelvin, 1)
    if slope <= 0:
        raise ValueError(f"{slope:.4g} K per count; expected temperatures that rise with the counts")
    return TemperatureScale(float(slope), float(offset))


def read_converted(path: Path, unit: str, layer_wh: tuple[int, int]) -> NDArray[np.float64]:
    """Return the temperatures, kelvin, of a TIFF file that another program wrote; NaN where it has none.

    Args:
        path: A TIFF with one channel of floats or whole numbers.
        unit: `celsius`, `kelvin`, `decikelvin` or `centikelvin`.
        layer_wh: Width and height of the radiometric layer; the file may have more or fewer pixels of the same scene.

    Raises:
        DatasetError: The file cannot be read, it shows another scene, or its values are no temperatures in that unit.
    """

    def refuse(code: str, found: str, expected: str) -> DatasetError:
        return bad_file(path, code, found, expected, "convert the picture again, or state the unit of the files")

    try:
        with open_picture(path, ("TIFF",)) as picture:
            pages = int(getattr(picture, "n_frames", 1))
            too_large = picture.width * picture.height > MAX_LAYER_PIXELS
            values = None if pages != 1 or too_large else np.asarray(picture, np.float64)
            white_is_zero = picture.mode == "I;16" and picture.tag_v2.get(PHOTOMETRIC_INTERPRETATION) == 0
    except Exception as error:  # Pillow raises what it likes on broken pictures
        found = f"no TIFF that can be read ({type(error).__name__})"
        raise refuse("image-unreadable", found, "a TIFF with one temperature per pixel") from error
    if values is None:
        found = f"{pages} pages" if pages != 1 else f"more than {MAX_LAYER_PIXELS} px"
        raise refuse("image-frames" if pages != 1 else "image-too-large", found, "one picture of temperatures")
    if values.ndim != 2:
        raise refuse("image-mode", f"{values.shape[2]} channels", "one temperature per pixel")
    if values.shape[1] * layer_wh[1] != values.shape[0] * layer_wh[0]:
        found = f"{values.shape[1]}x{values.shape[0]} px, not of the shape of the layer of {layer_wh[0]}x{layer_wh[1]}"
        raise refuse("raw-size", found, "the temperatures of the same picture, not cropped")
    if white_is_zero:
        values = 65535 - values
    slope, offset = CONVERTED_UNITS[unit]
    kelvin = values * slope + offset
    kelvin[~(kelvin > 0)] = np.nan  # programs mark missing values with large negative numbers
    median = implausible_median(kelvin, ground=False)
    if median is not None:
        raise refuse(
            "scale-malformed", f"a median of {median:.1f} K in the unit {unit}", describe_plausible(ground=False)
        )
    return np.asarray(kelvin)


# -- DJI's raw layer -----------------------------------------------------------------------------------------


def dji_segments(header: JpegHeader) -> tuple[Segment, ...]:
    """Return the segments of DJI's raw layer; none in files without one."""
    if header.find(APP1, b"FLIR\0"):
        return ()
    found = [header.find(marker) for marker in (APP3, APP4)]
    longest = max(found, key=lambda segments: sum(s.length for s in segments))
    return longest if sum(s.length for s in longest) >= _LEAST_DJI_BYTES else ()


def _dji_counts(header: JpegHeader) -> NDArray[np.uint16]:
    """Return the (h, w) raw counts of DJI's layer.

    Raises:
        DatasetError: With one problem: `raw-missing`, or `raw-truncated` if the length is that of no known sensor.
    """
    segments = dji_segments(header)
    if not segments:
        raise bad_file(header.path, "raw-missing", "no raw layer", "16-bit counts in segments APP3 or APP4")
    data = header.read(segments)
    size_wh = _dji_size(len(data) // 2, header.size_wh)
    if size_wh is None or len(data) % 2:
        found = f"a raw layer of {len(data)} bytes, which is no picture of the shape of {header.size_wh}"
        raise bad_file(header.path, "raw-truncated", found, "two bytes per pixel of the sensor")
    width, height = size_wh
    return np.frombuffer(data, "<u2").reshape(height, width).astype(np.uint16)


def _dji_size(pixels: int, picture_wh: tuple[int, int]) -> tuple[int, int] | None:
    """Return the size of a raw layer: a known sensor's, or that of the picture divided by a whole number."""
    whole = math.isqrt(picture_wh[0] * picture_wh[1] // pixels) if pixels else 0
    scaled = [(picture_wh[0] // whole, picture_wh[1] // whole)] if whole else []
    return next((wh for wh in (*scaled, *_DJI_SIZES_WH) if wh[0] * wh[1] == pixels), None)
