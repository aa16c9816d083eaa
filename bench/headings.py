"""Measure how real objects stand: along the lines on the ground, and along each other.

`bench/headings.py DATA [--category Car] [--recipe NAME] [--split train] [--read KEY=VALUE]` reads oriented boxes,
projects their longer axis to the ground, and prints, by time of day: quantiles of the angle to the lines that
`core.ground_plane` finds in the picture (0 to 45 degrees; 22.5 is the median of random directions), for all pictures
and for those with clear lines; the shares of pairs in one picture that are parallel, and at right angles, within 12
degrees; and the shares of objects along the line of sight, and at right angles to it, within 15 degrees. Boxes less
than 1.4 times as long as wide do not count. Oriented boxes of HIT-UAV: `--read form=rotate_json`.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.config.loading import load_recipe
from infrablend.config.recipe import MetricCamera
from infrablend.core.camera import CameraSpec
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.ground_plane import at_height, find_ground_edges, ground_point, ground_z_m
from infrablend.formats import detection
from infrablend.formats.reading import Reading

LEAST_ASPECT = 1.4
WITHIN_DEG = 12.0
WITHIN_OF_VIEW_DEG = 15.0
SHARES = (10, 25, 50, 75, 90)


def main() -> None:
    """Print three lines per time of day."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--category", default="Car")
    parser.add_argument("--recipe", default="hit-uav-cars", help="recipe with the lens of the dataset")
    parser.add_argument("--split", default="train")
    parser.add_argument("--read", action="append", default=[], help="option of the dataset reader, KEY=VALUE")
    options = parser.parse_args()
    lens = load_recipe(options.recipe).camera
    assert isinstance(lens, MetricCamera), f"{options.recipe}: expected a recipe with placement.mode metric"
    reading = Reading(options=dict(option.split("=", 1) for option in options.read))
    angles: dict[str, list[tuple[float, float]]] = defaultdict(list)
    pairs: dict[str, list[float]] = defaultdict(list)
    from_view: dict[str, list[float]] = defaultdict(list)
    for image in detection.read(options.data, reading).images:
        if image.split != options.split or image.size_wh is None:
            continue
        if image.capture.pitch_deg is None or image.capture.altitude_m is None:
            continue
        camera = CameraSpec(
            1.0, math.radians(image.capture.pitch_deg), 0.0, lens.focal_length_mm, lens.sensor_width_mm, image.size_wh
        )
        camera = at_height(camera, image.capture.altitude_m)
        ground = ground_z_m(camera, image.capture.altitude_m)
        yaws = [y for i in image.instances if i.category == options.category and (y := yaw_of(i, camera, ground))]
        when: str = image.capture.time_of_day or "unknown"
        pairs[when] += [_apart(a - b, 180) for a, b in itertools.combinations(yaws, 2)]
        # The camera looks along +Y.
        from_view[when] += [_apart(yaw - 90, 180) for yaw in yaws]
        edges = find_ground_edges(_pixels(image), camera, ground, [i.box_xyxy for i in image.instances])
        lines = None if edges is None else edges.lines()
        if lines is not None:
            angles[when] += [(_apart(yaw - math.degrees(lines.yaw_rad), 90), lines.clarity) for yaw in yaws]
    for when, found in sorted(angles.items()):
        apart, clarity = np.array(found).T
        clear = apart[clarity >= np.median(clarity)]
        print(f"{when}: {len(apart)} objects, angle to the lines {_quantiles(apart)}; clear lines {_quantiles(clear)}")
        parallel, across = (np.mean(np.abs(np.array(pairs[when]) - a) < WITHIN_DEG) for a in (0, 90))
        clarities = np.percentile(clarity, SHARES).round(2).tolist()
        print(f"{when}: {len(pairs[when])} pairs, {parallel:.2f} parallel, {across:.2f} across; clarity {clarities}")
        view = np.abs(np.array(from_view[when]))
        along, across = (np.mean(np.abs(view - a) < WITHIN_OF_VIEW_DEG) for a in (0, 90))
        print(f"{when}: {len(view)} objects, {along:.2f} along the line of sight, {across:.2f} at right angles to it")


def yaw_of(instance: Instance, camera: CameraSpec, ground_z_m: float) -> float | None:
    """Return the direction on the ground of a box's longer axis, degrees; None if it has none."""
    corners = instance.corners_xy
    if corners is None or instance.truncated:
        return None
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1)
    if sides[:2].max() < LEAST_ASPECT * sides[:2].min():
        return None
    first = int(np.argmin(sides[:2]))
    ends = [(corners[k] + corners[(k + 1) % 4]) / 2 for k in (first, first + 2)]
    start, end = (ground_point(camera, float(u), float(v), ground_z_m) for u, v in ends)
    if start is None or end is None:
        return None
    return math.degrees(math.atan2(end[1] - start[1], end[0] - start[0]))


def _apart(angle_deg: float, period_deg: float) -> float:
    return abs((angle_deg + period_deg / 2) % period_deg - period_deg / 2)


def _pixels(image: ImageRecord) -> NDArray[np.uint8]:
    return np.asarray(cv2.imread(str(image.path), cv2.IMREAD_GRAYSCALE), np.uint8)


def _quantiles(values: NDArray[np.float64]) -> str:
    return "/".join(f"{q:.1f}" for q in np.percentile(values, SHARES))


if __name__ == "__main__":
    main()
