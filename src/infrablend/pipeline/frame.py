"""One frame, from its background to its image and labels. This is the whole method; read it from top to bottom.

background --> scene --> render --> overlay --> image
                 |         |          ^
                 |         |          +-- grey levels (matching), sensor
                 +---------+--> new labels --> merged with the original ones --> record
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any

from infrablend.annotation.labels import annotate
from infrablend.annotation.merge import merge
from infrablend.assets.catalogue import load_model
from infrablend.compositing.gain import Backdrop
from infrablend.compositing.local import match_locally
from infrablend.compositing.mapping import GreyImage, GreyMapping, grey_unit, measure_levels, percentile_mapping
from infrablend.compositing.occlusion import Scenery, Share, put_behind, restore_front
from infrablend.compositing.overlay import compose, flat_layer, make_layer
from infrablend.compositing.radiometric import ThermalBackdrop, compose_radiance, match_radiometric
from infrablend.compositing.sensor import Sensor, apply_sensor, fit_sensor
from infrablend.config.modes import recipe_from_json
from infrablend.config.recipe import (
    GreyMatching,
    LocalMatching,
    MetricSections,
    MetricSensor,
    NoSensor,
    Overlay,
    PaperSensor,
    RadiometricMatching,
)
from infrablend.core.dataset import ImageRecord
from infrablend.core.files import write_bytes
from infrablend.core.frame_record import FrameRecord
from infrablend.core.machine import take_core
from infrablend.core.placed import PlacedScene
from infrablend.core.render import Renderer, RenderResult
from infrablend.core.rng import integer_seed, stream
from infrablend.core.run_folder import RunFolder
from infrablend.core.tasks import Task
from infrablend.core.temperature import TemperatureScale
from infrablend.formats.images import Background, encode_image, output_suffix
from infrablend.pipeline.backgrounds import background_facts, is_ground, require_temperatures, require_thermal_levels
from infrablend.pipeline.composed import ComposedFrame, MadeFrame, covered_facts
from infrablend.pipeline.extensions import LookRequest, SceneRequest
from infrablend.pipeline.frame_settings import (
    FrameSettings,
    least_contrast,
    local_settings,
    merge_settings,
    percentile_settings,
    sensor_profile,
    sensor_strength,
)
from infrablend.pipeline.inserts import FirstContrasts, faint_inserts, measure_inserts, with_seen_box
from infrablend.pipeline.occlusion import (
    Cover,
    behind_front,
    front_of,
    label_objects,
    occlusion_facts,
    too_hidden,
)
from infrablend.pipeline.original import unchanged_original
from infrablend.pipeline.plan import PlannedFrame
from infrablend.rendering import make_renderer
from infrablend.sampling.calibration import FROM_TABLE, PRIORS, HeightPrior, prior_of
from infrablend.sampling.metric import Site
from infrablend.sampling.scene import air_source, move_objects


class FrameComposer:
    """Composes frames in memory: the one way from a background to its picture and labels, for all commands."""

    def __init__(self, settings: FrameSettings, renderer: Renderer) -> None:
        """Load the recipe's models; `renderer` stays open and may be shared by several composers."""
        self._settings = settings
        self._extensions = settings.extensions
        self._recipe = recipe_from_json(settings.recipe_json)
        self._models = {o.model: load_model(o.model) for o in self._recipe.objects}
        self._renderer = renderer

    def compose(self, frame: PlannedFrame) -> ComposedFrame:
        """Return the picture and the record of a frame.

        Raises:
            DatasetError: The background cannot be used.
            RenderError: The renderer fails.
        """
        if frame.configuration is None:
            return unchanged_original(frame, self._recipe, self._settings)
        source, recipe = frame.background, self._recipe
        background = self._extensions.load(source)
        if isinstance(recipe.matching, LocalMatching):
            require_thermal_levels(background)
        elif isinstance(recipe.matching, RadiometricMatching):
            radiometry = frame.as_read.radiometry
            scale = None if radiometry is None else radiometry.scale
            require_temperatures(background, scale, is_ground(source, recipe))

        # Scene: the objects, their places and temperatures.
        rules, unit = recipe.occlusion, self._grey_unit(background)
        cover = None if rules.share == 0 else Cover(rules, Scenery(background.pixels, unit), self._models)
        key, site = frame.key(background.size_wh), self._site(frame, background, unit, cover)
        scene = self._extensions.scene(SceneRequest(key, recipe, self._models, self._settings.seed, site))
        scene = drop_barely_visible(scene, recipe.placement.min_visibility)

        # Image and labels. Objects that nobody can see in the finished picture are moved, or left out in the end.
        moves = 0
        first = FirstContrasts(scene)
        matching_facts: dict[str, Any] = {}
        while True:
            scene, mapping, facts, expected = self._match(scene, frame, background)
            # What was estimated for objects that are left out in the end is still reported.
            matching_facts = facts or matching_facts
            faint = movable(scene, expected)
            first.add(scene, {k: {"object": k, "changed": round(expected[k], 2), "expected": True} for k in faint})
            hidden: list[int] = []
            if not faint:
                sensor = self._sensor(scene, background, mapping.scale)
                rendered = self._renderer.render(scene)
                occluders = {} if cover is None else cover.find(scene)
                front = front_of(occluders, None if cover is None else cover.scenery, rendered)
                motion_px = scene.spec.motion_px
                pixels = overlay(rendered, background.pixels, mapping, recipe.overlay, sensor, motion_px, front)
                pixels = self._extensions.picture(LookRequest(pixels, background.pixels, rendered, scene))
                seen = behind_front(rendered, front, occluders)
                labels, label_report = label_objects(scene, rendered, seen, occluders, recipe.labels)
                inserts = measure_inserts(label_report.kept, labels, seen, background.pixels, pixels, site)
                first.add(scene, {i.number: i.to_json() for i in inserts})
                least = recipe.placement.min_visibility
                hidden = movable(scene, too_hidden(labels, label_report, occluders, rules, least))
                faint = movable(scene, {*faint_inserts(inserts, recipe, source.time_of_day), *hidden})
            if not faint:
                break
            moves += 1
            if isinstance(recipe, MetricSections) and moves <= recipe.placement.contrast_redraws:
                scene = move_objects(scene, faint, recipe, self._models, self._settings.seed, site, moves)
                scene = drop_barely_visible(scene, recipe.placement.min_visibility)
            elif hidden:
                scene = scene.without(hidden, "too_hidden")
            else:
                scene = scene.without(faint, "low_contrast")
        if recipe.labels.fit == "visible":
            labels = tuple(with_seen_box(i, background.pixels, pixels, site.grey_unit) for i in inserts)
        else:
            labels = tuple(i.labelled() for i in inserts)
        merged = merge(source.instances, labels, merge_settings(recipe))

        relative = frame.image_path(recipe.output.group_by, output_suffix(source.path, recipe.output.image))
        image_bytes = encode_image(pixels, background, recipe.output.image)
        record = FrameRecord(
            frame_id=frame.frame_id,
            image=relative,
            image_sha256=hashlib.sha256(image_bytes).hexdigest(),
            background=background_facts(source, background, self._settings.data_root),
            scene=scene.spec,
            mapping=mapping.to_json(),
            kept=merged.kept,
            inserted=merged.inserted,
            removed=tuple(r.to_json() for r in merged.removed),
            facts={
                **label_report.to_json(),
                **matching_facts,
                **({"contrast": [i.to_json() for i in inserts]} if inserts else {}),
                **({"contrast_first": first.found} if moves and first.found else {}),
                **({} if sensor is None else {"sensor": sensor.to_json()}),
                **({} if cover is None else {"occlusion": occlusion_facts(scene, occluders)}),
            },
            warnings=tuple(p.to_json() for p in background.problems),
            covered=covered_facts(merged),
            run=self._settings.run,
        )
        return ComposedFrame(record, image_bytes, dict(rendered.seconds))

    def _grey_unit(self, background: Background) -> float:
        """Return the picture's levels per 8-bit level: by its own range if it has 16 bits and the run measured none."""
        pixels, levels = background.pixels, self._settings.levels
        if levels is None:
            return 1.0 if background.bit_depth == 8 else grey_unit(pixels, measure_levels([pixels]))
        return grey_unit(pixels, levels)

    def _site(self, frame: PlannedFrame, background: Background, unit: float, cover: Cover | None) -> Site:
        """Return the facts about the background that placement may use."""
        source, recipe = frame.as_read, self._recipe
        if isinstance(recipe.matching, GreyMatching):
            black_hot = recipe.matching.polarity == "black-hot"
        else:
            scale = None if source.radiometry is None else source.radiometry.scale
            black_hot = scale is not None and scale.black_hot
        return Site(
            background.pixels,
            source.instances,
            frozenset(self._settings.ignored),
            source.altitude_m,
            unit,
            black_hot,
            recipe.placement.max_noise_grey if isinstance(recipe, MetricSections) else None,
            cover,
            self._height_prior(source),
            source.time_of_day,
        )

    def _height_prior(self, source: ImageRecord) -> HeightPrior:
        """Return what is known about the picture's stated height, by its origin."""
        known = PRIORS.get(str(source.extra.get("altitude_from")))
        if known is None and isinstance(self._recipe, MetricSections):
            heights = self._recipe.camera.stated_heights
            return prior_of(heights, source.altitude_m, source.pitch_deg, source.time_of_day)
        return known or FROM_TABLE

    def _match(
        self, scene: PlacedScene, frame: PlannedFrame, background: Background
    ) -> tuple[PlacedScene, GreyMapping, dict[str, Any], dict[int, float]]:
        """Choose the grey levels.

        Returns:
            The scene, without objects if the gain cannot be trusted and the recipe skips such backgrounds; its mapping;
            the facts estimated from the background; and the expected contrast, 8-bit levels, of the objects that are
            certainly too faint, before rendering.
        """
        matching, source, levels = self._recipe.matching, frame.as_read, self._settings.levels
        facts: dict[str, Any] = {}
        scale = None if source.radiometry is None else source.radiometry.scale
        if isinstance(matching, RadiometricMatching) and scene.objects and scale is not None:
            thermal = ThermalBackdrop(background.pixels, source.instances, scale)
            source_of_air = air_source(frame.key(background.size_wh), self._recipe)
            scene, mapping, found = match_radiometric(scene, thermal, source_of_air)
            return scene, mapping, {"matching": found}, {}
        if isinstance(matching, LocalMatching) and scene.objects:
            assert levels is not None
            backdrop = Backdrop(background.pixels, source.instances, source.time_of_day, levels)
            sensor = self._recipe.sensor
            last = sensor if isinstance(sensor, PaperSensor | MetricSensor) else None
            settings = local_settings(matching, source.time_of_day, last)
            # The same stream at each attempt, so that a moved object does not influence the gain.
            rng = stream(self._settings.seed, frame.frame_id, "matching")
            match = match_locally(scene, backdrop, settings, rng)
            facts = {"matching": match.facts}
            height_at_limit = scene.spec.view is not None and scene.spec.view.at_limit
            if not ((match.untrusted or height_at_limit) and matching.on_untrusted == "skip"):
                faint = {}
                for k, (placed, contrast) in enumerate(zip(scene.objects, match.contrasts, strict=True)):
                    least = least_contrast(self._recipe, placed.spec.category, source.time_of_day)
                    if least is not None and contrast < least.change * backdrop.grey_unit:
                        faint[k] = contrast / backdrop.grey_unit
                return scene, match.mapping, facts, faint
            scene = scene.without(range(len(scene.objects)), "untrusted")
        return scene, percentile_mapping(background.pixels, percentile_settings(matching)), facts, {}

    def _sensor(self, scene: PlacedScene, background: Background, scale: TemperatureScale | None) -> Sensor | None:
        """Return the sensor chain fitted to this background; None if there is none or no object."""
        sensor, levels = self._recipe.sensor, self._settings.levels
        if isinstance(sensor, NoSensor) or not scene.objects:
            return None
        assert levels is not None
        unit_k = None if scale is None else abs(scale.slope_k) * grey_unit(background.pixels, levels)
        return fit_sensor(
            background.pixels,
            sensor_profile(sensor, unit_k),
            sensor_strength(sensor),
            levels,
            integer_seed(self._settings.seed, scene.spec.frame_id, "sensor"),
            range_m=nearest_range_m(scene),
            motion_px=scene.spec.motion_px,
        )


def movable(scene: PlacedScene, numbers: Iterable[int]) -> list[int]:
    """Return the numbers of those objects that are not placed by hand, sorted."""
    return sorted(k for k in numbers if not scene.objects[k].spec.by_hand)


def drop_barely_visible(scene: PlacedScene, min_visibility: float) -> PlacedScene:
    """Return the scene without the objects whose visible share is below `min_visibility`.

    They are removed from the scene and not only from the labels, because an unlabelled object in the picture would
    teach a detector to overlook it. Objects are removed one at a time, since each removal may uncover others.
    """
    while min_visibility > 0 and scene.objects:
        labels, report = annotate(scene)
        seen = {k: i.visibility or 0.0 for k, i in zip(report.kept, labels, strict=True)}
        low = movable(scene, [k for k in range(len(scene.objects)) if seen.get(k, 0.0) < min_visibility])
        if not low:
            break
        # The least visible first: removing it may bring another above the limit.
        scene = scene.without([min(low, key=lambda k: seen.get(k, 0.0))], "min_visibility")
    return scene


def nearest_range_m(scene: PlacedScene) -> float | None:
    """Return the distance from the camera to the nearest object's origin.

    Returns None if the scene has no objects, or with the paper's placement, whose camera is virtual. All objects of a
    frame get the defocus of the nearest one, because the renderer's layer does not separate them.
    """
    if scene.spec.view is None or not scene.objects:
        return None
    return min(o.range_m for o in scene.objects)


def overlay(
    rendered: RenderResult,
    background: GreyImage,
    mapping: GreyMapping,
    style: Overlay,
    sensor: Sensor | None = None,
    motion_px: tuple[float, float] = (0.0, 0.0),
    front: Share | None = None,
) -> GreyImage:
    """Lay a rendered scene over its background and return the picture.

    Args:
        rendered: The rendered scene.
        background: (h, w) grey levels.
        mapping: From radiance to the background's grey levels, or to radiance at the sensor for a background with
            temperatures.
        style: Softness of the edge, or flat silhouettes (paper), for pictures without `sensor`.
        sensor: The camera to imitate; None to imitate none.
        motion_px: The scene's motion tail; only with `sensor`.
        front: (h, w) share of each pixel of the background that stays in front; None for nothing.
    """
    if sensor is not None:
        layer = make_layer(rendered, mapping, sensor.layer_sigma_px(style.softness_px), motion_px)
    else:
        layer = flat_layer(rendered, mapping) if style.flat else make_layer(rendered, mapping, style.softness_px)
    if front is not None:
        layer = put_behind(layer, front)
    if mapping.scale is not None:
        picture = compose_radiance(background, layer, mapping.scale, sensor)
    else:
        picture = compose(background, layer) if sensor is None else apply_sensor(background, layer, sensor)
    return picture if front is None else restore_front(picture, background, front)


class FrameMaker:
    """Composes frames and writes them to the folder of a run; each worker process has one instance."""

    def __init__(self, settings: FrameSettings) -> None:
        """Start the renderer and load the recipe's models."""
        if settings.pin_cores:
            take_core()
        if settings.out is None:
            raise ValueError("frames in memory are made by FrameWorker")
        self._folder = RunFolder(settings.out)
        self._renderer = make_renderer(settings.renderer, settings.device)
        self._composer = FrameComposer(settings, self._renderer)

    def __call__(self, task: Task) -> MadeFrame:
        """Write the image of the `PlannedFrame` in the task's payload, and return its record."""
        composed = self._composer.compose(task.payload)
        write_bytes(self._folder.image(composed.record.image), composed.image_bytes)
        return MadeFrame.of(composed.record, len(composed.image_bytes), composed.seconds)

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()


def make_frame_maker(settings: FrameSettings) -> FrameMaker:
    """Return a frame maker; the worker factory that `execution` calls by its dotted name."""
    return FrameMaker(settings)
