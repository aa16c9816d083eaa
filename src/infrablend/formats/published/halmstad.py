"""Halmstad's drones (Svanström et al. 2021) as published: thermal clips from the ground, MATLAB files of boxes.

    [Data/]Video_IR/IR_<AIRPLANE|BIRD|DRONE|HELICOPTER>_NNN.mp4   and   IR_..._NNN_LABELS.mat

A clip shows objects of the one class in its name. Its label file is a MATLAB `groundTruth` object with one box per
frame, x and y counted from 1, which mcos-decoder decodes.
"""

from __future__ import annotations

import importlib
import re
import struct
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.file_names import leaves_folder
from infrablend.core.files import read_regular
from infrablend.errors import DatasetError, MissingDependencyError, Problem
from infrablend.formats.annotation_files import leave_out
from infrablend.formats.base import Match, check_splits, step_of
from infrablend.formats.published.sidecar import checked
from infrablend.formats.records import Findings
from infrablend.formats.values import to_floats

_HEADER_BYTES = 128
_INT8 = 1
_UINT8 = 2
_MATRIX = 14
_COMPRESSED = 15
_MAX_BYTES = 200_000_000


def object_workspace(data: bytes) -> bytes:
    """Return the workspace of the objects in a MAT file: the bytes of its variable without a name.

    Raises:
        ValueError: The file is damaged, of another kind, or has no objects.
    """
    if len(data) < _HEADER_BYTES or data[126:128] != b"IM":
        raise ValueError("no MAT file of level 5 with little-endian numbers")
    for kind, content in _elements(data[_HEADER_BYTES:]):
        inner = content
        if kind == _COMPRESSED:
            inside = next(_elements(_inflated(content)), None)
            if inside is None:
                raise ValueError("an empty compressed element")
            kind, inner = inside
        if kind != _MATRIX:
            raise ValueError(f"an element of type {kind}, not a variable")
        parts = list(_elements(inner))
        # Flags, dimensions, name, values.
        if len(parts) >= 4 and parts[2] == (_INT8, b"") and parts[3][0] == _UINT8:
            return parts[3][1]
    raise ValueError("no variable with MATLAB objects")


def _inflated(content: bytes) -> bytes:
    unpacker = zlib.decompressobj()
    try:
        found = unpacker.decompress(content, _MAX_BYTES)
    except zlib.error as error:
        raise ValueError(f"damaged compression ({error})") from error
    if unpacker.unconsumed_tail:
        raise ValueError(f"more than {_MAX_BYTES // 10**6} MB after decompression")
    return found


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield type and content of the elements that follow each other.

    Raises:
        ValueError: An element is longer than the data.
    """
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from("<II", data, at)
        start = at + 8
        if kind >> 16:  # a short element: type and size are two bytes each, and the content is in the tag
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
            if size > 4:
                raise ValueError(f"a short element of {size} bytes")
        if start + size > len(data):
            raise ValueError(f"an element of {size} bytes where {len(data) - start} are left")
        yield kind, data[start : start + size]
        end = at + 8 if start == at + 4 else start + size
        # Compressed elements are not padded.
        at = end if kind == _COMPRESSED else end + -end % 8


NAME = "halmstad"
OPTIONS = {"every": "step in frames; 30 (a second) is the default"}
TAKES_VIDEO = True
CATEGORIES = tuple(Category(k, n) for k, n in enumerate(("airplane", "bird", "drone", "helicopter")))

_CLIP = re.compile(r"IR_(AIRPLANE|BIRD|DRONE|HELICOPTER)_(\d{3,4})", re.ASCII)
_FOLDERS = (".", "Video_IR", "Data/Video_IR")
_LABELS = "_LABELS.mat"
_WANTED = "Video_IR/IR_<CLASS>_NNN.mp4 with an IR_<CLASS>_NNN_LABELS.mat beside it"
_STEP = 30
_MAX_LABEL_BYTES = 20_000_000
# Labels that differ from the frames by one are usual; more are worth a line each.
_USUAL_DIFFERENCE = 1


def _clips(root: Path) -> dict[str, Path]:
    if root.is_file():
        return {root.stem: root} if _CLIP.fullmatch(root.stem) and root.suffix == ".mp4" else {}
    for name in _FOLDERS:
        folder = root / name
        found = {
            p.stem: p for p in sorted(folder.glob("IR_*.mp4"))
            if _CLIP.fullmatch(p.stem) and p.is_file() and not leaves_folder(p)
        } if folder.is_dir() else {}  # fmt: skip
        if found:
            return found
    return {}


def detect(root: Path) -> Match:
    """Decide whether `root` contains thermal clips with label files beside them."""
    clips = _clips(root)
    labelled = [n for n, p in clips.items() if p.with_name(n + _LABELS).is_file()]
    if not labelled:
        return Match(NAME, False, f"no {_WANTED}")
    return Match(NAME, True, f"{len(labelled)} thermal clip(s) with labels, such as {labelled[0]}")


def read(
    root: Path, *, splits: Iterable[str] | None = None, metadata: Path | None = None, every: str = ""
) -> Dataset:  # fmt: skip
    """Read frames and boxes of the thermal clips, as PNG files in the cache; there is no published split: all is train.

    Raises:
        DatasetError: An option has a wrong value, or no frame can be read.
        MissingDependencyError: PyAV or mcos-decoder is not installed.
    """
    step = step_of(root, every) or _STEP
    wanted = check_splits(splits)
    clips = _clips(root)
    if not clips:
        problem = Problem(
            str(root), "video-missing", "no clip IR_*.mp4 in it or its Video_IR", _WANTED, "check the path"
        )
        raise DatasetError(f"{root}: no clips of the Halmstad dataset", [problem])
    decoder = _require_decoder()
    found = Findings(root)
    records: list[ImageRecord] = []
    for clip, path in clips.items() if "train" in wanted else ():
        found.counts["clips"] += 1
        records += _read_clip(found, clip, path, step, decoder)
    rows = found.rows("clips", "undecoded", "frames", "objects", "read", "absent")
    return found.dataset(NAME, records, CATEGORIES, {"labels": NAME, "rows": rows}, metadata=metadata, splits=wanted)


def _require_decoder() -> Any:
    try:
        return importlib.import_module("mcos_decoder")
    except ImportError as error:
        raise MissingDependencyError(
            "mcos-decoder is not installed; the labels of the Halmstad dataset need it. "
            'Install the extras: pip install "infrablend[halmstad,video]"'
        ) from error


def _read_labels(path: Path, where: str, decoder: Any) -> tuple[list[Any], Problem | None]:
    """Return one box or None per frame, or an empty list and the problem."""
    expected = "a MATLAB file with a groundTruth object"
    todo = "fetch the file again"
    try:
        if leaves_folder(path) or not path.is_file():
            return [], Problem(where, "annotation-missing", "no label file", expected, todo)
        if path.stat().st_size > _MAX_LABEL_BYTES:
            most = f"at most {_MAX_LABEL_BYTES / 1e6:.0f} MB"
            return [], Problem(where, "annotation-too-large", f"{path.stat().st_size / 1e6:.0f} MB", most, todo)
        boxes = list(decoder.extract_bboxes(object_workspace(read_regular(path))))
        leave_out([path])
    except Exception as error:  # the decoder's parser raises what it likes on damaged files
        found = f"cannot be decoded ({type(error).__name__}: {error})"[:120].replace(str(path), path.name)
        return [], Problem(where, "annotation-unreadable", found, expected, todo)
    if not any(b is not None for b in boxes):
        found = f"no box in any of {len(boxes)} frames: mcos-decoder cannot decode two objects at once, for example"
        return [], Problem(where, "annotation-undecoded", found, "at least one box", "the clip is left out", "warning")
    return boxes, None


def _read_clip(found: Findings, clip: str, path: Path, step: int, decoder: Any) -> list[ImageRecord]:
    label = path.with_name(clip + _LABELS)
    where = found.place(label)
    here = found.place(path)
    boxes, problem = _read_labels(label, where, decoder)
    if problem is not None:
        found.problems.append(problem)
        found.counts["undecoded"] += 1
        return []
    times = found.video_times(path)
    if times is None:
        return []
    total = len(times)
    frames = found.video_frames(path, range(0, min(total, len(boxes)), step))
    if frames is None:
        return []
    if abs(total - len(boxes)) > _USUAL_DIFFERENCE:
        text = f"{len(boxes)} label(s) for {total} frame(s); what has no counterpart is left out"
        found.warn(where, "annotation-length", text, "a label per frame")
    category = clip.split("_")[1].lower()
    records = []
    for number, picture in frames.items():
        size_wh = found.size(picture, here)
        if size_wh is None:
            continue
        found.counts["frames"] += 1
        numbers = None if boxes[number] is None else to_floats(boxes[number], 4)
        found.counts["absent" if numbers is None else "objects"] += 1
        stated = None
        if numbers is not None:
            x, y, w, h = numbers
            # MATLAB counts from 1.
            stated = Instance(category, np.array([x - 1, y - 1, x - 1 + w, y - 1 + h]), track_id=0)
        instances = tuple(checked(found, [(f"{where}: frame {number}", stated)], size_wh))
        capture = Capture(sequence=clip, frame=number, time_s=times[number])
        name = f"{clip}/{clip}_{number:05d}.png"
        records.append(ImageRecord("", picture, "train", size_wh, instances, capture, file_name=name))
    return records
