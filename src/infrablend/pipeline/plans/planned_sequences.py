"""The sequences of a run whose objects move: their frames, how the camera moves, and when each frame was taken."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence

import numpy as np

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.mesh import FloatArray
from infrablend.errors import Problem
from infrablend.formats.labels.mot import ASSUMED_RATE
from infrablend.pipeline.plans.plan import PlannedFrame, PlannedSequence
from infrablend.pipeline.plans.sequence_motion import find_motion, motion_problems, sequences_of
from infrablend.sampling.tracks import Footage

log = logging.getLogger(__name__)


def plan_sequences(
    dataset: Dataset, as_read: Mapping[int, ImageRecord], used: Sequence[ImageRecord], anchors: Sequence[ImageRecord]
) -> tuple[dict[str, PlannedSequence], list[Problem]]:
    """Return the sequences that some used pictures belong to, by name, and what is not known of them.

    Args:
        dataset: All pictures: what a frame shows must not depend on the choice of frames.
        as_read: The same with the source's own names of classes, by `id`.
        used: Pictures that a run uses.
        anchors: Those of all pictures that a run could use, and so place objects in.

    Raises:
        DatasetError: No picture belongs to a sequence, or a picture cannot be read.
    """
    of_use, of_place = ({(i.split, i.id) for i in images} for images in (used, anchors))
    found = {}
    problems = []
    for name, images in sequences_of(dataset).items():
        if not any((i.split, i.id) in of_use for i in images):
            continue
        log.info("sequence %s: following the camera through %d frames", name, len(images))
        motion = find_motion(name, images)
        times = _times_s(images)
        if times is None:
            lacks = any(i.capture.time_s is None for i in images)
            found_times = "no time stamps" if lacks else "time stamps that do not rise from frame to frame"
            text = f"{found_times}; {ASSUMED_RATE:g} frames per second are assumed"
            todo = "a table with time_s"
            problems.append(Problem(f"sequence {name}", "frame-rate", text, "seconds of each frame", todo, "warning"))
            times = np.array([(i.capture.frame or 0) / ASSUMED_RATE for i in images])
        problems += motion_problems(motion)
        frames = tuple(PlannedFrame(i, 0, as_read[id(i)], i.id) for i in images)
        ids = {str(i.track_id) for image in images for i in image.instances if i.track_id is not None}
        numbers = [int(i) for i in ids if i.isdecimal() and i.isascii()]  # texts such as "1" count, too
        footage = Footage(motion.in_own_levels(), times, motion.size_wh, motion.other_sizes_wh)
        # Formats with numbers from 1 give the others, such as 0, the numbers between.
        others = len(ids) - sum(n > 0 for n in numbers)
        without_place = frozenset(n for n, i in enumerate(images) if (i.split, i.id) not in of_place)
        found[name] = PlannedSequence(name, frames, footage, max(numbers, default=0) + others + 1, without_place)
    single = sum(i.capture.sequence is None or i.capture.frame is None for i in used)
    if single:
        text = f"{single} picture(s) of no sequence get objects of their own, without tracks"
        problems.append(Problem("pictures", "no-sequence", text, "clips or numbered frames", severity="warning"))
    return found, problems


def _times_s(images: Sequence[ImageRecord]) -> FloatArray | None:
    """Return the seconds of the frames; None unless all are known and in order."""
    times = [i.capture.time_s for i in images]
    known = np.array([t for t in times if t is not None], np.float64)
    return known if len(known) == len(times) and (np.diff(known) > 0).all() else None
