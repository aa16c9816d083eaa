"""Measure how stated heights differ from true ones: `bench/heights.py DATA [--recipe NAME] [--split train]`.

For each known class, time of day and range of stated heights (with `--by-pitch`, of angles): the median of true over
stated height that the annotated boxes show, the standard deviation of its logarithm, and the number of pictures. These
are the factors of `camera.stated_heights.by_flight`. Boxes count as `camera.stated_heights.box_looseness` of the recipe
says.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import defaultdict
from pathlib import Path

import numpy as np

from infrablend.config.loading import load_recipe
from infrablend.config.recipe import MetricCamera
from infrablend.core.camera import CameraSpec
from infrablend.core.dataset import ImageRecord, KnownClass, known_class
from infrablend.core.ground_plane import at_height, ground_z_m
from infrablend.core.reference_sizes import REFERENCES
from infrablend.formats import dataset_folder
from infrablend.sampling.calibration import size_ratio

BELOW_M = (75.0, 95.0, 115.0, math.inf)
BELOW_DEG = (35.0, 65.0, math.inf)


def main() -> None:
    """Print one JSON object per class, time of day and range of heights."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--recipe", default="hit-uav-cars", help="recipe with the lens of the dataset")
    parser.add_argument("--split", default="train")
    parser.add_argument("--by-pitch", action="store_true", help="by the camera's pitch instead of the height")
    options = parser.parse_args()
    camera = load_recipe(options.recipe).camera
    assert isinstance(camera, MetricCamera), f"{options.recipe}: expected a recipe with placement.mode metric"
    factors: dict[tuple[str, str, float], list[float]] = defaultdict(list)
    for image in dataset_folder.read(options.data).images:
        if image.split == options.split and image.capture.altitude_m and image.capture.pitch_deg is not None:
            value, limits = (
                (image.capture.pitch_deg, BELOW_DEG) if options.by_pitch else (image.capture.altitude_m, BELOW_M)
            )
            below = next(limit for limit in limits if value < limit)
            for kind, factor in factors_of(image, camera).items():
                factors[kind, image.capture.time_of_day or "unknown", below].append(factor)
    for (kind, time_of_day, below), found in sorted(factors.items()):
        logs = np.log(found)
        limit = "below_pitch_deg" if options.by_pitch else "below_m"
        row = {"class": kind, "time_of_day": time_of_day, limit: None if math.isinf(below) else below}
        shown = {"factor": round(float(np.exp(np.median(logs))), 3), "spread": round(float(logs.std()), 3)}
        print(json.dumps({**row, **shown, "pictures": len(found)}))


def factors_of(image: ImageRecord, camera: MetricCamera) -> dict[KnownClass, float]:
    """Return true over stated height of one picture by the median of the boxes of each class."""
    if image.capture.pitch_deg is None or image.capture.altitude_m is None:
        return {}
    view = CameraSpec(
        1.0, math.radians(image.capture.pitch_deg), 0.0, camera.focal_length_mm, camera.sensor_width_mm, image.size_wh
    )
    view = at_height(view, image.capture.altitude_m)
    ground = ground_z_m(view, image.capture.altitude_m)
    logs: dict[KnownClass, list[float]] = defaultdict(list)
    for label in image.instances:
        kind = known_class(label.category)
        if kind is None or label.truncated or label.inserted:
            continue
        ratio = size_ratio(view, ground, label.box_xyxy, REFERENCES[kind])
        if ratio is not None:
            logs[kind].append(math.log(camera.stated_heights.box_looseness / ratio))
    return {kind: math.exp(float(np.median(found))) for kind, found in logs.items()}


if __name__ == "__main__":
    main()
