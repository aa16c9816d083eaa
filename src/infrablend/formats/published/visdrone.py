"""VisDrone (Zhu et al. 2018): people and vehicles from a drone, in visible light; a text per picture or per video.

    VisDrone2019-DET-{train,val,test-dev}/images/<name>.jpg    .../annotations/<name>.txt
    VisDrone2019-{MOT,VID}-{train,val,test-dev}/sequences/<name>/0000001.jpg    .../annotations/<name>.txt

A line of a picture is `left,top,width,height,score,category,truncation,occlusion`, in pixels. Category 0 is a region to
ignore, and so is any box of score 0, which does not count in evaluation. A line of a video begins with the frame, from
1, and the object. The folder may also be that of one split.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.file_names import real_path
from infrablend.formats.annotation_files import files_with
from infrablend.formats.base import Match, check_splits, require_options, split_of_stem
from infrablend.formats.box_checks import edges_of_xywh
from infrablend.formats.pictures.listing import is_hidden, list_pictures
from infrablend.formats.published.sidecar import (
    Fault,
    LabelledFolder,
    Stated,
    checked,
    if_file,
    line_reader,
    text_lines,
)
from infrablend.formats.records import KEEP_OR_DROP, Findings
from infrablend.formats.values import to_floats, to_int

NAME = "visdrone"
OPTIONS = {"unlabelled": "keep or drop pictures without a text file; keep is the default"}
CATEGORIES = tuple(
    Category(k, name, "", name in ("ignored regions", "others"))
    for k, name in enumerate(
        ("ignored regions", "pedestrian", "people", "bicycle", "car", "van", "truck", "tricycle", "awning-tricycle",
         "bus", "motor", "others")
    )
)  # fmt: skip

_IGNORED = [c.name for c in CATEGORIES if c.ignore]
_LINE = re.compile(rb"(-?\d+(\.\d+)?\s*,\s*){7}-?\d+(\.\d+)?\s*,?\s*", re.ASCII)
_VIDEO_LINE = re.compile(rb"\d+\s*,\s*(-?\d+(\.\d+)?\s*,\s*){8}-?\d+(\.\d+)?\s*,?\s*", re.ASCII)
_FIELDS = "left,top,width,height,score,category,truncation,occlusion"
_NUMBER = re.compile(r"\d{1,9}", re.ASCII)
# Names of published pictures: the first number is that of the flight, and `d` stands for detection.
_PUBLISHED = re.compile(r"(\d{7})_\d{5}_d_\d{7}", re.ASCII)
_PUBLISHED_VIDEO = re.compile(r"uav\d{7}_\d{5}_\w", re.ASCII)
_LOOKED_AT = 20


def _folders(root: Path, inside: str = "images") -> list[Path]:
    """Return the folders that contain a folder `inside`: the folder itself, or some in it or one level further down."""
    return [p.parent for depth in ("", "*/", "*/*/") for p in sorted(root.glob(depth + inside))]


def detect(root: Path) -> Match:
    """Decide whether `root` or folders in it contain `images`, and `annotations` with VisDrone's lines."""
    for folder in _folders(root):
        labels = folder / "annotations"
        if files_with(labels, "*.txt", _is_ours, 1000, most=_LOOKED_AT):
            return Match(NAME, True, f"VisDrone's lines in {labels.relative_to(root).as_posix()}")
    for folder in _folders(root, "sequences"):
        labels = folder / "annotations"
        if files_with(labels, "*.txt", _is_video, 1000, most=_LOOKED_AT):
            return Match(NAME, True, f"VisDrone's lines of videos in {labels.relative_to(root).as_posix()}")
    return Match(NAME, False, "no folder images with annotations beside it that hold lines of eight numbers")


def _is_ours(head: bytes) -> bool:
    return _LINE.fullmatch(head.removeprefix(b"\xef\xbb\xbf").partition(b"\n")[0]) is not None


def _is_video(head: bytes) -> bool:
    return _VIDEO_LINE.fullmatch(head.removeprefix(b"\xef\xbb\xbf").partition(b"\n")[0]) is not None


def _may_be_ours(head: bytes) -> bool:
    """Return whether a file is empty or has one of VisDrone's lines, which texts for people have not."""
    return not head.strip() or any(_LINE.fullmatch(line) for line in head.splitlines())


def read(
    root: Path, *, splits: Iterable[str] | None = None, metadata: Path | None = None, unlabelled: str = "keep"
) -> Dataset:
    """Read pictures and boxes; the name of a folder says the split, else it is train.

    Frames of videos count from 1 in the files, and from 0 in `Capture.frame`.

    Published pictures get the sequence in their names, and `modality` `visible` in `extra`.

    Raises:
        DatasetError: An option has a wrong value, or no picture can be read.
    """
    require_options(root, unlabelled=(unlabelled, KEEP_OR_DROP))
    wanted = check_splits(splits)
    found = Findings(root)
    records: list[ImageRecord] = []
    for inside, read_split in (("images", _read_split), ("sequences", _read_videos)):
        for folder in _folders(root, inside):
            split = split_of_stem(folder.relative_to(root).as_posix() if folder != root else real_path(root).name)
            if split in wanted:
                records += read_split(found, split, folder, unlabelled)
    found.counts["ignored"] = sum(o.category in _IGNORED for r in records for o in r.instances)
    notes = {"labels": NAME, "rows": found.rows("objects", "read", "ignored", "unlabelled")}
    return found.dataset(NAME, records, CATEGORIES, notes, metadata=metadata, splits=wanted)


def _read_split(found: Findings, split: Split, folder: Path, unlabelled: str) -> Iterator[ImageRecord]:
    labels = {p.stem: p for p in sorted((folder / "annotations").glob("*.txt")) if not p.name.startswith(".")}
    pictures = list_pictures(folder / "images", is_labelled=lambda p: p.stem in labels)

    def flight(stem: str) -> str | None:
        published = _PUBLISHED.fullmatch(stem)
        return published[1] if published else None

    labelled = LabelledFolder(
        where=found.place(folder),
        pictures=pictures,
        label_of=lambda picture: labels.pop(picture.stem, None),
        missing="no label file",
        capture_of=lambda stem: Capture(sequence=flight(stem)),
        split=split,
        is_visible=lambda stem: flight(stem) is not None,
    )
    yield from labelled.read(found, unlabelled, line_reader("a label file", _stated))
    left = files_with(folder / "annotations", "*.txt", _may_be_ours, 1000) if labels else []
    for label in (p for p in left if labels.get(p.stem) == p):
        found.add(found.place(label), "image-missing", "no picture of that name", "a file in images/", "restore it")


def _stated(line: str, size_wh: tuple[int, int]) -> Stated:
    values = to_floats(line.rstrip(",").split(","), 8)
    if values is None:
        return Fault("label-malformed", repr(line[:80]), _FIELDS)
    return _object(values, size_wh)


def _object(values: Sequence[float], size_wh: tuple[int, int], track: int | None = None) -> Stated:
    """Return the object that the eight values of a line state, or a fault."""
    score, number, truncation, occlusion = values[4:]
    if number not in range(len(CATEGORIES)):
        return Fault("category-unknown", f"category {number:g}", "0 to 11")
    category = CATEGORIES[int(number)].name
    extra: dict[str, object] = {}
    if occlusion in (0, 1, 2):
        extra = {"occluded": occlusion > 0, "occlusion": int(occlusion)}
    if score == 0 and category not in _IGNORED:
        extra["category"] = category
        category = _IGNORED[0]
    truncated = bool(truncation) if truncation in (0, 1) else None
    box = np.array(edges_of_xywh(values[:4], size_wh))
    return Instance(category, box, truncated=truncated, extra=extra, track_id=track)


# -- videos ----------------------------------------------------------------------------------------------------


_Rows = dict[int, list[tuple[str, tuple[float, ...]]]]
"""Place and values of the lines of a video's text, by frame."""


def _read_videos(found: Findings, split: Split, folder: Path, unlabelled: str) -> Iterator[ImageRecord]:
    """Yield the frames of videos; a frame without a line shows no object, if its video has a text."""
    for sequence in sorted(p for p in (folder / "sequences").iterdir() if p.is_dir() and not is_hidden(p.name)):
        where = found.place(sequence)
        pictures = list(list_pictures(sequence, is_labelled=lambda _: True).values())
        frames = {int(p.stem): p for p in pictures if _NUMBER.fullmatch(p.stem) and int(p.stem) > 0}
        if len(frames) < len(pictures):
            text = f"{len(pictures) - len(frames)} picture(s) left out: their names are not numbers from 1, each once"
            found.add(where, "name-grammar", text, "names such as 0000001.jpg", "rename them")
        label = if_file(folder / "annotations" / f"{sequence.name}.txt")
        rows = {} if label is None else _rows(found, label)
        if rows is None:
            continue
        lost = sum(len(r) for n, r in rows.items() if n not in frames)
        if label is not None and lost:
            text = f"{lost} line(s) left out because their frame has no picture"
            found.warn(found.place(label), "row-without-picture", text, "a picture per frame, numbered from 1")
        video = _labelled_video(found.place(sequence), sequence.name, frames, label, split)
        yield from video.read(found, unlabelled, partial(_read_frame, rows))


def _labelled_video(
    where: str, name: str, frames: Mapping[int, Path], label: Path | None, split: Split
) -> LabelledFolder:
    return LabelledFolder(
        where=where,
        pictures={f"{name}/{path.name}": path for _, path in sorted(frames.items())},
        label_of=lambda _: label,
        missing="no text of their video",
        capture_of=lambda stem: Capture(sequence=name, frame=int(stem) - 1),
        split=split,
        is_visible=lambda _: _PUBLISHED_VIDEO.fullmatch(name) is not None,
    )


def _read_frame(rows: _Rows, found: Findings, picture: Path, _: Path, size_wh: tuple[int, int]) -> list[Instance]:
    lines = rows.get(int(picture.stem), ())
    return checked(found, ((here, _object(v[2:], size_wh, int(v[1]))) for here, v in lines), size_wh)


def _rows(found: Findings, path: Path) -> _Rows | None:
    """Return place and values of the lines of a video's text by frame; None, with a problem, if it cannot be read."""
    lines = text_lines(found, path, "a line per box: frame,object," + _FIELDS)
    if lines is None:
        return None
    rows: _Rows = defaultdict(list)
    seen: set[tuple[int, int]] = set()
    for here, line in lines:
        values = to_floats(line.rstrip(",").split(","), 10)
        frame, track = (to_int(v) for v in values[:2]) if values else (None, None)
        if values is None or frame is None or track is None or frame < 1:
            expected = f"frame,object,{_FIELDS}; frames from 1"
            found.add(here, "label-malformed", repr(line[:80]), expected, "correct the line")
            continue
        if (frame, track) in seen:
            found.track_twice(here, track, frame, "give one of them another number")
        seen.add((frame, track))
        rows[frame].append((here, values))
    return rows
