"""Makes the plan of a run from a recipe and a dataset."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from infrablend import __version__
from infrablend.annotation.classes import ignored_turned_objects, rename_classes
from infrablend.assets.user_model import description_digest, is_description
from infrablend.config.agc import FixedAgc
from infrablend.config.recipe import (
    NOT_IN_KEY,
    RadiometricMatching,
    Recipe,
)
from infrablend.core.dataset import Category, Dataset, ImageRecord
from infrablend.core.file_names import as_text, distinct_names, fit_name, is_text
from infrablend.core.files import sha256_of_json
from infrablend.errors import DatasetError, Problem
from infrablend.formats.detection import DATASET_INSIDE
from infrablend.formats.temperatures import IMPLAUSIBLE, implausible_scales
from infrablend.pipeline.backgrounds import is_ground
from infrablend.pipeline.frame_selection import ALL_FRAMES, FrameSelection, find_frames
from infrablend.pipeline.left_out import Telemetry, above_horizon, place_of, scale_missing, telemetry_missing
from infrablend.pipeline.models import ready_model
from infrablend.pipeline.plan import PlannedFrame, RunPlan
from infrablend.pipeline.plan_checks import (
    other_lens,
    other_pitch,
    require_classes,
    require_ids,
    require_loosened,
    require_options,
    sun_unused,
    unknown_by_hand,
    without_effect,
)
from infrablend.sampling.scene import require_parts

LEVELS_SAMPLE = 64


def make_plan(
    recipe: Recipe,
    dataset: Dataset,
    seed: int,
    *,
    splits: Sequence[str] | None = None,
    selection: FrameSelection = ALL_FRAMES,
    recipe_warnings: Sequence[Problem] = (),
) -> RunPlan:
    """Return the plan of a run.

    Args:
        recipe: Recipe of the run.
        dataset: Backgrounds of the requested splits.
        seed: Seed of the run.
        splits: Requested splits, for error messages only.
        selection: Frames to produce.
        recipe_warnings: Warnings from reading the recipe.

    Raises:
        ArgumentError: The selection names a frame that does not exist.
        DatasetError: No background is left.
        RecipeError: A model does not have an option of the recipe, or the dataset lacks a category that it names.
        ModelError: A model does not exist, or lacks a part that the recipe names.
    """
    models = {o.model: ready_model(o.model) for o in recipe.objects}
    require_parts(recipe, models)
    require_options(recipe, models)
    require_classes(recipe, "labels.rename", recipe.labels.rename, dataset)
    ignored = tuple(c.name for c in dataset.categories if c.ignore)
    renamed = rename_classes(dataset, recipe.labels.rename)
    turned = ignored_turned_objects(dataset, recipe.labels.rename)
    as_read = {id(new): old for old, new in zip(dataset.images, renamed.images, strict=True)}
    dataset = renamed
    require_classes(recipe, "labels.keep_categories", recipe.labels.keep_categories or (), dataset)
    names = frame_names(dataset.images, recipe.output.originals, recipe.configurations)
    images, chosen = selection.backgrounds(dataset.images, seed), None
    if selection.frames is not None:
        chosen = find_frames(selection.frames, dataset.images, names)
        of_chosen = {image for image, _ in chosen}
        images = [image for image in images if id(image) in of_chosen]
    remarks = dataset.problems
    if whole := [p for p in remarks if p.code == DATASET_INSIDE]:
        # Their labels would be lost, and their objects become unlabelled background.
        raise DatasetError(f"{dataset.root}: a folder of datasets, not of one dataset", whole)
    if isinstance(recipe.matching, RadiometricMatching) and any(p.code == IMPLAUSIBLE for p in remarks):
        # The recipe may know better than the files that the pictures show the sky.
        if implausible := implausible_scales(dataset, lambda image: is_ground(image, recipe)):
            refused = [replace(p, severity="error") for p in implausible]
            raise DatasetError(f"{dataset.root}: temperatures that no scene has", refused)
        remarks = tuple(p for p in remarks if p.code != IMPLAUSIBLE)
    problems = [*recipe_warnings, *without_effect(recipe, models), *remarks, *turned]
    usable = []
    stands = all(model.stands for model in models.values())
    others = Telemetry.of(dataset)
    for image in images:
        if not is_text(image.path.name) or not is_text(image.id):
            problems.append(
                Problem(
                    as_text(f"{image.split}/{image.path.name}"),
                    "name-not-utf8",
                    "a file name that is not UTF-8",
                    "a name that labels in JSON can hold",
                    "rename the file",
                )
            )
        elif image.extra.get("modality") == "visible":
            problems.append(
                Problem(
                    place_of(image),
                    "image-visible",
                    "a picture of visible light",
                    "a thermal picture as background",
                    "use its labels only (infrablend convert), or use another dataset",
                )
            )
        elif unknown := telemetry_missing(recipe, image, others) or (above_horizon(recipe, image) if stands else None):
            problems.append(unknown)
        elif (isinstance(recipe.matching, RadiometricMatching) or isinstance(recipe.output.agc, FixedAgc)) and (
            image.capture.radiometry is None or not image.capture.scale
        ):
            problems.append(scale_missing(image, recipe, dataset))
        else:
            usable.append(image)
    if not usable:
        raise DatasetError(
            f"{dataset.root}: no usable background in {len(images)} image(s)"
            + (f" of split {', '.join(splits)}" if splits else ""),
            problems,
        )
    if recipe.labels.mode == "merged" and not any(image.instances for image in usable):
        found = "no labels in any image, so objects in the backgrounds stay unlabelled"
        todo = "check --data, or set labels.mode to new if the data has no labels"
        problems.append(Problem(dataset.root.name, "no-labels", found, "labels to merge with", todo, "warning"))
    problems += other_lens(recipe, usable) + other_pitch(recipe, usable) + sun_unused(recipe, usable)
    require_ids(recipe, usable)
    categories = list(dataset.categories)
    new = []
    for o in recipe.objects:
        name = o.category or models[o.model].category
        if name not in {c.name for c in categories}:
            new.append(name)
            categories.append(Category(max((c.id for c in categories), default=-1) + 1, name))
    require_loosened(recipe, {o.category or models[o.model].category for o in recipe.objects})
    problems += unknown_by_hand(recipe, dataset.images)
    frames = [
        PlannedFrame(image, k, as_read[id(image)], names[id(image), k])
        for image in usable
        for k in _configurations(recipe.output.originals, recipe.configurations)
        if chosen is None or (id(image), k) in chosen
    ]
    trimmed = Dataset(
        dataset.root, dataset.format, dataset.categories, tuple(usable), dataset.problems, dataset.notes, dataset.extra,
        dataset.markers,
    )  # fmt: skip
    key = {
        "version": __version__,
        "recipe": json.loads(recipe.model_dump_json(exclude={"output": NOT_IN_KEY})),
        "seed": seed,
        "backgrounds": fingerprint(trimmed),
    }
    if chosen is not None:
        key["frames"] = sorted(frame.frame_id for frame in frames)
    if own := {o.model: description_digest(Path(o.model)) for o in recipe.objects if is_description(o.model)}:
        key["models"] = own
    return RunPlan(
        recipe,
        seed,
        trimmed,
        models,
        tuple(categories),
        tuple(new),
        tuple(frames),
        tuple(problems),
        key,
        ignored,
        dataset.images[:: max(1, len(dataset.images) // LEVELS_SAMPLE)][:LEVELS_SAMPLE],
        run=_identity(key),
    )


def _identity(key: Mapping[str, Any]) -> str:
    deciding = {**key["recipe"], "description": None}
    return sha256_of_json([deciding, key["seed"]])[:16]


def _configurations(originals: bool, count: int) -> list[int | None]:
    """Return the configurations of a background in the order of its frames; None is the unchanged background."""
    return [*([None] if originals else []), *range(count)]


def frame_names(images: Sequence[ImageRecord], originals: bool, count: int) -> dict[tuple[int, int | None], str]:
    """Return the name of every frame by `id(image)` and configuration; names are unique in each split.

    Backgrounds whose ids look like names of frames (`a` and `a_c0`, when earlier output is used as input), or differ in
    case alone, would otherwise share files. Unchanged backgrounds keep their name, and of other equal names the first
    frame keeps it. The names depend on all backgrounds of the split, so that `--limit` does not change them.
    """
    names: dict[tuple[int, int | None], str] = {}
    for split in dict.fromkeys(i.split for i in images):
        of_split = [i for i in images if i.split == split]
        frames = [(i, k) for k in _configurations(originals, 0) for i in of_split]
        frames += [(i, k) for i in of_split for k in range(count)]
        found = distinct_names([fit_name(i.id) if k is None else f"{fit_name(i.id)}_c{k}" for i, k in frames])
        names |= {(id(i), k): name for (i, k), name in zip(frames, found, strict=True)}
    return names


def fingerprint(dataset: Dataset) -> str:
    """Return a digest of the images and labels of a dataset. Pixels are excluded: each frame's record covers those."""
    digest = hashlib.sha256()
    for c in dataset.categories:
        digest.update(f"{c.id}\x1f{c.name}\x1e".encode())
    for image in dataset.images:
        digest.update(repr((image.id, image.split, image.size_wh, image.capture)).encode())
        for i in image.instances:
            digest.update(i.category.encode() + i.box_xyxy.tobytes())
            if i.corners_xy is not None:
                digest.update(i.corners_xy.tobytes())
    return digest.hexdigest()
