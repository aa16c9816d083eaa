"""Extracts frames of videos without loss, with a table of pitch, height and time from the logs of the flights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from infrablend.core.files import write_bytes, write_text
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.workspace import FRAMES_FILE, replacing, workspace
from infrablend.errors import ArgumentError
from infrablend.formats.cameras.flight_log import sample
from infrablend.formats.pictures.images import png_bytes
from infrablend.formats.pictures.video import Frame
from infrablend.pipeline.extraction.clips import ClipPlan, FlightFacts, FrameChoice, plan_clips
from infrablend.pipeline.extraction.extraction_report import (
    TABLE,
    FramesReport,
    WrittenFrame,
    clip_problems,
    clip_result,
    missing_values,
    table_text,
    telemetry_rows,
)


def extract_frames(
    videos: Sequence[Path],
    out: Path,
    choice: FrameChoice,
    flight: FlightFacts | None = None,
    *,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> FramesReport:
    """Write frames as PNG files into a folder per video, and a table with the telemetry of each.

    The folder is a background dataset of the format `folder`; each video is a sequence. Grey videos give grey pictures,
    more than 8 bits give 16. The same files and arguments give the same bytes.

    Args:
        videos: Video files.
        out: Folder to write: new or empty, or with `overwrite` one that an earlier call wrote.
        choice: Frames to take.
        flight: Logs, clocks and names.
        overwrite: Replace the folder that an earlier call wrote.
        on_progress: Called after each frame.

    Raises:
        MissingDependencyError: PyAV is not installed.
        DatasetError: A video or log cannot be read, the log is that of another flight, or no frame is chosen.
        OutputError: The folder cannot be used or written.
    """
    flight = flight or FlightFacts()
    if not videos:
        raise ArgumentError("videos: found none, expected at least one file")
    done = 0
    report_done = paced(on_progress)
    with workspace(out, "extraction of frames", FRAMES_FILE, replacing(overwrite)) as space:
        plans = plan_clips(videos, choice, flight)
        total = sum(len(p.numbers) for p in plans)
        clips = []
        rows = []
        problems = []
        for plan in plans:
            written = []
            for frame in _wanted(plan):
                name = f"{plan.sequence}/{plan.sequence}_{frame.number:06d}.png"
                write_bytes(space.folder / name, png_bytes(frame.pixels))
                written.append(WrittenFrame(frame.number, frame.time_s, name, frame.pixels.ndim == 3))
                done += 1
                if report_done is not None:
                    report_done(done, total)
            sampled = None if plan.aligned is None else sample(plan.aligned.log, [f.time_s for f in written])
            rows += telemetry_rows(plan, written, sampled, flight)
            clips.append(clip_result(plan, written, sampled, flight.hfov_deg))
            problems += clip_problems(plan, written, sampled)
        problems += missing_values(clips)
        write_text(space.folder / TABLE, table_text(rows))
        report = FramesReport(out, tuple(clips), tuple(problems))
        space.finish({"every": choice.every, "start": choice.start, "end": choice.end, **report.to_json()})
    return report


def _wanted(plan: ClipPlan) -> Iterator[Frame]:
    wanted = {*plan.numbers.tolist()}
    last = int(plan.numbers[-1])
    with plan.video as video:
        for frame in video.frames():
            if frame.number in wanted:
                yield frame
            if frame.number >= last:
                return
