"""Sequence and frame number of pictures in plain folders whose names end in a running number."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import PurePosixPath

from infrablend.core.dataset import ImageRecord
from infrablend.formats.picture_facts import facts_from_name

# Longer numbers are times.
_END = re.compile(r"(|.*\D)(\d{1,9})", re.ASCII | re.DOTALL)
# Fewer numbers than this do not show whether they run.
_LEAST = 4
# Share of the steps between numbers that are equal in frames of a clip, of which some may have been removed.
_EQUAL = 0.5
_UNNAMED = "frames"


def with_numbered_frames(images: Sequence[ImageRecord]) -> tuple[ImageRecord, ...]:
    """Return the pictures with the sequence and frame number that their names show.

    The pictures of one folder, in all splits, are a sequence if their names differ in a number at their ends alone,
    each has another one, and the numbers run: at least half of the steps between them are equal. Its name is the path
    of the folder, or what the names have in common in the folder of the split itself. Pictures of which a sequence,
    frame or time is known are left as they are, with all of their folder.
    """
    folders = defaultdict[PurePosixPath, list[int]](list)
    for k, image in enumerate(images):
        folders[PurePosixPath(image.name).parent].append(k)
    taken = {i.capture.sequence for i in images}
    found = list(images)
    for folder, members in sorted(folders.items()):
        numbers = _numbers([images[k] for k in members])
        if numbers is None:
            continue
        prefix, frames = numbers
        sequence = prefix.strip("_-. ") or _UNNAMED if folder == PurePosixPath() else folder.as_posix()
        if sequence in taken:
            continue
        taken.add(sequence)
        for k, frame in zip(members, frames, strict=True):
            found[k] = replace(found[k], capture=replace(found[k].capture, sequence=sequence, frame=frame))
    return tuple(found)


def _numbers(images: Sequence[ImageRecord]) -> tuple[str, list[int]] | None:
    """Return what the names of pictures begin with, and their numbers; None if these do not count frames."""
    ends = [_END.fullmatch(PurePosixPath(i.name).stem) for i in images]
    known = any(i.capture.sequence or i.capture.captured or i.capture.frame is not None for i in images)
    if len(images) < _LEAST or known or any(facts_from_name(i.name) for i in images):
        return None
    names = [(m[1], int(m[2])) for m in ends if m is not None]
    frames = [n for _, n in names]
    if len(names) < len(images) or len({prefix for prefix, _ in names}) > 1 or len({*frames}) < len(frames):
        return None
    ordered = sorted(frames)
    steps = Counter(b - a for a, b in pairwise(ordered))
    most = steps.most_common(1)[0][1]
    return (names[0][0], frames) if most >= _EQUAL * (len(frames) - 1) else None
