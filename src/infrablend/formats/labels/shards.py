"""Reads a run in packed shards: labels from the tars, pictures by way of the user's cache folder.

shards.json   shard-00001-of-00002.tar   shard-00001-of-00002.parquet   shard-00001-of-00002.json   ...
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

from infrablend.core.dataset import Category, Dataset, ImageRecord
from infrablend.core.files import read_object, write_bytes
from infrablend.core.run_folder import SHARDS_FILE, ShardFiles
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import Match, check_splits, shorten, sort_images
from infrablend.formats.labels.shard_tar import image_of, packed_frames
from infrablend.formats.pictures.derived import derived_folder
from infrablend.formats.pictures.listing import assign_ids

NAME = "shards"
SOURCE = "source"
"""Origin of the pictures: a mapping in the records of shards, its JSON text in `Dataset.extra`."""
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

    Raises:
        DatasetError: A shard is missing, damaged or of another run, or no frame can be read.
    """
    frames = _Frames(root, check_splits(splits))
    found = list(frames.unpacked(lambda files: derived_folder(files.tar, NAME), again=False))
    frames.require_any(len(found))
    return frames.dataset(found)


def read_parts(root: Path, folder: Path, *, splits: Iterable[str] | None = None, most: int) -> Iterator[Dataset]:
    """Read the labels of every shard in parts, of which one is in memory; the arguments and errors are those of `read`.

    Args:
        root: Folder of the run in shards.
        folder: Empty folder for the pictures of one part; they are deleted when the next one is asked for.
        splits: Splits to read; None reads all.
        most: Largest number of frames of a part.
    """
    frames = _Frames(root, check_splits(splits))
    count = 0
    unpacked = frames.unpacked(lambda files: folder, again=True)
    while part := list(islice(unpacked, most)):
        count += len(part)
        yield frames.dataset(part)
        for image in part:
            image.path.unlink(missing_ok=True)
    frames.require_any(count)
    if frames.problems:  # of frames after the last one that could be read
        yield frames.dataset([])


def frame_count(root: Path) -> int:
    """Return the number of frames that the records of the shards state."""
    counts = (((read_object(files.marker) or {}).get("counts") or {}).get("frames") for files in _markers(root))
    return sum(n for n in counts if isinstance(n, int))


class _Frames:
    """Frames of all shards of a run.

    Attributes:
        problems: Problems of the frames since the last dataset.
    """

    def __init__(self, root: Path, wanted: Collection[str]) -> None:
        self._root = root
        self._wanted = wanted
        self._shards = _markers(root)
        count = (read_object(root / SHARDS_FILE) or {}).get("shards")
        if len(self._shards) != count:
            found = f"{len(self._shards)} of {count} shards"
            todo = (
                f"finish them, see infrablend status {shlex.quote(str(root))}; or merge those that are finished: "
                "infrablend merge --partial"
            )
            problem = Problem(str(root), "shards-unmerged", found, "all shards", todo)
            raise DatasetError(f"{root}: belongs to an unfinished run in shards", [problem])
        self._categories: tuple[Category, ...] = ()
        self._source: object = None
        self.problems: list[Problem] = []

    def unpacked(self, folder_of: Callable[[ShardFiles], Path], again: bool) -> Iterator[ImageRecord]:
        """Yield the frames that can be read, with their pictures in a folder; `again` replaces those that are there."""
        key = (read_object(self._root / SHARDS_FILE) or {}).get("key")
        for files in self._shards:
            record = _record(files, key)
            self._categories = self._categories or _categories(files, record)
            self._source = self._source or record.get(SOURCE)
            known = {c.name for c in self._categories}
            folder = folder_of(files)
            for frame in packed_frames(files.tar):
                try:
                    image = image_of(json.loads(frame.label), folder)
                    if unknown := {i.category for i in image.instances} - known:
                        raise ValueError(f"category {min(map(str, unknown))!r} is not in {files.marker.name}")
                except _DAMAGED as error:
                    where = f"{files.tar.name}: {frame.key}"
                    text = f"{type(error).__name__}: {error}"
                    self.problems.append(
                        Problem(where, "annotation-layout", text, "labels as they were written", _MAKE_AGAIN)
                    )
                    continue
                if image.split not in self._wanted:
                    continue
                if again or not image.path.is_file():
                    write_bytes(image.path, frame.image)
                yield image

    def require_any(self, count: int) -> None:
        if not count:
            found = f"no frame of {', '.join(sorted(self._wanted))} in {len(self._shards)} shards"
            raise DatasetError(f"{self._root}: {found}", shorten(self.problems))

    def dataset(self, found: Sequence[ImageRecord]) -> Dataset:
        ids = assign_ids(f"{i.split}/{i.name}" for i in found)
        images = sort_images(replace(i, id=ids[f"{i.split}/{i.name}"]) for i in found)
        problems = tuple(self.problems)
        self.problems = []
        notes = {"labels": NAME, "shards": len(self._shards)}
        # As JSON, because line breaks in other texts that are read are replaced.
        extra = {} if self._source is None else {SOURCE: json.dumps(self._source)}
        return Dataset(self._root, NAME, self._categories, images, problems, notes, extra)


def _record(files: ShardFiles, key: object) -> Mapping[str, object]:
    """Return the record of a shard of a run with this key.

    Raises:
        DatasetError: The shard is not whole, or is one of another run.
    """
    record = read_object(files.marker) or {}
    try:
        sizes = {path: record["archive"][name]["bytes"] for path, name in ((files.tar, "tar"), (files.table, "table"))}
    except _DAMAGED:
        sizes = {}
    if not sizes:
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
