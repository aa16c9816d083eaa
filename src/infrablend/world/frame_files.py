"""One frame of the virtual world: its image on disk, its labels and its entry in `world.json`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.files import write_bytes
from infrablend.core.rng import stream
from infrablend.core.temperature import Radiometry, TemperatureScale
from infrablend.formats import monet
from infrablend.formats.images import png_bytes
from infrablend.world.camera_files import camera_file
from infrablend.world.frames import FrameFacts, telemetry_of
from infrablend.world.labels import Label
from infrablend.world.plan import WorldPlan
from infrablend.world.sampling import sample_world
from infrablend.world.thermal_image import jpeg_bytes, radiometric_frame, thermal_frame, tiff_bytes

CENTIKELVIN = TemperatureScale(0.01, 0.0, "centikelvin")


class PlanRenderer(Protocol):
    """Renderer of a plan; Blender's is `infrablend.blender.world.renderer.WorldRenderer`."""

    def render(self, plan: WorldPlan) -> tuple[NDArray[np.float32], list[Label]]:
        """Return the (h, w) temperatures of a frame in kelvin, and a label for every thing that has a class."""
        ...


@dataclass(frozen=True, eq=False)
class FinishedFrame:
    """A frame with its image on disk.

    Attributes:
        number: Number of the frame in the dataset, from 0.
        image: Record of the image with its labels.
        facts: Entry of the frame in `world.json`.
        dropped: Number of objects without a label per reason.
    """

    number: int
    image: ImageRecord
    facts: dict[str, Any]
    dropped: Mapping[str, int]


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
    record = _monet_record if frame.sequence is not None else _hit_uav_record if frame.maker is None else _bare_record
    dropped = Counter(label.dropped for label in labels if label.dropped)
    image = record(frame, plan, labels, path, seed)
    return FinishedFrame(frame.number, image, _facts(frame, plan, labels), dict(dropped))


def _hit_uav_record(frame: FrameFacts, plan: WorldPlan, labels: Sequence[Label], path: Path, _: int) -> ImageRecord:
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


def _bare_record(frame: FrameFacts, plan: WorldPlan, _labels: Sequence[Label], path: Path, _seed: int) -> ImageRecord:
    """Return the record of a camera's file: what it states is in its header, and it has no labels."""
    return ImageRecord(path.stem, path, frame.split, plan.camera.size_wh, ())


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


def _facts(frame: FrameFacts, plan: WorldPlan, labels: Sequence[Label]) -> dict[str, Any]:
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
