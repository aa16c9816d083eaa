"""Sampling of scenes: camera, objects, temperatures; places are redrawn until the object is visible."""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from infrablend.assets.model import ObjectModel, PartRange, Range
from infrablend.config.recipe import ALL_PARTS, Object, Recipe
from infrablend.core.camera import CameraSpec
from infrablend.core.mesh import Mesh
from infrablend.core.render import PlacedObject, PlacedScene, place
from infrablend.core.rng import integer_seed, stream
from infrablend.core.scene import Appearance, ObjectSpec, PartState, SceneSpec, Sun, Weather
from infrablend.errors import ModelError
from infrablend.sampling.by_hand import place_by_hand
from infrablend.sampling.metric import MetricPlacer
from infrablend.sampling.paper import PaperPlacer
from infrablend.sampling.placement import DrawStatistics, PlacementRequest, Pose
from infrablend.sampling.placer import Placer, Streams
from infrablend.sampling.shade import in_shade, with_shadow, without_shadow
from infrablend.sampling.site import FrameKey, Site
from infrablend.sampling.weather import draw_air_k, draw_weather, knows_air
from infrablend.thermal.daytime import SKY_COOLING_SHARE
from infrablend.thermal.radiometry import ZERO_C_K

COOL_AIR_K = ZERO_C_K + 12
"""Air up to which bodies are as much warmer as their models say."""

PitchFrom = Literal["metadata", "horizon", "recipe", "nothing"]

_PLACERS: Mapping[str, Callable[[Any], Placer]] = {"paper": PaperPlacer, "metric": MetricPlacer}


def sample_scene(
    frame: FrameKey, recipe: Recipe, models: Mapping[str, ObjectModel], seed: int, site: Site | None = None
) -> PlacedScene:
    """Draw the scene of one frame; see `RecipeSampler`."""
    return RecipeSampler(recipe, models, seed).sample(frame, site)


class RecipeSampler:
    """Draws scenes from the distributions of a recipe.

    A scene depends only on the recipe, its models, the seed, the frame's key and the background. Shape, temperature and
    placement use separate random streams, so that a change to one does not alter the others.
    """

    def __init__(self, recipe: Recipe, models: Mapping[str, ObjectModel], seed: int) -> None:
        """Choose the placement."""
        self._recipe = recipe
        self._models = models
        self._seed = seed
        self.placer = _PLACERS[recipe.placement.mode](recipe)

    def _streams(self, frame_id: str) -> Streams:
        return functools.partial(stream, self._seed, frame_id)

    def sample(self, frame: FrameKey, site: Site | None = None) -> PlacedScene:
        """Draw the scene of one frame.

        Metric placement needs the background, as does keeping clear of ignore regions.
        """
        recipe = self._recipe
        streams = self._streams(frame.frame_id)
        tally = DrawStatistics()
        world = streams("world")
        pitch_deg, pitch_from = _pitch_deg(frame, recipe, world, site)
        air_k = draw_air_k(frame, recipe.environment, world)
        sky = recipe.environment.sky
        weather = None if sky is None else draw_weather(frame, sky, air_k, self._seed)
        empty = bool(world.random() < recipe.empty_share)

        asked = [] if empty else self._objects(frame, streams)
        # Without a pitch nothing is inserted; the camera of such a frame has no meaning.
        unfit = "no_horizon" if pitch_deg is None else site.unfit if site is not None else None
        wanted = asked if unfit is None else []
        if unfit is not None:
            tally.left_out.update((item.number, unfit) for item in asked)
        like = _camera_of(frame, recipe, 0.0 if pitch_deg is None else pitch_deg)
        found = self.placer.arrange(like, wanted, site, streams, tally)
        poses, by_hand = place_by_hand(frame.frame_id, recipe, wanted, found.poses, found.camera, found.view)
        for number in by_hand:
            tally.left_out.pop(number, None)
        if weather is not None:
            poses = _before_camera(wanted, poses, found.camera, tally)

        light = _Light(air_k, weather, found.camera, site, streams, knows_air(recipe.environment))
        objects, meshes = self._in_place(wanted, poses, by_hand, light)
        ends = recipe.appearance.ends
        spec = SceneSpec(
            frame_id=frame.frame_id,
            background_id=frame.background_id,
            split=frame.split,
            configuration=frame.configuration,
            camera=found.camera,
            objects=tuple(objects),
            ambient_k=air_k,
            appearance=Appearance(
                cold_k=air_k - ends.cold_below_air_k,
                hot_k=air_k + ends.hot_above_air_k,
                surroundings_k=air_k - ends.surroundings_below_air_k,
                texture_k=recipe.appearance.texture_k,
            ),
            samples=recipe.samples,
            render_seed=integer_seed(self._seed, frame.frame_id, "render"),
            draws={
                "wanted": len(asked),
                "wanted_by_kind": dict(sorted(Counter(str(recipe.objects.index(r.kind)) for r in asked).items())),
                "empty_by_recipe": empty,
                **tally.to_json(),
                **({} if recipe.camera.horizon is None else {"pitch_from": pitch_from}),
            },
            weather=weather,
            motion_px=_motion(recipe, streams("motion")) if objects else (0.0, 0.0),
            view=found.view,
            left_out=tally.left_out,
        )
        return place(spec, meshes)

    def _objects(self, frame: FrameKey, streams: Streams) -> list[PlacementRequest]:
        """Draw number, shape and size of the objects of a frame, and which of them are to be partly hidden."""
        recipe = self._recipe
        rng = streams("shape")
        drawn = []
        for kind in recipe.objects:
            model = self._models[kind.model]
            options = kind.options
            # The artistic look stays as the paper tuned it, at any time of day.
            by_time = recipe.appearance.follows_time_of_day and "time_of_day" in model.options
            if by_time and frame.capture.time_of_day is not None:
                options = {"time_of_day": frame.capture.time_of_day, **options}
            for _ in range(kind.draw_count(rng, frame.capture)):
                params = model.sample(rng, options)
                low, high = kind.scale
                scale = math.exp(rng.uniform(math.log(low), math.log(high)))
                drawn.append(PlacementRequest(kind, model, params, model.build(params), scale))
        rng = streams("occlusion")
        low, high = recipe.occlusion.visible
        wanted = []
        for number, item in enumerate(drawn):
            chosen, share = (float(v) for v in rng.random(2))
            aim = round(low + (high - low) * share, 4) if chosen < recipe.occlusion.share else None
            wanted.append(replace(item, visible_aim=aim, number=number))
        return wanted

    def _in_place(
        self,
        wanted: Sequence[PlacementRequest],
        poses: Sequence[Pose | None],
        by_hand: Collection[int],
        light: _Light,
    ) -> tuple[list[ObjectSpec], list[Mesh]]:
        """Draw the temperatures of a frame's objects, and return those that have a place, with their meshes."""
        objects = []
        meshes = []
        for number, (item, pose) in enumerate(zip(wanted, poses, strict=True)):
            kind = item.kind
            model = item.model
            item, shaded = (item, False) if pose is None else light.fall_on(item, pose)
            # Drawn even if the object found no place, so that the draws of later objects do not depend on that.
            parts = light.parts(kind, model.roles(item.params), item.mesh, model.skin_limit_c)
            if pose is None:
                continue
            meshes.append(item.mesh)
            objects.append(
                ObjectSpec(
                    model=kind.model,
                    category=kind.category or model.category,
                    params=item.params,
                    parts=parts,
                    position_m=pose[:3],
                    yaw_rad=pose[3],
                    scale=item.scale,
                    kind=self._recipe.objects.index(kind),
                    visible_aim=item.visible_aim,
                    shaded=shaded,
                    by_hand=number in by_hand,
                    number=number,
                )
            )
        return objects, meshes

    def move(self, scene: PlacedScene, numbers: Collection[int], site: Site, attempt: int) -> PlacedScene | None:
        """Return the scene with some of its objects at other places, drawn from a stream of their own.

        Shapes and temperatures stay; the other objects stay where they are. An object without another place is left
        out. None if the placement does not move objects (again).
        """
        spec = scene.spec
        moved = sorted(numbers)
        tally = DrawStatistics()
        requests = []
        occupied = []
        for k, placed in enumerate(scene.objects):
            o = placed.spec
            kind = self._recipe.objects[o.kind]
            model = self._models[o.model]
            request = PlacementRequest(kind, model, o.params, placed.mesh, o.scale, o.visible_aim, o.number or 0)
            if k in numbers:
                requests.append(without_shadow(request))
            else:
                occupied.append((request, (*o.position_m, o.yaw_rad)))
        streams = self._streams(spec.frame_id)
        poses = self.placer.arrange_again(spec, requests, occupied, site, attempt, streams, tally)
        if poses is None:
            return None
        found = dict(zip(moved, zip(requests, poses, strict=True), strict=True))
        objects = []
        for k, placed in enumerate(scene.objects):
            if k not in found:
                objects.append(placed)  # with the geometry that it has computed already
                continue
            item, pose = found[k]
            if pose is not None:
                objects.append(_moved(placed, item, pose, spec, site))
        draws = dict(spec.draws)
        draws["attempts"] += tally.attempts
        draws["moved"] = draws.get("moved", 0) + len(moved)
        for name, counts in (("rejected", tally.rejected), ("absent", tally.absent)):
            merged = Counter(draws[name]) + counts
            draws[name] = dict(sorted(merged.items()))
        left_out = {**spec.left_out, **tally.left_out}
        arranged = replace(spec, objects=tuple(o.spec for o in objects), draws=draws, left_out=left_out)
        return PlacedScene(arranged, tuple(objects))


def _moved(placed: PlacedObject, item: PlacementRequest, pose: Pose, spec: SceneSpec, site: Site) -> PlacedObject:
    """Return an object at another place, with the shadow that it throws there."""
    parts = placed.spec.parts
    shaded = False
    sun = None if spec.weather is None else spec.weather.sun
    if sun is not None:
        shadowed, shaded = _shade(item, pose, spec.camera, sun, site)
        # An object that threw no shadow at its first place has no state for one.
        item = shadowed if set(shadowed.mesh.part_names) <= set(parts) else item
    moved_to = replace(
        placed.spec,
        params=item.params,
        parts={name: parts[name] for name in parts if name in item.mesh.part_names},
        position_m=pose[:3],
        yaw_rad=pose[3],
        shaded=shaded,
    )
    return PlacedObject(moved_to, item.mesh, spec.camera, sun)


class _Light:
    """Air and sun of a frame, and how they warm its objects, one after the other."""

    def __init__(
        self,
        air_k: float,
        weather: Weather | None,
        camera: CameraSpec,
        site: Site | None,
        streams: Streams,
        knows_air: bool,
    ) -> None:
        """Start the streams of temperatures and emissivities, and in the sun that of surfaces' absorptivities."""
        self._air_k = air_k
        self._warm = knows_air and air_k > COOL_AIR_K
        self._camera = camera
        self._site = site
        self._sun = None if weather is None else weather.sun
        self._sun_kw_m2 = 0.0 if self._sun is None else (self._sun.direct_w_m2 + self._sun.diffuse_w_m2) / 1000
        self._overcast = weather is not None and weather.overcast
        self._heat = streams("heat")
        self._lit = None if self._sun is None else streams("sun")
        self._shift = streams("shift")

    def fall_on(self, item: PlacementRequest, pose: Pose) -> tuple[PlacementRequest, bool]:
        """Return an object with any thermal shadow of its own, and whether it stands in the shade itself."""
        if self._sun is None or self._site is None:
            return item, False
        return _shade(item, pose, self._camera, self._sun, self._site)

    def parts(
        self, kind: Object, roles: Mapping[str, PartRange], mesh: Mesh, skin_limit_c: float | None
    ) -> dict[str, PartState]:
        """Draw the state of every part in an object's mesh.

        One draw sets the temperature level of the whole object; a second one per part varies it.
        """
        limit_k = ZERO_C_K + skin_limit_c if self._warm and skin_limit_c is not None else None
        heat = self._heat.random()
        low, high = kind.delta_t_k
        shift_k = low + (high - low) * float(self._shift.random())
        absorbs: dict[str, float] = {}
        if self._lit is not None:
            surfaces = sorted({r.sun.surface for r in roles.values() if r.sun is not None})
            absorbs = {surface: float(self._lit.random()) for surface in surfaces}
        parts = {}
        for name in sorted(roles):
            role = roles[name]
            own, surface = self._heat.random(2)
            override = kind.part_override(name, ground=role.ground)
            sun = role.sun if absorbs else None
            rise_k = 0.0
            delta = role.delta_t_k if sun is None else sun.shade_k
            if self._overcast:
                delta = under_clouds(role, lit=sun is not None)
            if limit_k is not None:
                delta = in_warm_air(delta, self._air_k, limit_k)
            if override and override.delta_t_k:
                # What a recipe states includes the sun.
                delta = override.delta_t_k
                sun = None
            if sun is not None:
                rise_k = sun.rise_k[0] + (sun.rise_k[1] - sun.rise_k[0]) * absorbs[sun.surface]
            emissivity = override.emissivity if override and override.emissivity else role.emissivity
            share = 0.7 * heat + 0.3 * own
            if name in mesh.part_names:
                own_shift_k = 0.0 if role.ground else shift_k
                temperature_k = self._air_k + delta[0] + (delta[1] - delta[0]) * share + own_shift_k
                if limit_k is not None and role.kind == "skin" and not (override and override.delta_t_k):
                    temperature_k = min(temperature_k, limit_k)
                    rise_k = min(rise_k, (limit_k - temperature_k) / max(self._sun_kw_m2, 1e-3))
                parts[name] = PartState(
                    temperature_k=temperature_k,
                    emissivity=emissivity[0] + (emissivity[1] - emissivity[0]) * surface,
                    label=role.label,
                    ior=role.ior,
                    roughness=role.roughness,
                    metal=role.metal,
                    opacity=role.opacity,
                    sun_k=rise_k,
                    glow=role.glow,
                )
        return parts


def _shade(
    item: PlacementRequest, pose: Pose, camera: CameraSpec, sun: Sun, site: Site
) -> tuple[PlacementRequest, bool]:
    """Return a placed object with any thermal shadow of its own, and whether it stands in the shade itself."""
    if not item.model.stands or sun.direct_w_m2 == 0:
        return item, False
    if in_shade(camera, item.in_world(pose), site):
        return item, True
    return with_shadow(item, pose, camera, sun, site.labels), False


def under_clouds(role: PartRange, *, lit: bool) -> Range:
    """Return a part's range above the air under a closed cloud cover, which is nearly as warm as the air itself.

    Parts that a clear sky cools are hardly colder than the air, and ground that objects shield from it hardly warmer
    than the rest. `lit` is whether diffuse sunlight warms the part in addition.
    """
    delta_k = role.delta_t_k
    if lit and role.sun is not None:
        delta_k = role.sun.overcast_k or role.sun.shade_k
    low, high = (SKY_COOLING_SHARE * v if v < 0 or role.sheltered else v for v in delta_k)
    return low, high


def in_warm_air(delta_k: Range, air_k: float, limit_k: float) -> Range:
    """Return by how much a part of a living body is warmer than air above `COOL_AIR_K`, for which its range holds.

    Heat flows by the difference from the skin to the air, which goes to nothing as the air nears the skin's limit.
    """
    share = max(0.0, (limit_k - air_k) / (limit_k - COOL_AIR_K))
    low, high = (share * v if v > 0 else v for v in delta_k)
    return low, high


def _before_camera(
    wanted: Sequence[PlacementRequest], poses: Sequence[Pose | None], camera: CameraSpec, tally: DrawStatistics
) -> list[Pose | None]:
    """Return the poses without those of objects that are wholly behind the camera: they have no place in the picture.

    The look of an object depends on the picture around it. Placement rejects such poses unless the recipe keeps all.
    """
    kept: list[Pose | None] = []
    for item, pose in zip(wanted, poses, strict=True):
        behind = pose is not None and not (camera.project(item.in_world(pose))[1] > 0).any()
        if behind:
            tally.left_out[item.number] = "behind_camera"
        kept.append(None if behind else pose)
    return kept


def _camera_of(frame: FrameKey, recipe: Recipe, pitch_deg: float) -> CameraSpec:
    """Return the camera of a frame as far as it is known; placement draws the rest."""
    c = recipe.camera
    roll_rad = math.radians(frame.capture.roll_deg or 0.0)
    return CameraSpec(
        1.0, math.radians(pitch_deg), roll_rad, c.lens_mm(frame.capture.hfov_deg), c.sensor_width_mm, frame.size_wh
    )


def _pitch_deg(
    frame: FrameKey, recipe: Recipe, rng: np.random.Generator, site: Site | None
) -> tuple[float | None, PitchFrom]:
    """Return the camera's pitch, degrees, and where it comes from; None if no horizon is known, found or stated."""
    c = recipe.camera
    drawn = float(rng.random())  # always drawn, so that other draws do not depend on the choice
    if c.stated_pitch_deg is not None:
        low, high = c.stated_pitch_deg
        return low + (high - low) * drawn, "recipe"
    if frame.capture.pitch_deg is not None:
        return frame.capture.pitch_deg, "metadata"
    if c.horizon is None:
        raise ValueError(f"{frame.frame_id}: no camera pitch; the plan must have left this background out")
    if site is None:
        raise ValueError(f"{frame.frame_id}: the horizon is found in the background, which is missing")
    focal_px = c.lens_mm(frame.capture.hfov_deg) / c.sensor_width_mm * frame.size_wh[0]
    half_px = frame.size_wh[1] / 2
    if site.horizon_px is not None:
        return math.degrees(math.atan((half_px - site.horizon_px) / focal_px)), "horizon"
    if c.horizon.else_deg is None:
        return None, "nothing"
    low, high = c.horizon.else_deg
    if site.shows_sky:
        # The picture shows the sky alone, so the horizon is below its lower edge.
        high = max(low, min(high, -math.degrees(math.atan(half_px / focal_px))))
    return float(low + (high - low) * drawn), "recipe"


def _motion(recipe: Recipe, rng: np.random.Generator) -> tuple[float, float]:
    """Draw length and direction of the motion tail, and return it as (right, down) in pixels."""
    length, turn = rng.random(2)
    low, high = recipe.sensor.motion_px
    if high == 0:
        return 0.0, 0.0
    length_px = low + (high - low) * float(length)
    return length_px * math.cos(2 * math.pi * turn), length_px * math.sin(2 * math.pi * turn)


def rebuild_scene(spec: SceneSpec, models: Mapping[str, ObjectModel]) -> PlacedScene:
    """Rebuild the geometry of a scene that was read from its JSON."""
    return place(spec, [models[o.model].build(o.params) for o in spec.objects])


def require_parts(recipe: Recipe, models: Mapping[str, ObjectModel]) -> None:
    """Check that the recipe overrides only parts that its models have.

    Raises:
        ModelError: Some parts do not exist; the message names them.
    """
    wrong = [
        f"objects.{i}.parts.{part}: {kind.model} has no such part; it has {', '.join(sorted(models[kind.model].parts))}"
        for i, kind in enumerate(recipe.objects)
        for part in kind.parts
        if part not in {*models[kind.model].parts, ALL_PARTS}
    ]
    if wrong:
        raise ModelError(f"recipe {recipe.name}: " + "; ".join(wrong))


def mean_objects(recipe: Recipe, frame: FrameKey) -> dict[str, float]:
    """Return how many objects of each model a recipe asks for in a frame on average, before places are looked for."""
    found = dict.fromkeys((kind.model for kind in recipe.objects), 0.0)
    for kind in recipe.objects:
        found[kind.model] += (1 - recipe.empty_share) * kind.mean_count(frame.capture)
    return found
