"""From scene temperature to the image that a thermal camera stores: optics, gain, noise, codec."""

from __future__ import annotations

import io

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from infrablend.core.quantiles import percentile
from infrablend.core.temperature import TemperatureScale

Field = NDArray[np.float32]
# HIT-UAV keeps the limited range of video; the camera holds the mean near mid-grey.
LOW_GREY = 16.0
HIGH_GREY = 235.0
MEAN_GREY = 126.0
HEADROOM_GREY = 95.0
# Noise equivalent temperature difference of uncooled cameras at f/1.0, by their data sheets.
NETD_K = 0.05
CENTIKELVIN = TemperatureScale(0.01, 0.0, "centikelvin")


def optics(kelvin: Field, sigma_px: float) -> Field:
    """Return the image blurred by the lens."""
    return np.asarray(cv2.GaussianBlur(kelvin, (0, 0), sigma_px), np.float32)


def gain(kelvin: Field, gain_per_k: float, std_grey: float, mean_grey: float = MEAN_GREY) -> Field:
    """Return grey levels, linear in temperature as HIT-UAV's histograms suggest; not yet clipped or rounded.

    Args:
        kelvin: (h, w) scene temperatures.
        gain_per_k: Nominal grey levels per kelvin; the gain stays within 0.8 to 2 times this, so flat scenes stay flat.
        std_grey: Target deviation of the grey levels.
        mean_grey: Target mean, after clipping to the displayable range.
    """
    # A few very hot or cold spots must not set the gain.
    centre = float(np.median(kelvin))
    limit = 110.0 / gain_per_k
    inner = np.clip(kelvin, centre - limit, centre + limit)
    slope = float(np.clip(std_grey / max(float(inner.std()), 1e-6), 0.8 * gain_per_k, 2.0 * gain_per_k))
    # Leave headroom above the ground, so that people do not vanish on a white road.
    slope = min(slope, HEADROOM_GREY / max(percentile(inner, 96) - float(inner.mean()), 1e-6))
    grey = (kelvin - np.float32(inner.mean())) * np.float32(slope) + np.float32(mean_grey)
    for _ in range(4):
        grey += np.float32(mean_grey) - np.clip(grey, LOW_GREY, HIGH_GREY).mean()
    return np.asarray(grey, np.float32)


def detail(grey: Field, strength: float, radius_px: float) -> Field:
    """Apply the camera's detail enhancement: light and dark fringes along strong edges."""
    return np.asarray(grey + np.float32(strength) * (grey - cv2.GaussianBlur(grey, (0, 0), radius_px)), np.float32)


def noise(rng: np.random.Generator, shape_hw: tuple[int, int], std_grey: float) -> Field:
    """Return noise as measured on HIT-UAV: neighbouring pixels correlate by about 0.79."""
    white = rng.standard_normal(shape_hw).astype(np.float32)
    n = cv2.GaussianBlur(white, (0, 0), 1.05)
    return np.asarray(n * np.float32(std_grey / float(n.std())), np.float32)


def vignette(shape_hw: tuple[int, int], depth_grey: float) -> Field:
    """Return grey levels to add: 0 in the middle of the frame, `-depth_grey` in its corners."""
    h, w = shape_hw
    y = np.linspace(-1, 1, h, dtype=np.float32)[:, None]
    x = np.linspace(-1, 1, w, dtype=np.float32)[None, :]
    return np.asarray(-np.float32(depth_grey) * ((x * x + y * y) / 2) ** 1.5, np.float32)


def codec(grey: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """Return a frame after lossy video coding."""
    return np.asarray(Image.open(io.BytesIO(jpeg_bytes(grey, quality))), np.uint8).copy()


def thermal_frame(
    kelvin: Field, gain_per_k: float, std_grey: float, mean_grey: float, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Return the (h, w) uint8 white-hot image of (h, w) float32 scene temperatures in kelvin."""
    h, w = kelvin.shape
    grey = gain(optics(kelvin, float(rng.uniform(0.7, 0.95))), gain_per_k, std_grey, mean_grey)
    # Clipped before the enhancement: bodies far above the range get no fringe of matching size.
    grey = detail(np.clip(grey, LOW_GREY - 25, HIGH_GREY + 25), float(rng.uniform(0.45, 0.8)), 1.6)
    grey = grey + noise(rng, (h, w), float(rng.uniform(1.3, 2.1))) + vignette((h, w), float(rng.uniform(2, 8)))
    levels = np.round(np.clip(grey, LOW_GREY + 1, HIGH_GREY)).astype(np.uint8)
    return np.clip(codec(levels, int(rng.integers(58, 80))), int(LOW_GREY), int(HIGH_GREY)).astype(np.uint8)


def radiometric_frame(kelvin: Field, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Return the (h, w) centikelvin that a radiometric camera stores: optics and noise, neither gain nor codec."""
    seen = optics(kelvin, float(rng.uniform(0.45, 0.6)))
    seen = seen + (rng.standard_normal(kelvin.shape) * NETD_K).astype(np.float32)
    return CENTIKELVIN.counts(seen)


def tiff_bytes(counts: NDArray[np.uint16]) -> bytes:
    """Encode a radiometric frame: 16-bit grey TIFF."""
    buffer = io.BytesIO()
    Image.fromarray(counts).save(buffer, "TIFF")
    return buffer.getvalue()


def jpeg_bytes(grey: NDArray[np.uint8], quality: int = 95) -> bytes:
    """Encode a frame as HIT-UAV stores it: 8-bit grey JPEG."""
    buffer = io.BytesIO()
    Image.fromarray(grey).save(buffer, "JPEG", quality=quality)
    return buffer.getvalue()
