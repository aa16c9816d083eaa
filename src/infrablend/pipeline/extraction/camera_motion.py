"""Writes down how the camera moves through the sequences of a dataset: one JSON and one page for each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from infrablend.core.dataset import Dataset
from infrablend.core.file_names import distinct_names, file_name
from infrablend.core.files import write_json, write_text
from infrablend.core.output_checks import require_apart
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.workspace import MOTION_FILE, replacing, workspace
from infrablend.errors import Problem
from infrablend.pipeline.plans.sequence_motion import VERSION, find_motion, motion_problems, sequences_of
from infrablend.report.motion_page import motion_page


@dataclass(frozen=True)
class MotionReport:
    """Movements that were written.

    Attributes:
        out: Their folder.
        sequences: Number of frames in each state, by sequence.
        problems: Sequences and frames whose movement is not known, each with its reason.
    """

    out: Path
    sequences: Mapping[str, Mapping[str, int]]
    problems: tuple[Problem, ...] = field(default=())

    @property
    def ok(self) -> bool:
        """True if some frame of every sequence is known and all pictures could be read."""
        return bool(self.sequences) and not any(p.severity == "error" for p in self.problems)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {**asdict(self), "out": str(self.out), "problems": [p.to_json() for p in self.problems]}


def write_motion(
    dataset: Dataset, out: Path, *, overwrite: bool = False, on_progress: OnProgress | None = None
) -> MotionReport:
    """Write `NAME.json` and `NAME.html` for each sequence: how the camera moves, frame by frame.

    Raises:
        OutputError: `out` has something that may not be replaced, or cannot be written.
        DatasetError: The dataset has no sequence, or a picture cannot be read.
    """
    require_apart(dataset.root, out)
    sequences = sequences_of(dataset)
    total = sum(len(images) for images in sequences.values())
    names = distinct_names([file_name(name) for name in sequences])
    problems = list(dataset.problems)
    states = {}
    done = 0
    progress = paced(on_progress)

    def read() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    with workspace(out, "movements of cameras", MOTION_FILE, replacing(overwrite)) as space:
        for name, (sequence, images) in zip(names, sequences.items(), strict=True):
            motion = find_motion(sequence, images, on_frame=read)
            facts = motion.to_json()
            write_json(space.folder / f"{name}.json", facts)
            page = motion_page(facts, motion.size_wh, motion.frames, motion.moments)
            write_text(space.folder / f"{name}.html", page)
            states[sequence] = facts["states"]
            problems += motion_problems(motion)
        report = MotionReport(out, states, tuple(problems))
        space.finish({"sequences": states, "version": VERSION})
    return report
