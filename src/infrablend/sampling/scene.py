"""Drawing a scene: camera, objects, temperatures, and redrawing until the object can be seen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.assets.model import ObjectModel, PartRange
from infrablend.config.recipe import Count, FixedPitch, Object, RandomPitch, Recipe
from infrablend.core.boxes import clip_triangles_to_rect
from infrablend.core.camera import CameraSpec, object_to_world
from infrablend.core.dataset import TimeOfDay
from infrablend.core.mesh import FloatArray, IntArray, Mesh
from infrablend.core.raster import inside_fraction, project_triangles
from infrablend.core.rng import integer_seed, stream
from infrablend.core.scene import Appearance, ObjectSpec, PartState, SceneSpec, Weather
from infrablend.errors import ModelError

ZERO_C_K = 273.15


@dataclass(frozen=True, eq=False)
class SampledScene:
    """A scene and the geometry of its objects (object coordinates, unscaled), in the same order."""

    spec: SceneSpec
    meshes: tuple[Mesh, ...]


@dataclass(frozen=True)
class FrameKey:
    """Which frame: what its random streams depend on, beside the run's seed.

    Attributes:
        background_id: Id of the image record.
        split: Of the image record.
        configuration: Number of the scene on this background, from 0.
        size_wh: Size of the background.
        pitch_deg: Depression angle the metadata gives, or None.
        time_of_day: Of the background, or None if unknown.
    """

    background_id: str
    split: str
    configuration: int
    size_wh: tuple[int, int]
    pitch_deg: float | None
    time_of_day: TimeOfDay | None = None

    @property
    def frame_id(self) -> str:
        """`<split>/<background>_c<configuration>`."""
        return f"{self.split}/{self.background_id}_c{self.configuration}"


@dataclass
class _Tally:
    """What happened while drawing one frame; goes into the scene's `draws`."""

    attempts: int = 0
    first_distance_m: float | None = None
    rejected: dict[str, int] = field(default_factory=dict)
    absent: dict[str, int] = field(default_factory=dict)


def sample_scene(frame: FrameKey, recipe: Recipe, models: Mapping[str, ObjectModel], seed: int) -> SampledScene:
    """The scene of one frame.

    Depends on (seed, frame id) and the recipe alone. Shape and temperature come from other streams than placement,
    so that a change of one leaves the others as they were.

    Args:
        frame: Which frame.
        recipe: What to draw.
        models: Every model the recipe names, by that name.
        seed: The run's seed.
    """
    rng = {s: stream(seed, frame.frame_id, s) for s in ("world", "shape", "heat", "placement")}
    pitch_rad = math.radians(_pitch_deg(frame, recipe, rng["world"]))
    air_k = float(rng["world"].uniform(*recipe.environment.air_temperature_c)) + ZERO_C_K
    empty = bool(rng["world"].random() < recipe.empty_share)
    wanted = [] if empty else _wanted(recipe, models, rng["shape"], frame.time_of_day)
    tally = _Tally()

    camera, poses = _place(frame, recipe, models, pitch_rad, wanted, rng["placement"], tally)
    objects, meshes = [], []
    for (kind, params, mesh, scale), pose in zip(wanted, poses, strict=True):
        model = models[kind.model]
        # Drawn also for an object that found no place: the next object's numbers must not depend on it.
        parts = _parts(kind, model.roles(params), mesh, air_k, rng["heat"])
        if pose is None:
            continue
        meshes.append(mesh)
        objects.append(
            ObjectSpec(
                model=kind.model,
                category=kind.category or model.category,
                params=params,
                parts=parts,
                position_m=(pose[0], pose[1], pose[2]),
                yaw_rad=pose[3],
                scale=scale,
            )
        )
    look = recipe.appearance
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
            cold_k=air_k - look.cold_below_air_k,
            hot_k=air_k + look.hot_above_air_k,
            surroundings_k=air_k - look.surroundings_below_air_k,
            texture_k=look.texture_k,
        ),
        samples=recipe.samples,
        render_seed=integer_seed(seed, frame.frame_id, "render"),
        draws={
            "wanted": len(wanted),
            "empty_by_recipe": empty,
            "attempts": tally.attempts,
            "first_distance_m": tally.first_distance_m,
            "rejected": dict(sorted(tally.rejected.items())),
            "absent": dict(sorted(tally.absent.items())),
        },
        weather=_weather(frame, recipe, air_k, seed) if look.mode == "physical" else None,
        motion_px=_motion(frame, recipe, seed) if objects else (0.0, 0.0),
    )
    return SampledScene(spec, tuple(meshes))


def _weather(frame: FrameKey, recipe: Recipe, air_k: float, seed: int) -> Weather:
    """What the frame's surfaces stand in and mirror; from a stream of its own."""
    rng, e = stream(seed, frame.frame_id, "weather"), recipe.environment
    below, wind = (float(rng.uniform(*r)) for r in (e.dew_point_below_air_k, e.wind_m_s))
    clear, cover, base = (float(v) for v in rng.random(3))
    ground = e.ground_above_air_day_k if frame.time_of_day == "day" else e.ground_above_air_night_k
    return Weather(
        air_k=air_k,
        dew_point_k=air_k - below,
        cloud=0.0 if clear < e.clear_share else cover,
        cloud_base_k=air_k - (5 + 5 * base),
        wind_m_s=wind,
        ground_k=air_k + float(rng.uniform(*ground)),
    )


def _motion(frame: FrameKey, recipe: Recipe, seed: int) -> tuple[float, float]:
    """Mean displacement by the motion tail: its length, in any direction; from a stream of its own."""
    length, turn = stream(seed, frame.frame_id, "motion").random(2)
    low, high = recipe.sensor.motion_px
    if recipe.sensor.profile == "off" or high == 0:
        return 0.0, 0.0
    length_px = low + (high - low) * float(length)
    return length_px * math.cos(2 * math.pi * turn), length_px * math.sin(2 * math.pi * turn)


def build_meshes(spec: SceneSpec, models: Mapping[str, ObjectModel]) -> tuple[Mesh, ...]:
    """The geometry of a scene read back from its JSON."""
    return tuple(models[o.model].build(o.params) for o in spec.objects)


def require_parts(recipe: Recipe, models: Mapping[str, ObjectModel]) -> None:
    """Check that the recipe overrides only parts that its models have.

    Raises:
        ModelError: Naming every part that does not exist.
    """
    wrong = [
        f"objects.{i}.parts.{part}: {kind.model} has no such part; it has {', '.join(sorted(models[kind.model].parts))}"
        for i, kind in enumerate(recipe.objects)
        for part in kind.parts
        if part not in models[kind.model].parts
    ]
    if wrong:
        raise ModelError(f"recipe {recipe.name}: " + "; ".join(wrong))


def _pitch_deg(frame: FrameKey, recipe: Recipe, rng: np.random.Generator) -> float:
    pitch = recipe.camera.pitch
    drawn = float(rng.random())  # always taken, so that other draws do not depend on the choice
    if isinstance(pitch, FixedPitch):
        return pitch.fixed_deg
    if isinstance(pitch, RandomPitch):
        low, high = pitch.random_deg
        return float(low + (high - low) * drawn)
    if frame.pitch_deg is None:
        raise ValueError(f"{frame.frame_id}: no camera pitch; the plan must have left this background out")
    return frame.pitch_deg


_Wanted = tuple[Object, dict[str, Any], Mesh, float]


def _wanted(
    recipe: Recipe, models: Mapping[str, ObjectModel], rng: np.random.Generator, time_of_day: TimeOfDay | None
) -> list[_Wanted]:
    """Kind, parameters, mesh and scale of each object the frame shall hold."""
    result = []
    for kind in recipe.objects:
        options = kind.options
        # The artistic look stays as the paper tuned it, at all times of day.
        physical = recipe.appearance.mode == "physical"
        if physical and time_of_day is not None and "time_of_day" in models[kind.model].options:
            options = {"time_of_day": time_of_day, **options}
        if isinstance(kind.count, Count):
            weights = np.array(kind.count.weights or [1.0] * len(kind.count.values))
            count = int(rng.choice(np.array(kind.count.values), p=weights / weights.sum()))
        else:
            count = kind.count
        for _ in range(count):
            params = models[kind.model].sample(rng, options)
            low, high = kind.scale
            scale = math.exp(rng.uniform(math.log(low), math.log(high)))
            result.append((kind, params, models[kind.model].build(params), scale))
    return result


def _parts(
    kind: Object, roles: Mapping[str, PartRange], mesh: Mesh, air_k: float, rng: np.random.Generator
) -> dict[str, PartState]:
    """State of every part in the mesh. One draw says how hot the object runs, one more varies each part about it."""
    heat = rng.random()
    parts = {}
    for name in sorted(roles):
        role = roles[name]
        own, surface = rng.random(2)
        override = kind.parts.get(name)
        delta = override.delta_t_k if override and override.delta_t_k else role.delta_t_k
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
            )
    return parts


_Pose = tuple[float, float, float, float]  # x_m, y_m, z_m, yaw_rad


def _place(
    frame: FrameKey,
    recipe: Recipe,
    models: Mapping[str, ObjectModel],
    pitch_rad: float,
    wanted: Sequence[_Wanted],
    rng: np.random.Generator,
    tally: _Tally,
) -> tuple[CameraSpec, list[_Pose | None]]:
    """The camera and a pose for each object, None for one that found no place.

    The first object is drawn together with the camera (paper: d, x, y, yaw, roll); further ones are drawn into that
    camera's view one by one. Asking all of several objects at once would need astronomically many draws.
    """
    rules = recipe.placement

    def draw_camera() -> CameraSpec:
        return CameraSpec(
            distance_m=float(rng.uniform(*recipe.camera.distance_m)),
            pitch_rad=pitch_rad,
            roll_rad=math.radians(rng.uniform(*recipe.camera.roll_deg)),
            focal_length_mm=recipe.camera.focal_length_mm,
            sensor_width_mm=recipe.camera.sensor_width_mm,
            size_wh=frame.size_wh,
        )

    def draw_pose(kind: Object) -> _Pose:
        x, y, z = (float(rng.uniform(*r)) for r in (kind.x_m, kind.y_m, kind.z_m))
        return x, y, z, math.radians(rng.uniform(*kind.yaw_deg))

    camera = draw_camera()
    tally.first_distance_m = camera.distance_m
    poses: list[_Pose | None] = []
    for number, (kind, _, mesh, scale) in enumerate(wanted):
        pose = draw_pose(kind)
        model = models[kind.model]
        labelled = np.array([model.parts[n].label for n in mesh.part_names])[mesh.part_of_triangle]
        if rules.on_miss == "keep":
            tally.attempts += 1
            poses.append(pose)
            continue
        accepted = False
        for attempt in range(rules.attempts):
            if attempt:
                if rules.on_miss == "redraw" and number == 0:
                    camera, pose = draw_camera(), draw_pose(kind)
                else:
                    fresh = draw_pose(kind)
                    pose = fresh if rules.on_miss == "redraw" else (fresh[0], fresh[1], pose[2], pose[3])
            tally.attempts += 1
            world = object_to_world(mesh.vertices_m, pose[:3], pose[3], scale)
            reason = _rejection(camera, world, mesh, labelled, recipe)
            if reason is None:
                accepted = True
                break
            tally.rejected[reason] = tally.rejected.get(reason, 0) + 1
        if not accepted:
            tally.absent["no_place"] = tally.absent.get("no_place", 0) + 1
        poses.append(pose if accepted else None)
    return camera, poses


def _rejection(
    camera: CameraSpec, world_m: FloatArray, mesh: Mesh, labelled: NDArray[np.bool_], recipe: Recipe
) -> str | None:
    """Why this draw does not count, or None; `labelled` (T,) are the triangles that the label's box is about."""
    rules = recipe.placement
    inside, depth_m = inside_fraction(camera, world_m, mesh.triangles)
    if depth_m < rules.min_depth_m:
        return "too_near"
    if inside < max(rules.min_inside, rules.min_visibility):
        return "outside_frame"
    if rules.size_px is not None:
        size = _box_size_px(camera, world_m, mesh.triangles[labelled])
        if size < rules.size_px[0]:
            return "too_small"
        if size > rules.size_px[1]:
            return "too_large"
    return None


def _box_size_px(camera: CameraSpec, world_m: FloatArray, triangles: IntArray) -> float:
    """Longest side of the box that triangles would get: in the image and cut to the frame, as labels are."""
    xy = project_triangles(camera, world_m, triangles).xy
    points = clip_triangles_to_rect(xy, np.array([0, 0, *camera.size_wh], np.float64))
    return float(np.ptp(points, axis=0).max()) if len(points) else 0.0


def without_objects(scene: SampledScene, numbers: Sequence[int], reason: str) -> SampledScene:
    """The scene less some of its objects, counted in its draws as absent for `reason`."""
    keep = [i for i in range(len(scene.spec.objects)) if i not in set(numbers)]
    draws = dict(scene.spec.draws)
    absent = dict(draws.get("absent", {}))
    absent[reason] = absent.get(reason, 0) + len(numbers)
    draws["absent"] = absent
    spec = replace(scene.spec, objects=tuple(scene.spec.objects[i] for i in keep), draws=draws)
    return SampledScene(spec, tuple(scene.meshes[i] for i in keep))
