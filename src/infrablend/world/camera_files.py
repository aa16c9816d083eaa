"""Frames of the virtual world as the radiometric JPEG files of a camera: a made-up flight off the card."""

from __future__ import annotations

import math
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import NDArray

from infrablend.core.temperature import TemperatureScale
from infrablend.formats.rjpeg.writing import PLANCK, Shot, radiometric_jpeg
from infrablend.thermal.flir import ObjectSettings
from infrablend.world.frames import FrameFacts
from infrablend.world.plan import WorldPlan
from infrablend.world.thermal_image import optics

# Scale of the made-up DJI counts. Real cameras do not state theirs.
DJI_SCALE = TemperatureScale(0.02, -20.0)
_PLACE = (46.2, 15.1)
# Local time of the first frame, hours ahead of UTC, and seconds between frames.
_START, _ZONE_H, _STEP_S = datetime(2026, 1, 12, 5, 0), 1, 20
# Blur of the lens, and noise of one reading.
_BLUR_PX, _NOISE_K = 0.6, 0.04
# Every second frame has the laser's distance.
_LASER_EVERY = 2


def camera_file(
    frame: FrameFacts,
    plan: WorldPlan,
    kelvin: NDArray[np.float32],
    grey: NDArray[np.uint8],
    rng: np.random.Generator,
) -> bytes:
    """Return the radiometric JPEG of a frame: its picture, its temperatures as raw counts, and how it was taken."""
    if frame.maker is None:
        raise ValueError(f"{frame.name}: no maker of a camera")
    camera = plan.camera
    w, h = camera.size_wh
    captured = _START + timedelta(seconds=_STEP_S * frame.number)
    shot = Shot(
        pitch_deg=frame.pitch_deg,
        altitude_m=frame.altitude_m,
        captured=captured,
        # Of the same diagonal: the focal length in units of the picture's diagonal, times that of the film.
        focal_length_35mm=camera.focal_px / math.hypot(w, h) * math.hypot(36, 24),
        place=(_PLACE[0] + 1e-4 * frame.number, _PLACE[1]),
        laser_m=frame.altitude_m / math.sin(math.radians(frame.pitch_deg)) if frame.number % _LASER_EVERY else None,
        utc=captured - timedelta(hours=_ZONE_H),
        settings=ObjectSettings(reflected_k=plan.air_k, air_k=plan.air_k),
    )
    seen = optics(kelvin, _BLUR_PX) + _NOISE_K * rng.standard_normal(kelvin.shape).astype(np.float32)
    if frame.maker == "dji":
        counts = DJI_SCALE.counts(seen)
    else:
        counts = np.clip(np.rint(PLANCK.counts(seen.astype(np.float64))), 0, 65_535).astype(np.uint16)
    return radiometric_jpeg(frame.maker, grey, counts, shot)
