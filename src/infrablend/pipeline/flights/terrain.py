"""Heights of cameras above the ground that their rays meet, by a height model.

The height of the model at take-off and the height above take-off give that of the camera; what a header states as
absolute height is not used, whose zero differs from model to model of aircraft. A laser's height counts from the ground
in the middle of the picture. As only differences enter, so does the zero of the height model not matter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from infrablend.core.dataset import ImageRecord
from infrablend.core.ground_position import (
    LEAST_DEPRESSION_DEG,
    LocalFrame,
    Pose,
    StatedError,
    ground_of_pixels,
    rays_of_pixels,
)
from infrablend.core.mesh import FloatArray
from infrablend.detection.truth import image_key
from infrablend.errors import DatasetError, Problem
from infrablend.formats.maps.height_model import HeightGrid, read_heights
from infrablend.pipeline.flights.flight_poses import FlightPoses

_MODEL_ERROR = StatedError(3.0, "height above take-off, height model")
# Valleys may be this much deeper below the camera than the ground at take-off.
_DEEPER_M = 200.0
_BISECTIONS = 40


@dataclass(frozen=True, eq=False)
class Terrain:
    """The ground below a flight.

    Attributes:
        grids: Heights around each frame's pictures.
        camera_z_m: Height of each picture's camera in the model's zero.
    """

    grids: Mapping[LocalFrame, HeightGrid]
    camera_z_m: Mapping[str, float]

    def height_m(self, key: str, pose: Pose, frame: LocalFrame, xy: FloatArray) -> float:
        """Return metres from the ground that the ray of a pixel (2,) meets up to the camera; NaN if it meets none."""
        camera = frame.to_metres(pose.latitude_deg, pose.longitude_deg)
        return drop_m(self.grids[frame], camera, self.camera_z_m[key], rays_of_pixels(pose, xy[None])[0])


def drop_m(grid: HeightGrid, camera: FloatArray, camera_z_m: float, ray: FloatArray) -> float:
    """Return metres from a camera down to the ground that a ray meets first; NaN if it leaves the model before.

    Args:
        grid: Heights of the ground.
        camera: (2,) metres east and north.
        camera_z_m: Height in the model's zero.
        ray: (3,) east, north and up, of any length.
    """
    lowest = np.nanmin(grid.heights_m, initial=np.inf)
    if not (ray[2] < 0 and math.isfinite(lowest)):
        return math.nan

    def above_m(down_m: FloatArray) -> FloatArray:
        return np.asarray(camera_z_m - down_m - grid.at(camera - ray[:2] / ray[2] * down_m[:, None]))

    most = (camera_z_m - lowest) * (1 + 1e-9)
    # Steps of half a cell on the ground.
    steps = 2 + math.ceil(max(most, 0) * float(np.linalg.norm(ray[:2] / ray[2])) / (grid.cell_m / 2))
    down = np.linspace(0, most, steps)
    above = above_m(down)
    first = int(np.argmax(~(above > 0)))
    if not above[0] > 0 or not above[first] <= 0:
        return math.nan
    over, under = down[first - 1], down[first]
    for _ in range(_BISECTIONS):
        middle = (over + under) / 2
        over, under = (middle, under) if above_m(np.array([middle]))[0] > 0 else (over, middle)
    return float(under)


def on_terrain(
    path: Path, images: Sequence[ImageRecord], poses: FlightPoses, take_off: tuple[float, float] | None
) -> tuple[FlightPoses, Terrain]:
    """Return the poses with heights above the ground in the middle of their pictures, and the ground.

    Args:
        path: The height model.
        images: The pictures.
        poses: Their poses over level ground.
        take_off: Latitude and longitude of the take-off; by default, that of each flight's first picture.

    Raises:
        MissingDependencyError: rasterio is not installed.
        DatasetError: The file is no height model, or has no height at take-off.
    """
    captures = {image_key(i): i.capture for i in images}
    starts: dict[str | None, Pose] = {}
    for key in sorted(poses.known, key=lambda k: (captures[k].captured or "", k)):
        starts.setdefault(captures[key].sequence, poses.known[key])
    grids = {frame: _grid(path, poses, frame, take_off) for frame in dict.fromkeys(poses.frames.values())}
    known: dict[str, Pose] = {}
    camera_z: dict[str, float] = {}
    lacking = dict(poses.lacking)
    for key, pose in poses.known.items():
        frame, capture = poses.frames[key], captures[key]
        start = starts[capture.sequence]
        reference = take_off or (start.latitude_deg, start.longitude_deg)
        zero = frame.to_metres(*reference)[None]
        middle = np.array(pose.size_wh) / 2
        if capture.altitude_from == "laser":
            zero = ground_of_pixels(pose, frame, middle[None])
        elif capture.altitude_from is None:
            zero = frame.to_metres(pose.latitude_deg, pose.longitude_deg)[None]
        base = float(grids[frame].at(zero)[0])
        if capture.altitude_from == "take-off" and math.isnan(base):
            found = "no height at take-off, {:.5f}, {:.5f}".format(*reference)
            expected = "a height model that covers take-off and flight"
            todo = "take a larger model, or give --take-off LAT,LON"
            raise DatasetError(f"{path}: cannot be used", [Problem(path.name, "terrain", found, expected, todo)])
        camera_z[key] = base + pose.height_m
        height = Terrain(grids, camera_z).height_m(key, pose, frame, middle)
        if math.isnan(height):
            lacking[key] = "ground of the height model below the camera and in the middle of the picture"
            continue
        errors = pose.errors
        if errors["height_m"].source not in ("laser", "given"):
            errors = {**errors, "height_m": _MODEL_ERROR}
        known[key] = replace(pose, height_m=height, errors=errors)
    return FlightPoses(known, {k: poses.frames[k] for k in known}, lacking), Terrain(grids, camera_z)


def _grid(path: Path, poses: FlightPoses, frame: LocalFrame, take_off: tuple[float, float] | None) -> HeightGrid:
    """Return the heights of the ground that pictures of a frame can show."""
    own = [pose for key, pose in poses.known.items() if poses.frames[key] == frame]
    places = [(p.latitude_deg, p.longitude_deg) for p in own] + ([take_off] if take_off else [])
    at = np.concatenate([frame.to_metres(*place)[None] for place in places])
    steepness = math.tan(math.radians(LEAST_DEPRESSION_DEG))
    reach = (max(p.height_m for p in own) + _DEEPER_M) / steepness
    return read_heights(path, frame, at.min(axis=0) - reach, at.max(axis=0) + reach)
