"""Writes down how the camera moves through the sequences of a dataset: one JSON and one page for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import Dataset
from infrablend.core.file_names import distinct_names, file_name
from infrablend.core.files import write_json, write_text
from infrablend.core.output_checks import require_apart
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.workspace import MOTION_FILE, replacing, workspace
from infrablend.errors import Problem
from infrablend.imaging.camera_path import Moment
from infrablend.pipeline.plans.sequence_motion import VERSION, find_motion, motion_problems, sequences_of
from infrablend.report.charts import COLOURS, curves, legend, panels, png_bytes
from infrablend.report.page import render_page


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


_STATES = ("followed", "first", "frozen", "bridged", "lost", "cut")
_LABELS = ("middle of the picture,\npx from the span's first", "px", "level of what had\n128 at first", "", "")


def motion_page(
    facts: Mapping[str, object], size_wh: tuple[int, int], frames: Sequence[int], moments: Sequence[Moment]
) -> str:
    """Return the HTML page of a sequence; the same facts give the same bytes.

    Args:
        facts: Content of the sequence's JSON.
        size_wh: Size of the pictures, px.
        frames: Numbers of the frames, ascending.
        moments: What is known of the camera in each of them.
    """
    plot = _plot(size_wh, np.array(frames), moments)
    return render_page("motion", title=f"Camera of {facts['sequence']}", facts=facts, plot=plot)


def _plot(size_wh: tuple[int, int], frames: NDArray[np.int64], moments: Sequence[Moment]) -> bytes:
    known = np.array([m.known for m in moments])
    middle = np.array([size_wh[0] / 2, size_wh[1] / 2, 1.0])
    there = np.array([m.to_first for m in moments]) @ middle
    moved = np.where(known[:, None], there[:, :2] / there[:, 2:] - middle[:2], np.nan)
    mid = [m.gain * 128 + m.offset for m in moments]
    figure, axes = panels(5, 1, (11, 10), sharex=True, height_ratios=(2, 1.4, 1.4, 1.4, 0.4))
    curves(axes[0], frames, {"to the right": moved[:, 0], "down": moved[:, 1]})
    certain = {"error at a corner": [m.error_px for m in moments], "median residual": [m.residual_px for m in moments]}
    curves(axes[1], frames, {name: np.where(known, of, np.nan) for name, of in certain.items()})
    axes[2].plot(frames, np.where(known, mid, np.nan), color=COLOURS[0])
    seen = {"corners that fit": [m.fitting for m in moments], "sharpness": [m.sharpness**0.5 for m in moments]}
    curves(axes[3], frames, seen)
    for state, colour in zip(_STATES, COLOURS, strict=False):
        here = frames[[m.state == state for m in moments]]
        axes[4].vlines(here, 0, 1, color=colour, lw=1.2, label=state if here.size else "")
    axes[4].set(yticks=[], xlabel="frame")
    for ax, label in zip(axes, _LABELS, strict=True):
        ax.set_ylabel(label)
    for ax in axes[:4]:
        legend(ax)
    legend(axes[4], ncols=6, loc="upper center", bbox_to_anchor=(0.5, -0.9))
    return png_bytes(figure)
