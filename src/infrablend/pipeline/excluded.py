"""Keeps frames out of a finished run: their files move to `excluded/`, and `excluded.json` holds the choice.

The choice is written before anything moves. Whatever a kill leaves, the next call that finishes the run (`exclude`,
`include` or `generate --resume`) brings the files in line with the choice.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from infrablend.core.file_names import real_path
from infrablend.core.files import load_json, output_error, sha256_of, sha256_of_json, write_json
from infrablend.core.finished import COMPLETE
from infrablend.core.manifest import Manifest, remove_empty
from infrablend.core.run_layout import EXCLUDED, IMAGES, SCENES, RunLayout
from infrablend.errors import OutputError
from infrablend.pipeline.record import RecordError, load_record
from infrablend.pipeline.review import read_verdicts

VERSION = 2
CHOICE = "choice"
"""Field of a run record with the digest of the frames that are left out."""


def read_choice(layout: RunLayout) -> dict[str, str]:
    """Return the excluded frames of a run, by id, each with its reason; empty if there is no choice.

    Raises:
        OutputError: The file cannot be read.
    """
    path = layout.excluded_file
    if not os.path.lexists(path):
        return {}
    try:
        data = load_json(path)
        frames = data["frames"]
        if data["version"] != VERSION or not all(isinstance(v, str) for pair in frames.items() for v in pair):
            raise ValueError("not a choice of frames")
        if data["sha256"] != sha256_of_json(frames):
            raise ValueError("it was edited: frames are chosen by `infrablend exclude` and `include`")
        return dict(frames)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        command = shlex.join(["infrablend", "exclude", str(layout.root)])
        raise OutputError(
            f"{path}: cannot be read ({error}); expected the frames that `infrablend exclude` left out. Restore the "
            f"file; or remove it and repeat `{command}`, which puts all frames back first"
        ) from error


def require_choice(record: Mapping[str, Any], layout: RunLayout) -> dict[str, str]:
    """Return the choice of frames, after a check that a finished run has that which its labels were written with.

    Raises:
        OutputError: `excluded.json` is damaged, was removed, or is an earlier one.
    """
    frames = read_choice(layout)
    if record.get("status") == COMPLETE and record.get(CHOICE) != choice_digest(frames):
        found = f"chooses {len(frames)} frames" if frames else "is missing"
        raise OutputError(
            f"{layout.excluded_file}: {found}; expected the choice that the labels of the run were written with. "
            "Restore the file, or make the run again with --overwrite"
        )
    return frames


def choice_digest(frames: Mapping[str, str]) -> str | None:
    """Return the digest of a choice for the record of its run; None if no frame is left out."""
    return sha256_of_json(dict(frames)) if frames else None


def write_choice(layout: RunLayout, excluded: Mapping[str, str]) -> None:
    """Write the choice of frames."""
    frames = dict(sorted(excluded.items()))
    write_json(layout.excluded_file, {"version": VERSION, "frames": frames, "sha256": sha256_of_json(frames)}, indent=2)


def place_frames(
    layout: RunLayout, manifest: Manifest, files: Mapping[str, tuple[str, str]], excluded: Iterable[str]
) -> None:
    """Move the files of excluded frames to `excluded/`, and those of other frames back.

    Args:
        layout: The run.
        manifest: Its manifest, which moves files aside that are in the way.
        files: Paths of image and record of each frame, relative to the run.
        excluded: Ids of the excluded frames.
    """
    left_out, moved = {*excluded}, []
    for frame_id, (image, record) in files.items():
        away = frame_id in left_out
        # Whatever is in `images/` is in a record: the image leaves first, and comes back last.
        for name in (image, record) if away else (record, image):
            aside = f"{EXCLUDED}/{name}"
            source, target = (name, aside) if away else (aside, name)
            if os.path.lexists(layout.root / source):
                _move(layout.root, manifest, source, target)
                moved.append(source)
    remove_empty(layout.root, moved)


def _move(root: Path, manifest: Manifest, source: str, target: str) -> None:
    try:
        if os.path.lexists(root / target):
            digest = _digest(root / source)
            if digest is not None and digest == _digest(root / target):
                (root / source).unlink()
                return
            manifest.move_aside(target)
        (root / target).parent.mkdir(parents=True, exist_ok=True)
        (root / source).replace(root / target)
    except OutputError:
        raise
    except OSError as error:
        raise output_error(root / target, error) from error


def _digest(path: Path) -> str | None:
    return sha256_of(path) if path.is_file() and not path.is_symlink() else None


def excluded_files(layout: RunLayout) -> dict[str, str | None]:
    """Return the intact files in `excluded/` that the run wrote, relative to the run, images with their SHA-256."""
    found: dict[str, str | None] = {}
    for path in sorted((layout.root / EXCLUDED / SCENES).rglob("*.json")):
        try:
            record = load_record(path)
        except RecordError:
            continue
        if path != layout.root / EXCLUDED / SCENES / f"{record.frame_id}.json":
            continue  # a copy that somebody made
        found[f"{EXCLUDED}/{IMAGES}/{record.image}"] = record.image_sha256
        found[path.relative_to(layout.root).as_posix()] = None
    return found


def purge(layout: RunLayout, manifest: Manifest) -> int:
    """Delete the files of excluded frames that nobody changed; return the number of deleted files."""
    deleted = []
    for name, digest in excluded_files(layout).items():
        if manifest.add_present(name, digest):
            manifest.delete_own(name)
            deleted.append(name)
    remove_empty(layout.root, deleted)
    return len(deleted)


def read_review(path: Path, run: Path) -> tuple[dict[str, str], set[str]]:
    """Return the rejected frames of a review, each with its reason, and the accepted ones.

    Args:
        path: The review; a file of the run may not be a link, any other may.
        run: Folder of the run.

    Raises:
        OutputError: The file cannot be read.
    """
    verdicts = read_verdicts(path if path.parent == run else real_path(path))
    rejected = {k: v.reason or "review" for k, v in verdicts.items() if v.word == "reject"}
    return rejected, {k for k, v in verdicts.items() if v.word == "accept"}
