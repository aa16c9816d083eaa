"""One frame, from its background to its image and labels. This is the whole method; read it from top to bottom.

background --> scene --> render --> grey levels --> overlay [--> sensor] --> image
                 |          |
                 +----------+--> new labels --> merged with the original ones --> record
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.annotation.labels import LabelSettings, annotate
from infrablend.annotation.merge import MergeSettings, cover_of, merge, partly_covered
from infrablend.assets.catalogue import load_model
from infrablend.assets.model import ObjectModel
from infrablend.compositing.local import GainPrior, Insert, expected_contrast, grey_unit, is_warm, local_mapping
from infrablend.compositing.mapping import GreyImage, GreyMapping, Mapper, PercentileMapper, Place
from infrablend.compositing.overlay import compose, flat_layer, make_layer
from infrablend.compositing.sensor import Sensor, SensorStrength, apply_sensor, fit_sensor
from infrablend.config.modes import recipe_from_json
from infrablend.config.recipe import LocalMatching, MetricSensor, NoSensor, Overlay, PercentileMatching, Recipe
from infrablend.core.camera import CameraSpec, object_to_world
from infrablend.core.cores import take_core
from infrablend.core.dataset import ImageRecord
from infrablend.core.files import write_bytes, write_json
from infrablend.core.mesh import Mesh
from infrablend.core.registry import resolve
from infrablend.core.render import Renderer, RenderResult
from infrablend.core.rng import integer_seed, stream
from infrablend.core.scene import ObjectSpec, SceneSpec
from infrablend.core.tasks import Task
from infrablend.errors import DatasetError, Problem
from infrablend.formats.images import Background, encode_image, load_background, output_suffix, save_image
from infrablend.pipeline.folder import RunFolder
from infrablend.pipeline.plan import PlannedFrame
from infrablend.pipeline.record import FrameRecord
from infrablend.sampling.ground import ground_point
from infrablend.sampling.metric import Site
from infrablend.sampling.scene import SampledScene, build_meshes, sample_scene, without_objects

# Fewer levels between dark and bright than this: nothing in the picture says how warm is how bright.
MIN_SPAN_LEVELS = 4
RENDERERS = {
    "blender": "infrablend.blender.renderer:BlenderRenderer",
    "fake": "infrablend.core.fake_renderer:FakeRenderer",
}


@dataclass(frozen=True)
class FrameSettings:
    """What every worker of a run needs to know; picklable.

    Attributes:
        out: Folder of the run.
        data_root: Folder that background paths are recorded against.
        recipe_json: The recipe.
        seed: The run's seed.
        levels: Darkest and brightest level that the dataset uses; for `appearance.mode: physical` and the sensor.
        renderer: Name in `RENDERERS`.
        device: Where Cycles computes.
        pin_cores: Keep each worker on a processor core of its own.
        ignored: The source's own names of the categories that mark ignore regions.
    """

    out: Path
    data_root: Path
    recipe_json: str
    seed: int
    renderer: str = "blender"
    device: str = "cpu"
    pin_cores: bool = True
    levels: tuple[float, float] | None = None
    ignored: tuple[str, ...] = ()


@dataclass(frozen=True)
class FrameDone:
    """What a worker reports of a finished frame; small, for counting."""

    inserted: int
    wanted: int
    seconds: Mapping[str, float]


class FrameMaker:
    """Makes frames; one per worker process."""

    def __init__(self, settings: FrameSettings) -> None:
        """Start the renderer and load the recipe's models."""
        if settings.pin_cores:
            take_core()
        self._settings = settings
        self._folder = RunFolder(settings.out)
        self._recipe = recipe_from_json(settings.recipe_json)
        self._models = {o.model: load_model(o.model) for o in self._recipe.objects}
        self._mapper = make_mapper(self._recipe)
        self._renderer = make_renderer(settings.renderer, settings.device)

    def __call__(self, task: Task) -> FrameDone:
        """Make the `PlannedFrame` in the task's payload and write its image and its record."""
        frame: PlannedFrame = task.payload
        if frame.configuration is None:
            return self._copy_original(frame)
        source = frame.background
        background = load_background(source.path, source.size_wh)
        if self._recipe.appearance.mode == "physical":
            require_readable_levels(background)
        site = self._site(frame.as_read, background)
        sampled = sample_scene(frame.key(background.size_wh), self._recipe, self._models, self._settings.seed, site)
        sampled = drop_barely_visible(sampled, self._recipe.placement.min_visibility)
        sampled, mapping, matching_facts = self._match(frame.as_read, background, sampled)
        sensor = self._sensor(background, sampled)
        picture = paint(sampled, background, self._renderer, mapping, self._recipe.overlay, sensor)

        labels, label_report = annotate(
            sampled.spec, sampled.meshes, picture.result, LabelSettings(obb=self._recipe.labels.obb)
        )
        # DontCare stays in the record: which formats leave it out is decided when they are written.
        choice = MergeSettings(
            labels=self._recipe.labels.mode,
            keep_categories=self._recipe.labels.keep_categories,
            cover_share=self._recipe.labels.remove_covered,
            dont_care="keep",
        )
        unlabelled = [d.mask for d in label_report.drops if d.mask is not None]
        together, removed = merge(source.instances, labels, choice, unlabelled_masks=unlabelled)
        kept_ids = {id(i) for i in together}
        covered = partly_covered(source.instances, cover_of(labels, unlabelled))

        kind = self._recipe.output.image
        relative = frame.image_path(self._recipe.output.group_by, output_suffix(source.path, kind))
        image_bytes = encode_image(picture.pixels, background, kind)
        write_bytes(self._folder.image(relative), image_bytes)
        record = FrameRecord(
            frame_id=frame.frame_id,
            image=relative,
            image_sha256=hashlib.sha256(image_bytes).hexdigest(),
            background=self._background_facts(frame, background),
            scene=sampled.spec,
            mapping=mapping.to_json(),
            kept=tuple(n for n, i in enumerate(source.instances) if id(i) in kept_ids),
            inserted=tuple(i for i in labels if id(i) in kept_ids),
            removed=tuple(r.to_json() for r in removed),
            facts={
                **label_report.to_json(),
                **matching_facts,
                **({} if sensor is None else {"sensor": sensor.to_json()}),
            },
            warnings=tuple(p.to_json() for p in background.problems),
            covered={
                n: {"visibility": i.visibility, **({} if i.mask is None else {"mask": i.mask.to_coco()})}
                for n, i in covered.items()
                if id(source.instances[n]) in kept_ids
            },
        )
        write_json(self._folder.record(frame.frame_id), record.to_json())
        return FrameDone(len(labels), sampled.spec.draws["wanted"], dict(picture.result.seconds))

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()

    def _site(self, source: ImageRecord, background: Background) -> Site:
        """What placement may know of the background."""
        unit = 1.0 if self._settings.levels is None else grey_unit(background.pixels, self._settings.levels)
        ignored = frozenset(self._settings.ignored)
        return Site(background.pixels, source.instances, ignored, source.altitude_m, unit)

    def _match(
        self, source: ImageRecord, background: Background, sampled: SampledScene
    ) -> tuple[SampledScene, GreyMapping, dict[str, Any]]:
        """The scene less what nobody would see, its grey levels, and what was estimated of the background."""
        m = self._recipe.matching
        while isinstance(m, LocalMatching) and sampled.spec.objects:
            mapping, facts = self._local_mapping(source, background, sampled)
            weather, grounds = sampled.spec.weather, facts["ground_grey"]
            assert weather is not None
            least = m.min_contrast_grey
            if least > 0:
                least *= grey_unit(background.pixels, facts["levels"])
            places: Sequence[GreyMapping | Place] = mapping.places or (mapping,)
            seen = [
                expected_contrast(spec, part_areas(sampled.spec.camera, spec, mesh), place, ground, weather)
                for spec, mesh, place, ground in zip(sampled.spec.objects, sampled.meshes, places, grounds, strict=True)
            ]
            faint = [k for k, contrast in enumerate(seen) if contrast < least]
            if not faint:
                return sampled, mapping, {"matching": facts}
            sampled = without_objects(sampled, faint, "low_contrast")
        return sampled, self._mapper(background.pixels), {}

    def _local_mapping(
        self, source: ImageRecord, background: Background, sampled: SampledScene
    ) -> tuple[GreyMapping, dict[str, Any]]:
        """Grey levels by radiance, from the ground around each object."""
        m, spec = self._recipe.matching, sampled.spec
        assert isinstance(m, LocalMatching)
        assert self._settings.levels is not None
        assert spec.weather is not None
        low, high = m.gain_grey_per_k
        expected = m.gain_prior_grey_per_k
        if source.time_of_day == "day" and m.gain_prior_day_grey_per_k is not None:
            expected = m.gain_prior_day_grey_per_k
        return local_mapping(
            background.pixels,
            [insert_of(spec, k, mesh) for k, mesh in enumerate(sampled.meshes)],
            source.instances,
            spec.weather,
            source.time_of_day,
            self._settings.levels,
            stream(self._settings.seed, spec.frame_id, "matching"),
            prior=GainPrior(expected, expected * m.gain_prior_spread, low, high),
            polarity=m.polarity,
            clothing_k=m.clothing_above_air_k,
        )

    def _sensor(self, background: Background, sampled: SampledScene) -> Sensor | None:
        """The camera to imitate, fitted to this background; None if the recipe wants none."""
        s = self._recipe.sensor
        if isinstance(s, NoSensor) or not sampled.spec.objects:
            return None
        assert self._settings.levels is not None
        seed = integer_seed(self._settings.seed, sampled.spec.frame_id, "sensor")
        defocus = s.defocus if isinstance(s, MetricSensor) else 0.0
        strength = SensorStrength(s.optics, s.halo, s.noise, s.codec, s.clip, defocus)
        return fit_sensor(
            background.pixels,
            s.profile,
            strength,
            self._settings.levels,
            seed,
            range_m=nearest_range_m(sampled.spec),
            motion_px=sampled.spec.motion_px,
        )

    def _copy_original(self, frame: PlannedFrame) -> FrameDone:
        """The background itself as a frame of the dataset, byte for byte unless another file type is asked for."""
        source = frame.background
        background = load_background(source.path, source.size_wh)
        kind = self._recipe.output.image
        relative = frame.image_path(self._recipe.output.group_by, output_suffix(source.path, kind))
        target = self._folder.image(relative)
        if kind == "png" and source.path.suffix.lower() != ".png":
            save_image(target, background.pixels, background, kind)
        else:
            write_bytes(target, source.path.read_bytes())
        choice = MergeSettings(labels=self._recipe.labels.mode, keep_categories=self._recipe.labels.keep_categories)
        together, removed = merge(source.instances, (), choice)
        kept_ids = {id(i) for i in together}
        record = FrameRecord(
            frame_id=frame.frame_id,
            image=relative,
            image_sha256=hashlib.sha256(target.read_bytes()).hexdigest(),
            background=self._background_facts(frame, background),
            scene=None,
            mapping=None,
            kept=tuple(n for n, i in enumerate(source.instances) if id(i) in kept_ids),
            inserted=(),
            removed=tuple(r.to_json() for r in removed),
            warnings=tuple(p.to_json() for p in background.problems),
        )
        write_json(self._folder.record(frame.frame_id), record.to_json())
        return FrameDone(0, 0, {})

    def _background_facts(self, frame: PlannedFrame, background: Background) -> dict[str, Any]:
        source = frame.background
        return {
            "id": source.id,
            "path": os.path.relpath(source.path, self._settings.data_root),
            "sha256": hashlib.sha256(source.path.read_bytes()).hexdigest(),
            "size_wh": list(background.size_wh),
            "pitch_deg": source.pitch_deg,
            "altitude_m": source.altitude_m,
            "time_of_day": source.time_of_day,
            "source_id": source.source_id,
        }


@dataclass(frozen=True, eq=False)
class Picture:
    """A finished picture and what it was made of."""

    pixels: GreyImage
    result: RenderResult


def paint(
    sampled: SampledScene,
    background: Background,
    renderer: Renderer,
    mapping: GreyMapping,
    overlay: Overlay,
    sensor: Sensor | None = None,
) -> Picture:
    """Render a scene and lay it over its background, as the background's camera would show it if `sensor` says how."""
    result = renderer.render(sampled.spec, sampled.meshes)
    if sensor is None:
        layer = flat_layer(result, mapping) if overlay.flat else make_layer(result, mapping, overlay.softness_px)
        return Picture(compose(background.pixels, layer), result)
    layer = make_layer(result, mapping, sensor.layer_sigma_px(overlay.softness_px), sampled.spec.motion_px)
    return Picture(apply_sensor(background.pixels, layer, sensor), result)


def nearest_range_m(spec: SceneSpec) -> float | None:
    """From the camera to the nearest object's origin; None with the paper's placement: its camera is not the real one.

    All objects of a frame get the defocus of the nearest: the renderer's layer does not tell them apart.
    """
    if spec.view is None or not spec.objects:
        return None
    camera = spec.camera.position_m
    return min(float(np.linalg.norm(np.array(o.position_m) - camera)) for o in spec.objects)


def repaint(
    record: FrameRecord, background: Background, recipe: Recipe, models: Mapping[str, ObjectModel], renderer: Renderer
) -> Picture:
    """Make the picture of a recorded frame again; the same pixels as the first time on the same device."""
    if record.scene is None or record.mapping is None:
        raise ValueError(f"{record.frame_id}: an unchanged original has no scene")
    sampled = SampledScene(record.scene, build_meshes(record.scene, models))
    fitted = record.facts.get("sensor")
    return paint(
        sampled,
        background,
        renderer,
        GreyMapping.from_json(record.mapping),
        recipe.overlay,
        None if fitted is None else Sensor.from_json(fitted),
    )


def insert_of(spec: SceneSpec, number: int, mesh: Mesh) -> Insert:
    """Where object `number` of a scene lies in the picture, and how far away if the camera is the real one."""
    o, camera = spec.objects[number], spec.camera
    world = object_to_world(mesh.vertices_m, o.position_m, o.yaw_rad, o.scale)
    xy, _ = camera.project(world)
    box = np.concatenate([np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)])
    assert spec.weather is not None
    warm = is_warm(o, part_areas(camera, o, mesh), spec.weather)
    if spec.view is None:
        return Insert(box, warm=warm)
    away = float(np.linalg.norm(np.asarray(o.position_m) - camera.position_m))
    u, v = ((box[:2] + box[2:]) / 2).tolist()
    below = ground_point(camera, u, v, spec.view.ground_z_m)
    return Insert(box, away, None if below is None else float(np.linalg.norm(below - camera.position_m)), warm)


def part_areas(camera: CameraSpec, item: ObjectSpec, mesh: Mesh) -> dict[str, float]:
    """Area of each part that faces the camera, px^2; what lies behind other parts is not taken off."""
    world = object_to_world(mesh.vertices_m, item.position_m, item.yaw_rad, item.scale)
    xy, depth = camera.project(world)
    corners = xy[mesh.triangles]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    # Counter-clockwise from outside in the world is clockwise, negative, with y down.
    facing = np.where((depth[mesh.triangles] > 0).all(axis=1), np.maximum(b[:, 0] * a[:, 1] - a[:, 0] * b[:, 1], 0), 0)
    areas = np.bincount(mesh.part_of_triangle, facing / 2, len(mesh.part_names))
    return dict(zip(mesh.part_names, areas.tolist(), strict=True))


def require_readable_levels(background: Background) -> None:
    """Refuse a picture whose grey levels cannot stand for temperatures: physical matching would make nonsense of it.

    Raises:
        DatasetError: Colour-mapped, or without any contrast.
    """
    name = background.path.name
    if any(p.code == "image-colour" for p in background.problems):
        problem = Problem(
            name,
            "image-colour-mapped",
            "colours: grey levels made of them do not follow temperature",
            "a grey picture, as physical matching needs",
            "export it from the camera in white-hot grey, or use appearance.mode: artistic",
        )
        raise DatasetError(f"{background.path}: colour-mapped", [problem])
    low, high = (float(v) for v in np.percentile(background.pixels, [0.5, 99.5]))
    if high - low < MIN_SPAN_LEVELS:
        problem = Problem(
            name,
            "image-no-contrast",
            f"grey levels {low:g} to {high:g}",
            f"a picture of at least {MIN_SPAN_LEVELS} levels between its 0.5 and 99.5 percentiles",
            "leave it out, or use appearance.mode: artistic",
        )
        raise DatasetError(f"{background.path}: no contrast", [problem])


def make_mapper(recipe: Recipe) -> Mapper:
    """Return the mapping by percentiles: of the artistic look, and of physical frames without objects."""
    m = recipe.matching
    if not isinstance(m, PercentileMatching):
        m = PercentileMatching(polarity=m.polarity)
    return PercentileMapper(m.low_percentile, m.high_percentile, m.min_span, m.polarity)


def make_renderer(name: str, device: str) -> Renderer:
    """The renderer of that name; Blender is imported here and only here."""
    make: Callable[..., Renderer] = resolve(RENDERERS[name])
    return make(device=device) if name == "blender" else make()


def drop_barely_visible(sampled: SampledScene, min_visibility: float) -> SampledScene:
    """The scene without objects of which less than `min_visibility` can be seen.

    They are taken out of the scene, not just out of the labels: an object in the picture without a label would teach
    a detector to overlook it. Repeated, since what a removed object hid may now be seen.
    """
    while min_visibility > 0 and sampled.meshes:
        labels, report = annotate(sampled.spec, sampled.meshes)
        seen = {k: i.visibility or 0.0 for k, i in zip(report.kept, labels, strict=True)}
        low = [k for k in range(len(sampled.meshes)) if seen.get(k, 0.0) < min_visibility]
        if not low:
            break
        # The least visible first: it may be what brings another above the limit.
        sampled = without_objects(sampled, [min(low, key=lambda k: seen.get(k, 0.0))], "min_visibility")
    return sampled


def make_frame_maker(settings: FrameSettings) -> FrameMaker:
    """Worker factory, named by `execution` through its dotted name."""
    return FrameMaker(settings)
