"""Carries placed objects through a sequence: each keeps its place in the world while camera and object move.

An object is placed in one frame, its anchor, as in any picture. In another frame it is where the camera's motion moves
that place in the picture, after what the object itself has moved since: on the ground by the ground plane of its
anchor, in the air by direction and distance. It has the size that the background there has. A track is therefore as
steady against the background as the estimate of the camera's motion, and no frame depends on another one.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from infrablend.assets.model import ObjectModel, Params
from infrablend.config.recipe import SPEED_M_S, Motion, PathPoint
from infrablend.core.camera import CameraSpec
from infrablend.core.ground_plane import at_height, ground_point, ground_z_m, pixel_ray
from infrablend.core.mesh import FloatArray
from infrablend.core.render import PlacedObject, PlacedScene
from infrablend.core.scene import ObjectSpec, SceneSpec, View
from infrablend.errors import Problem, RecipeError
from infrablend.imaging.camera_path import Moment
from infrablend.imaging.camera_shift import Matrix, moved
from infrablend.sampling.paths import Fits, Path, find_path, sway

# Length of the step that shows an object's heading on the ground, metres.
_HEADING_M = 0.5
# A followed drone is within this share of the picture's half about its middle, and wanders there over such periods, s.
_WANDER = 0.45
_WANDER_S = (6.0, 25.0)
# How fast the operator's corrections of the camera are smoothed out of its path.
_STEADY_S = 1.0
# How much its distance varies, and over which periods, seconds.
_NEARER = 0.12
_NEARER_S = (20.0, 60.0)
# How far its heading turns and its attitude leans, radians, and over which periods, seconds.
_TURN = 0.7
_TURN_S = (8.0, 30.0)
_LEAN = math.radians(5)
_LEAN_S = (3.0, 12.0)
# What of an object at the edge of the picture is less wide or high is not drawn, px; of small ones, less than a half.
_SLIVER_PX = 2.0
# Azimuth has no meaning for a camera that looks straight down.
_LEAST_COS = 0.3


@dataclass(frozen=True, eq=False)
class Footage:
    """How camera and time go on through a sequence, frame by frame.

    Attributes:
        moments: What is known of the camera in each frame.
        times_s: (n,) seconds of the frames, ascending.
        size_wh: Size of the pictures.
        other_sizes_wh: Size of the pictures by span, where it is another one.
        is_timed: Whether the data state the seconds, which are assumed otherwise.
    """

    moments: Sequence[Moment]
    times_s: FloatArray
    size_wh: tuple[int, int]
    other_sizes_wh: Mapping[int, tuple[int, int]] = field(default_factory=dict)
    is_timed: bool = True

    def size_of(self, n: int) -> tuple[int, int]:
        """Return the size of a frame's picture."""
        return self.other_sizes_wh.get(self.moments[n].span, self.size_wh)

    def shown(self, n: int) -> int:
        """Return the frame whose picture frame `n` shows: one before it if the picture is frozen."""
        return self._shown[n]

    @cached_property
    def _shown(self) -> Sequence[int]:
        shown: list[int] = []
        for k, moment in enumerate(self.moments):
            shown.append(shown[-1] if k > 0 and moment.state == "frozen" else k)
        return shown

    def of_span(self, n: int) -> Sequence[int]:
        """Return the frames that can be related to a frame, itself among them, ascending."""
        return self._spans[self.moments[n].span]

    def moving(self, n: int) -> Sequence[int]:
        """Return those of `of_span` whose pictures are their own."""
        return self._moving[self.moments[n].span]

    @cached_property
    def _spans(self) -> Mapping[int, Sequence[int]]:
        spans: dict[int, list[int]] = {}
        for k, moment in enumerate(self.moments):
            spans.setdefault(moment.span, []).append(k)
        return spans

    @cached_property
    def _moving(self) -> Mapping[int, Sequence[int]]:
        return {span: [k for k in of if self._shown[k] == k] for span, of in self._spans.items()}

    @cached_property
    def _from_first(self) -> FloatArray:
        return np.linalg.inv(np.stack([m.to_first for m in self.moments]))

    def from_to(self, first: int, second: int) -> Matrix:
        """Return the (3, 3) matrix from pixels of one frame to those of another one of its span."""
        matrix = self._from_first[second] @ self.moments[first].to_first
        return np.asarray(matrix / matrix[2, 2])

    def levels(self, first: int, second: int) -> tuple[float, float]:
        """Return gain and offset from levels of one frame to those of another one of its span."""
        a, b = self.moments[first], self.moments[second]
        return b.gain / a.gain, b.offset - b.gain / a.gain * a.offset


@dataclass(frozen=True, eq=False)
class Track:
    """One object throughout a span of a sequence.

    Attributes:
        number: Number of the track in its sequence, from 1.
        placed: The object in its anchor.
        stands: Whether it stands on the ground.
        view: The ground below the anchor's camera.
        anchor: Number of the anchor's frame in the sequence.
        xy_px: (n, 2) its origin in the anchor's picture at the time of each frame; NaN where it is in no picture.
        ahead_px: (n, 2) a point of the ground in front of it; for objects in the air unused.
        range_m: (n,) distance from the anchor's camera.
        path: Its attitude at the time of each frame.
        phase: Phase of its limbs in its anchor, in [0, 1).
    """

    number: int
    placed: PlacedObject
    stands: bool
    view: View
    anchor: int
    xy_px: FloatArray
    ahead_px: FloatArray
    range_m: FloatArray
    path: Path
    phase: float = 0.0

    @property
    def stays(self) -> bool:
        """Whether the object stays in its place."""
        shown = self.xy_px[np.isfinite(self.xy_px).all(axis=1)]
        return bool((shown == shown[:1]).all())


def find_track(
    number: int,
    placed: PlacedObject,
    model: ObjectModel,
    motion: Motion,
    view: View,
    anchor: int,
    footage: Footage,
    rng: np.random.Generator,
    fits: Fits,
) -> Track:
    """Return the track of an object that was placed in a frame, its anchor; see `Track`.

    An individual whose pose does not walk stays where it is, whatever the motion.
    """
    camera = placed.camera
    spec = placed.spec
    times = footage.times_s - footage.times_s[anchor]
    low, high = motion.speed_m_s or SPEED_M_S[motion.kind]
    speed = low + (high - low) * float(rng.random())
    phase = float(rng.random())
    if motion.path is not None:
        path = _path_by_hand(motion.path, placed, model.stands, view, footage.times_s)
    elif motion.kind == "followed":
        return _followed(number, placed, view, anchor, footage, rng)
    else:
        rests = model.stands and model.stride_m is not None and model.stride_m(spec.params) == 0
        start = (*spec.position_m, spec.yaw_rad)
        span = (min(times[0], 0.0), max(times[-1], 0.0))
        path = find_path("still" if rests else motion.kind, start, speed, span, rng, fits).at(times)
    heading = np.stack([np.cos(path.yaw_rad), np.sin(path.yaw_rad), np.zeros(len(times))], axis=1)
    xy, _ = camera.project(path.place_m)
    ahead, _ = camera.project(path.place_m + _HEADING_M * heading)
    away = np.linalg.norm(path.place_m - camera.position_m, axis=1)
    return Track(number, placed, model.stands, view, anchor, xy, ahead, away, path, phase)


def _path_by_hand(
    points: Sequence[PathPoint], placed: PlacedObject, stands: bool, view: View, times_s: FloatArray
) -> Path:
    """Return the straight lines between points.

    Raises:
        RecipeError: A point of the picture that is to be one of the ground is above the horizon.
    """
    camera = placed.camera
    spec = placed.spec
    known = []
    for number, p in enumerate(points):
        place: FloatArray | None
        if p.offset_m is not None:
            place = np.array(spec.position_m) + p.offset_m
        elif stands:
            place = ground_point(camera, float(p.x_px or 0), float(p.y_px or 0), view.ground_z_m)
        else:
            ray = pixel_ray(camera, float(p.x_px or 0), float(p.y_px or 0))
            place = camera.position_m + (p.range_m or placed.range_m) * ray
        if place is None:
            where = f"objects.{spec.kind}.motion.path.{number}"
            problem = Problem(where, "recipe-value", f"found {p.x_px:g}, {p.y_px:g}", "a point below the horizon")
            raise RecipeError("a path that is not on the ground", [problem])
        known.append((p.time_s, *place.tolist()))
    found = np.array(known, np.float64)
    place_m = np.stack([np.interp(times_s, found[:, 0], found[:, k]) for k in (1, 2, 3)], axis=1)
    step = np.gradient(place_m, axis=0) if len(times_s) > 1 else np.zeros_like(place_m)
    moving = np.flatnonzero(np.linalg.norm(step[:, :2], axis=1) > 1e-9)
    yaw = np.full(len(times_s), spec.yaw_rad)
    if len(moving):  # at rest, as when it last moved
        headings = np.unwrap(np.arctan2(step[moving, 1], step[moving, 0]))
        yaw = headings[np.clip(np.searchsorted(moving, np.arange(len(times_s)), side="right") - 1, 0, None)]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(place_m, axis=0), axis=1))])
    return Path(times_s, place_m, yaw, np.zeros(len(times_s)), np.zeros(len(times_s)), way)


def _followed(
    number: int, placed: PlacedObject, view: View, anchor: int, footage: Footage, rng: np.random.Generator
) -> Track:
    """Return the track of a drone that the camera follows: about the middle of the picture, in all of its span."""
    times = footage.times_s
    size_wh = footage.size_of(anchor)
    middle = np.array([size_wh]) / 2
    span = footage.of_span(anchor)
    centres = np.full((len(times), 2), np.nan)
    for n in span:
        centres[n] = moved(middle, footage.from_to(n, anchor))[0]
    steady = np.stack([np.interp(times, times[span], _smoothed(centres[span, k], times[span])) for k in (0, 1)], axis=1)
    reach = _WANDER * min(size_wh) / 2
    wander = np.stack([sway(times, reach, _WANDER_S, rng) for _ in range(2)], axis=1)
    away = placed.range_m * np.exp(sway(times, _NEARER, _NEARER_S, rng))
    yaw = placed.spec.yaw_rad + sway(times, _TURN, _TURN_S, rng)
    lean, bank = (sway(times, _LEAN, _LEAN_S, rng) for _ in range(2))
    path = Path(times, np.zeros((len(times), 3)), yaw, lean, bank, np.zeros(len(times)))
    return Track(number, placed, False, view, anchor, steady + wander, steady, away, path)


def _smoothed(values: FloatArray, times_s: FloatArray) -> FloatArray:
    """Return values without what is faster than `_STEADY_S`: at each time, that of the line through those around it.

    A line follows an even pan without a lag, at the ends too.
    """
    found = np.empty_like(values)
    for k, time in enumerate(times_s):
        low, high = np.searchsorted(times_s, (time - 4 * _STEADY_S, time + 4 * _STEADY_S))
        off = times_s[low:high] - time
        weight = np.exp(-((off / _STEADY_S) ** 2) / 2)
        w = weight.sum()
        wx = weight @ off
        wxx = weight @ off**2
        y = weight @ values[low:high]
        xy = (weight * off) @ values[low:high]
        spread = w * wxx - wx**2
        found[k] = (wxx * y - wx * xy) / spread if spread > 1e-9 else y / w
    return found


def camera_in(
    spec: SceneSpec, footage: Footage, anchor: int, n: int, pitch_rad: float | None
) -> tuple[CameraSpec, View]:
    """Return the camera of a frame, and the ground below it: that of an anchor of its span, turned and zoomed.

    Args:
        spec: The anchor's scene.
        footage: The sequence.
        anchor: The anchor's frame.
        n: The frame.
        pitch_rad: Its pitch; None to take a shift of the picture for a turn of the camera, as on a mast.
    """
    assert spec.view is not None
    matrix = footage.from_to(anchor, n)
    middle = np.array([footage.size_of(anchor)]) / 2
    turn, zoom = _turn_and_zoom(matrix, moved(middle, footage.from_to(n, anchor))[0])
    pitch = spec.camera.pitch_rad + _turned(spec.camera, footage, anchor, n)[1] if pitch_rad is None else pitch_rad
    camera = replace(
        spec.camera,
        pitch_rad=min(max(pitch, -math.pi / 2), math.pi / 2),
        roll_rad=spec.camera.roll_rad - turn,
        focal_length_mm=spec.camera.focal_length_mm * zoom,
    )
    camera = at_height(camera, spec.view.camera_height_m)
    return camera, replace(spec.view, ground_z_m=ground_z_m(camera, spec.view.camera_height_m))


def _turn_and_zoom(matrix: Matrix, xy: FloatArray) -> tuple[float, float]:
    """Return by how much a matrix turns (clockwise in the picture) and enlarges what is around a position."""
    place = moved(np.array([xy, xy + (1, 0), xy + (0, 1)]), matrix)
    across = place[1] - place[0]
    down = place[2] - place[0]
    return math.atan2(across[1], across[0]), math.sqrt(abs(across[0] * down[1] - across[1] * down[0]))


def _turned(camera: CameraSpec, footage: Footage, anchor: int, n: int) -> tuple[float, float]:
    """Return by which angles a camera that only turns has turned since its anchor: to the right and down, radians."""
    middle = np.array([footage.size_of(anchor)]) / 2
    right, down = (moved(middle, footage.from_to(n, anchor)) - middle)[0] / camera.focal_px
    c, s = math.cos(camera.roll_rad), math.sin(camera.roll_rad)
    right, down = c * right - s * down, s * right + c * down
    return right / max(math.cos(camera.pitch_rad), _LEAST_COS), down


def objects_in(
    tracks: Sequence[Track], models: Sequence[ObjectModel], footage: Footage, n: int, camera: CameraSpec, view: View
) -> list[PlacedObject]:
    """Return the objects in a frame's picture, in the order of their tracks; `models` has that of each track."""
    found = []
    for track, model in zip(tracks, models, strict=True):
        if (spec := _spec_in(track, footage, n, camera, view)) is None:
            continue
        params = _moving(model, spec.params, track, n)
        mesh = track.placed.mesh if params == track.placed.spec.params else model.build(params)
        placed = PlacedObject(replace(spec, params=params), mesh, camera, track.placed.sun)
        if (placed.depth_m > 0).all() and _in_picture(placed.box_xyxy, camera.size_wh):
            found.append(placed)
    return found


def _spec_in(track: Track, footage: Footage, n: int, camera: CameraSpec, view: View) -> ObjectSpec | None:
    """Return an object where it is in a frame; None where that is no place in front of the camera."""
    xy = track.xy_px[n]
    before = track.placed.camera
    if not np.isfinite(xy).all():
        return None
    matrix = footage.from_to(track.anchor, n)
    spec = track.placed.spec
    u, v = (float(c) for c in moved(xy[None], matrix)[0])
    _, zoom = _turn_and_zoom(matrix, xy)
    if not track.stands:
        away = float(track.range_m[n]) * camera.focal_px / (before.focal_px * zoom)
        x, y, z = (float(c) for c in camera.position_m + away * pixel_ray(camera, u, v))
        pan, _ = _turned(before, footage, track.anchor, n)
        return replace(spec, position_m=(x, y, z), yaw_rad=float(track.path.yaw_rad[n]) + pan, track=track.number)
    below = ground_point(camera, u, v, view.ground_z_m)
    u, v = (float(c) for c in moved(track.ahead_px[n][None], matrix)[0])
    ahead = ground_point(camera, u, v, view.ground_z_m)
    if below is None or ahead is None:
        return None
    yaw = math.atan2(ahead[1] - below[1], ahead[0] - below[0])
    # The background shows how large things are there; a camera that moves on is not quite where its anchor was.
    has = camera.focal_px / float(np.linalg.norm(below - camera.position_m))
    scale = spec.scale * before.focal_px / float(track.range_m[n]) * zoom / has
    x, y = float(below[0]), float(below[1])
    z = view.ground_z_m + spec.position_m[2] - track.view.ground_z_m
    return replace(spec, position_m=(x, y, z), yaw_rad=yaw, scale=scale, track=track.number)


def _moving(model: ObjectModel, params: Params, track: Track, n: int) -> Params:
    """Return the parameters of an object in a frame: its limbs move as it goes, its attitude changes with its path."""
    lean = math.degrees(track.path.lean_rad[n])
    bank = math.degrees(track.path.bank_rad[n])
    found = dict(params)
    stride = model.stride_m(params) * track.placed.spec.scale if model.stride_m is not None else 0.0
    cycle_hz = model.cycle_hz(params) if model.cycle_hz is not None else 0.0
    walks = stride > 0 and bool(track.path.way_m.any())
    if model.animate is not None and (walks or cycle_hz > 0):
        steps = float(track.path.way_m[n]) / stride if walks else 0.0
        phase = (track.phase + steps + cycle_hz * float(track.path.times_s[n])) % 1.0
        found = dict(model.animate(params, phase))
    if "lean_deg" in found:
        found["lean_deg"] = round(lean, 3)
    if "bank_deg" in found:
        found["bank_deg"] = round(bank, 3)
    return found


def _in_picture(box_xyxy: FloatArray, size_wh: tuple[int, int]) -> bool:
    """Return whether enough of an object is in the picture for a label: a sliver at the edge has not entered yet."""
    extent = box_xyxy[2:] - box_xyxy[:2]
    inside = np.minimum(box_xyxy[2:], size_wh) - np.maximum(box_xyxy[:2], 0)
    return bool((inside > np.minimum(_SLIVER_PX, extent / 2)).all())


def velocity_px_s(tracks: Sequence[Track], footage: Footage, n: int) -> tuple[float, float]:
    """Return the mean velocity (right, down) of objects in the picture up to a frame, px/s; 0 for a frame alone.

    That of the first frame is the one after it.
    """
    of_span = footage.moving(n)
    at = max(bisect_left(of_span, n), 1)
    if at >= len(of_span):
        return 0.0, 0.0
    a, b = of_span[at - 1], of_span[at]
    seconds = footage.times_s[b] - footage.times_s[a]

    def places(k: int) -> FloatArray:
        return np.array([moved(t.xy_px[k][None], footage.from_to(t.anchor, k))[0] for t in tracks])

    shifts = (places(b) - places(a)).reshape(-1, 2)
    shifts = shifts[np.isfinite(shifts).all(axis=1)]
    if not len(shifts) or seconds <= 0:
        return 0.0, 0.0
    right, down = shifts.mean(axis=0) / seconds
    return float(right), float(down)


def scene_in(
    first: PlacedScene,
    frame: tuple[str, str, int],
    objects: Sequence[PlacedObject],
    camera: CameraSpec,
    view: View,
    render_seed: int,
    motion_px: tuple[float, float],
    out_of_view: int = 0,
) -> PlacedScene:
    """Return the scene of a frame with the weather and the look of the sequence's first anchor.

    `frame` is its id, the background's id and the configuration; `out_of_view` tracks of its span are not in it.
    """
    frame_id, background_id, configuration = frame
    draws = first.spec.draws
    here = Counter(o.spec.kind for o in objects)
    asked = Counter({int(kind): n for kind, n in draws.get("wanted_by_kind", {}).items()})
    here += asked - Counter(o.kind for o in first.spec.objects)  # what found no place when the sequence was populated
    wanted = {"wanted": here.total(), "wanted_by_kind": {str(kind): n for kind, n in sorted(here.items())}}
    spec = replace(
        first.spec,
        frame_id=frame_id,
        background_id=background_id,
        configuration=configuration,
        camera=camera,
        objects=tuple(o.spec for o in objects),
        render_seed=render_seed,
        motion_px=motion_px,
        view=view,
        draws={**draws, **wanted, "out_of_view": out_of_view},
    )
    return PlacedScene(spec, tuple(objects))
