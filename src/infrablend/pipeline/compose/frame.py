"""One frame, from its background to its image and labels. This is the whole method; read it from top to bottom.

background --> scene --> render --> overlay --> image
                 |         |          ^
                 |         |          +-- grey levels (matching), sensor
                 +---------+--> new labels --> merged with the original ones --> record
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from infrablend.annotation.labels import LabelReport, annotate
from infrablend.annotation.merge_labels import MergeSettings, merge
from infrablend.assets.catalogue import load_model
from infrablend.compositing.mapping import GreyImage, grey_unit, measure_levels
from infrablend.compositing.occlusion import Occluder, Scenery
from infrablend.compositing.other_camera import OtherCamera
from infrablend.compositing.sensor import Sensor, SensorStrength, fit_sensor, focus_missed
from infrablend.config.modes import recipe_from_json
from infrablend.config.recipe import MetricRecipe
from infrablend.core.dataset import Instance, boxes_of
from infrablend.core.frame_row import FrameRecord, Remains
from infrablend.core.render import PlacedScene, Renderer, RenderResult
from infrablend.core.rle_masks import Mask
from infrablend.core.rng import integer_seed, stream
from infrablend.core.temperature import TemperatureScale
from infrablend.errors import MissingDependencyError
from infrablend.formats.pictures.images import Background, encode_image, output_suffix
from infrablend.formats.pictures.place_masks import read_mask
from infrablend.imaging.paint_out import Shown
from infrablend.pipeline.compose.composed import ComposedFrame
from infrablend.pipeline.compose.inserts import (
    FirstContrasts,
    MeasuredInsert,
    faint_inserts,
    measure_inserts,
    with_seen_box,
)
from infrablend.pipeline.compose.looks import Match, make_look
from infrablend.pipeline.compose.partly_hidden import (
    Cover,
    behind_front,
    behind_text,
    front_of,
    label_objects,
    occlusion_facts,
    too_hidden,
)
from infrablend.pipeline.compose.sequence_objects import Anchored, Sequences, Take
from infrablend.pipeline.compose.settings import FrameSettings
from infrablend.pipeline.plans.backgrounds import background_facts
from infrablend.pipeline.plans.plan import PlannedFrame
from infrablend.sampling.site import FrameKey, Site


@dataclass(frozen=True, eq=False)
class Canvas:
    """A background, and what is known of it.

    Attributes:
        frame: The frame that it is for.
        background: The picture.
        key: Key of the frame's random streams.
        site: The background as placement sees it.
        cover: What can hide objects in part; None if the recipe hides none.
    """

    frame: PlannedFrame
    background: Background
    key: FrameKey
    site: Site
    cover: Cover | None


@dataclass(frozen=True, eq=False)
class Picture:
    """A finished picture, with all that is known of its objects.

    Attributes:
        scene: The scene.
        match: From radiance to grey levels.
        rendered: The rendered scene.
        pixels: (h, w) grey levels.
        inserts: Objects with a label.
        report: What became of the others.
        sensor: The camera that was imitated; None for none.
        occluders: What of the background is in front of objects, by their numbers.
        facts: Facts for the frame's record.
    """

    scene: PlacedScene
    match: Match
    rendered: RenderResult
    pixels: GreyImage
    inserts: Sequence[MeasuredInsert]
    report: LabelReport
    sensor: Sensor | None
    occluders: Mapping[int, Occluder]
    facts: Mapping[str, object]


@dataclass(frozen=True, eq=False)
class Unseen:
    """A scene with objects that nobody can see in its picture.

    Attributes:
        scene: The scene.
        numbers: Numbers of these objects.
        hidden: Numbers of those of them that structures of the background hide too much.
        matching: Facts that matching estimated.
        sensor: The chain fitted to the background; None if there is none yet.
    """

    scene: PlacedScene
    numbers: Sequence[int] = ()
    hidden: Sequence[int] = ()
    matching: Mapping[str, object] = field(default_factory=dict)
    sensor: Sensor | None = None


class FrameComposer:
    """Composes frames in memory: the one way from a background to its picture and labels, for all commands."""

    def __init__(self, settings: FrameSettings, renderer: Renderer) -> None:
        """Load the recipe's models; `renderer` stays open and may be shared by several composers."""
        self._settings = settings
        self._recipe = recipe_from_json(settings.recipe_json)
        if reason := self._recipe.needs_blender:
            try:
                renderer.start()
            except MissingDependencyError as error:
                raise MissingDependencyError(f"{reason}: {error.message}", error.problems) from None
        self._models = {o.model: load_model(o.model) for o in self._recipe.objects}
        self._sampler = settings.extensions.make_sampler(self._recipe, self._models, settings.seed)
        self._look = make_look(self._recipe, settings)
        self._renderer = renderer
        self._sequences: Sequences | None = None
        if self._recipe.in_sequences:  # only metric placement has them
            self._sequences = Sequences(settings, cast(MetricRecipe, self._recipe), self._models, self._settle)

    def compose(self, frame: PlannedFrame) -> ComposedFrame:
        """Return the picture and the record of a frame.

        Raises:
            DatasetError: The background cannot be used.
            RenderError: The renderer fails.
        """
        if frame.configuration is None:
            return self._unchanged(frame)
        canvas, picture = self._picture(frame)

        # Labels, file and record.
        labels = self._labels(picture, canvas)
        objects = [*labels, *frame.background.instances]
        pixels, camera = self._retaken(picture.pixels, canvas.background, frame, objects)
        image_bytes = encode_image(pixels, canvas.background, self._recipe.output.image)
        record = replace(
            self._record(frame, canvas.background, labels, image_bytes),
            scene=picture.scene.spec,
            mapping=picture.match.mapping.to_json(),
            facts={**picture.facts, **camera},
        )
        return ComposedFrame(record, image_bytes, dict(picture.rendered.seconds))

    def _picture(self, frame: PlannedFrame) -> tuple[Canvas, Picture]:
        """Return a frame's background, and the picture with the objects of its sequence, or with its own."""
        if self._sequences is None:
            return self._own_picture(frame)
        take = self._sequences.take(frame)
        if take is None:
            return self._own_picture(frame, left_out=self._sequences.why_none(frame))
        canvas = self._canvas(frame, self._load(frame))
        picture = self._draw(take.scene, canvas, FirstContrasts(take.scene), Unseen(take.scene), take)
        assert isinstance(picture, Picture), "tracks are never moved"
        return canvas, picture

    def _own_picture(self, frame: PlannedFrame, left_out: str | None = None) -> tuple[Canvas, Picture]:
        """Return a frame's background, and the picture with objects that are drawn for it alone.

        `left_out` is the reason why it gets none after all.
        """
        # The objects, their places and temperatures.
        if left_out is None:
            canvas, scene = self._arrange(frame)
        else:  # whatever its grey levels are
            canvas = self._canvas(frame, self._settings.extensions.load(frame.background))
            scene = self._sampler.sample(canvas.key, canvas.site)
            scene = scene.without(range(len(scene.objects)), left_out)

        # Objects that nobody can see in the finished picture are moved, or left out in the end.
        first = FirstContrasts(scene)
        moves = 0
        picture = self._draw(scene, canvas, first, Unseen(scene))
        while isinstance(picture, Unseen):
            moves += 1
            scene = self._redraw(picture, canvas.site, moves)
            picture = self._draw(scene, canvas, first, picture)
        if moves and first.found:
            picture = replace(picture, facts={**picture.facts, "contrast_first": first.found})
        return canvas, picture

    def _settle(self, frame: PlannedFrame) -> Anchored:
        """Draw the objects of an anchor of a sequence."""
        canvas, picture = self._own_picture(frame)
        return Anchored(picture.scene, canvas.site, picture.match, picture.sensor, picture.occluders)

    def place(self, frame: PlannedFrame) -> FrameRecord:
        """Return the record of a frame whose objects have their places, with their boxes; nothing is drawn.

        Objects that nobody could see in the finished picture are still among them.

        Raises:
            DatasetError: The background cannot be used.
        """
        canvas, scene = self._arrange(frame)
        return replace(self._record(frame, canvas.background, annotate(scene)[0], b""), scene=scene.spec)

    def _arrange(self, frame: PlannedFrame) -> tuple[Canvas, PlacedScene]:
        """Return what is known of a frame's background, and the scene whose objects have places there."""
        canvas = self._canvas(frame, self._load(frame))
        scene = self._sampler.sample(canvas.key, canvas.site)
        return canvas, drop_barely_visible(scene, self._recipe.placement.min_visibility)

    def _load(self, frame: PlannedFrame) -> Background:
        background = self._settings.extensions.load(frame.background)
        self._look.check(frame, background)
        return background

    def _unchanged(self, frame: PlannedFrame) -> ComposedFrame:
        """Return a background as a frame; the image is a byte-for-byte copy unless the recipe changes it."""
        path = frame.background.path
        kind = self._recipe.output.image
        extensions = self._settings.extensions
        background = extensions.load(frame.background)
        pixels, camera = self._retaken(background.pixels, background, frame, frame.background.instances)
        if camera or extensions.backgrounds is not None or (kind == "png" and path.suffix.lower() != ".png"):
            image_bytes = encode_image(pixels, background, kind)
        else:
            image_bytes = path.read_bytes()
        record = replace(self._record(frame, background, (), image_bytes), facts=camera)
        return ComposedFrame(record, image_bytes, {})

    def _retaken(
        self, pixels: GreyImage, background: Background, frame: PlannedFrame, objects: Sequence[Instance]
    ) -> tuple[GreyImage, dict[str, object]]:
        """Return a picture as another camera shows it, and that camera for the record; as it is without one.

        `objects` are all that have a label in it.
        """
        rules = self._recipe.sensor.randomise
        if rules is None:
            return pixels, {}
        shown = None if self._sequences is None else self._sequences.shown_in(frame)
        key = frame.frame_id
        if shown is not None:
            key = f"{shown.background.split}/{shown.background.capture.sequence}_c{frame.configuration}"
        rng = stream(self._settings.seed, key, "camera")
        camera = OtherCamera.draw(rules, self._grey_unit(background), rng)
        if shown is not None:  # one camera, new noise in each picture
            camera = replace(camera, noise_seed=integer_seed(self._settings.seed, shown.background_id, "camera"))
        camera = camera.clear_of(boxes_of(objects))
        return camera.take(pixels), {"camera": camera.to_json()}

    def _canvas(self, frame: PlannedFrame, background: Background) -> Canvas:
        recipe = self._recipe
        source = frame.as_read
        pixels = background.pixels
        unit = self._grey_unit(background)
        rules = recipe.occlusion
        cover = None if rules.share == 0 else Cover(rules, Scenery(pixels, unit), self._models)
        site = Site(
            pixels=pixels,
            labels=source.instances,
            ignored=frozenset(self._settings.ignored),
            altitude_m=source.capture.altitude_m,
            grey_unit=unit,
            black_hot=recipe.matching.is_black_hot(source.capture.scale),
            max_noise_grey=recipe.placement.max_noise_grey,
            hiding=cover,
            height_prior=self._sampler.placer.height_prior(source),
            time_of_day=source.capture.time_of_day,
            labelled_ground=self._settings.labelled_ground,
            allowed=self._allowed(frame, background),
        )
        return Canvas(frame, background, frame.key(background.size_wh), site, cover)

    def _allowed(self, frame: PlannedFrame, background: Background) -> NDArray[np.bool_] | None:
        """Return the pixels where the caller's mask lets objects stand; None without one."""
        where = self._recipe.placement.surfaces
        if where is None or where.masks is None:
            return None
        return read_mask(Path(where.masks), frame.background, background.size_wh)

    def _grey_unit(self, background: Background) -> float:
        """Return the picture's levels per 8-bit level: by its own range if it has 16 bits and the run measured none."""
        pixels = background.pixels
        levels = self._settings.levels
        if levels is None:
            return 1.0 if background.bit_depth == 8 else grey_unit(pixels, measure_levels([pixels]))
        return grey_unit(pixels, levels)

    def _draw(
        self, scene: PlacedScene, canvas: Canvas, first: FirstContrasts, before: Unseen, take: Take | None = None
    ) -> Picture | Unseen:
        """Draw a scene over its background, unless some of its objects cannot be seen.

        `first` collects contrasts. `before` is the last attempt: its facts of matching count, also those of objects
        that have been left out since, and its sensor serves again. With a `take`, levels and sensor are those of the
        sequence.
        """
        recipe = self._recipe
        ground = canvas.background.pixels
        match = self._match(scene, canvas, take)
        scene = match.scene
        matching = match.facts or before.matching
        if faint := movable(scene, match.faint):
            first.add(scene, {k: {"object": k, "changed": round(match.faint[k], 2), "expected": True} for k in faint})
            return Unseen(scene, faint, (), matching, before.sensor)
        known = before.sensor if take is None else take.sensor
        sensor = self._sensor(scene, canvas.background, match.mapping.scale, known)
        rendered = self._renderer.render(scene)
        occluders = {} if canvas.cover is None else canvas.cover.find(scene, {} if take is None else take.fronts)
        front = front_of(occluders, None if canvas.cover is None else canvas.cover.scenery, rendered)
        pixels = self._look.paint(match, rendered, ground, sensor, front)
        written = None if take is None else covered_text(take.written, pixels, ground)
        if written is not None:
            pixels = np.where(written, ground, pixels)

        seen = behind_front(rendered, front, occluders)
        labels, report = label_objects(scene, rendered, seen, occluders, recipe.labels)
        if written is not None:
            labels, report, seen = behind_text(labels, report, seen, written)
        inserts = measure_inserts(report.kept, labels, seen, ground, pixels, canvas.site)
        first.add(scene, {i.number: i.to_json() for i in inserts})
        least = recipe.placement.min_visibility
        hidden = movable(scene, too_hidden(labels, report, occluders, recipe.occlusion, least))
        unseen = faint_inserts(inserts, recipe, canvas.frame.background.capture.time_of_day)
        if faint := movable(scene, {*unseen, *hidden}):
            return Unseen(scene, faint, hidden, matching, sensor)
        facts = {
            **report.to_json(),
            **matching,
            **({"contrast": [i.to_json() for i in inserts]} if inserts else {}),
            **({} if sensor is None else {"sensor": sensor.to_json()}),
            **({} if canvas.cover is None else {"occlusion": occlusion_facts(scene, occluders)}),
            **({"faint": unseen} if take is not None and unseen else {}),
            **({} if written is None else {"written": Mask.from_array(written).to_coco()}),
        }
        return Picture(scene, match, rendered, pixels, inserts, report, sensor, occluders, facts)

    def _match(self, scene: PlacedScene, canvas: Canvas, take: Take | None) -> Match:
        """Return the map to grey levels: that of a frozen picture is that of the picture which it shows."""
        if take is None:
            return self._look.match(scene, canvas.frame, canvas.background)
        frozen = take.shown.background_id != canvas.frame.background_id
        background = self._load(take.shown) if frozen else canvas.background
        return self._look.match(scene, take.shown, background, take.earlier)

    def _redraw(self, unseen: Unseen, site: Site, attempt: int) -> PlacedScene:
        """Return a scene whose unseen objects are at other places, or left out if the recipe moves them no more."""
        moved = self._sampler.move(unseen.scene, unseen.numbers, site, attempt)
        if moved is not None:
            return drop_barely_visible(moved, self._recipe.placement.min_visibility)
        if unseen.hidden:
            return unseen.scene.without(unseen.hidden, "too_hidden")
        return unseen.scene.without(unseen.numbers, "low_contrast")

    def _sensor(
        self, scene: PlacedScene, background: Background, scale: TemperatureScale | None, known: Sensor | None
    ) -> Sensor | None:
        """Return the sensor chain, `known` or fitted to this background; None if there is none or no object."""
        sensor = self._recipe.sensor
        levels = self._settings.levels
        if sensor.profile == "off" or not scene.objects:
            return None
        assert levels is not None
        unit_k = None if scale is None else abs(scale.slope_k) * grey_unit(background.pixels, levels)
        profile = sensor.profile_at(unit_k)
        range_m = nearest_range_m(scene)
        strength = SensorStrength(sensor.optics, sensor.halo, sensor.noise, sensor.codec, sensor.clip, sensor.defocus)
        if known is not None:
            return focus_missed(known, profile, strength, range_m)
        return fit_sensor(
            background.pixels,
            profile,
            strength,
            levels,
            integer_seed(self._settings.seed, scene.spec.frame_id, "sensor"),
            range_m=range_m,
            motion_px=scene.spec.motion_px,
        )

    def _labels(self, picture: Picture, canvas: Canvas) -> tuple[Instance, ...]:
        if self._recipe.labels.fit == "visible":
            before, after = canvas.background.pixels, picture.pixels
            return tuple(with_seen_box(i, before, after, canvas.site.grey_unit) for i in picture.inserts)
        return tuple(i.labelled() for i in picture.inserts)

    def _record(
        self, frame: PlannedFrame, background: Background, labels: Sequence[Instance], image_bytes: bytes
    ) -> FrameRecord:
        """Return the record of a frame with the labels of its inserts, without its scene and what was estimated."""
        source = frame.background
        output = self._recipe.output
        wanted = self._recipe.labels
        # Ignore regions stay in the record: each format leaves them out, or not, when it is written.
        rules = MergeSettings(wanted.mode, wanted.keep_categories, wanted.remove_covered)
        merged = merge(source.instances, labels, rules)
        return FrameRecord(
            frame_id=frame.frame_id,
            image=frame.image_path(output.group_by, output_suffix(source.path, output.image)),
            image_sha256=hashlib.sha256(image_bytes).hexdigest(),
            background=background_facts(source, background, self._settings.data_root),
            kept=merged.kept,
            inserted=merged.inserted,
            removed=tuple(r.to_json() for r in merged.removed),
            warnings=tuple(background.problems),
            covered={n: Remains(i.visibility, i.mask) for n, i in merged.partly_covered.items()},
            run=self._settings.run,
            scene=None,
            mapping=None,
        )


def movable(scene: PlacedScene, numbers: Iterable[int]) -> list[int]:
    """Return the numbers of those objects whose places are not fixed, sorted."""
    return sorted(k for k in numbers if not scene.objects[k].spec.stays)


def covered_text(
    written: NDArray[np.bool_] | None, picture: GreyImage, background: GreyImage
) -> NDArray[np.bool_] | None:
    """Return the (h, w) mask of text that a picture changes; None for none."""
    if written is None or written.shape != picture.shape:
        return None
    covered = written & (picture != background)
    if covered.any():
        # A mast that stands still in most frames is no text where other frames show the sky.
        covered &= Shown(background, None).thin
    return covered if covered.any() else None


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
