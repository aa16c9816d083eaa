"""Frames in memory: composed on warm workers when they are asked for, without a run folder."""

from __future__ import annotations

import logging
import weakref
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infrablend.annotation.looseness import Looseness
from infrablend.config.loading import read_recipe
from infrablend.config.recipe import Recipe
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.frame_row import FrameRecord
from infrablend.core.scene import SceneSpec
from infrablend.core.tasks import TaskResult
from infrablend.errors import ArgumentError, Problem
from infrablend.formats import dataset_folder
from infrablend.formats.pictures.images import decode_image
from infrablend.formats.read_write import READ_ALL, Reading
from infrablend.pipeline.compose.composed import ComposedFrame, labelled_image
from infrablend.pipeline.compose.extensions import NO_EXTENSIONS, BackgroundSource, Extensions
from infrablend.pipeline.compose.frame_worker import FrameWorkers
from infrablend.pipeline.compose.settings import FrameSettings, settings_for
from infrablend.pipeline.plans.backgrounds import dataset_levels
from infrablend.pipeline.plans.labelled_height import require_height
from infrablend.pipeline.plans.own_boxes import OwnBoxes
from infrablend.pipeline.plans.plan import PlannedFrame
from infrablend.pipeline.plans.planning import make_plan, reading_for
from infrablend.pipeline.plans.run_request import DEFAULT_EXECUTION, Execution, Settings
from infrablend.pipeline.plans.selection import ALL_FRAMES, FrameSelection
from infrablend.pipeline.plans.sequence_motion import Follow, find_motion

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Frame:
    """A finished frame in memory, with the same picture and labels as in a run.

    Attributes:
        id: Id of the frame, `<split>/<name>`.
        pixels: (h, w) grey levels of the finished picture file, uint8 or uint16, read-only.
        labels: Labels: kept original ones, then inserted ones.
        scene: Camera, objects, temperatures and weather; None for an unchanged original.
        image: Metadata of the background: split, pitch, height, time of day.
        record: Record of the frame, as a run writes it: removed labels, gain, sensor and warnings.
        image_bytes: Picture file, the same bytes as in a run.
    """

    id: str
    pixels: NDArray[np.uint8] | NDArray[np.uint16]
    labels: tuple[Instance, ...]
    scene: SceneSpec | None
    image: ImageRecord
    record: FrameRecord
    image_bytes: bytes

    @property
    def inserted(self) -> tuple[Instance, ...]:
        """Labels of the inserted objects."""
        return tuple(i for i in self.labels if i.inserted)


def as_frame(planned: PlannedFrame, composed: ComposedFrame, recipe: Recipe) -> Frame:
    """Return a composed frame with decoded pixels, and labels as a run writes them."""
    record = composed.record
    image, _ = labelled_image(planned, record, Path(record.image), Looseness.of_labels(recipe.labels))
    pixels = decode_image(composed.image_bytes)
    pixels.setflags(write=False)
    return Frame(record.frame_id, pixels, image.instances, record.scene, image, record, composed.image_bytes)


@dataclass(frozen=True)
class FramesRequest:
    """Request for frames in memory.

    Attributes:
        recipe: Name of a shipped recipe, or path of a YAML file.
        data: Folder of the background dataset, a video, or a source of backgrounds.
        selection: Frames to offer.
        seed: Seed of every random stream, as of a run.
        settings: Recipe fields to set.
        reading: How to read `data`, if it is a folder.
        execution: Workers, device and renderer.
        extensions: The caller's own sampler and look.
        dataset: What is in `data`, where it has been read and changed.
        follow: How the camera moves through a sequence.
    """

    recipe: str | Path
    data: Path | BackgroundSource
    selection: FrameSelection = ALL_FRAMES
    seed: int = 0
    settings: Settings = ()
    reading: Reading = READ_ALL
    execution: Execution = DEFAULT_EXECUTION
    extensions: Extensions = NO_EXTENSIONS
    dataset: Dataset | None = None
    follow: Follow = find_motion


class Frames:
    """Frames of a recipe on a dataset, composed when they are asked for.

    Iterating yields them in the order of `ids`, ahead of the caller on all workers; `frames[id]` composes one. Nothing
    is written. Workers start with the first frame and stay until `close`, the end of a `with` block, or the end of the
    process. Backgrounds that cannot be used are left out, with a problem in `problems`.

    Attributes:
        ids: Ids of the frames, in the order of a run.
        backgrounds: Backgrounds of the frames with their own labels, by the id of the frame.
        categories: Classes of the labels.
        problems: Backgrounds that were left out, and warnings.
    """

    def __init__(self, request: FramesRequest) -> None:
        """Read recipe and backgrounds, and plan the frames.

        Raises:
            RecipeError, DatasetError, ModelError, ArgumentError: See `infrablend.errors`.
        """
        extensions = request.extensions
        source = request.data
        if isinstance(source, BackgroundSource):
            extensions = replace(extensions, backgrounds=source)
        if not request.execution.in_process:
            extensions.require_importable()
        self._workers = FrameWorkers(request.execution)
        self._close = weakref.finalize(self, self._workers.close)
        loaded = read_recipe(request.recipe, request.settings)
        if isinstance(source, BackgroundSource):
            if loaded.recipe.in_sequences:
                raise ArgumentError(
                    "data: a source of backgrounds, but objects with motion need the files of whole sequences; give "
                    "their folder or video, or leave out objects.N.motion"
                )
            dataset = source.dataset()
        elif request.dataset is not None:
            dataset = request.dataset
        else:
            dataset = dataset_folder.read(source, reading_for(loaded.recipe, request.reading, source))
        self._plan = make_plan(
            loaded.recipe, dataset, request.seed, splits=request.reading.splits, selection=request.selection,
            recipe_warnings=loaded.warnings, own_boxes=OwnBoxes(dataset, extensions.load), follow=request.follow,
        )  # fmt: skip
        levels = dataset_levels(self._plan, extensions.load) if self._plan.needs_levels else None
        self._settings = settings_for(self._plan, levels, request.execution, extensions=extensions)
        self._frames = {f.frame_id: f for f in self._plan.frames}
        self.ids: tuple[str, ...] = tuple(self._frames)
        self.backgrounds: dict[str, ImageRecord] = {f.frame_id: f.as_read for f in self._plan.frames}
        self.categories: tuple[Category, ...] = self._plan.categories
        require_height(self._plan.recipe, self._plan.problems)
        self.problems: list[Problem] = list(self._plan.problems)

    @property
    def inserted_classes(self) -> tuple[str, ...]:
        """Classes that the recipe inserts, in the order of its entries, each once."""
        models = self._plan.models
        return tuple(dict.fromkeys(o.category or models[o.model].category for o in self._plan.recipe.objects))

    @property
    def recipe(self) -> Recipe:
        """Recipe of the frames, with what was measured in the data."""
        return self._plan.recipe

    @property
    def seed(self) -> int:
        """Seed of the frames, unless `iterate` is given another."""
        return self._plan.seed

    def __len__(self) -> int:
        return len(self.ids)

    def __iter__(self) -> Iterator[Frame]:
        return self.iterate()

    def __getitem__(self, frame_id: str) -> Frame:
        """Compose one frame.

        Raises:
            KeyError: There is no such frame.
            InfraBlendError: It cannot be composed.
        """
        planned = self._frames[frame_id]
        composed = self._workers.compose_one(planned, self._settings)
        return as_frame(planned, composed, self._plan.recipe)

    def iterate(self, ids: Sequence[str] | None = None, seed: int | None = None) -> Iterator[Frame]:
        """Yield these frames in this order.

        Args:
            ids: Ids of the frames; None for all. An id may occur several times.
            seed: Seed of other objects on the same backgrounds; None for the seed of the frames.

        Raises:
            ArgumentError: There is no such frame.
            InfraBlendError: A frame cannot be composed for another reason than its background.
        """
        wanted = self.ids if ids is None else tuple(ids)
        unknown = [i for i in wanted if i not in self._frames]
        if unknown:
            raise ArgumentError(f"ids: found {unknown[0]!r}, expected one of the {len(self.ids)} frames in `ids`")
        return self._composed(wanted, self._settings if seed is None else replace(self._settings, seed=seed))

    def close(self) -> None:
        """End the workers."""
        self._close()

    def __enter__(self) -> Frames:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _composed(self, wanted: Sequence[str], settings: FrameSettings) -> Iterator[Frame]:
        """Yield frames in the order of `wanted`, which workers finish in another one."""
        early: dict[str, list[TaskResult]] = {}
        results = self._workers.compose((self._frames[i] for i in wanted), settings)
        for frame_id in wanted:
            while not early.get(frame_id):
                result = next(results)
                early.setdefault(result.key, []).append(result)
            result = early[frame_id].pop()
            if result.failure is None:
                yield as_frame(self._frames[frame_id], result.value, self._plan.recipe)
            elif result.failure.error == "DatasetError":
                new = [p for p in result.failure.problems if p not in self.problems]
                self.problems += new
                for problem in new:
                    log.warning("skipped background of %s: %s", frame_id, problem)
            else:
                raise result.failure.to_exception()
