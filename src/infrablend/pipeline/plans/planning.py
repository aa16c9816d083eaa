"""Makes the plan of a run from a recipe and a dataset, with the sequences of a run whose objects move."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from infrablend import __version__
from infrablend.annotation.classes import ignored_turned_objects, rename_classes
from infrablend.assets.user_model import description_digest, is_description
from infrablend.config.recipe import AUTO, NOT_IN_KEY, Recipe
from infrablend.core.dataset import Category, Dataset, ImageRecord
from infrablend.core.file_names import distinct_names, file_name, fit_name
from infrablend.core.files import sha256_of_json
from infrablend.core.mesh import FloatArray
from infrablend.errors import DatasetError, Problem
from infrablend.formats import dataset_folder
from infrablend.formats.labels.mot import ASSUMED_RATE
from infrablend.formats.pictures.temperature_scale import OPTIONS
from infrablend.formats.read_write import Reading
from infrablend.imaging.surfaces import model_version
from infrablend.pipeline.datasets.content import fingerprint
from infrablend.pipeline.plans.checks import (
    data_warnings,
    dataset_remarks,
    require_classes,
    require_distinct_classes,
    require_ids,
    require_loosened,
    require_movable,
    require_options,
    require_pitch_of_pixels,
    unknown_by_hand,
    without_effect,
    without_mask,
)
from infrablend.pipeline.plans.labelled_height import height_problems
from infrablend.pipeline.plans.left_out import all_in_colour, usable_images
from infrablend.pipeline.plans.models import ready_model
from infrablend.pipeline.plans.own_boxes import OwnBoxes, with_measured_boxes
from infrablend.pipeline.plans.plan import PlannedFrame, PlannedSequence, RunPlan
from infrablend.pipeline.plans.scenes import CHOICE, choose_scenes
from infrablend.pipeline.plans.selection import ALL_FRAMES, FrameSelection, find_frames
from infrablend.pipeline.plans.sequence_motion import VERSION as MOTION_VERSION
from infrablend.pipeline.plans.sequence_motion import Follow, find_motion, motion_problems, sequences_of
from infrablend.pipeline.plans.times import time_warnings, with_clock_times, with_used_times
from infrablend.pipeline.storage.store import local_folder
from infrablend.sampling.scene_sampler import require_parts
from infrablend.sampling.tracks import Footage

LEVELS_SAMPLE = 64


def plan_folder(
    recipe: Recipe, data: Path, seed: int, reading: Reading, selection: FrameSelection, warnings: Sequence[Problem]
) -> RunPlan:
    """Read the backgrounds in a folder or at an address, and return the plan of a run on them.

    `warnings` are those about the recipe. The errors are those of `make_plan`, and of reading the dataset.
    """
    root = local_folder(data)
    dataset = dataset_folder.read(root, reading_for(recipe, reading, root))
    return make_plan(recipe, dataset, seed, splits=reading.splits, selection=selection, recipe_warnings=warnings)


def make_plan(
    recipe: Recipe,
    dataset: Dataset,
    seed: int,
    *,
    splits: Sequence[str] | None = None,
    selection: FrameSelection = ALL_FRAMES,
    recipe_warnings: Sequence[Problem] = (),
    own_boxes: OwnBoxes | None = None,
    follow: Follow = find_motion,
) -> RunPlan:
    """Return the plan of a run on the backgrounds of the requested splits, which `splits` names in messages only.

    `own_boxes` are those of the dataset, where they have been measured before or its pictures are not files. `follow`
    says how the camera moves through a sequence.

    Raises:
        ArgumentError: The selection names a frame that does not exist.
        DatasetError: No background is left.
        RecipeError: A model does not have an option of the recipe, or the dataset lacks a category that it names.
        ModelError: A model does not exist, or lacks a part that the recipe names.
    """
    models = {o.model: ready_model(o.model) for o in recipe.objects}
    require_parts(recipe, models)
    require_options(recipe, models)
    classes = [o.category or models[o.model].category for o in recipe.objects]
    require_loosened(recipe, {*classes})
    require_classes(recipe, "labels.rename", recipe.labels.rename, dataset)
    timed = with_used_times(dataset, recipe)
    timed = with_clock_times(timed) if recipe.in_sequences else timed
    renamed = rename_classes(timed, recipe.labels.rename)
    require_classes(recipe, "labels.keep_categories", recipe.labels.keep_categories or (), renamed)
    require_distinct_classes(recipe, classes, renamed)
    recipe, boxes = with_measured_boxes(recipe, classes, own_boxes or OwnBoxes(dataset))

    stands = all(m.stands for m in models.values())
    recipe, request = _with_scenes(recipe, classes, renamed, selection, stands)
    names = frame_names(renamed.images, recipe)
    images = selection.backgrounds(renamed.images, seed)
    chosen = None
    if selection.frames is not None:
        chosen = find_frames(selection.frames, renamed.images, names)
        images = _images_of(chosen, images)
    height = height_problems(recipe, timed.images) if any(m.stands for m in models.values()) else []
    usable, left_out = usable_images(recipe, renamed, images, stands)
    problems = [
        *recipe_warnings,
        *without_effect(recipe, models),
        *dataset_remarks(recipe, renamed),
        *ignored_turned_objects(timed, recipe.labels.rename),
        *left_out,
    ]
    if not usable:
        of_splits = f" of split {', '.join(splits)}" if splits else ""
        reasons = [*all_in_colour(images), *problems]
        raise DatasetError(f"{dataset.root}: no usable background in {len(images)} image(s){of_splits}", reasons)
    if selection.pictures is not None:
        chosen = selection.share_out(usable, recipe.output.originals, seed)
        usable = _images_of(chosen, usable)
        recipe = recipe.model_copy(update={"configurations": 1 + max(k or 0 for _, k in chosen)})
        names = frame_names(renamed.images, recipe)
    problems = [*height, *problems, *_warnings(recipe, dataset, renamed, usable)]

    as_read = {id(new): old for old, new in zip(timed.images, renamed.images, strict=True)}
    frames = [
        PlannedFrame(image, k, as_read[id(image)], names[id(image), k])
        for image in usable
        for k in _configurations(recipe.output.originals, recipe.scenes)
        if chosen is None or (id(image), k) in chosen
    ]
    sequences: dict[str, PlannedSequence] = {}
    if recipe.in_sequences:
        require_movable(recipe, models)
        anchors, _ = usable_images(recipe, renamed, renamed.images, stands)
        sequences, unknown = plan_sequences(renamed, as_read, usable, anchors, follow)
        problems += unknown
    used = replace(renamed, images=tuple(usable))
    categories = _with_new(renamed.categories, classes)
    key = _key(recipe, seed, used) | _selected(selection, frames)
    return RunPlan(
        recipe=recipe,
        seed=seed,
        dataset=used,
        models=models,
        categories=categories,
        new_categories=tuple(c.name for c in categories[len(renamed.categories) :]),
        frames=tuple(frames),
        problems=tuple(problems),
        key=key,
        ignored=tuple(c.name for c in timed.categories if c.ignore),
        sample=renamed.images[:: max(1, len(renamed.images) // LEVELS_SAMPLE)][:LEVELS_SAMPLE],
        run=sha256_of_json([{**key["recipe"], "description": None}, seed])[:16],
        request=request,
        sequences=sequences,
        boxes=boxes,
    )


def _images_of(chosen: Set[tuple[int, int | None]], images: Sequence[ImageRecord]) -> list[ImageRecord]:
    """Return the images of frames that are given by `id(image)` and configuration."""
    wanted = {image for image, _ in chosen}
    return [image for image in images if id(image) in wanted]


def _warnings(recipe: Recipe, read: Dataset, renamed: Dataset, usable: Sequence[ImageRecord]) -> list[Problem]:
    """Return warnings about the backgrounds that are used; refuse those whose labels no format of the recipe holds.

    Raises:
        RecipeError, DatasetError: See `require_ids`, `require_pitch_of_pixels`.
    """
    problems = [
        *data_warnings(recipe, usable, read.root),
        *time_warnings(recipe, read.images, usable),
        *without_mask(recipe, usable, renamed.images),
        *unknown_by_hand(recipe, renamed.images),
    ]
    require_ids(recipe, usable)
    require_pitch_of_pixels(recipe, usable)
    return problems


def _with_new(known: Sequence[Category], classes: Iterable[str]) -> tuple[Category, ...]:
    categories = list(known)
    for name in classes:
        if name not in {c.name for c in categories}:
            categories.append(Category(max((c.id for c in categories), default=-1) + 1, name))
    return tuple(categories)


def _selected(selection: FrameSelection, frames: Sequence[PlannedFrame]) -> dict[str, Any]:
    """Return the choice of frames that recipe, seed and backgrounds do not determine, for the key of a run."""
    if selection.frames is not None:
        return {"frames": sorted(frame.frame_id for frame in frames)}
    return {} if selection.pictures is None else {"pictures": selection.pictures}


def _key(recipe: Recipe, seed: int, used: Dataset) -> dict[str, Any]:
    """Return what must match for a run to be resumed, with any choice of frames."""
    key: dict[str, Any] = {
        "version": __version__,
        # Whether a height is accepted does not change frames.
        "recipe": json.loads(recipe.model_dump_json(exclude={"output": NOT_IN_KEY, "camera": {"accept_height"}})),
        "seed": seed,
        "backgrounds": fingerprint(used),
    }
    if recipe.placement.surfaces is not None:
        key["places"] = model_version()
    if recipe.in_sequences:
        key["motion"] = MOTION_VERSION
    if own := {o.model: description_digest(Path(o.model)) for o in recipe.objects if is_description(o.model)}:
        key["models"] = own
    return key


def _with_scenes(
    recipe: Recipe, classes: Sequence[str], dataset: Dataset, selection: FrameSelection, stands: bool
) -> tuple[Recipe, dict[str, object]]:
    """Return a recipe with a number in place of `configurations: auto`, and what the run's request says of it."""
    if recipe.configurations != AUTO:
        return recipe, {}
    # Of all backgrounds, so that a choice of frames gives those of a full run.
    of_all, _ = usable_images(recipe, dataset, dataset.images, stands)
    scenes = choose_scenes(recipe, classes, of_all)
    chosen = recipe.model_copy(update={"configurations": scenes.number})
    if selection.pictures is not None:  # which replaces the number
        return chosen, {}
    part = "" if selection == ALL_FRAMES else "as in a run of all frames: "
    return chosen, {CHOICE: part + scenes.describe()}


def _configurations(originals: bool, count: int) -> list[int | None]:
    """Return the configurations of a background in the order of its frames; None is the unchanged background."""
    return [*([None] if originals else []), *range(count)]


def frame_names(images: Sequence[ImageRecord], recipe: Recipe) -> dict[tuple[int, int | None], str]:
    """Return the name of every frame by `id(image)` and configuration; names are unique in each split.

    Frames of sequences have the name of their sequence and six digits, if objects move through them.

    Backgrounds whose ids look like names of frames (`a` and `a_c0`, when earlier output is used as input), or differ in
    case alone, would otherwise share files. Unchanged backgrounds keep their name, and of other equal names the first
    frame keeps it. The names depend on all backgrounds of the split, so that `--limit` does not change them.
    """
    names: dict[tuple[int, int | None], str] = {}
    originals = recipe.output.originals
    count = recipe.scenes

    def name_of(i: ImageRecord, k: int | None) -> str:
        name = fit_name(i.id)
        c = i.capture
        if recipe.in_sequences and c.sequence is not None and c.frame is not None:
            name = fit_name(f"{file_name(c.sequence)}_{c.frame:06d}")
            if count == 1 and not originals:
                return name
        return name if k is None else f"{name}_c{k}"

    for split in dict.fromkeys(i.split for i in images):
        of_split = [i for i in images if i.split == split]
        frames = [(i, k) for k in _configurations(originals, 0) for i in of_split]
        frames += [(i, k) for i in of_split for k in range(count)]
        found = distinct_names([name_of(i, k) for i, k in frames])
        names |= {(id(i), k): name for (i, k), name in zip(frames, found, strict=True)}
    return names


def reading_for(recipe: Recipe, reading: Reading, root: Path) -> Reading:
    """Return how to read backgrounds for a recipe: with its temperature scale, and with every frame for its tracks.

    What the options of the reading state comes first.
    """
    if recipe.in_sequences:
        reading = dataset_folder.with_every_frame(reading, root)
    stated = {k: str(v) for k, v in recipe.data.model_dump().items() if v is not None}
    if not stated or any(name in reading.options for name in OPTIONS):
        return reading
    return replace(reading, options={**reading.options, **stated})


log = logging.getLogger(__name__)


def plan_sequences(
    dataset: Dataset, as_read: Mapping[int, ImageRecord], used: Sequence[ImageRecord], anchors: Sequence[ImageRecord],
    follow: Follow = find_motion,
) -> tuple[dict[str, PlannedSequence], list[Problem]]:  # fmt: skip
    """Return the sequences that some used pictures belong to, by name, and what is not known of them.

    Args:
        dataset: All pictures: what a frame shows must not depend on the choice of frames.
        as_read: The same with the source's own names of classes, by `id`.
        used: Pictures that a run uses.
        anchors: Those of all pictures that a run could use, and so place objects in.
        follow: How the camera moves through a sequence.

    Raises:
        DatasetError: No picture belongs to a sequence, or a picture cannot be read.
    """
    of_use, of_place = ({(i.split, i.id) for i in images} for images in (used, anchors))
    found = {}
    problems = []
    for name, images in sequences_of(dataset).items():
        if not any((i.split, i.id) in of_use for i in images):
            continue
        log.info("sequence %s: following the camera through %d frames", name, len(images))
        motion = follow(name, images)
        times = _times_s(images)
        is_timed = times is not None
        if times is None:
            lacks = any(i.capture.time_s is None for i in images)
            found_times = "no time stamps" if lacks else "time stamps that do not rise from frame to frame"
            text = f"{found_times}; {ASSUMED_RATE:g} frames per second are assumed, and blur longer than an object is "
            text += "left out"
            todo = "a table with time_s, or captured with seconds"
            problems.append(Problem(f"sequence {name}", "frame-rate", text, "seconds of each frame", todo, "warning"))
            times = np.array([(i.capture.frame or 0) / ASSUMED_RATE for i in images])
        problems += motion_problems(motion)
        frames = tuple(PlannedFrame(i, 0, as_read[id(i)], i.id) for i in images)
        ids = {str(i.track_id) for image in images for i in image.instances if i.track_id is not None}
        numbers = [int(i) for i in ids if i.isdecimal() and i.isascii()]  # texts such as "1" count, too
        footage = Footage(motion.in_own_levels(), times, motion.size_wh, motion.other_sizes_wh, is_timed)
        # Formats with numbers from 1 give the others, such as 0, the numbers between.
        others = len(ids) - sum(n > 0 for n in numbers)
        without_place = frozenset(n for n, i in enumerate(images) if (i.split, i.id) not in of_place)
        found[name] = PlannedSequence(name, frames, footage, max(numbers, default=0) + others + 1, without_place)
    single = sum(i.capture.sequence is None or i.capture.frame is None for i in used)
    if single:
        text = f"{single} picture(s) of no sequence get objects of their own, without tracks"
        problems.append(Problem("pictures", "no-sequence", text, "clips or numbered frames", severity="warning"))
    return found, problems


def _times_s(images: Sequence[ImageRecord]) -> FloatArray | None:
    """Return the seconds of the frames; None unless all are known and in order."""
    times = [i.capture.time_s for i in images]
    known = np.array([t for t in times if t is not None], np.float64)
    return known if len(known) == len(times) and (np.diff(known) > 0).all() else None
