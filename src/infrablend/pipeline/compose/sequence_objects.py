"""The objects of sequences: drawn once for each, and carried to every frame.

A sequence is populated frame by frame: where a frame, an anchor, shows enough ground or sky that no anchor before it
has shown, its objects are drawn as those of any picture, with all checks of places and contrast. Those in what earlier
anchors have shown are left out again: these have populated it. From then on each object is a track
(`sampling.tracks`), with the weather, the map to grey levels and the sensor of the first anchor of its span.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from infrablend.assets.model import ObjectModel
from infrablend.compositing.occlusion import Occluder
from infrablend.compositing.sensor import Sensor
from infrablend.config.recipe import MetricRecipe, Motion
from infrablend.config.sensor_profile import find_profile
from infrablend.core.mesh import FloatArray
from infrablend.core.render import PlacedObject, PlacedScene
from infrablend.core.rng import integer_seed, stream
from infrablend.errors import DatasetError
from infrablend.imaging.camera_shift import moved
from infrablend.imaging.paint_out import Shown, find_written
from infrablend.pipeline.compose.looks import Earlier, Match
from infrablend.pipeline.compose.partly_hidden import Front
from infrablend.pipeline.compose.settings import FrameSettings
from infrablend.pipeline.plans.plan import PlannedFrame, PlannedSequence
from infrablend.pipeline.plans.sequence_motion import sample_of
from infrablend.sampling.paths import Fits
from infrablend.sampling.placement import PlacementRequest
from infrablend.sampling.site import Site
from infrablend.sampling.suitable_ground import suitable_ground
from infrablend.sampling.tracks import (
    Footage,
    Track,
    camera_in,
    find_track,
    objects_in,
    scene_in,
    velocity_px_s,
)

# A frame is an anchor if less than this share of it has been shown by those before; points across a picture.
_SHOWN = 0.5
_POINTS = 9
# Where none of the objects of an anchor can be seen, so many frames later another one is tried, so many times at most.
_AGAIN = 25
_TRIES = 8
# Populated sequences that each worker keeps, of two or three MB each.
_KEPT = 32
# How well ground has to suit, of the place where an object was put.
_NEARLY = 0.5


@dataclass(frozen=True, eq=False)
class Anchored:
    """An anchor: a frame whose objects were drawn for it alone.

    Attributes:
        scene: Its scene.
        site: Its background as placement sees it.
        match: Its map to grey levels.
        sensor: Its sensor; None for no imitation, or without objects.
        occluders: What is in front of its objects, by their numbers.
    """

    scene: PlacedScene
    site: Site
    match: Match
    sensor: Sensor | None
    occluders: Mapping[int, Occluder]

    def without_meshes(self) -> Anchored:
        """Return what other frames need of it, a few MB less."""
        scene = PlacedScene(self.scene.spec, ())
        return replace(self, scene=scene, match=replace(self.match, scene=scene))


@dataclass(frozen=True, eq=False)
class Take:
    """What a frame of a sequence shows.

    Attributes:
        scene: The objects of the sequence that are in the picture.
        shown: The frame whose picture it shows: one before it if the picture is frozen.
        earlier: The map of the sequence to grey levels; None without objects.
        sensor: The sensor of the sequence.
        written: (h, w) mask of text and reticle, which stay in front; None without any.
        fronts: What else stays in front, by track.
    """

    scene: PlacedScene
    shown: PlannedFrame
    earlier: Earlier | None
    sensor: Sensor | None
    written: NDArray[np.bool_] | None
    fronts: Mapping[int, Front]


@dataclass(eq=False)
class _Span:
    """The tracks of a span, the anchor that they share their look with, and whether its last anchor asked for any."""

    tracks: list[Track] = field(default_factory=list)
    fronts: dict[int, Front] = field(default_factory=dict)
    first: tuple[int, Anchored] | None = None
    asked: bool = False


class Sequences:
    """The sequences of a run, each populated when the first of its frames is made."""

    def __init__(
        self,
        settings: FrameSettings,
        recipe: MetricRecipe,
        models: Mapping[str, ObjectModel],
        settle: Callable[[PlannedFrame], Anchored],
    ) -> None:
        """Keep what sequences are populated with; `settle` draws the objects of one frame."""
        self._settings = settings
        self._recipe = recipe
        self._models = models
        self._settle = settle
        # The configurations of a frame follow one another, and who trains on frames in memory shuffles them.
        self._spans = functools.lru_cache(maxsize=max(_KEPT, 4 * recipe.scenes))(self._populate)
        self._text = functools.lru_cache(maxsize=4)(self._written)

    @functools.cached_property
    def _places(self) -> Mapping[str, tuple[PlannedSequence, int]]:
        """Sequence of each background, and its number in it."""
        sequences = self._settings.sequences.values()
        return {f.background_id: (s, n) for s in sequences for n, f in enumerate(s.frames)}

    def take(self, frame: PlannedFrame) -> Take | None:
        """Return what a frame shows; None for one without sequence, known camera, or anchor that could be drawn."""
        if (place := self._places.get(frame.background_id)) is None:
            return None
        sequence, n = place
        footage = sequence.footage
        m = sequence.footage.shown(n)
        if frame.configuration is None or not footage.moments[n].known:
            return None
        span = self._spans(sequence.name, frame.configuration)[footage.moments[n].span]
        if span.first is None:
            return None
        anchor, anchored = span.first
        shown = replace(sequence.frames[m], configuration=frame.configuration)
        camera, view = camera_in(anchored.scene.spec, footage, anchor, m, self._pitch_rad(sequence, span, m))
        models = [self._models[t.placed.spec.model] for t in span.tracks]
        objects = objects_in(span.tracks, models, footage, m, camera, view)
        motion_px = self._motion_px(span.tracks, objects, footage, m)
        key = (frame.frame_id, frame.background.id, frame.configuration)
        of_shown = functools.partial(integer_seed, self._settings.seed, shown.key(footage.size_wh).frame_id)
        sensor = anchored.sensor and replace(anchored.sensor, noise_seed=of_shown("sensor"))
        away = len(span.tracks) - len(objects)
        scene = scene_in(anchored.scene, key, objects, camera, view, of_shown("render"), motion_px, away)
        earlier = Earlier(anchored.match, *footage.levels(anchor, m)) if objects else None
        fronts = {t.number: _in_levels(span.fronts[t.number], footage.levels(t.anchor, m)[0]) for t in span.tracks}
        return Take(scene, shown, earlier, sensor, self._text(sequence.name), fronts)

    def shown_in(self, frame: PlannedFrame) -> PlannedFrame | None:
        """Return the frame whose picture a frame of a sequence shows; None for one of no sequence."""
        if (place := self._places.get(frame.background_id)) is None:
            return None
        sequence, n = place
        return sequence.frames[sequence.footage.shown(n)]

    def why_none(self, frame: PlannedFrame) -> str | None:
        """Return the reason why a frame without a take stays without objects; None if it gets objects of its own."""
        if (place := self._places.get(frame.background_id)) is None:
            return None
        sequence, n = place
        moment = sequence.footage.moments[n]
        if not moment.known:
            return "camera_lost"
        # A frame that could not be an anchor says why when it is drawn as one.
        return "no_anchor" if moment.state in ("frozen", "bridged") else None

    def _motion_px(
        self, tracks: Sequence[Track], objects: Sequence[PlacedObject], footage: Footage, n: int
    ) -> tuple[float, float]:
        """Return the motion tail of the objects in view: it stretches to where they come from.

        A tail longer than the smallest of them does not follow from an assumed frame rate.
        """
        sensor = self._recipe.sensor
        if sensor.profile == "off" or not objects:
            return 0.0, 0.0
        in_view = {o.spec.track for o in objects}
        tail_s = find_profile(sensor.profile_at(None)).time_constant_s
        right, down = velocity_px_s([t for t in tracks if t.number in in_view], footage, n)
        smallest = min(float((o.box_xyxy[2:] - o.box_xyxy[:2]).max()) for o in objects)
        if not footage.is_timed and math.hypot(right, down) * tail_s > smallest:
            return 0.0, 0.0
        return -right * tail_s, -down * tail_s

    def _pitch_rad(self, sequence: PlannedSequence, span: _Span, n: int) -> float | None:
        """Return the pitch of a frame; None if it follows from the shift of the picture, as for cameras on a mast."""
        assert span.first is not None
        anchor, anchored = span.first
        before = anchored.scene.spec.camera.pitch_rad
        then, now = (sequence.frames[k].background.capture.pitch_deg for k in (anchor, n))
        if then is not None and now is not None and then != now:
            return before + float(np.radians(now - then))
        return before if all(t.stands for t in span.tracks) else None

    def _populate(self, name: str, configuration: int) -> Mapping[int, _Span]:
        """Return the tracks of a sequence by span."""
        sequence = self._settings.sequences[name]
        footage = sequence.footage
        spans = {m.span: _Span() for m in footage.moments if m.known}
        number = sequence.first_track
        anchors = list[int]()
        stated = sequence.frames[0].background.capture.sequence  # unlike `name`, whatever splits are read
        assert stated is not None
        for n, moment in enumerate(footage.moments):
            lacks = n in sequence.without_place or moment.state == "bridged"
            if not moment.known or footage.shown(n) != n or lacks:
                continue
            span = spans[moment.span]
            before = [a for a in anchors if footage.moments[a].span == moment.span]
            if before and span.tracks and (self._all_once or self._shown(footage, n, before) >= _SHOWN):
                continue
            if before and not span.tracks and (not span.asked or n - before[-1] < _AGAIN or len(before) >= _TRIES):
                continue
            try:
                anchored = self._settle(replace(sequence.frames[n], configuration=configuration))
            except DatasetError:  # reported where the frame itself is made
                continue
            anchors.append(n)
            span.first = span.first or (n, anchored.without_meshes())
            span.asked = bool(anchored.scene.spec.draws.get("wanted"))
            for k, placed in enumerate(anchored.scene.objects):
                middle = (placed.box_xyxy[:2] + placed.box_xyxy[2:]) / 2
                motion = self._motion_of(placed)
                once = motion.kind == "followed" or motion.path is not None
                if before and (once or _are_shown(footage, middle[None], n, before).all()):
                    continue
                if not span.tracks:
                    span.first = n, anchored.without_meshes()
                purpose = f"kind {placed.spec.kind}" if motion.kind == "flock" else f"object {n} {k}"
                rng = stream(self._settings.seed, stated, configuration, "track", purpose)
                placed = _in_air(placed, _air_k(spans, anchored) - anchored.scene.spec.ambient_k)
                assert anchored.scene.spec.view is not None
                model = self._models[placed.spec.model]
                fits = self._fits(placed, anchored.site)
                view = anchored.scene.spec.view
                track = find_track(number, placed, model, motion, view, n, footage, rng, fits)
                span.tracks.append(track)
                span.fronts[number] = Front(anchored.occluders.get(k), track.stays)
                number += 1
        return spans

    @property
    def _all_once(self) -> bool:
        motions = [o.motion for o in self._recipe.objects]
        return all(m is not None and (m.kind == "followed" or m.path is not None) for m in motions)

    def _motion_of(self, placed: PlacedObject) -> Motion:
        return self._recipe.objects[placed.spec.kind].motion or Motion(kind="still")

    def _shown(self, footage: Footage, n: int, anchors: list[int]) -> float:
        """Return the share of a frame that anchors have shown."""
        w, h = footage.size_of(n)
        x, y = np.meshgrid(np.linspace(0.05, 0.95, _POINTS) * w, np.linspace(0.05, 0.95, _POINTS) * h)
        points = np.stack([x.ravel(), y.ravel()], axis=1)
        return float(np.mean(_are_shown(footage, points, n, anchors)))

    def _fits(self, placed: PlacedObject, site: Site) -> Fits:
        """Return whether an object may go to a place; what its anchor does not show is open to it."""
        kind = self._recipe.objects[placed.spec.kind]
        model = self._models[placed.spec.model]
        spec = placed.spec
        request = PlacementRequest(kind, model, spec.params, placed.mesh, spec.scale)
        ground = suitable_ground(self._recipe.placement.surfaces, site, request)
        if ground is None:
            return lambda x, y: True
        camera = placed.camera
        z = spec.position_m[2]
        at_start, _ = camera.project(np.array([spec.position_m]))
        least = _NEARLY * float(ground.at(at_start)[0])

        def fits(x: float, y: float) -> bool:
            xy, depth_m = camera.project(np.array([[x, y, z]]))
            inside = depth_m[0] > 0 and (xy[0] >= 0).all() and (xy[0] < camera.size_wh).all()
            return not inside or float(ground.at(xy)[0]) >= least

        return fits

    def _written(self, name: str) -> NDArray[np.bool_] | None:
        """Return where text and reticle are in a sequence."""
        some = sample_of([f.background for f in self._settings.sequences[name].frames])
        strokes = find_written([Shown(p, None) for p in some if p.shape == some[0].shape]).strokes
        return strokes if strokes.any() else None


def _are_shown(footage: Footage, xy: FloatArray, n: int, anchors: list[int]) -> NDArray[np.bool_]:
    """Return (m,) whether one of some anchors shows what is at (m, 2) positions of a frame."""
    found = np.zeros(len(xy), np.bool_)
    for a in reversed(anchors):  # the last one shows most
        if not found.all():
            places = moved(xy, footage.from_to(n, a))
            found |= ((places >= 0) & (places < footage.size_of(n))).all(axis=1)
    return found


def _in_levels(front: Front, gain: float) -> Front:
    """Return what is in front of a track in a frame that has `gain` times the contrast of its anchor."""
    if front.occluder is None:
        return front
    limit = round(front.occluder.limit_grey * gain, 3)
    soft = round(front.occluder.soft_grey * gain, 3)
    return replace(front, occluder=replace(front.occluder, limit_grey=limit, soft_grey=soft))


def _air_k(spans: Mapping[int, _Span], anchored: Anchored) -> float:
    """Return the air temperature of a sequence: that of its first anchor with objects, by default this one."""
    first = (s.first[1] for s in spans.values() if s.tracks and s.first is not None)
    return next(first, anchored).scene.spec.ambient_k


def _in_air(placed: PlacedObject, warmer_k: float) -> PlacedObject:
    """Return an object whose parts are as much above air that is `warmer_k` as they were above their own."""
    parts = {k: replace(p, temperature_k=p.temperature_k + warmer_k) for k, p in placed.spec.parts.items()}
    return replace(placed, spec=replace(placed.spec, parts=parts))
