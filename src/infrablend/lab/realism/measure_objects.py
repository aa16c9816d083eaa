"""Workers that measure real objects, inserted objects, controls, and objects of frames that are rendered again."""

from __future__ import annotations

import io
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from infrablend.annotation.looseness import Looseness, loosen_image
from infrablend.annotation.measured_looseness import BoxExtent, box_extent
from infrablend.assets.catalogue import load_model
from infrablend.compositing.mapping import GreyImage, GreyMapping
from infrablend.compositing.object_contrast import ObjectContrast, Picture, eight_bit, from_eight_bit, object_contrast
from infrablend.compositing.picture import overlay
from infrablend.compositing.sensor import Sensor
from infrablend.config.modes import recipe_from_json
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.frame_row import FrameRecord
from infrablend.core.operating_system import take_core
from infrablend.core.render import Renderer
from infrablend.core.run_folder import RunFolder
from infrablend.core.tasks import Task
from infrablend.errors import DatasetError
from infrablend.formats.pictures.images import Background, SaveKind, encode_image, load_background
from infrablend.lab.realism.controls import SENSOR_STEPS, paste_controls, sensor_steps
from infrablend.lab.realism.features import Bool, Labels, Measured, measure, reason_not_measured
from infrablend.pipeline.compose.partly_hidden import recorded_front
from infrablend.rendering import make_renderer
from infrablend.sampling.scene_sampler import rebuild_scene


@dataclass(frozen=True)
class MeasuringSettings:
    """Settings that all measuring workers share; picklable.

    Attributes:
        run: Folder of the run.
        recipe_json: The run's recipe.
        categories: Classes to measure.
        levels: Darkest and brightest level of the dataset, for 16-bit pictures.
        renderer: Name in `rendering.RENDERERS`.
        device: Device that Cycles computes on.
        pin_cores: Whether each worker keeps to a processor core of its own.
    """

    run: Path
    recipe_json: str
    categories: tuple[str, ...]
    levels: tuple[float, float]
    renderer: str
    device: str
    pin_cores: bool = True


@dataclass(frozen=True, eq=False)
class PictureJob:
    """One picture to measure objects in.

    | `record` | `redo` | what is measured |
    |---|---|---|
    | None | None | the real objects of the dataset's picture |
    | given | None | the inserted objects of the run's frame |
    | None | given | controls made from these real objects |
    | given | given | these inserted objects, rendered again with each step of the sensor chain |

    Attributes:
        background: The dataset's image.
        record: Frame of the run on that image, or None.
        redo: Numbers of the objects to make controls of or to render again, or None.
    """

    background: ImageRecord
    record: FrameRecord | None = None
    redo: tuple[int, ...] | None = None


@dataclass(eq=False)
class Measurements:
    """Measured objects by population, and a count of those that were not measured.

    Attributes:
        objects: Measured objects by population: `real`, `inserted`, `floor`, `hard_paste`, or a sensor step.
        left_out: Objects that were not measured: `<population>/<class>` to reason to number.
        unreadable: Messages about pictures that could not be read.
        contrasts: Contrast of all `real` and `inserted` objects, whether or not they are in `objects`. `as_written` are
            the inserted ones in the boxes of the label files, where the recipe enlarges or fits these.
        extents: Box and visible extent of those objects, where the extent can be found.
    """

    objects: dict[str, list[Measured]] = field(default_factory=lambda: defaultdict(list))
    left_out: dict[str, Counter[str]] = field(default_factory=lambda: defaultdict(Counter))
    unreadable: list[str] = field(default_factory=list)
    contrasts: dict[str, list[ObjectContrast]] = field(default_factory=lambda: defaultdict(list))
    extents: dict[str, list[BoxExtent]] = field(default_factory=lambda: defaultdict(list))

    def leave_out(self, population: str, category: str, reason: str) -> None:
        """Count an object that is not measured."""
        self.left_out[f"{population}/{category}"][reason] += 1

    def extend(self, other: Measurements) -> None:
        """Add everything from another picture."""
        populations: list[tuple[dict[str, list[Any]], dict[str, list[Any]]]] = [
            (self.objects, other.objects), (self.contrasts, other.contrasts), (self.extents, other.extents),
        ]  # fmt: skip
        for ours, theirs in populations:
            for population, found in theirs.items():
                ours[population] += found
        for key, reasons in other.left_out.items():
            self.left_out[key].update(reasons)
        self.unreadable += other.unreadable

    def drop_without_real_object(self) -> None:
        """Leave out inserted objects whose background shows no real object of their class to compare with."""
        beside = {(m.category, m.group) for m in self.objects["real"]}
        inserted = self.objects["inserted"]
        self.objects["inserted"] = []
        for m in inserted:
            if (m.category, m.group) in beside:
                self.objects["inserted"].append(m)
            else:
                self.leave_out("inserted", m.category, "none_beside")

    # What workers have measured is sorted: the order must not depend on that of finishing.

    def of(self, population: str, category: str) -> list[Measured]:
        """Return a population's objects of one class."""
        return sorted((m for m in self.objects[population] if m.category == category), key=lambda m: m.key)

    def contrasts_of(self, population: str, category: str) -> list[ObjectContrast]:
        """Return the contrasts of one class."""
        return sorted((c for c in self.contrasts[population] if c.category == category), key=lambda c: c.image)

    def extents_of(self, population: str, category: str) -> list[BoxExtent]:
        """Return the boxes and extents of one class."""
        return sorted((e for e in self.extents[population] if e.category == category), key=lambda e: e.image)


class ObjectMeasurer:
    """Measures the objects of pictures; one per worker process."""

    def __init__(self, settings: MeasuringSettings) -> None:
        """Load the recipe. The renderer starts with the first frame that is rendered again."""
        if settings.pin_cores:
            take_core()
        self._settings = settings
        self._recipe = recipe_from_json(settings.recipe_json)
        self._renderer: Renderer | None = None

    def __call__(self, task: Task) -> Measurements:
        """Do the `PictureJob` in the task's payload."""
        job: PictureJob = task.payload
        if job.record is not None:
            if job.redo is None:
                return self._inserted(job.background, job.record)
            return self._rendered_again(job.background, job.record, job.redo)
        return self._real(job.background) if job.redo is None else self._controls(job.background, job.redo)

    def close(self) -> None:
        """Release the renderer, if one was started."""
        if self._renderer is not None:
            self._renderer.close()

    def _real(self, source: ImageRecord) -> Measurements:
        try:
            pixels = load_background(source.path, source.size_wh).pixels
        except DatasetError as error:  # `generate` has left it out, too
            return Measurements(unreadable=[error.message])
        picture = eight_bit(pixels, self._settings.levels)
        key = image_key(source)
        found = self._all_of("real", picture, source, source.instances, source.instances, key)
        drawn = self._contrasts(picture, source, source.instances, source.instances, key)
        found.contrasts["real"] = [c for _, c in drawn]
        found.extents["real"] = _extents(picture, drawn, source.instances)
        return found

    def _inserted(self, source: ImageRecord, record: FrameRecord) -> Measurements:
        pixels = load_background(RunFolder(self._settings.run).image(record.image)).pixels
        picture = eight_bit(pixels, self._settings.levels)
        kept = _kept_of(source, record)
        image = replace(source, instances=record.inserted, size_wh=(picture.shape[1], picture.shape[0]))

        def contrasts_in(boxes: ImageRecord) -> list[tuple[Instance, ObjectContrast]]:
            labels = [*kept, *boxes.instances]
            return self._contrasts(picture, source, boxes.instances, labels, record.frame_id)

        found = self._all_of("inserted", picture, source, [*kept, *record.inserted], record.inserted, record.frame_id)
        drawn = contrasts_in(image)
        found.contrasts["inserted"] = [c for _, c in drawn]
        looseness = Looseness.of_labels(self._recipe.labels)
        fitted = image
        if looseness.fit != "shape":
            # A margin is in addition to a fit, so the fitted boxes are compared with the visible extents.
            fitted, _ = loosen_image(image, Looseness(fit=looseness.fit))
            drawn = contrasts_in(fitted)
        found.extents["inserted"] = _extents(picture, drawn, [*kept, *fitted.instances])
        if looseness:
            found.contrasts["as_written"] = [c for _, c in contrasts_in(loosen_image(image, looseness)[0])]
        return found

    def _contrasts(
        self,
        picture: Picture,
        source: ImageRecord,
        objects: Sequence[Instance],
        labels: Sequence[Instance],
        key: str,
    ) -> list[tuple[Instance, ObjectContrast]]:
        """Return the contrasts of the objects of the wanted classes; objects with too small a ring are left out."""
        level = float(np.median(picture))
        time = source.capture.time_of_day or "unknown"
        return [
            (i, ObjectContrast(i.category, key, time, contrast, level))
            for i in objects
            if i.category in self._settings.categories and (contrast := object_contrast(picture, i, labels)) is not None
        ]

    def _all_of(
        self,
        population: str,
        picture: Picture,
        source: ImageRecord,
        labels: Sequence[Instance],
        objects: Sequence[Instance],
        key: str,
    ) -> Measurements:
        """Measure the features of the wanted classes; `labels` are all labels of the picture."""
        found = Measurements()
        where = Labels(picture.shape, labels)
        for number, instance in enumerate(objects):
            if instance.category not in self._settings.categories:
                continue
            reason = reason_not_measured(instance, where)
            if reason:
                found.leave_out(population, instance.category, reason)
            else:
                measured = _measure(picture, instance, where.free, source, f"{key}#{number}")
                found.objects[population].append(measured)
        return found

    def _controls(self, source: ImageRecord, numbers: Sequence[int]) -> Measurements:
        found = Measurements()
        key = image_key(source)
        levels = self._settings.levels
        background = load_background(source.path, source.size_wh)
        picture = eight_bit(background.pixels, levels)
        chosen = [(n, source.instances[n]) for n in numbers]
        controls = paste_controls(picture, Labels(picture.shape, source.instances), chosen, key)
        for n, i in chosen:
            if n not in controls.labels:
                found.leave_out("floor", i.category, "no_place")
        for population, pasted in (("floor", controls.real), ("hard_paste", controls.flat)):
            pixels = from_eight_bit(pasted, background.pixels.dtype, levels)
            saved = eight_bit(_after_saving(pixels, background, self._recipe.output.image), levels)
            for n, i in sorted(controls.labels.items()):
                found.objects[population].append(_measure(saved, i, controls.free, source, f"{key}#{n}"))
        return found

    def _rendered_again(self, source: ImageRecord, record: FrameRecord, numbers: Sequence[int]) -> Measurements:
        """Measure inserted objects with one more step of the sensor chain each time; the frame is rendered once."""
        found = Measurements()
        fitted = record.facts.get("sensor")
        assert fitted is not None and record.scene is not None and record.mapping is not None
        background = load_background(source.path, source.size_wh)
        scene = rebuild_scene(record.scene, {o.model: load_model(o.model) for o in record.scene.objects})
        if self._renderer is None:
            self._renderer = make_renderer(self._settings.renderer, self._settings.device)
        rendered = self._renderer.render(scene)
        mapping = GreyMapping.from_json(record.mapping)
        free = Labels(background.pixels.shape, [*_kept_of(source, record), *record.inserted]).free
        front = recorded_front(record.facts, background.pixels, rendered)
        for step, sensor in sensor_steps(Sensor.from_json(fitted)).items():
            # The motion tail belongs to the optics, which the first step leaves out.
            motion_px = (0.0, 0.0) if step == SENSOR_STEPS[0] else record.scene.motion_px
            pixels = overlay(rendered, background.pixels, mapping, self._recipe.overlay, sensor, motion_px, front)
            saved = _after_saving(pixels, background, self._recipe.output.image)
            picture = eight_bit(saved, self._settings.levels)
            for n in numbers:
                measured = _measure(picture, record.inserted[n], free, source, f"{record.frame_id}#{n}")
                found.objects[step].append(measured)
        return found


def image_key(image: ImageRecord) -> str:
    """Return `<split>/<id>`, which is unique in the dataset."""
    return f"{image.split}/{image.id}"


def _kept_of(source: ImageRecord, record: FrameRecord) -> list[Instance]:
    return [source.instances[k] for k in record.kept]


def _extents(
    picture: Picture, drawn: Sequence[tuple[Instance, ObjectContrast]], labels: Sequence[Instance]
) -> list[BoxExtent]:
    extents = (box_extent(picture, instance, labels, contrast) for instance, contrast in drawn)
    return [extent for extent in extents if extent is not None]


def _measure(picture: Picture, instance: Instance, free: Bool, source: ImageRecord, key: str) -> Measured:
    return measure(picture, instance, free, key=key, group=image_key(source), altitude_m=source.capture.altitude_m)


def _after_saving(pixels: GreyImage, like: Background, kind: SaveKind) -> GreyImage:
    with Image.open(io.BytesIO(encode_image(pixels, like, kind))) as picture:
        saved = np.array(picture)
    grey = saved if saved.ndim == 2 else saved[..., 0]
    return np.asarray(grey, np.uint8) if like.pixels.dtype == np.uint8 else np.asarray(grey, np.uint16)
