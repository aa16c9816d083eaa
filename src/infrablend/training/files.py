"""Files that the training process writes, and the manifest of the folder of a training."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from fnmatch import fnmatchcase
from pathlib import Path

from infrablend.core.files import output_error
from infrablend.core.manifest import JOURNAL, REPLACED, Manifest, files_below

CHECKPOINT = "checkpoint.pt"
NEW_CHECKPOINT = "checkpoint.new"
DAMAGED = "checkpoint.damaged.pt"
WEIGHTS = "weights.pt"
LOG = "train.log"
RUN, ULTRALYTICS = "run", "ultralytics"

# What Ultralytics writes, as patterns; its changes cannot be told from a user's.
_OF_ULTRALYTICS = (
    f"{RUN}/args.yaml", f"{RUN}/results.csv", f"{RUN}/weights/*.pt", f"{ULTRALYTICS}/*.json", "data/labels/*.cache",
    "data/images/*.npy",
)  # fmt: skip


def open_manifest(out: Path) -> Manifest:
    """Return the manifest of the folder of a training, as read from its file.

    It leaves out what the training process rewrites again and again: checkpoints, the log, and Ultralytics' own files.
    """
    ignored = (CHECKPOINT, NEW_CHECKPOINT, DAMAGED, LOG, RUN, ULTRALYTICS)
    return Manifest(out, out / JOURNAL, out / REPLACED, ignored).read()


def is_of_ultralytics(name: str) -> bool:
    """Return whether Ultralytics writes a file of this path, relative to the folder of the training."""
    return any(fnmatchcase(name, pattern) for pattern in _OF_ULTRALYTICS)


def remove_folders(manifest: Manifest, folders: Iterable[str]) -> None:
    """Delete working folders with what InfraBlend and Ultralytics wrote there; move everything else aside."""
    manifest.remove_parts()
    there = [name for name in folders if os.path.lexists(manifest.root / name)]
    for name in [n for n in there if (manifest.root / n).is_symlink() or not (manifest.root / n).is_dir()]:
        manifest.move_aside(name)
        there.remove(name)
    for name in files_below(manifest.root, there):
        if is_of_ultralytics(name) and not (manifest.root / name).is_symlink():
            _delete(manifest.root / name)
        else:
            manifest.delete_own(name)
            if os.path.lexists(manifest.root / name):
                manifest.move_aside(name)
    for name in there:
        for directory, _, _ in os.walk(manifest.root / name, topdown=False):
            with contextlib.suppress(OSError):
                Path(directory).rmdir()


def _delete(path: Path) -> None:
    try:
        path.unlink()
    except OSError as error:
        raise output_error(path, error) from error
