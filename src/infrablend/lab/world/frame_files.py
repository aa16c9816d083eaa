"""One frame of the virtual world: its image on disk, its labels and its entry in `world.json`.

As the radiometric JPEG file of a camera, a frame is part of a made-up flight off the card.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.files import write_bytes
from infrablend.core.rng import stream
from infrablend.core.temperature import Radiometry, TemperatureScale
from infrablend.formats.pictures.images import png_bytes
from infrablend.formats.published import monet
from infrablend.lab.world.draw_plan import sample_world
from infrablend.lab.world.rjpeg_writing import PLANCK, Shot, radiometric_jpeg
from infrablend.lab.world.scene_plan import WorldPlan
from infrablend.lab.world.thermal_image import (
    CENTIKELVIN,
    jpeg_bytes,
    optics,
    radiometric_frame,
    thermal_frame,
    tiff_bytes,
)
from infrablend.lab.world.world_frames import FrameFacts, telemetry_of
from infrablend.lab.world.world_labels import Label
from infrablend.thermal.flir import ObjectSettings

# Scale of the made-up DJI counts. Real cameras do not state theirs.
DJI_SCALE = TemperatureScale(0.02, -20.0)
_PLACE = (46.2, 15.1)
# Local time of the first frame, hours ahead of UTC, and seconds between frames.
_START = datetime(2026, 1, 12, 5, 0)
_ZONE_H = 1
_STEP_S = 20
# Blur of the lens, and noise of one reading.
_BLUR_PX = 0.6
_NOISE_K = 0.04
# Every second frame has the laser's distance.
_LASER_EVERY = 2


class PlanRenderer(Protocol):
    """Renderer of a plan; Blender's is `infrablend.lab.world.blender_world.WorldRenderer`."""

    def render(self, plan: WorldPlan) -> tuple[NDArray[np.float32], list[Label]]:
        """Return the (h, w) temperatures of a frame in kelvin, and a label for every thing that has a class."""


@dataclass(frozen=True, eq=False)
class FinishedFrame:
    """A frame with its image on disk.

    Attributes:
        number: Number of the frame in the dataset, from 0.
        image: Record of the image with its labels.
        facts: Entry of the frame in `world.json`.
    """

    number: int
    image: ImageRecord
    facts: dict[str, object]


def make_frame(frame: FrameFacts, seed: int, renderer: PlanRenderer, folder: Path) -> FinishedFrame:
    """Draw the scene of a frame, render it and write its image to `folder`/<split>/."""
    rng = stream(seed, "world", frame.number, "plan")
    plan = sample_world(rng, frame.pitch_deg, frame.altitude_m, frame.time_of_day, frame.kind, frame.size_wh)
    kelvin, labels = renderer.render(plan)
    look = stream(seed, "world", frame.number, "look")
    path = folder / frame.split / frame.name
    if frame.radiometric:
        write_bytes(path, tiff_bytes(radiometric_frame(kelvin, look)))
    else:
        grey = thermal_frame(kelvin, plan.gain_per_k, plan.std_grey, plan.mean_grey, look)
        if frame.maker is not None:
            counts = stream(seed, "world", frame.number, "counts")
            write_bytes(path, camera_file(frame, plan, kelvin, grey, counts))
        else:
            write_bytes(path, jpeg_bytes(grey) if frame.sequence is None else png_bytes(grey))
    facts = _facts(frame, plan, labels)
    if frame.sequence is not None:
        return FinishedFrame(frame.number, _monet_record(frame, plan, labels, path, seed), facts)
    if frame.maker is not None:
        # What the file of a camera states is in its header, and it has no labels.
        return FinishedFrame(frame.number, ImageRecord(path.stem, path, frame.split, plan.camera.size_wh, ()), facts)
    return FinishedFrame(frame.number, _hit_uav_record(frame, plan, labels, path), facts)


def _hit_uav_record(frame: FrameFacts, plan: WorldPlan, labels: Sequence[Label], path: Path) -> ImageRecord:
    instances = tuple(
        Instance(
            category=label.category,
            box_xyxy=np.asarray(label.box_xyxy, np.float64),
            corners_xy=label.corners_xy,
            visibility=label.visibility,
            truncated=label.truncated,
            difficult=label.visibility < 0.5,
            extra={"tight_box": True},
        )
        for label in labels
        if label.box_xyxy is not None
    )
    return ImageRecord(
        id=path.stem,
        path=path,
        split=frame.split,
        size_wh=plan.camera.size_wh,
        instances=instances,
        capture=Capture(
            pitch_deg=frame.pitch_deg,
            altitude_m=frame.altitude_m,
            time_of_day=frame.time_of_day,
            radiometry=Radiometry(CENTIKELVIN, "virtual world", air_k=plan.air_k) if frame.radiometric else None,
        ),
        extra={"weather": "0"},
    )


def _monet_record(frame: FrameFacts, plan: WorldPlan, labels: Sequence[Label], path: Path, seed: int) -> ImageRecord:
    """Return MONET's record: axis-aligned boxes of persons and vehicles, and telemetry in `metadata`, if any."""
    boxes = [("person" if i.category == "Person" else "vehicle", i.box_xyxy) for i in labels]
    instances = [Instance(category, np.asarray(box, np.float64)) for category, box in boxes if box is not None]
    return ImageRecord(
        id=f"{frame.sequence}_{path.stem}",
        path=path,
        split=frame.split,
        size_wh=plan.camera.size_wh,
        instances=tuple(instances),
        capture=Capture(
            pitch_deg=frame.pitch_deg if frame.telemetry else None,
            altitude_m=frame.altitude_m if frame.telemetry else None,
            sequence=frame.sequence,
        ),
        extra={"fields": {monet.NEST: telemetry_of(frame, seed)}},
        file_name=frame.name,
    )


def _facts(frame: FrameFacts, plan: WorldPlan, labels: Sequence[Label]) -> dict[str, object]:
    """Return the camera, the place, and every object that has a class with its visibility."""
    return {
        "name": frame.name,
        "split": frame.split,
        "kind": plan.kind,
        "air_k": plan.air_k,
        "camera": asdict(plan.camera),
        "objects": [
            {
                "category": label.category,
                "visibility": round(label.visibility, 4),
                "truncated": label.truncated,
                "dropped": label.dropped,
            }
            for label in labels
        ],
    }


def camera_file(
    frame: FrameFacts,
    plan: WorldPlan,
    kelvin: NDArray[np.float32],
    grey: NDArray[np.uint8],
    rng: np.random.Generator,
) -> bytes:
    """Return the radiometric JPEG of a frame: its picture, its temperatures as raw counts, and how it was taken."""
    assert frame.maker is not None
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
