"""The images of an evaluation: those of the split, what their reader rejected, and the groups drawn together."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import PurePosixPath

from infrablend.core.dataset import Dataset, ImageRecord, Split
from infrablend.errors import DatasetError, Problem
from infrablend.evaluation.truth import image_key
from infrablend.formats.capture import facts_from_name
from infrablend.formats.groups import GROUPINGS, background_stem, group_images

_SPLIT_WORDS: Mapping[str, Split] = {
    "train": "train", "training": "train", "val": "val", "valid": "val", "validation": "val", "test": "test",
    "testing": "test",
}  # fmt: skip


def rejected_in(dataset: Dataset, split: str) -> list[Problem]:
    """Return the errors of the reader in a split, without those that surely belong to another one.

    An error names a file only. Its split is that of its folder, that of the picture with its name, or, for JSON of
    many pictures, the one in the file name, as in `instances_val2017.json`.
    """
    of_stem: dict[str, set[str]] = {}
    for image in dataset.images:
        of_stem.setdefault(PurePosixPath(image.name).stem, set()).add(image.split)

    def splits(p: Problem) -> set[str]:
        path = PurePosixPath(p.where.partition(": ")[0])
        folders: set[str] = {_SPLIT_WORDS[f.lower()] for f in path.parts[:-1] if f.lower() in _SPLIT_WORDS}
        words = re.split(r"[^a-z]+", path.stem.lower()) if path.suffix == ".json" else []
        return folders or of_stem.get(path.stem) or {_SPLIT_WORDS[w] for w in words if w in _SPLIT_WORDS} or {split}

    return [p for p in dataset.problems if p.severity == "error" and split in splits(p)]


def image_groups(images: Sequence[ImageRecord], by: str, problems: list[Problem]) -> tuple[str, ...]:
    """Return the group of each image. Configurations of one background and the background itself share one."""
    if by == "image":
        return _frames(images)
    kind = next(b for b in GROUPINGS if b == by)
    try:
        groups = group_images(images, kind)
    except DatasetError as error:
        todo = "take --group image, gap or date, whichever the dataset says"
        problems += [replace(p, where="--group", todo=todo) for p in error.problems]
        return ()
    of = {image_key(i): name for name, group in groups.items() for i in group}
    return tuple(of[image_key(i)] for i in images)


def _frames(images: Sequence[ImageRecord]) -> tuple[str, ...]:
    """Return the frame that each image shows: its own key, or one name for an original and all images made of it."""
    backgrounds, made = [], []
    for image in images:
        key = PurePosixPath(image_key(image))
        background = background_stem(key.stem)
        backgrounds.append(str(key.with_name(background)))
        made.append(background != key.stem)
    sizes = Counter(backgrounds)
    names = {b: f"frame {b}" for b, m in zip(backgrounds, made, strict=True) if m and sizes[b] > 1}
    for image, background in zip(images, backgrounds, strict=True):
        facts = facts_from_name(image.name)
        if facts is not None and facts.configuration is not None:  # its number is the frame's in the whole dataset
            names[background] = f"frame {facts.frame}"
    return tuple(names.get(b, image_key(i)) for i, b in zip(images, backgrounds, strict=True))
