"""Extracts frames of videos without loss, with a table of pitch, height and time from the logs of the flights."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypedDict

from infrablend.core.files import write_bytes, write_text
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.workspace import FRAMES_FILE, replacing, workspace
from infrablend.errors import ArgumentError, Problem
from infrablend.formats.cameras.flight_headers import FOR_ALL
from infrablend.formats.cameras.flight_log import FIELDS, Coverage, Sampled, sample
from infrablend.formats.cameras.video_log import log_problems, rate_problems, telemetry_of, value_text
from infrablend.formats.pictures.images import png_bytes
from infrablend.formats.pictures.video import Frame
from infrablend.formats.values import number_text
from infrablend.pipeline.extraction.clips import ClipPlan, FlightFacts, FrameChoice, plan_clips

TABLE = "metadata.csv"
COLUMNS = (
    "file",
    "sequence",
    "captured",
    "pitch_deg",
    "altitude_m",
    "altitude_from",
    "hfov_deg",
    "time_of_day",
    "frame",
    "time_s",
    "roll_deg",
    "yaw_deg",
    "latitude_deg",
    "longitude_deg",
)
_NEEDED = {
    "pitch_deg": ("gimbal pitch", "camera.pitch='{fixed_deg: 90}'"),
    "altitude_m": ("height", "camera.altitude='{fixed_m: 60}'"),
    "hfov_deg": ("field of view", "camera.model=NAME (of your camera)"),
}


@dataclass(frozen=True)
class WrittenFrame:
    """A frame that has been written.

    Attributes:
        number: Number of the frame in its video, from 0.
        time_s: Time in its video.
        path: Path of the picture in the folder.
        colour: Whether the picture is in colour.
    """

    number: int
    time_s: float
    path: str
    colour: bool


def telemetry_rows(
    plan: ClipPlan, written: Sequence[WrittenFrame], sampled: Sampled | None, flight: FlightFacts
) -> list[dict[str, str]]:
    """Return the rows of the frames of one video, by column."""
    rows = []
    for k, frame in enumerate(written):
        row = {
            "file": frame.path,
            "sequence": plan.sequence,
            "time_of_day": flight.time_of_day or "",
            "frame": str(frame.number),
            "time_s": number_text(round(frame.time_s, 6)),
            "hfov_deg": "" if flight.hfov_deg is None else f"{flight.hfov_deg:g}",
        }
        if sampled is not None:
            stated = telemetry_of(sampled, k)
            row |= stated | {"time_of_day": flight.time_of_day or stated["time_of_day"]}
        rows.append(row)
    return rows


def table_text(rows: Sequence[Mapping[str, str]]) -> str:
    """Return the table as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


class VideoFacts(TypedDict):
    """What a video's file says, as plain JSON values."""

    size_wh: list[int]
    codec: str
    frames: int
    duration_s: float
    variable_rate: bool
    shortest_step_s: float
    longest_step_s: float


@dataclass(frozen=True, eq=False)
class Clip:
    """Result of one video.

    Attributes:
        video: The file.
        sequence: Name of its sequence.
        facts: Size, codec, frames and times.
        frames: Number of frames extracted.
        colour: Number of those in colour.
        log: Name, kind and match of the log; empty without one.
        coverage: How well the log covers the extracted frames; None without a log.
        known: Number of frames with a value, per field.
    """

    video: Path
    sequence: str
    facts: VideoFacts
    frames: int
    colour: int
    log: Mapping[str, str]
    coverage: Coverage | None
    known: Mapping[str, int]

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "video": self.video.name,
            "sequence": self.sequence,
            **self.facts,
            "extracted": self.frames,
            "colour": self.colour,
            "log": dict(self.log),
            "coverage": None if self.coverage is None else self.coverage.to_json(),
            "known": dict(self.known),
        }


@dataclass(frozen=True, eq=False)
class FramesReport:
    """Result of an extraction.

    Attributes:
        out: Folder that was written.
        clips: Result per video.
        problems: Faults of videos and logs, and missing values.
    """

    out: Path
    clips: tuple[Clip, ...]
    problems: tuple[Problem, ...] = field(default=())

    @property
    def ok(self) -> bool:
        """True if every frame could be decoded."""
        return not any(p.severity == "error" for p in self.problems)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "ok": self.ok,
            "frames": sum(c.frames for c in self.clips),
            "clips": [c.to_json() for c in self.clips],
            "problems": [p.to_json() for p in self.problems],
        }


def clip_result(
    plan: ClipPlan, written: Sequence[WrittenFrame], sampled: Sampled | None, hfov_deg: float | None
) -> Clip:
    """Return the result of one video."""
    video = plan.video
    timeline = plan.video.timeline
    shortest, longest = timeline.steps_s
    facts: VideoFacts = {
        "size_wh": list(video.size_wh),
        "codec": video.codec,
        "frames": len(timeline.times_s),
        "duration_s": round(timeline.duration_s, 3),
        "variable_rate": timeline.varies,
        "shortest_step_s": round(shortest, 4),
        "longest_step_s": round(longest, 4),
    }
    log: dict[str, str] = {}
    known: dict[str, int] = {} if hfov_deg is None else {"hfov_deg": len(written)}
    if plan.aligned is not None and sampled is not None:
        log = {
            "name": plan.aligned.log.name,
            "kind": plan.aligned.log.dialect,
            "matched_by": plan.aligned.by,
            "height": plan.aligned.log.height,
        }
        for name in FIELDS:
            column = sampled.values.get(name)
            known[name] = 0 if column is None else sum(bool(value_text(name, float(v))) for v in column)
        known["captured"] = sum(c is not None for c in sampled.captured)
    colour = sum(f.colour for f in written)
    coverage = None if sampled is None else sampled.coverage
    return Clip(video.path, plan.sequence, facts, len(written), colour, log, coverage, known)


def clip_problems(plan: ClipPlan, written: Sequence[WrittenFrame], sampled: Sampled | None) -> list[Problem]:
    """Return the faults of one video and its log."""
    where = plan.video.path.name
    problems = [*plan.remarks, *plan.video.problems()]
    lost = len(plan.numbers) - len(written)
    if lost:
        found = f"{lost} of {len(plan.numbers)} chosen frame(s) cannot be decoded"
        problems.append(Problem(where, "frames-lost", found, "an intact video", "copy the file from the card again"))
    colour = sum(f.colour for f in written)
    if colour:
        found = f"{colour} of {len(written)} frame(s) in colour, written as RGB"
        todo = "record with a grey palette (white hot); colours of a palette are no temperatures"
        problems.append(Problem(where, "image-colour", found, "a thermal video in grey", todo, "warning"))
    problems += rate_problems(where, plan.video.timeline)
    if plan.aligned is not None and sampled is not None:
        todo = "check --offset and --log-start, or cut the video with --start and --end"
        problems += log_problems(plan.aligned, sampled, todo)
    return problems


def _joined(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def missing_values(clips: Sequence[Clip]) -> list[Problem]:
    """Return one warning per video that names all values that recipes need and the table lacks."""
    problems = []
    for clip in clips:
        lacking = [name for name in _NEEDED if not clip.known.get(name)]
        if not lacking:
            continue
        names = _joined([_NEEDED[name][0] for name in lacking])
        source = f"no {names} in {clip.log['name']}" if clip.log else f"no log beside or in the video: no {names}"
        options = []
        if "hfov_deg" in lacking:
            options.append("--hfov DEGREES")
        if lacking != ["hfov_deg"]:
            options.append("a log that has it (--log)")
        settings = " ".join(f"--set {_NEEDED[name][1]}" for name in lacking)
        todo = f"give {' and '.join(options)}, or set it in the recipe: {settings}"
        if any(other.known.get(name) for other in clips for name in lacking):
            todo += FOR_ALL
        problems.append(Problem(clip.video.name, "telemetry-missing", source, names, todo, "warning"))
    return problems


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
