"""Sampling of scenes: camera, objects, temperatures; places are redrawn until the object is visible."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from infrablend.assets.model import ObjectModel, PartRange
from infrablend.config.recipe import (
    ArtisticAppearance,
    Count,
    FixedPitch,
    HorizonPitch,
    MetricCamera,
    MetricRecipe,
    MetricSections,
    NoSensor,
    Numbers,
    Object,
    PhysicalEnvironment,
    PhysicalRecipe,
    PhysicalSections,
    RadiometricSections,
    RandomPitch,
    Recipe,
    SkyEnvironment,
)
from infrablend.core.camera import CameraSpec
from infrablend.core.dataset import TimeOfDay
from infrablend.core.mesh import Mesh
from infrablend.core.placed import PlacedObject, PlacedScene, place
from infrablend.core.rng import integer_seed, stream
from infrablend.core.scene import Appearance, ObjectSpec, PartState, SceneSpec, Sun, Weather
from infrablend.core.temperature import Radiometry
from infrablend.errors import ModelError
from infrablend.sampling.by_hand import place_by_hand
from infrablend.sampling.calibration import is_below
from infrablend.sampling.metric import Site, common_headings, place_metric, real_camera
from infrablend.sampling.placement import DrawStatistics, PlacementRequest, Pose, place_as_paper
from infrablend.sampling.shade import in_shade, with_shadow, without_shadow
from infrablend.thermal.sky import dew_point, irradiance, sun_position, time_of

ZERO_C_K = 273.15


@dataclass(frozen=True)
class FrameKey:
    """Key of a frame: together with the run's seed, it determines the random streams.

    Attributes:
        background_id: Id of the image record.
        split: Split of the image record.
        configuration: Number of the scene on this background, from 0.
        size_wh: Size of the background.
        pitch_deg: Depression angle according to the metadata, or None.
        time_of_day: Time of day of the background, or None if unknown.
        sequence: Flight or clip of the background; None if unknown. All its frames have the same sun.
        captured: Date or time of capture, ISO 8601; None if unknown.
        radiometry: What the picture's file states about the air; None if unknown.
        hfov_deg: Horizontal field of view of the background; None if unknown.
        altitude_m: Height of the camera according to the metadata; None if unknown.
        roll_deg: Roll of the background's own camera, for metric placement; None if unknown.
    """

    background_id: str
    split: str
    configuration: int
    size_wh: tuple[int, int]
    pitch_deg: float | None
    time_of_day: TimeOfDay | None = None
    sequence: str | None = None
    captured: str | None = None
    radiometry: Radiometry | None = None
    hfov_deg: float | None = None
    altitude_m: float | None = None
    roll_deg: float | None = None

    @property
    def frame_id(self) -> str:
        """`<split>/<background>_c<configuration>`."""
        return f"{self.split}/{self.background_id}_c{self.configuration}"


PitchFrom = Literal["metadata", "horizon", "recipe", "nothing"]


def sample_scene(
    frame: FrameKey, recipe: Recipe, models: Mapping[str, ObjectModel], seed: int, site: Site | None = None
) -> PlacedScene:
    """Draw the scene of one frame.

    The result depends only on the arguments. Shape, temperature and placement use separate random streams, so that a
    change to one does not alter the others.

    Args:
        frame: Key of the frame.
        recipe: Distributions to draw from.
        models: The recipe's models, by the name used in the recipe.
        seed: The run's seed.
        site: The background; needed by metric placement and to keep clear of ignore regions.
    """
    rng = {s: stream(seed, frame.frame_id, s) for s in ("world", "shape", "heat", "placement")}
    pitch, pitch_from = _pitch_deg(frame, recipe, rng["world"], site)
    # Without a pitch nothing is inserted; the camera of such a frame has no meaning.
    pitch_rad = math.radians(0.0 if pitch is None else pitch)
    unfit = site.unfit if site is not None and isinstance(recipe, MetricSections) else None
    unfit = "no_horizon" if pitch is None else unfit
    air_k = float(rng["world"].uniform(*recipe.environment.air_temperature_c)) + ZERO_C_K
    if isinstance(recipe, RadiometricSections) and frame.radiometry is not None:
        air_k = frame.radiometry.plausible_air_k or air_k
    empty = bool(rng["world"].random() < recipe.empty_share)
    wanted = [] if empty else _wanted(recipe, models, rng["shape"], frame)
    weather = None
    if isinstance(recipe, PhysicalSections | RadiometricSections):
        weather = _weather(frame, recipe, air_k, seed)
    lit = stream(seed, frame.frame_id, "sun") if weather is not None and weather.sun is not None else None
    wanted = _to_hide(frame, recipe, wanted, seed)
    tally = DrawStatistics()
    asked = len(wanted)
    if unfit is not None:
        for _ in wanted:
            tally.leave_out(unfit)
        wanted = []
    c, view = recipe.camera, None
    roll_rad = math.radians(frame.roll_deg or 0.0)
    like = CameraSpec(1.0, pitch_rad, roll_rad, _focal_length_mm(frame, recipe), c.sensor_width_mm, frame.size_wh)
    if isinstance(recipe, MetricSections):
        if site is None:
            raise ValueError(f"{frame.frame_id}: metric placement needs the background")
        camera, view = real_camera(recipe, like, site, stream(seed, frame.frame_id, "camera"))
        headings = common_headings(camera, view, recipe, site, stream(seed, frame.frame_id, "heading"))
        poses = place_metric(camera, view, recipe, wanted, site, rng["placement"], tally, headings=headings)
    else:
        labels, ignored, margin = (site.labels, site.ignored, site.margin) if site else ((), frozenset(), None)
        camera, poses = place_as_paper(like, recipe, wanted, labels, ignored, rng["placement"], tally, margin)
    drawn = poses
    poses, by_hand = place_by_hand(frame.frame_id, recipe, wanted, drawn, camera, view)
    if found := sum(drawn[k] is None for k in by_hand):
        tally.absent["no_place"] -= found
    if weather is not None:
        poses = _before_camera(wanted, poses, camera, tally)
    objects, meshes = [], []
    for number, (item, pose) in enumerate(zip(wanted, poses, strict=True)):
        kind, model = item.kind, item.model
        shaded = False
        if weather is not None and weather.sun is not None and site is not None and pose is not None:
            item, shaded = _shade(item, pose, camera, weather.sun, site)
        # Drawn even if the object found no place, so that the draws of later objects do not depend on that.
        parts = _parts(kind, model.roles(item.params), item.mesh, air_k, rng["heat"], lit)
        if pose is None:
            continue
        meshes.append(item.mesh)
        objects.append(
            ObjectSpec(
                model=kind.model,
                category=kind.category or model.category,
                params=item.params,
                parts=parts,
                position_m=(pose[0], pose[1], pose[2]),
                yaw_rad=pose[3],
                scale=item.scale,
                kind=recipe.objects.index(item.kind),
                visible_aim=item.visible_aim,
                shaded=shaded,
                by_hand=number in by_hand,
            )
        )
    look = recipe.appearance
    # The flat renderer and the turntable show temperatures between these ends in every mode.
    ends = look if isinstance(look, ArtisticAppearance) else ArtisticAppearance()
    spec = SceneSpec(
        frame_id=frame.frame_id,
        background_id=frame.background_id,
        split=frame.split,
        configuration=frame.configuration,
        camera=camera,
        objects=tuple(objects),
        ambient_k=air_k,
        appearance=Appearance(
            mode=look.mode,
            cold_k=air_k - ends.cold_below_air_k,
            hot_k=air_k + ends.hot_above_air_k,
            surroundings_k=air_k - ends.surroundings_below_air_k,
            texture_k=look.texture_k,
        ),
        samples=recipe.samples,
        render_seed=integer_seed(seed, frame.frame_id, "render"),
        draws={
            "wanted": asked,
            "empty_by_recipe": empty,
            "attempts": tally.attempts,
            "first_distance_m": tally.first_distance_m,
            "rejected": dict(sorted(tally.rejected.items())),
            "absent": {reason: count for reason, count in sorted(tally.absent.items()) if count},
            **({"pitch_from": pitch_from} if isinstance(recipe.camera.pitch, HorizonPitch) else {}),
        },
        weather=weather,
        motion_px=_motion(frame, recipe, seed) if objects else (0.0, 0.0),
        view=view,
    )
    return place(spec, meshes)


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
            tally.leave_out("behind_camera")
        kept.append(None if behind else pose)
    return kept


def air_source(frame: FrameKey, recipe: Recipe) -> Literal["metadata", "stated", "drawn"]:
    """Return where the temperature of the air comes from: the picture's file, the recipe, or a draw from its range."""
    if frame.radiometry is not None and frame.radiometry.plausible_air_k is not None:
        return "metadata"
    low, high = recipe.environment.air_temperature_c
    return "stated" if low == high else "drawn"


def _weather(frame: FrameKey, recipe: PhysicalRecipe, air_k: float, seed: int) -> Weather:
    """Draw air, sky and ground of the frame, from a stream of its own.

    With radiometric matching, humidity is that of the picture's file if it states one, and the ground is that of the
    picture: it gets its temperature from there when the objects are in their places.
    """
    rng, e = stream(seed, frame.frame_id, "weather"), recipe.environment
    below = float(rng.uniform(*e.dew_point_below_air_k))
    rng.random()  # unused; keeps the later draws the same as before a quantity was removed
    clear, cover, base = (float(v) for v in rng.random(3))
    day = frame.time_of_day == "day"
    if isinstance(e, PhysicalEnvironment):
        ground_k = air_k + float(rng.uniform(*(e.ground_above_air_day_k if day else e.ground_above_air_night_k)))
    else:
        ground_k = air_k
        if frame.radiometry is not None and (humidity := frame.radiometry.plausible_humidity) is not None:
            below = air_k - dew_point(air_k, humidity)
    sun = None
    if day:
        # The sun and the clouds are those of the whole sequence.
        together = stream(seed, "sun", frame.sequence or frame.captured or frame.frame_id)
        clear, cover, share, turn = (float(v) for v in together.random(4))
        sun = _sun(frame, e, share, turn, 0.0 if clear < e.clear_share else cover)
    return Weather(
        air_k=air_k,
        dew_point_k=air_k - below,
        cloud=0.0 if clear < e.clear_share else cover,
        cloud_base_k=air_k - (5 + 5 * base),
        ground_k=ground_k,
        sun=sun,
    )


def _sun(frame: FrameKey, environment: SkyEnvironment, share: float, turn: float, cloud: float) -> Sun:
    """Return the sun over a frame.

    Its azimuth is relative to the camera's heading, which no dataset states, and is therefore always drawn.

    Args:
        frame: Key of the frame.
        environment: Range of the elevation, or the place.
        share: Drawn number in [0, 1) that sets the elevation within its range.
        turn: Drawn number in [0, 1) that sets the azimuth.
        cloud: Share of the sky that clouds cover.
    """
    low, high = environment.sun_elevation_deg
    elevation = math.radians(low + (high - low) * share)
    source: Literal["computed", "drawn", "contradicted"] = "drawn"
    when, place = time_of(frame.captured), environment.place
    if place is not None and when is not None:
        _, computed = sun_position(when, place.latitude_deg, place.longitude_deg)
        if computed > 0:
            elevation, source = computed, "computed"
        else:
            source = "contradicted"
    direct, diffuse = irradiance(elevation, cloud)
    return Sun(2 * math.pi * turn, elevation, direct, diffuse, source)


def _shade(
    item: PlacementRequest, pose: Pose, camera: CameraSpec, sun: Sun, site: Site
) -> tuple[PlacementRequest, bool]:
    """Return a placed object with any thermal shadow of its own, and whether it stands in the shade itself."""
    if not item.model.stands:
        return item, False
    if in_shade(camera, item.in_world(pose), site):
        return item, True
    return with_shadow(item, pose, camera, sun, site.labels), False


def _motion(frame: FrameKey, recipe: Recipe, seed: int) -> tuple[float, float]:
    """Draw length and direction of the motion tail, in pixels, from a stream of its own."""
    length, turn = stream(seed, frame.frame_id, "motion").random(2)
    if isinstance(recipe.sensor, NoSensor):
        return 0.0, 0.0
    low, high = recipe.sensor.motion_px
    if high == 0:
        return 0.0, 0.0
    length_px = low + (high - low) * float(length)
    return length_px * math.cos(2 * math.pi * turn), length_px * math.sin(2 * math.pi * turn)


def move_objects(
    scene: PlacedScene,
    numbers: Collection[int],
    recipe: MetricRecipe,
    models: Mapping[str, ObjectModel],
    seed: int,
    site: Site,
    attempt: int,
) -> PlacedScene:
    """Return the scene with some of its objects at other places, drawn from a stream of their own.

    Shapes and temperatures stay; the other objects stay where they are. An object without another place is left out.

    Args:
        scene: A scene of metric placement.
        numbers: Objects to move.
        recipe: The scene's recipe.
        models: The recipe's models, by the name used in the recipe.
        seed: The run's seed.
        site: The background.
        attempt: Number of the attempt, from 1.
    """
    spec, view = scene.spec, scene.spec.view
    assert view is not None
    sun = None if spec.weather is None else spec.weather.sun
    rng = stream(seed, spec.frame_id, f"placement-{attempt}")
    moved = sorted(numbers)
    requests, occupied = [], []
    for k, placed in enumerate(scene.objects):
        o = placed.spec
        kind = recipe.objects[o.kind]
        request = PlacementRequest(kind, models[o.model], o.params, placed.mesh, o.scale, o.visible_aim)
        if k in numbers:
            requests.append(without_shadow(request))
        else:
            occupied.append((request, (*o.position_m, o.yaw_rad)))
    tally = DrawStatistics()
    headings = common_headings(spec.camera, view, recipe, site, stream(seed, spec.frame_id, "heading"))
    drawn = place_metric(spec.camera, view, recipe, requests, site, rng, tally, occupied, headings)
    poses = dict(zip(moved, drawn, strict=True))
    objects = []
    for k, placed in enumerate(scene.objects):
        if k not in poses:
            objects.append(placed)  # with the geometry that it has computed already
            continue
        pose = poses[k]
        if pose is None:
            continue
        item, shaded = requests[moved.index(k)], False
        parts = placed.spec.parts
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
        objects.append(PlacedObject(moved_to, item.mesh, spec.camera, sun))
    draws = dict(spec.draws)
    draws["attempts"] += tally.attempts
    draws["moved"] = draws.get("moved", 0) + len(moved)
    for name, counts in (("rejected", tally.rejected), ("absent", tally.absent)):
        merged = Counter(draws[name]) + Counter(counts)
        draws[name] = dict(sorted(merged.items()))
    return PlacedScene(replace(spec, objects=tuple(o.spec for o in objects), draws=draws), tuple(objects))


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
        if part not in models[kind.model].parts
    ]
    if wrong:
        raise ModelError(f"recipe {recipe.name}: " + "; ".join(wrong))


def _focal_length_mm(frame: FrameKey, recipe: Recipe) -> float:
    """Return the focal length of the camera: that of the background's own field of view, or the recipe's."""
    c = recipe.camera
    if not isinstance(c, MetricCamera) or c.field_of_view == "recipe" or frame.hfov_deg is None:
        return c.focal_length_mm
    return c.sensor_width_mm / 2 / math.tan(math.radians(frame.hfov_deg) / 2)


def _pitch_deg(
    frame: FrameKey, recipe: Recipe, rng: np.random.Generator, site: Site | None
) -> tuple[float | None, PitchFrom]:
    """Return the camera's pitch, degrees, and where it comes from; None if no horizon is known, found or stated."""
    pitch = recipe.camera.pitch
    drawn = float(rng.random())  # always drawn, so that other draws do not depend on the choice
    if isinstance(pitch, FixedPitch):
        return pitch.fixed_deg, "recipe"
    if isinstance(pitch, RandomPitch):
        low, high = pitch.random_deg
        return float(low + (high - low) * drawn), "recipe"
    if isinstance(pitch, HorizonPitch) and pitch.from_horizon and frame.pitch_deg is None:
        if site is None:
            raise ValueError(f"{frame.frame_id}: the horizon is found in the background, which is missing")
        c = recipe.camera
        focal_px = _focal_length_mm(frame, recipe) / c.sensor_width_mm * frame.size_wh[0]
        half_px = frame.size_wh[1] / 2
        if site.horizon_px is not None:
            return math.degrees(math.atan((half_px - site.horizon_px) / focal_px)), "horizon"
        if pitch.else_deg is None:
            return None, "nothing"
        low, high = pitch.else_deg
        if site.shows_sky:
            # The picture shows the sky alone, so the horizon is below its lower edge.
            high = max(low, min(high, -math.degrees(math.atan(half_px / focal_px))))
        return float(low + (high - low) * drawn), "recipe"
    if frame.pitch_deg is None:
        raise ValueError(f"{frame.frame_id}: no camera pitch; the plan must have left this background out")
    return frame.pitch_deg, "metadata"


def _wanted(
    recipe: Recipe, models: Mapping[str, ObjectModel], rng: np.random.Generator, frame: FrameKey
) -> list[PlacementRequest]:
    """Draw number, shape and size of the objects of a frame."""
    time_of_day = frame.time_of_day
    result = []
    for kind in recipe.objects:
        options = kind.options
        # The artistic look stays as the paper tuned it, at any time of day.
        physical = recipe.appearance.mode == "physical"
        if physical and time_of_day is not None and "time_of_day" in models[kind.model].options:
            options = {"time_of_day": time_of_day, **options}
        if isinstance(kind.count, Count):
            numbers = _numbers(kind.count, frame)
            weights = np.array(numbers.weights or [1.0] * len(numbers.values))
            count = int(rng.choice(np.array(numbers.values), p=weights / weights.sum()))
        else:
            count = kind.count
        for _ in range(count):
            params = models[kind.model].sample(rng, options)
            low, high = kind.scale
            scale = math.exp(rng.uniform(math.log(low), math.log(high)))
            result.append(PlacementRequest(kind, models[kind.model], params, models[kind.model].build(params), scale))
    return result


def mean_objects(recipe: Recipe, frame: FrameKey) -> float:
    """Return how many objects a recipe asks for in a frame on average, before places are looked for."""
    total = 0.0
    for kind in recipe.objects:
        if isinstance(kind.count, Count):
            numbers = _numbers(kind.count, frame)
            total += float(np.average(numbers.values, weights=numbers.weights))
        else:
            total += kind.count
    return (1 - recipe.empty_share) * total


def _numbers(count: Count, frame: FrameKey) -> Numbers:
    """Return the numbers of objects for the time of day, the height and the angle of a picture."""
    for numbers in count.by_flight:
        if (
            numbers.time_of_day in (None, frame.time_of_day)
            and is_below(frame.altitude_m, numbers.below_m)
            and is_below(frame.pitch_deg, numbers.below_pitch_deg)
        ):
            return numbers
    return count


def _to_hide(frame: FrameKey, recipe: Recipe, wanted: Sequence[PlacementRequest], seed: int) -> list[PlacementRequest]:
    """Draw which objects are to be partly hidden, and their visible share, from a stream of its own."""
    rng, o = stream(seed, frame.frame_id, "occlusion"), recipe.occlusion
    low, high = o.visible
    result = []
    for item in wanted:
        chosen, share = (float(v) for v in rng.random(2))
        aim = round(low + (high - low) * share, 4) if chosen < o.share else None
        result.append(replace(item, visible_aim=aim))
    return result


def _parts(
    kind: Object,
    roles: Mapping[str, PartRange],
    mesh: Mesh,
    air_k: float,
    rng: np.random.Generator,
    lit: np.random.Generator | None,
) -> dict[str, PartState]:
    """Draw the state of every part in the mesh.

    One draw sets the temperature level of the whole object; a second one per part varies it.

    Args:
        kind: The recipe's entry, which may set temperatures and emissivities.
        roles: Thermal roles of the parts.
        mesh: The object's mesh.
        air_k: Air temperature.
        rng: Draws temperatures and emissivities.
        lit: Draws the absorptivity of each surface; None in scenes without a sun.
    """
    heat = rng.random()
    surfaces = sorted({r.sun.surface for r in roles.values() if r.sun is not None}) if lit is not None else []
    absorbs = {surface: float(lit.random()) for surface in surfaces if lit is not None}
    parts = {}
    for name in sorted(roles):
        role = roles[name]
        own, surface = rng.random(2)
        override = kind.parts.get(name)
        sun = role.sun if surfaces else None
        delta = role.delta_t_k if sun is None else sun.shade_k
        if override and override.delta_t_k:
            # What a recipe states includes the sun.
            delta, sun = override.delta_t_k, None
        emissivity = override.emissivity if override and override.emissivity else role.emissivity
        share = 0.7 * heat + 0.3 * own
        if name in mesh.part_names:
            parts[name] = PartState(
                temperature_k=air_k + delta[0] + (delta[1] - delta[0]) * share,
                emissivity=emissivity[0] + (emissivity[1] - emissivity[0]) * surface,
                label=role.label,
                ior=role.ior,
                roughness=role.roughness,
                metal=role.metal,
                opacity=role.opacity,
                sun_k=0.0 if sun is None else sun.rise_k[0] + (sun.rise_k[1] - sun.rise_k[0]) * absorbs[sun.surface],
                glow=role.glow,
            )
    return parts
