"""Tells finished datasets of InfraBlend from unfinished ones by the `status` in the record of the command.

Commands that write a dataset write their record first, with the status `running`, and last, with the status `complete`.
Everything that reads a dataset checks this, because an unfinished dataset has pictures without labels.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend.core.file_names import leaves_folder, real_path
from infrablend.core.files import read_object, sha256_of
from infrablend.core.manifest import REPLACED
from infrablend.core.run_layout import EXCLUDED, LOGS, RUN_FILE, SCENES, SHARDS_FILE
from infrablend.core.typed_command import recorded_command, run_command
from infrablend.errors import DatasetError, Problem

CONVERT_FILE = "convert.json"
SPLIT_FILE = "split.json"
WORLD_FILE = "world.json"
DOWNLOAD_FOLDER = ".fetch"
"""Folder of an unfinished download."""
PLACED = ".ready.json"
"""End of the names of files in it that are there while the parts of a dataset are moved to their places."""
FRAMES_FILE = "frames.json"
TEMPERATURES_FILE = "temperatures.json"
COMPLETE = "complete"
EXCLUDING = "excluding"
"""Status of a run while frames are excluded or included."""
UNFINISHED = "folder-unfinished"


@dataclass(frozen=True)
class _Marker:
    """Record that marks a folder as finished."""

    file: str
    noun: str
    command: str


_MARKERS = (
    _Marker(RUN_FILE, "run", "infrablend generate ... --out {root} --resume"),
    _Marker(CONVERT_FILE, "conversion", "infrablend convert {source} {root} --to {format} ... --overwrite"),
    _Marker(WORLD_FILE, "virtual world", "infrablend world --out {root} ..."),
    _Marker(SPLIT_FILE, "split dataset", "infrablend split {source} {root} --by {by} ... --overwrite"),
    _Marker(FRAMES_FILE, "extraction of frames", "infrablend frames {source} --every {every} --out {root} --overwrite"),
    _Marker(
        TEMPERATURES_FILE, "extraction of temperatures", "infrablend temperatures {source} --out {root} --overwrite"
    ),
)


def require_finished(folder: Path) -> None:
    """Check that no unfinished run, conversion, split or extraction of frames wrote the folder or one around it.

    Raises:
        DatasetError: One did; the message names the command that finishes it.
    """
    inside = real_path(folder)
    # A dataset may be given by a folder at any depth of the one with the record: `RUN/coco`, `RUN/native/a/train`.
    for root in (inside, *inside.parents):
        for marker in _MARKERS:
            path = root / marker.file
            if not path.is_file():
                continue
            if leaves_folder(path, root):
                raise _linked(folder, path, marker)
            record = read_object(path)
            if record is not None and marker.file == RUN_FILE and "shard" in record:
                raise _in_shards(folder, path.parent.parent)
            damaged = record is None and (root / SCENES).is_dir()
            if damaged or (record is not None and not is_finished(record)):
                raise _unfinished(folder, path, marker, record)
        plan = read_object(root / SHARDS_FILE) or {}
        if "shards" in plan and plan.get("layout") != "shards":
            raise _in_shards(folder, root)
        if "shards" in plan and len(_shard_records(root)) != plan["shards"]:
            raise _lacks_shards(folder, root, plan["shards"])
        if any((root / DOWNLOAD_FOLDER).glob(f"*{PLACED}")):
            raise _half_placed(folder, root)


def markers_of(folder: Path) -> dict[str, str]:
    """Return what identifies each record of InfraBlend for a folder and those around it, by path.

    A record that is written again is another file, also if it has the same content.
    """
    inside = real_path(folder)
    paths = [root / m.file for root in (inside, *inside.parents) for m in _MARKERS]
    paths += _shard_records(inside)
    return {str(p): _identity(p) for p in paths if p.is_file() and not leaves_folder(p)}


def _identity(path: Path) -> str:
    status = path.stat()
    return f"{sha256_of(path)} {status.st_ino} {status.st_mtime_ns}"


def require_unchanged(folder: Path, markers: Mapping[str, str] | None) -> None:
    """Check that no command has written a dataset again while it was read.

    Args:
        folder: Folder of the dataset.
        markers: `markers_of` the folder before it was read; None if it was not read.

    Raises:
        DatasetError: One has.
    """
    if markers is None:
        return
    now = markers_of(folder)
    changed = sorted(p for p in {*markers, *now} if markers.get(p) != now.get(p))
    if changed:
        problems = [
            Problem(p, "folder-changed", "written again meanwhile", "the record as it was", "repeat the command")
            for p in changed
        ]
        raise DatasetError(f"{folder}: was written again while it was read", problems)


def kept_aside(folder: Path) -> frozenset[str]:
    """Return the names of folders in a dataset that InfraBlend wrote which hold no part of it; none for others.

    These are changed files that were replaced, frames left out, and logs.
    """
    own = any(_is_own(read_object(folder / m.file)) for m in _MARKERS if (folder / m.file).is_file())
    return frozenset({REPLACED, EXCLUDED, LOGS}) if own else frozenset()


def _is_own(record: Mapping[str, Any] | None) -> bool:
    return record is not None and "infrablend" in record


def is_finished(record: Mapping[str, Any]) -> bool:
    """Return whether a record says that its folder is finished; other programs and earlier versions wrote no status."""
    return "infrablend" not in record or record.get("status", COMPLETE) == COMPLETE


def finishing_command(root: Path, record: Mapping[str, Any] | None) -> str | None:
    """Return the command that finishes the run in a folder, None if its record is too damaged to tell.

    Where the record does not hold the command itself, as after a call in Python, RECIPE stands for the recipe.
    """
    if record is None:
        return None
    if record.get("status") == EXCLUDING:
        return shlex.join(["infrablend", "exclude", str(root)])
    if (command := recorded_command(record, root)) is not None:
        return command
    try:
        return shlex.join([*run_command(record, "RECIPE", str(record["data"]["root"]), str(root)), "--resume"])
    except (LookupError, TypeError, AttributeError):
        return None


def _in_shards(folder: Path, root: Path) -> DatasetError:
    problem = Problem(
        str(root),
        UNFINISHED,
        "shards of a run, which have no label files",
        "a dataset",
        f"merge them: infrablend merge {root} DST",
    )
    return DatasetError(f"{folder}: belongs to a run in shards; its labels are missing", [problem])


def _shard_records(root: Path) -> list[Path]:
    """Return the records of packed shards in a folder, each of which marks a shard as finished."""
    return sorted(root.glob("shard-*-of-*.json"))


def _lacks_shards(folder: Path, root: Path, count: object) -> DatasetError:
    problem = Problem(
        str(root),
        UNFINISHED,
        f"{len(_shard_records(root))} of {count} shards",
        "all shards",
        f"finish them, see infrablend status {shlex.quote(str(root))}; or merge those that are finished: "
        "infrablend merge --partial",
    )
    return DatasetError(f"{folder}: belongs to an unfinished run in shards", [problem])


def _linked(folder: Path, path: Path, marker: _Marker) -> DatasetError:
    problem = Problem(str(path), "name-climbs", "a link out of its folder", "a file inside it", "copy the file there")
    return DatasetError(f"{folder}: the record of the {marker.noun} cannot be read", [problem])


def _half_placed(folder: Path, root: Path) -> DatasetError:
    problem = Problem(
        str(root),
        UNFINISHED,
        "a download whose files are being moved to their places",
        "a finished download",
        f"wait for it, or finish it by repeating its command: infrablend fetch ... {root}",
    )
    return DatasetError(f"{folder}: belongs to an unfinished download; files may be missing", [problem])


def _unfinished(folder: Path, path: Path, marker: _Marker, record: Mapping[str, Any] | None) -> DatasetError:
    found = "a record that cannot be read" if record is None else f"status {record.get('status')}"
    command = finishing_command(path.parent, record) if marker.file == RUN_FILE else None
    if command is None and (command := recorded_command(record, path.parent)) is None:
        facts = {k: shlex.quote(str((record or {}).get(k, "..."))) for k in ("source", "format", "by", "every")}
        command = marker.command.format(root=shlex.quote(str(path.parent)), **facts)
    problem = Problem(
        str(path),
        UNFINISHED,
        f"{found}: the {marker.noun} is still being written, or was interrupted",
        f"status {COMPLETE}",
        f"wait for it, or finish it by repeating its command: {command}",
    )
    return DatasetError(f"{folder}: belongs to an unfinished {marker.noun}; its labels may be missing", [problem])
