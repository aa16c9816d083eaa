"""A survey over one scene of the virtual world: parallel strips flown to and fro, with overlap.

Frames are windows of the map of `world_flight`. They state where the camera was as a drone does, with errors: position
by satellites, height by pressure, yaw by the gimbal. `world.json` has the truth, and where each object is.

The camera is turned a little against its course, as in wind from the side, so that its yaw is not that of the track.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pymap3d
from numpy.typing import NDArray

from infrablend.core.capture import Capture
from infrablend.core.mesh import FloatArray
from infrablend.core.rng import stream
from infrablend.errors import Problem, RecipeError
from infrablend.lab.world.frame_files import FinishedFrame, Label, PlanRenderer
from infrablend.lab.world.people import draw_person
from infrablend.lab.world.scene_plan import WorldPlan
from infrablend.lab.world.setting import FOCAL_PX, Draws, Weather
from infrablend.lab.world.world_flight import ACROSS, Flight, Pose, begin_flight, flight_frame, flight_plan
from infrablend.lab.world.world_frames import FrameFacts, Survey
from infrablend.sampling.paths import Path as Way
from infrablend.sampling.paths import find_path, sway

# Speed of the aircraft, m/s, and what a turn between two strips takes, s.
_SPEED_M_S = 5.0
_TURN_S = 4.0
# Most degrees between the camera's yaw and its course, which stays, and by which its yaw sways; height as a share.
_CRAB_DEG = 8.0
_YAW_DEG = 1.5
_YAW_S = (5.0, 20.0)
_HEIGHT = 0.01
_HEIGHT_S = (15.0, 40.0)
# How far the camera is off its course, px of the map.
_OFF_PX = 10.0
_OFF_S = (5.0, 30.0)
# Errors of what frames state: position from picture to picture and slowly, m; height, m; yaw, degrees.
_PLACE_M = 0.25
_DRIFT_M = 0.5
_DRIFT_S = (60.0, 240.0)
_BAROMETER_M = 0.5
_GIMBAL_DEG = 0.3
# The middle of the map: in the sea, so that no real place is shown.
_PLACE = (43.0, 15.5)
# People besides those that the scene has, and how fast they walk, m/s.
_PEOPLE = 24
_WALK_M_S = (0.7, 1.5)
# Patches of people are so much larger than their outlines, px.
_AROUND_PX = 6
# Most px beside a window that resampling and blur take in.
_MARGIN_PX = 8


@dataclass(frozen=True)
class Station:
    """Where a frame of a survey is taken.

    Attributes:
        middle_xy: Middle of the frame on the map, px.
        yaw_deg: Heading of the camera.
        zoom: Height as a share of the flight's.
        time_s: Seconds since the first frame.
    """

    middle_xy: tuple[float, float]
    yaw_deg: float
    zoom: float
    time_s: float


@dataclass(frozen=True, eq=False)
class Walker:
    """A person who walks.

    Attributes:
        index: Number of the label in the flight's.
        levels: (h, w) levels of the person above those of the ground.
        corner_xy: (2,) where these begin on the map, px.
        way: Path in the scene, whose time 0 is that of the first frame.
    """

    index: int
    levels: NDArray[np.float32]
    corner_xy: tuple[int, int]
    way: Way


@dataclass(frozen=True, eq=False)
class SurveyFlight:
    """What all frames of a survey share.

    Attributes:
        flight: The map and the camera; without those who walk on it.
        stations: Where frames are taken, in their order.
        walkers: People who walk.
    """

    flight: Flight
    stations: Sequence[Station]
    walkers: Sequence[Walker]


def find_stations(survey: Survey, seed: int, size_wh: tuple[int, int], pixel_m: float) -> list[Station]:
    """Return where the frames of a survey are taken: strips to the east and the west, from the north on.

    Args:
        survey: The survey.
        seed: Seed of everything random.
        size_wh: Size of frames, px.
        pixel_m: Metres per pixel of the map.
    """
    w, h = size_wh
    rng = stream(seed, "world", "survey", "path")
    crab = float(rng.uniform(-_CRAB_DEG, _CRAB_DEG))
    turned = math.radians(_CRAB_DEG + _YAW_DEG)
    extra = _OFF_PX + _MARGIN_PX
    # Half of what a turned frame takes along and across the strips.
    halves = [(1 + _HEIGHT) * (a * math.cos(turned) + b * math.sin(turned)) / 2 + extra for a, b in ((h, w), (w, h))]
    along, across = ((1 - survey.overlap) * n for n in (h, w))
    columns, rows = (
        half + step * np.arange(int((ACROSS * n - 2 * half) / step) + 1)
        for n, half, step in zip(size_wh, halves, (along, across), strict=True)
    )
    course = [
        (x, y, 90.0 if k % 2 == 0 else -90.0)
        for k, y in enumerate(rows.tolist())
        for x in (columns if k % 2 == 0 else columns[::-1]).tolist()
    ]
    step_s = along * pixel_m / _SPEED_M_S
    times = np.array([k * step_s + k // len(columns) * _TURN_S for k in range(len(course))])
    sways = ((_OFF_PX, _OFF_S), (_OFF_PX, _OFF_S), (_YAW_DEG, _YAW_S), (_HEIGHT, _HEIGHT_S))
    off_x, off_y, yaw, height = (sway(times, size, periods, rng) for size, periods in sways)
    return [
        Station((x + off_x[k], y + off_y[k]), heading + crab + float(yaw[k]), 1 + float(height[k]), float(times[k]))
        for k, (x, y, heading) in enumerate(course)
    ]


def begin_survey(frame: FrameFacts, seed: int, renderer: PlanRenderer) -> SurveyFlight:
    """Draw the scene below a survey and render its map; `frame` is any frame of it."""
    assert frame.survey is not None
    plan = _peopled(flight_plan(frame, seed), seed)
    flight = begin_flight(frame, seed, renderer, plan)
    stations = find_stations(frame.survey, seed, frame.size_wh, _pixel_m(frame))
    if not frame.survey.walking:
        return SurveyFlight(flight, stations, ())
    empty = begin_flight(frame, seed, renderer, replace(plan, people=()))
    # Both maps have their own gain; that of the peopled one counts, and what differs from it by a line is ground.
    slope, offset = np.polyfit(empty.levels.ravel()[::97], flight.levels.ravel()[::97], 1)
    ground = np.asarray(empty.levels * np.float32(slope) + np.float32(offset), np.float32)
    walkers = [*_walkers(flight, ground, stations[-1].time_s, _pixel_m(frame))]
    return SurveyFlight(replace(flight, levels=ground), stations, walkers)


def _pixel_m(frame: FrameFacts) -> float:
    """Return the metres per pixel of the map, which are those of a frame at the flight's height."""
    return frame.altitude_m / FOCAL_PX


def _peopled(plan: WorldPlan, seed: int) -> WorldPlan:
    """Return the scene with people all over it."""
    rng = stream(seed, "world", "survey", "people")
    draws = Draws(rng)
    weather = Weather(plan.sun is None, plan.air_k, 0.7, plan.sun, 0.0 if plan.sun is None else 0.8)
    pixel_m = plan.camera.distance_m / plan.camera.focal_px
    w, h = (n * pixel_m / 2 for n in plan.camera.size_wh)
    more = (
        draw_person(draws, weather, draws.uniform(-w, w), draws.uniform(-h, h), draws.uniform(0, 2 * math.pi), "walk")
        for _ in range(_PEOPLE)
    )
    return replace(plan, people=(*plan.people, *more))


def _walkers(flight: Flight, ground: NDArray[np.float32], last_s: float, pixel_m: float) -> list[Walker]:
    """Return the labelled people of a flight, with their levels above the ground and paths up to a second.

    Nobody leaves the map.
    """
    labels = [(k, label) for k, label in enumerate(flight.labels) if label.category == "Person"]
    found = []
    height, width = ground.shape

    def on_map(x_m: float, y_m: float) -> bool:
        return bool(2 * abs(x_m) < width * pixel_m and 2 * abs(y_m) < height * pixel_m)

    for number, ((index, label), person) in enumerate(zip(labels, flight.plan.people, strict=True)):
        if label.outline_xy is None:
            continue
        low = np.maximum(np.floor(label.outline_xy.min(axis=0)).astype(int) - _AROUND_PX, 0)
        high = np.minimum(np.ceil(label.outline_xy.max(axis=0)).astype(int) + _AROUND_PX, (width, height))
        part = np.s_[low[1] : high[1], low[0] : high[0]]
        rng = stream(flight.seed, "world", "survey", "walk", number)
        start = (person.x_m, person.y_m, 0.0, person.heading_rad)
        way = find_path("walk", start, float(rng.uniform(*_WALK_M_S)), (0.0, last_s), rng, on_map)
        corner = int(low[0]), int(low[1])
        found.append(Walker(index, flight.levels[part] - ground[part], corner, way))
    return found


def survey_frame(survey: SurveyFlight, frame: FrameFacts, folder: Path) -> FinishedFrame:
    """Write the image of a frame of a survey to `folder`/<split>/.

    Raises:
        RecipeError: The survey has fewer frames.
    """
    assert frame.survey is not None
    if frame.number >= len(survey.stations):
        found = f"more than {len(survey.stations)} images"
        expected = f"at most {len(survey.stations)}: so many cover the scene with this overlap"
        problem = Problem("count", "world-value", found, expected, "take fewer, or more overlap")
        raise RecipeError("the virtual world cannot be rendered with these values", [problem])
    station = survey.stations[frame.number]
    flight = _at(survey, station.time_s, _pixel_m(frame))
    pose = Pose(station.middle_xy, math.radians(station.yaw_deg), station.zoom, 1.0, 0.0)
    east, north = _metres(np.array([station.middle_xy]), frame)[0]
    header = _header(flight.seed, frame, station, (float(east), float(north)))
    finished = flight_frame(flight, frame, folder, pose, header)
    places = {k: _metres(o.outline_xy.mean(axis=0)[None], frame)[0] for k, o in enumerate(flight.labels, 1)
              if o.outline_xy is not None}  # fmt: skip
    truth = {
        "east_m": float(east),
        "north_m": float(north),
        "yaw_deg": station.yaw_deg,
        "height_m": frame.altitude_m * station.zoom,
        "ground_pixel_m": _pixel_m(frame) * station.zoom,
        "time_s": station.time_s,
        "objects_m": [places[int(o.track_id)].tolist() for o in finished.image.instances if o.track_id is not None],
    }
    return replace(finished, facts={**finished.facts, "survey": truth})


def _metres(xy: FloatArray, frame: FrameFacts) -> FloatArray:
    """Return (n, 2) metres east and north of the middle of the map for positions on it."""
    size = np.array(frame.size_wh) * ACROSS
    return np.asarray((xy - size / 2) * (1, -1) * _pixel_m(frame))


def _at(survey: SurveyFlight, time_s: float, pixel_m: float) -> Flight:
    """Return the flight with everybody where they are at a moment."""
    flight = survey.flight
    if not survey.walkers:
        return flight
    levels = flight.levels.copy()
    labels = list(flight.labels)
    height, width = levels.shape
    for walker in survey.walkers:
        start, now = (walker.way.at(np.array([t])) for t in (0.0, time_s))
        # The path is in the scene, with y to the north; the map has it downwards.
        from_xy, to_xy = (np.array([width, height]) / 2 + p.place_m[0, :2] * (1, -1) / pixel_m for p in (start, now))
        turn = -float(now.yaw_rad[0] - start.yaw_rad[0])
        c, s = math.cos(turn), math.sin(turn)
        turned = np.array([[c, -s], [s, c]])
        label = labels[walker.index]
        assert label.outline_xy is not None
        outline = (label.outline_xy - from_xy) @ turned.T + to_xy
        labels[walker.index] = _moved(label, outline)
        _add(levels, walker, turned, to_xy - turned @ from_xy)
    return replace(flight, levels=levels, labels=labels)


def _moved(label: Label, outline_xy: FloatArray) -> Label:
    return replace(label, outline_xy=outline_xy, box_xyxy=None, corners_xy=None)


def _add(levels: NDArray[np.float32], walker: Walker, turned: FloatArray, shift: FloatArray) -> None:
    """Add the levels of a person to those of the map, turned and moved on it."""
    side = math.ceil(math.hypot(*walker.levels.shape)) + 2
    patch = np.array(walker.levels.shape[::-1]) / 2
    middle = turned @ (np.array(walker.corner_xy) + patch) + shift
    low = np.floor(middle - side / 2).astype(int)
    # From the patch to the square around its new place; OpenCV has the middle of the first pixel at 0.
    to_square = np.column_stack([turned, middle - low - turned @ (patch - 0.5) - 0.5])
    square = cv2.warpAffine(walker.levels, to_square, (side, side), flags=cv2.INTER_LINEAR)
    height, width = levels.shape
    x0, y0 = np.maximum(low, 0)
    x1, y1 = np.minimum(low + side, (width, height))
    if x1 > x0 and y1 > y0:
        levels[y0:y1, x0:x1] += square[y0 - low[1] : y1 - low[1], x0 - low[0] : x1 - low[0]]


def _header(seed: int, frame: FrameFacts, station: Station, place_m: tuple[float, float]) -> Capture:
    """Return what the camera states of a frame, with the errors of a drone."""
    assert frame.survey is not None
    rng = stream(seed, "world", "survey", frame.number, "header")
    drift = stream(seed, "world", "survey", "drift")
    time = np.array([station.time_s])
    off = [_PLACE_M * rng.standard_normal() + sway(time, _DRIFT_M, _DRIFT_S, drift)[0] for _ in range(2)]
    east, north = (p + o for p, o in zip(place_m, off, strict=True))
    height = frame.altitude_m * station.zoom + sway(time, _BAROMETER_M, _DRIFT_S, drift)[0]
    latitude, longitude, _ = pymap3d.enu2geodetic(east, north, 0.0, *_PLACE, 0.0)
    yaw = station.yaw_deg + frame.survey.yaw_error_deg + _GIMBAL_DEG * rng.standard_normal()
    return Capture(
        altitude_m=round(float(height), 2),
        latitude_deg=round(float(latitude), 7),
        longitude_deg=round(float(longitude), 7),
        yaw_deg=round((yaw + 180) % 360 - 180, 1),
        time_s=round(station.time_s, 3),
    )
