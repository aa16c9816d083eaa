"""Videos without labels: one file, or a folder of clips; one sequence per clip.

CLIP.mp4   [CLIP.SRT]
[train|val|test/]**/CLIP.<mp4|mov|avi|...>   [CLIP.SRT]   [metadata.csv]
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path

from infrablend.core.capture import UNKNOWN, Capture
from infrablend.core.dataset import Dataset, ImageRecord, Split
from infrablend.core.file_names import distinct_names, file_name, fold_name
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import SPLIT_FOLDERS, Match, check_splits, step_of
from infrablend.formats.cameras.flight_log import sample
from infrablend.formats.cameras.log_alignment import NO_CLOCK, align
from infrablend.formats.cameras.video_log import (
    log_problems,
    own_subtitles,
    rate_problems,
    subtitles_beside,
    telemetry_of,
)
from infrablend.formats.pictures.images import COLOUR_REMEDY, COLOURS, IN_COLOUR
from infrablend.formats.pictures.listing import check_link, is_hidden, open_picture, walk
from infrablend.formats.pictures.video import SUFFIXES, Video
from infrablend.formats.records import Findings

NAME = "videos"
OPTIONS = {"every": "step in frames; 30 is the default, 1 takes every frame"}
TAKES_VIDEO = True

_STEP = 30
# Small copies that cameras record beside a clip, of the same stem.
_PREVIEWS = (".lrv", ".lrf")
# What may hold the labels of the clip whose name they begin with.
_LABELS = (".txt", ".json", ".xml", ".csv", ".mat")
_LABEL_END = re.compile(r"(?:[_-](?:labels?|gt|groundtruth|annotations?))?", re.IGNORECASE)


@dataclass(frozen=True)
class _Clip:
    """A video: its name in problems, the name of its sequence, its split."""

    path: Path
    where: str
    sequence: str
    split: Split


def detect(root: Path) -> Match:
    """Decide whether `root` is a video, or contains videos."""
    if root.is_file():
        is_one = root.suffix.lower() in SUFFIXES
        return Match(
            NAME, is_one, "a video" if is_one else f"a file with the suffix {root.suffix or '(none)'}, no video"
        )
    names = _names(root)
    if not names:
        return Match(NAME, False, f"no video ({', '.join(SUFFIXES)}) in it or below")
    return Match(NAME, True, f"{len(names)} video(s), such as {names[0]}")


def _names(root: Path) -> list[str]:
    """Return the videos below a folder by relative path, sorted; of a video alone, its name."""
    if root.is_file():
        return [root.name]
    files = (Path(base, n).relative_to(root).as_posix() for base, names in walk(root) for n in names)
    return sorted(n for n in files if n.lower().endswith(SUFFIXES) and not is_hidden(Path(n).name))


def read(root: Path, *, splits: Iterable[str] | None = None, metadata: Path | None = None, every: str = "") -> Dataset:
    """Read frames of all clips, as PNG files in the cache; what is outside of the folders of splits is train.

    Pitch, height and time of capture are those of the subtitles beside or in the clip; without a clock in these, the
    time is that of the container. `Capture.time_s` is the container's, too.

    Raises:
        DatasetError: An option has a wrong value, or no frame can be read.
        MissingDependencyError: PyAV is not installed.
    """
    step = step_of(root, every) or _STEP
    wanted = check_splits(splits)
    found = Findings(root)
    records: list[ImageRecord] = []
    for clip in _clips(found):
        if clip.split in wanted:
            found.counts["clips"] += 1
            records += _read_clip(found, clip, step)
    rows = found.rows("clips", "unread", "frames", "lost", "colour", "with_telemetry")
    notes = {"labels": "none", "every": step, "rows": rows}
    return found.dataset(NAME, records, (), notes, metadata=metadata, splits=wanted)


def _clips(found: Findings) -> list[_Clip]:
    """Return the clips with distinct names of their sequences: the stems, or with the folders where stems repeat."""
    folder = found.folder
    names = _names(found.root)
    stems = {n.rpartition(".")[0] for n in names if not n.lower().endswith(_PREVIEWS)}
    kept = []
    for name in names:
        if name.lower().endswith(_PREVIEWS) and name.rpartition(".")[0] in stems:
            found.warn(name, "video-preview", "the small copy of a clip of this stem, left out", "one file per clip")
        elif found.root.is_dir() and (problem := check_link(folder / name, found.root, name)) is not None:
            found.problems.append(replace(problem, found=problem.found.replace("picture ", "video ", 1)))
        else:
            kept.append(name)
    plain = [file_name(Path(n).stem) for n in kept]
    count = Counter(map(fold_name, plain))
    wanted = [
        file_name("_".join(Path(n).with_suffix("").parts)) if count[fold_name(p)] > 1 else p
        for n, p in zip(kept, plain, strict=True)
    ]
    return [
        _Clip(folder / name, name, sequence, SPLIT_FOLDERS.get(name.partition("/")[0].lower(), "train"))
        for name, sequence in zip(kept, distinct_names(wanted), strict=True)
    ]


def _read_clip(found: Findings, clip: _Clip, step: int) -> list[ImageRecord]:
    _name_labels(found, clip)
    try:
        video = Video(clip.path)
    except DatasetError as error:
        found.counts["unread"] += 1
        found.add_all(error.problems, clip.where)
        return []
    times = video.timeline.seconds
    numbers = range(0, len(times), step)
    frames = found.video_frames(clip.path, numbers) or {}
    if lost := len(numbers) - len(frames):
        found.counts["lost"] += lost
        text = f"{lost} of {len(numbers)} chosen frame(s) that cannot be decoded, or have another size, left out"
        found.add(clip.where, "frames-lost", text, "an intact video", "copy the file from the card again")
    found.problems += rate_problems(clip.where, video.timeline)
    _name_colours(found, clip, list(frames.values()))
    captures = _captures(found, clip, video, list(frames))
    found.counts["frames"] += len(frames)
    return [
        ImageRecord(
            "",
            path,
            clip.split,
            video.size_wh,
            (),
            replace(captures.get(n, UNKNOWN), sequence=clip.sequence, frame=n, time_s=times[n]),
            file_name=f"{clip.sequence}/{clip.sequence}_{n:06d}.png",
        )
        for n, path in frames.items()
    ]


def _name_labels(found: Findings, clip: _Clip) -> None:
    """Warn of files beside a clip that may hold its labels: no other reader knows them."""
    stem = clip.path.stem
    beside = sorted(
        p.name
        for p in clip.path.parent.iterdir()
        if p.suffix.lower() in _LABELS and p.stem.startswith(stem) and _LABEL_END.fullmatch(p.stem[len(stem) :])
    )
    if beside:
        text = f"{', '.join(beside[:3])} beside it may hold labels, which are not read"
        todo = "convert labels, for example with CVAT, to a format of docs/formats: their objects count as absent here"
        found.warn(clip.where, "label-unread", text, "a clip without labels", todo)


def _name_colours(found: Findings, clip: _Clip, paths: Sequence[Path]) -> None:
    colour = sum(_is_colour(p) for p in paths)
    if colour:
        found.counts["colour"] += colour
        text = f"{colour} of {len(paths)} frame(s) {COLOURS}, which do not follow temperature"
        found.warn(clip.where, IN_COLOUR, text, "a thermal video in grey", COLOUR_REMEDY)


def _is_colour(path: Path) -> bool:
    with open_picture(path) as picture:
        return bool(picture.mode == "RGB")


def _captures(found: Findings, clip: _Clip, video: Video, numbers: Sequence[int]) -> Mapping[int, Capture]:
    """Return what subtitles state of the frames of a clip, else the times that follow from its container."""
    times = [float(video.timeline.times_s[n]) for n in numbers]
    by_container = {}
    if video.created is not None:
        when = [(video.created + timedelta(seconds=t)).isoformat(timespec="milliseconds") for t in times]
        by_container = {n: Capture(captured=w) for n, w in zip(numbers, when, strict=True)}
    beside = subtitles_beside(clip.path)
    place = clip.where if beside is None else found.place(beside)
    try:
        log, problems = own_subtitles(video)
        found.add_all(problems, place)
        if log is None or not numbers:
            return by_container
        aligned = align(log, video.timeline, video.created, NO_CLOCK)
    except DatasetError as error:
        # The frames do not depend on it.
        todo = "the frames are read without telemetry; mend or remove the subtitles, or use infrablend frames --log"
        found.problems += [Problem(place, p.code, p.found, p.expected, todo, "warning") for p in error.problems]
        return by_container
    sampled = sample(aligned.log, times)
    todo = "use infrablend frames with --offset if the clocks differ, else the subtitles of this clip"
    found.add_all(log_problems(aligned, sampled, todo), place)
    found.counts["with_telemetry"] += sampled.coverage.inside
    stated = {n: telemetry_of(sampled, k) for k, n in enumerate(numbers)}
    facts = {n: {k: v for k, v in row.items() if v} for n, row in stated.items()}
    return {n: Capture.from_json(f, strict=False).over(by_container.get(n, UNKNOWN)) for n, f in facts.items()}
