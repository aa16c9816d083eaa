"""A flight over one scene of the virtual world: a sequence of frames from a camera that looks straight down.

The scene is rendered once, from far up, as a picture several times as wide and as high as a frame, the map. A frame is
the window of the map that the camera sees at its moment, resampled, with its labels carried along. This leaves out what
views of a camera near the ground differ in: parallax, and that things lean outwards towards the edges. The camera has
no motion blur, and the people and cars of the scene stand still. `world_survey` has the other course, of parallel
strips with overlap, and people who walk.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_of_points, clip_convex, corners_of_box, polygon_area
from infrablend.core.capture import UNKNOWN, Capture
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.files import write_bytes
from infrablend.core.mesh import FloatArray
from infrablend.core.rng import stream
from infrablend.formats.pictures.images import png_bytes
from infrablend.lab.world.frame_files import (
    HIGH_GREY,
    LOW_GREY,
    MEAN_GREY,
    MIN_PIXELS,
    MIN_VISIBILITY,
    FinishedFrame,
    Label,
    PlanRenderer,
    codec,
    detail,
    gain,
    noise,
    optics,
    sample_world,
    vignette,
)
from infrablend.lab.world.scene_plan import WorldPlan
from infrablend.lab.world.setting import FOCAL_PX, world_camera
from infrablend.lab.world.world_frames import FPS, FrameFacts
from infrablend.sampling.paths import sway

# The map is so many frames wide and high, seen from so many times the height of the flight.
ACROSS = 4
_FARTHER = 16
# How far the camera goes from its mean course, and in which periods, seconds: its height as a share, its heading in
# radians, jitter of the gimbal in px and radians, gain as a share, and offset in levels.
_GLIDE_S = (25.0, 70.0)
_HEIGHT = 0.04
_HEIGHT_S = (15.0, 40.0)
_TURN = 0.6
_TURN_S = (20.0, 60.0)
_JITTER_PX = 0.8
_JITTER = 0.001
_JITTER_S = (0.2, 1.0)
_GAIN = 0.02
_OFFSET = 3.0
_LEVELS_S = (8.0, 40.0)
_PATTERN_GREY = 0.4
_STRIPES_GREY = 0.3
# Most px beside a window that resampling and blur take in.
_MARGIN_PX = 8


@dataclass(frozen=True)
class Pose:
    """Where the camera of a frame looks, and the levels it shows.

    Attributes:
        middle_xy: Middle of the frame on the map, px.
        turn_rad: Heading, clockwise on the map.
        zoom: Pixels of the map per pixel of the frame; that of the flight's height is 1.
        gain: Factor on levels, about the mean level.
        offset_grey: Levels added to that.
    """

    middle_xy: tuple[float, float]
    turn_rad: float
    zoom: float
    gain: float
    offset_grey: float

    def to_map(self, size_wh: tuple[int, int]) -> FloatArray:
        """Return the (3, 3) matrix from positions in a frame of some size to those on the map."""
        c, s = self.zoom * math.cos(self.turn_rad), self.zoom * math.sin(self.turn_rad)
        turned = np.array([[c, -s], [s, c]])
        matrix = np.eye(3)
        matrix[:2, :2] = turned
        matrix[:2, 2] = self.middle_xy - turned @ (np.array(size_wh) / 2)
        return matrix


def find_pose(seed: int, number: int, size_wh: tuple[int, int]) -> Pose:
    """Return the pose of a frame; `size_wh` is the size of frames."""
    rng = stream(seed, "world", "flight", "path")
    time = np.array([number / FPS])

    def wave(size: float, periods_s: tuple[float, float]) -> float:
        return float(sway(time, size, periods_s, rng)[0])

    # A window that is turned in any way stays within the map.
    half = math.hypot(*size_wh) / 2 * (1 + _HEIGHT) + _MARGIN_PX + 2 * _JITTER_PX
    middle = [ACROSS * n / 2 + wave(ACROSS * n / 2 - half, _GLIDE_S) + wave(_JITTER_PX, _JITTER_S) for n in size_wh]
    turn = wave(_TURN, _TURN_S) + wave(_JITTER, _JITTER_S)
    zoom = 1 + wave(_HEIGHT, _HEIGHT_S)
    levels = 1 + wave(_GAIN, _LEVELS_S), wave(_OFFSET, _LEVELS_S)
    return Pose((middle[0], middle[1]), turn, zoom, *levels)


@dataclass(frozen=True, eq=False)
class Flight:
    """What all frames of a flight share.

    Attributes:
        seed: Seed of everything random.
        plan: Plan of the scene, as the map shows it.
        levels: (h, w) grey levels of the map, neither blurred nor clipped.
        labels: Labels of the map, in the order of their tracks, which are numbered from 1.
        blur_px: Blur of the lens.
        detail: Strength of the camera's enhancement of edges.
        grain_grey: Deviation of the grain, which is new in each frame.
        pattern: (h, w) levels of the fixed pattern and the vignette.
        quality: Quality of the camera's codec.
    """

    seed: int
    plan: WorldPlan
    levels: NDArray[np.float32]
    labels: Sequence[Label]
    blur_px: float
    detail: float
    grain_grey: float
    pattern: NDArray[np.float32]
    quality: int


def flight_plan(frame: FrameFacts, seed: int) -> WorldPlan:
    """Draw the scene below a flight; `frame` is any frame of it."""
    w, h = frame.size_wh
    return sample_world(
        stream(seed, "world", "flight", "plan"), 90, _FARTHER * frame.altitude_m, frame.time_of_day, frame.kind,
        (ACROSS * w, ACROSS * h), _FARTHER / ACROSS * FOCAL_PX,
    )  # fmt: skip


def begin_flight(frame: FrameFacts, seed: int, renderer: PlanRenderer, plan: WorldPlan | None = None) -> Flight:
    """Render the map of a flight; `frame` is any frame of it, `plan` the scene, drawn if it is None."""
    w, h = frame.size_wh
    plan = flight_plan(frame, seed) if plan is None else plan
    kelvin, labels = renderer.render(plan)
    rng = stream(seed, "world", "flight", "look")
    stripes = np.float32(_STRIPES_GREY) * rng.standard_normal((1, w)).astype(np.float32)
    return Flight(
        seed=seed,
        plan=plan,
        levels=gain(kelvin, plan.gain_per_k, plan.std_grey, plan.mean_grey),
        labels=labels,
        blur_px=float(rng.uniform(0.6, 0.85)),
        detail=float(rng.uniform(0.45, 0.8)),
        grain_grey=float(rng.uniform(1.3, 2.1)),
        pattern=noise(rng, (h, w), _PATTERN_GREY) + stripes + vignette((h, w), float(rng.uniform(2, 8))),
        quality=int(rng.integers(70, 90)),
    )


def flight_frame(
    flight: Flight, frame: FrameFacts, folder: Path, pose: Pose | None = None, header: Capture = UNKNOWN
) -> FinishedFrame:
    """Write the image of a frame of a flight to `folder`/<split>/.

    Args:
        flight: What all frames share.
        frame: The frame.
        folder: Folder of the images.
        pose: Where the camera looks; None for a smooth course.
        header: What the camera states of the picture; the truth where it states nothing.
    """
    pose = find_pose(flight.seed, frame.number, frame.size_wh) if pose is None else pose
    matrix = pose.to_map(frame.size_wh)
    path = folder / frame.split / frame.name
    write_bytes(path, png_bytes(_picture(flight, pose, matrix, frame)))
    seen = list(_seen(flight.labels, np.asarray(np.linalg.inv(matrix)), frame.size_wh))
    camera = world_camera(90, frame.altitude_m * pose.zoom, frame.size_wh)
    record = ImageRecord(
        id=path.stem,
        path=path,
        split=frame.split,
        size_wh=frame.size_wh,
        instances=tuple(seen),
        capture=header.over(
            Capture(
                pitch_deg=90.0,
                altitude_m=round(camera.distance_m, 3),
                time_of_day=frame.time_of_day,
                hfov_deg=round(math.degrees(2 * math.atan(frame.size_wh[0] / 2 / camera.focal_px)), 4),
                sequence=frame.sequence,
                frame=frame.index,
                time_s=round(frame.index / FPS, 6),
            )
        ),
        file_name=frame.name,
    )
    facts: dict[str, object] = {
        "name": frame.name,
        "split": frame.split,
        "kind": flight.plan.kind,
        "air_k": flight.plan.air_k,
        "camera": asdict(camera),
        "to_map": matrix.tolist(),
        "gain": pose.gain,
        "offset_grey": pose.offset_grey,
        "objects": [
            {"category": o.category, "track_id": o.track_id, "visibility": o.visibility, "truncated": o.truncated}
            for o in seen
        ],
    }
    return FinishedFrame(frame.number, record, facts)


def _picture(flight: Flight, pose: Pose, matrix: FloatArray, frame: FrameFacts) -> NDArray[np.uint8]:
    """Return the window of the map that a frame shows, as its camera shows it."""
    w, h = frame.size_wh
    # OpenCV has the middle of the first pixel at 0, not at a half.
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    taken = (np.linalg.inv(half) @ matrix @ half)[:2]
    grey = cv2.warpAffine(flight.levels, taken, (w, h), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
    grey = (optics(np.asarray(grey, np.float32), flight.blur_px) - MEAN_GREY) * pose.gain + MEAN_GREY + pose.offset_grey
    # Clipped before the enhancement: bodies far above the range get no fringe of matching size.
    grey = detail(np.clip(grey, LOW_GREY - 25, HIGH_GREY + 25).astype(np.float32), flight.detail, 1.6)
    grain = noise(stream(flight.seed, "world", frame.number, "grain"), (h, w), flight.grain_grey)
    levels = np.round(np.clip(grey + grain + flight.pattern, LOW_GREY + 1, HIGH_GREY)).astype(np.uint8)
    return np.clip(codec(levels, flight.quality), int(LOW_GREY), int(HIGH_GREY)).astype(np.uint8)


def _seen(labels: Sequence[Label], from_map: FloatArray, size_wh: tuple[int, int]) -> Iterator[Instance]:
    """Yield the labelled objects that a frame shows; `from_map` is the (3, 3) matrix from the map to the frame."""
    frame = corners_of_box(np.array([0.0, 0.0, *size_wh]))
    for track, label in enumerate(labels, 1):
        if label.outline_xy is None:
            continue
        outline = label.outline_xy @ from_map[:2, :2].T + from_map[:2, 2]
        inside = clip_convex(outline, frame)
        area = polygon_area(inside)
        whole = polygon_area(outline)
        visibility = label.visibility * min(area / max(whole, 1e-9), 1.0)
        if visibility < MIN_VISIBILITY or area < MIN_PIXELS:
            continue
        box = np.clip(box_of_points(inside), 0.0, np.array([*size_wh, *size_wh], np.float64))
        if (box[2:] - box[:2] < 1).any():
            continue
        truncated = bool((outline < 0).any() or (outline > size_wh).any())
        yield Instance(label.category, box, visibility=round(visibility, 4), truncated=truncated, track_id=track)
