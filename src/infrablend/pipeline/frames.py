"""Extracts frames of videos without loss, with a table of pitch, height and time from the logs of the flights."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.arguments import require_names
from infrablend.core.camera_angles import STRAIGHT_DOWN_DEG
from infrablend.core.dataset import TimeOfDay
from infrablend.core.file_names import distinct_names, file_name
from infrablend.core.files import write_bytes, write_text
from infrablend.core.finished import FRAMES_FILE
from infrablend.core.tasks import OnProgress, paced
from infrablend.errors import ArgumentError, DatasetError, Problem
from infrablend.formats.dji_srt import parse_srt, read_srt
from infrablend.formats.flight import time_of_day
from infrablend.formats.flight_csv import read_flight_csv
from infrablend.formats.flight_log import FIELDS, Coverage, FlightLog, Sampled, sample
from infrablend.formats.images import png_bytes
from infrablend.formats.log_alignment import NO_CLOCK, Aligned, Clock, align
from infrablend.formats.video import Frame, Video
from infrablend.pipeline.dataset_folder import DatasetFolder

TABLE = "metadata.csv"
COLUMNS = (
    "file", "sequence", "captured", "pitch_deg", "altitude_m", "altitude_from", "hfov_deg",
    "time_of_day", "frame", "time_s",
    "roll_deg", "yaw_deg", "latitude_deg", "longitude_deg",
)  # fmt: skip
_DECIMALS = {"latitude_deg": 7, "longitude_deg": 7}
_EVERY = re.compile(r"(\d+(?:\.\d+)?)\s*(s|ms|f|frames?)", re.ASCII)
_TIME = re.compile(r"(?:(?:(\d+):)?(\d{1,3}):)?(\d+(?:\.\d+)?)s?", re.ASCII)
_NEEDED = {
    "pitch_deg": ("gimbal pitch", "camera.pitch='{fixed_deg: 90}'"),
    "altitude_m": ("height", "camera.altitude='{fixed_m: 60}'"),
    "hfov_deg": ("field of view", "camera.focal_length_mm=40"),
}


@dataclass(frozen=True)
class FrameChoice:
    """Which frames of a video to extract.

    Attributes:
        every: Step, `2s` or `500ms` for times, `60f` for frames.
        start: Time of the first frame, as seconds or [h:]m:s; empty for the beginning.
        end: Time after which no frame is taken; empty for the end.

    Raises:
        ArgumentError: A text is none of these.
    """

    every: str
    start: str = ""
    end: str = ""

    def __post_init__(self) -> None:
        step, _ = self.step
        if not step > 0:
            raise ArgumentError(f"every {self.every!r}: expected a step above 0")
        if self.end and self.seconds("end") < self.seconds("start"):
            raise ArgumentError(f"end {self.end!r}: is before start {self.start!r}; expected a later time")

    @property
    def step(self) -> tuple[float, bool]:
        """Step, and whether it counts frames instead of seconds."""
        match = _EVERY.fullmatch(self.every.strip().lower())
        if match is None or (match[2][0] == "f" and "." in match[1]):
            raise ArgumentError(f"every {self.every!r}: expected a step such as 2s, 500ms or 60f (frames)")
        number = float(match[1])
        if not math.isfinite(number):
            raise ArgumentError(f"every {self.every[:20]!r}...: expected a shorter step")
        return (number, True) if match[2][0] == "f" else (number / (1000 if match[2] == "ms" else 1), False)

    def seconds(self, name: str) -> float:
        """Return `start` or `end` in seconds; an empty end is infinite."""
        text = str(getattr(self, name)).strip()
        if not text:
            return math.inf if name == "end" else 0.0
        match = _TIME.fullmatch(text)
        if match is None:
            raise ArgumentError(f"{name} {text!r}: expected seconds such as 12.5, or [h:]m:s such as 1:02:30")
        return int(match[1] or 0) * 3600 + int(match[2] or 0) * 60 + float(match[3])

    def numbers(self, times_s: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the numbers of the frames to take, from the times of all frames.

        With a step in seconds, these are the first frames not earlier than each multiple of the step after the start.
        """
        step, in_frames = self.step
        start, end = self.seconds("start"), self.seconds("end")
        inside = np.flatnonzero((times_s >= start - 1e-6) & (times_s <= end + 1e-6))
        if in_frames:
            return inside[:: int(step)]
        due = np.floor((times_s[inside] - start + 1e-6) / step)
        return inside[np.concatenate([[True], np.diff(due) > 0])] if inside.size else inside


@dataclass(frozen=True)
class FlightFacts:
    """What the user says about the flights.

    Attributes:
        log: Log for all videos; None takes the subtitles beside each video or else in it, if there are any.
        use_log: False to extract without telemetry.
        clock: What is known about the clocks.
        time_of_day: Day or night, for the table; None takes it from the sun where time and place are known.
        hfov_deg: Field of view across the width of the video, for the table; None if unknown.
        names: Names of the sequences, one per video; empty to use the videos' names.
    """

    log: Path | None = None
    use_log: bool = True
    clock: Clock = NO_CLOCK
    time_of_day: TimeOfDay | None = None
    hfov_deg: float | None = None
    names: Sequence[str] = ()

    def __post_init__(self) -> None:
        require_names("names", self.names)
        if self.hfov_deg is not None and not 0.1 <= self.hfov_deg <= 170:
            raise ArgumentError(f"hfov_deg: found {self.hfov_deg}, expected 0.1 to 170 degrees")


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
    facts: Mapping[str, Any]
    frames: int
    colour: int
    log: Mapping[str, str]
    coverage: Coverage | None
    known: Mapping[str, int]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "video": self.video.name, "sequence": self.sequence, **self.facts, "extracted": self.frames,
            "colour": self.colour, "log": dict(self.log),
            "coverage": None if self.coverage is None else self.coverage.to_json(), "known": dict(self.known),
        }  # fmt: skip


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

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "ok": self.ok,
            "frames": sum(c.frames for c in self.clips),
            "clips": [c.to_json() for c in self.clips],
            "problems": [p.to_json() for p in self.problems],
        }


@dataclass(frozen=True, eq=False)
class _Plan:
    """What to do with one video."""

    video: Video
    sequence: str
    numbers: NDArray[np.int64]
    aligned: Aligned | None
    remarks: tuple[Problem, ...] = ()


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
        overwrite: Delete the files that the earlier call wrote first; changed and other files are kept.
        on_progress: Called after each frame.

    Raises:
        MissingDependencyError: PyAV is not installed.
        DatasetError: A video or log cannot be read, the log is that of another flight, or no frame is chosen.
        OutputError: The folder cannot be used or written.
    """
    flight = flight or FlightFacts()
    if not videos:
        raise ArgumentError("videos: found none, expected at least one file")
    folder = DatasetFolder(out, "extraction of frames", FRAMES_FILE)
    folder.require_usable(overwrite)
    plans = _plans(videos, choice, flight)
    header = {"source": " ".join(str(v) for v in videos), "every": choice.every}
    total, done = sum(len(p.numbers) for p in plans), 0
    report_done = paced(on_progress)
    with folder.writing(header, overwrite):
        clips, rows, problems = [], [], []
        for plan in plans:
            written: list[tuple[Frame, str, bool]] = []
            for frame in _wanted(plan):
                path, colour = _write_picture(out, plan.sequence, frame)
                written.append((frame, path, colour))
                done += 1
                if report_done is not None:
                    report_done(done, total)
            sampled = _sampled(plan, written)
            rows += _rows(plan, written, sampled, flight)
            clips.append(_clip(plan, written, sampled, flight.hfov_deg))
            problems += _problems(plan, written, sampled)
        problems += _missing(clips)
        write_text(out / TABLE, _table(rows))
        problems += folder.problems()
        report = FramesReport(out, tuple(clips), tuple(problems))
        folder.finish({"every": choice.every, "start": choice.start, "end": choice.end}, report.to_json())
    return report


def find_subtitles(video: Path) -> Path | None:
    """Return the subtitle file beside a video, of the same name in upper or lower case, or None."""
    for suffix in (".SRT", ".srt", ".Srt"):
        if (path := video.with_suffix(suffix)).is_file():
            return path
    return None


def _own_subtitles(video: Video) -> tuple[FlightLog | None, tuple[Problem, ...]]:
    """Return the log of the subtitles beside a video, or else in it; warnings if those in it hold no telemetry."""
    beside = find_subtitles(video.path)
    if beside is not None:
        return read_log(beside), ()
    text = video.subtitles()
    if not text:
        return None, ()
    try:
        return parse_srt(text, video.path), ()
    except DatasetError as error:
        return None, tuple(replace(p, severity="warning") for p in error.problems)


def read_log(path: Path) -> FlightLog:
    """Read a log of any known kind.

    Raises:
        DatasetError: It cannot be read, or is of no known kind.
    """
    return read_srt(path) if path.suffix.lower() == ".srt" else read_flight_csv(path)


def _plans(videos: Sequence[Path], choice: FrameChoice, flight: FlightFacts) -> list[_Plan]:
    """Open all videos and logs, before anything is written."""
    if flight.names and len(flight.names) != len(videos):
        raise ArgumentError(f"names: found {len(flight.names)}, expected one for each of {len(videos)} video(s)")
    names = distinct_names([file_name(n) for n in (flight.names or [v.stem for v in videos])])
    common = read_log(flight.log) if flight.log is not None and flight.use_log else None
    plans = []
    for path, name in zip(videos, names, strict=True):
        video = Video(path)
        log, remarks = (common, ()) if common is not None or not flight.use_log else _own_subtitles(video)
        aligned = None if log is None else align(log, video.timeline, video.created, flight.clock)
        numbers = choice.numbers(video.timeline.times_s)
        if not numbers.size:
            found = f"no frame between {choice.start or 'the start'} and {choice.end or 'the end'}"
            expected = f"times within the video's {video.timeline.duration_s:.1f} s"
            problem = Problem(path.name, "frames-none", found, expected, "change --start and --end")
            raise DatasetError(f"{path}: no frame to extract", [problem])
        plans.append(_Plan(video, name, numbers, aligned, remarks))
    return plans


def _wanted(plan: _Plan) -> Any:
    """Yield the chosen frames; decoding stops after the last one."""
    wanted = {*plan.numbers.tolist()}
    last = int(plan.numbers[-1])
    with plan.video as video:
        for frame in video.frames():
            if frame.number in wanted:
                yield frame
            if frame.number >= last:
                return


def _write_picture(out: Path, sequence: str, frame: Frame) -> tuple[str, bool]:
    """Write one frame; return its path in the folder and whether it is in colour."""
    pixels = frame.pixels
    name = f"{sequence}/{sequence}_{frame.number:06d}.png"
    write_bytes(out / name, png_bytes(pixels))
    return name, pixels.ndim == 3


def _sampled(plan: _Plan, written: Sequence[tuple[Frame, str, bool]]) -> Sampled | None:
    return None if plan.aligned is None else sample(plan.aligned.log, [f.time_s for f, _, _ in written])


def _usable(field_name: str, value: float) -> bool:
    """Return whether a value can be in the table: a camera that looks down or up, a height that is not negative."""
    if field_name == "pitch_deg":
        return abs(value) <= STRAIGHT_DOWN_DEG
    return value >= 0 if field_name == "altitude_m" else math.isfinite(value)


def _text(field_name: str, value: float) -> str:
    if not math.isfinite(value) or not _usable(field_name, value):
        return ""
    return f"{value:.{_DECIMALS.get(field_name, 3)}f}"


def _rows(
    plan: _Plan, written: Sequence[tuple[Frame, str, bool]], sampled: Sampled | None, flight: FlightFacts
) -> list[dict[str, str]]:
    rows = []
    for k, (frame, path, _) in enumerate(written):
        row = {
            "file": path, "sequence": plan.sequence, "time_of_day": flight.time_of_day or "",
            "frame": str(frame.number), "time_s": f"{frame.time_s:.3f}",
            "hfov_deg": "" if flight.hfov_deg is None else f"{flight.hfov_deg:g}",
        }  # fmt: skip
        if sampled is not None:
            row["captured"] = sampled.captured[k] or ""
            row |= {name: _text(name, float(values[k])) for name, values in sampled.values.items()}
            row["altitude_from"] = "take-off" if row.get("altitude_m") else ""
            row["time_of_day"] = row["time_of_day"] or _time_of_day(row)
        rows.append(row)
    return rows


def _time_of_day(row: Mapping[str, str]) -> str:
    """Return day or night by the sun, if time and place of a frame are known and leave no doubt; else nothing."""
    latitude, longitude = (float(row[k]) if row.get(k) else None for k in ("latitude_deg", "longitude_deg"))
    return time_of_day(row["captured"], latitude, longitude) or ""


def _table(rows: Sequence[Mapping[str, str]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _clip(
    plan: _Plan, written: Sequence[tuple[Frame, str, bool]], sampled: Sampled | None, hfov_deg: float | None
) -> Clip:
    video, timeline = plan.video, plan.video.timeline
    shortest, longest = timeline.steps_s
    facts = {
        "size_wh": list(video.size_wh), "codec": video.codec, "frames": len(timeline.times_s),
        "duration_s": round(timeline.duration_s, 3), "variable_rate": timeline.varies,
        "shortest_step_s": round(shortest, 4), "longest_step_s": round(longest, 4),
    }  # fmt: skip
    log: dict[str, str] = {}
    known: dict[str, int] = {} if hfov_deg is None else {"hfov_deg": len(written)}
    if plan.aligned is not None and sampled is not None:
        log = {
            "name": plan.aligned.log.name, "kind": plan.aligned.log.dialect, "matched_by": plan.aligned.by,
            "height": plan.aligned.log.height,
        }  # fmt: skip
        for name in FIELDS:
            column = sampled.values.get(name)
            known[name] = 0 if column is None else sum(bool(_text(name, float(v))) for v in column)
        known["captured"] = sum(c is not None for c in sampled.captured)
    colour = sum(c for _, _, c in written)
    coverage = None if sampled is None else sampled.coverage
    return Clip(video.path, plan.sequence, facts, len(written), colour, log, coverage, known)


def _problems(
    plan: _Plan, written: Sequence[tuple[Frame, str, bool]], sampled: Sampled | None
) -> list[Problem]:  # fmt: skip
    where = plan.video.path.name
    problems = [*plan.remarks, *plan.video.problems()]
    lost = len(plan.numbers) - len(written)
    if lost:
        found = f"{lost} of {len(plan.numbers)} chosen frame(s) cannot be decoded"
        problems.append(Problem(where, "frames-lost", found, "an intact video", "copy the file from the card again"))
    colour = sum(c for _, _, c in written)
    if colour:
        found = f"{colour} of {len(written)} frame(s) in colour, written as RGB"
        todo = "record with a grey palette (white hot); colours of a palette are no temperatures"
        problems.append(Problem(where, "image-colour", found, "a thermal video in grey", todo, "warning"))
    if plan.video.timeline.varies:
        shortest, longest = plan.video.timeline.steps_s
        found = f"a varying frame rate: steps of {shortest:.3f} to {longest:.3f} s; frames are matched by their times"
        problems.append(Problem(where, "video-rate", found, "equal steps", severity="warning"))
    if plan.aligned is None or sampled is None:
        return problems
    log = plan.aligned.log
    problems += [*log.problems, *plan.aligned.problems]
    c = sampled.coverage
    if c.before or c.after or c.in_gaps:
        found = f"{c.before} frame(s) before the log, {c.after} after it, {c.in_gaps} in gaps of up to "
        found += f"{c.largest_gap_s:.1f} s: no telemetry"
        todo = "check --offset and --log-start, or cut the video with --start and --end"
        problems.append(Problem(log.name, "log-mismatch", found, "a log that covers the video", todo, "warning"))
    for name, what, expected in (
        ("altitude_m", "below the take-off point", "heights above 0"),
        ("pitch_deg", "with a camera that looks back under the aircraft", "-90 to 90 degrees"),
    ):
        values = sampled.values.get(name, np.zeros(0))
        bad = sum(math.isfinite(v) and not _usable(name, float(v)) for v in values.tolist())
        if bad:
            found = f"{bad} frame(s) {what}: {name} is left empty"
            problems.append(Problem(log.name, "log-value", found, expected, severity="warning"))
    return problems


def _joined(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _missing(clips: Sequence[Clip]) -> list[Problem]:
    """Return one warning per video that names all values that recipes need and the table lacks."""
    problems = []
    for clip in clips:
        lacking = [name for name in _NEEDED if not clip.known.get(name)]
        if not lacking:
            continue
        names = _joined([_NEEDED[name][0] for name in lacking])
        source = f"no {names} in {clip.log['name']}" if clip.log else f"no log beside or in the video: no {names}"
        options = ["--hfov DEGREES"] * ("hfov_deg" in lacking) + ["a log that has it (--log)"] * (
            lacking != ["hfov_deg"]
        )
        settings = " ".join(f"--set {_NEEDED[name][1]}" for name in lacking)
        todo = f"give {' and '.join(options)}, or set it in the recipe: {settings}"
        problems.append(Problem(clip.video.name, "telemetry-missing", source, names, todo, "warning"))
    return problems
