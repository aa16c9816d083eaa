"""Reads a run in packed shards: labels from the tars, pictures by way of the user's cache folder.

shards.json   shard-00001-of-00002.tar   shard-00001-of-00002.parquet   shard-00001-of-00002.json   ...
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from infrablend.core.dataset import Category, Dataset, ImageRecord
from infrablend.core.files import read_object, write_bytes
from infrablend.core.finished import COMPLETE
from infrablend.core.run_layout import SHARDS_FILE, ShardFiles
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import Match, check_splits, shorten, sort_images
from infrablend.formats.derived import derived_folder
from infrablend.formats.pictures import assign_ids
from infrablend.formats.shard_tar import image_of, packed_frames

NAME = "shards"
TAKES_TABLE = False  # the labels contain pitch and altitude
_MAKE_AGAIN = "make the shard again: repeat its command with --resume"
_DAMAGED = (LookupError, TypeError, ValueError, AttributeError, RecursionError)


def detect(root: Path) -> Match:
    """Decide whether `root` is a run in packed shards."""
    plan = read_object(root / SHARDS_FILE) or {}
    if plan.get("layout") != "shards":
        return Match(NAME, False, f"no {SHARDS_FILE} of a run with output.layout: shards")
    return Match(NAME, True, f"{len(_markers(root))} shards in WebDataset form")


def _markers(root: Path) -> list[ShardFiles]:
    return [ShardFiles(root, p.stem) for p in sorted(root.glob("shard-*-of-*.json"))]


def read(root: Path, *, splits: Iterable[str] | None = None) -> Dataset:
    """Read the labels of every shard, and unpack the pictures that are not in the cache yet.

    Args:
        root: Folder of the run in shards.
        splits: Splits to read; None reads all.

    Raises:
        DatasetError: A shard is missing, damaged or of another run, or no frame can be read.
    """
    wanted = check_splits(splits)
    key = (read_object(root / SHARDS_FILE) or {}).get("key")
    found: list[ImageRecord] = []
    problems: list[Problem] = []
    categories: tuple[Category, ...] = ()
    shards = _markers(root)
    for files in shards:
        record = _record(files, key)
        categories = categories or _categories(files, record)
        known = {c.name for c in categories}
        folder = derived_folder(files.tar, NAME)
        for frame in packed_frames(files.tar):
            try:
                image = image_of(json.loads(frame.label), folder)
                if unknown := {i.category for i in image.instances} - known:
                    raise ValueError(f"category {min(map(str, unknown))!r} is not in {files.marker.name}")
            except _DAMAGED as error:
                where, text = f"{files.tar.name}: {frame.key}", f"{type(error).__name__}: {error}"
                problems.append(Problem(where, "annotation-layout", text, "labels as they were written", _MAKE_AGAIN))
                continue
            if image.split not in wanted:
                continue
            if not image.path.is_file():
                write_bytes(image.path, frame.image)
            found.append(image)
    if not found:
        raise DatasetError(
            f"{root}: no frame of {', '.join(sorted(wanted))} in {len(shards)} shards", shorten(problems)
        )
    ids = assign_ids(f"{i.split}/{i.name}" for i in found)
    images = sort_images(replace(i, id=ids[f"{i.split}/{i.name}"]) for i in found)
    return Dataset(root, NAME, categories, images, tuple(problems), {"labels": NAME, "shards": len(shards)})


def _record(files: ShardFiles, key: object) -> Mapping[str, Any]:
    """Return the record of a shard of a run with this key.

    Raises:
        DatasetError: The shard is not whole, or is one of another run.
    """
    record = read_object(files.marker) or {}
    try:
        sizes = {path: record["archive"][name]["bytes"] for path, name in ((files.tar, "tar"), (files.table, "table"))}
    except _DAMAGED:
        sizes = {}
    if record.get("status") != COMPLETE or not sizes:
        raise _broken(files.marker, "no record of a finished shard", "the record as it was written")
    if record.get("key") != key:
        raise _broken(files.marker, "a shard of another run", f"the run of {SHARDS_FILE}")
    for path, expected in sizes.items():
        if not path.is_file():
            raise _broken(path, "no such file", f"{expected} bytes")
        if path.stat().st_size != expected:
            raise _broken(path, f"{path.stat().st_size} bytes", f"{expected} bytes")
    return record


def _broken(path: Path, found: str, expected: str) -> DatasetError:
    problem = Problem(path.name, "shard-truncated", found, expected, _MAKE_AGAIN)
    return DatasetError(f"{path.parent}: a shard is not whole", [problem])


def _categories(files: ShardFiles, record: Mapping[str, Any]) -> tuple[Category, ...]:
    try:
        found = [Category(c["id"], c["name"], c["supercategory"], bool(c["ignore"])) for c in record["categories"]]
        if not all(
            type(c.id) is int and isinstance(c.supercategory, str) and isinstance(c.name, str) and c.name for c in found
        ):
            raise ValueError("a category without a number or a name")
    except _DAMAGED as error:
        raise _broken(files.marker, f"damaged categories ({error})", "the record as it was written") from error
    return tuple(found)
