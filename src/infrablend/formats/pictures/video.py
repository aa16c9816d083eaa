"""Decode a video frame by frame with PyAV: pictures without loss, and the time of each."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.files import replace_atomically
from infrablend.errors import DatasetError, MissingDependencyError, Problem
from infrablend.formats.cameras.flight_log import MAX_LOG_BYTES
from infrablend.formats.pictures.images import grey_of_rgb
from infrablend.formats.pictures.listing import MAX_PIXELS

SUFFIXES = (".mp4", ".mov", ".mkv", ".avi", ".m4v", ".ts", ".mts", ".webm", ".lrv", ".lrf")
# Containers of video. FFmpeg also knows playlists, which open other files and addresses.
_CONTAINERS = "mov,mp4,matroska,webm,avi,mpegts,mpeg,mpegvideo,m4v,h264,hevc,flv,asf,mxf,ogg,nut,ivf,mjpeg,wav"
# Formats with interleaved planes, and those with the same values in planes of their own.
_PLANES = {"nv12": "yuv420p", "nv21": "yuv420p", "yuyv422": "yuv422p", "uyvy422": "yuv422p"}
# Codecs of subtitles as text: FFmpeg's names; `mov_text` is the one of MP4.
_TEXT_SUBTITLES = ("mov_text", "subrip", "srt", "text")
# Encoders of grey pictures leave the colour planes at their middle, give or take rounding.
_NEUTRAL = 2


# Levels of video, 16 to 235, of grey levels.
_LIMITED = np.rint(16 + 219 / 255 * np.arange(256)).astype(np.uint8)


def is_video(path: Path) -> bool:
    """Return whether a path is a file with a video's suffix."""
    return path.suffix.lower() in SUFFIXES and path.is_file()


def require_av() -> Any:
    """Return PyAV's module.

    Raises:
        MissingDependencyError: PyAV is not installed.
    """
    try:
        return importlib.import_module("av")
    except ImportError as error:
        raise MissingDependencyError(
            'PyAV is not installed; reading video needs it. Install the extra: pip install "infrablend[video]"'
        ) from error


@dataclass(frozen=True, eq=False)
class Frame:
    """One decoded frame.

    Attributes:
        number: Number in order of presentation, from 0; it counts frames that cannot be decoded, too.
        time_s: Seconds since the first frame.
    """

    number: int
    time_s: float
    _picture: Any = field(repr=False)

    @property
    def pixels(self) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """(h, w) grey levels, uint8 or uint16, or (h, w, 3) uint8 colour."""
        return _pixels(self._picture)


@dataclass(frozen=True, eq=False)
class Timeline:
    """Times of all frames of a video, from its packets, before anything is decoded.

    Attributes:
        times_s: (n,) seconds since the first frame, ascending.
        numbers: Frame number by timestamp; empty if the timestamps are missing or repeat.
        repeated: Frames with the same time as the frame before.
    """

    times_s: NDArray[np.float64]
    numbers: Mapping[int, int]
    repeated: int = 0

    @property
    def seconds(self) -> list[float]:
        """Times of all frames to the microsecond, as in `Capture.time_s`."""
        return [round(t, 6) for t in self.times_s.tolist()]

    @property
    def duration_s(self) -> float:
        """Time of the last frame."""
        return float(self.times_s[-1]) if self.times_s.size else 0.0

    @property
    def steps_s(self) -> tuple[float, float]:
        """Shortest and longest time between two frames; zeros for fewer than two frames."""
        steps = np.diff(self.times_s)
        return (float(steps.min()), float(steps.max())) if steps.size else (0.0, 0.0)

    @property
    def varies(self) -> bool:
        """True if the frame rate varies: steps differ by more than a fifth and two milliseconds."""
        shortest, longest = self.steps_s
        return longest > 1.2 * shortest + 2e-3


class Video:
    """A video file, open for reading once from its beginning; use it as a context manager.

    Attributes:
        path: The file.
        size_wh: Width and height, px.
        codec: Codec and pixel format.
        created: Creation time in the container, UTC; None if there is none.
        announced: Number of frames according to the container; 0 if it does not say.
        timeline: Times of all frames.
        damaged: Packets that could not be decoded so far.
        other_size: Frames of another size so far, left out.
        turned: Whether the container asks players to turn the picture.
    """

    def __init__(self, path: Path) -> None:
        """Open a file, and read the times of its frames without decoding them.

        Raises:
            MissingDependencyError: PyAV is not installed.
            DatasetError: There is no such file, it is no video, it has no video stream or no frame, or its frames are
                too large.
        """
        self.path = path
        self._av = require_av()
        self._container, self._stream = self._open()
        try:
            context = self._stream.codec_context
            self.size_wh = int(context.width or 0), int(context.height or 0)
            if self.size_wh[0] * self.size_wh[1] > MAX_PIXELS or min(self.size_wh) <= 0:
                found = f"{self.size_wh[0]}x{self.size_wh[1]} px"
                raise _refuse(path, "image-too-large", found, f"1 to {MAX_PIXELS} px", "check the file")
            self.codec = f"{context.name} {context.pix_fmt}"
            self.created = _created(self._container, self._stream)
            self.announced = int(self._stream.frames or 0)
            self.damaged = self.other_size = 0
            self.turned = False
            self.timeline = self._scan()
        finally:
            self._container.close()

    def _open(self) -> tuple[Any, Any]:
        path = self.path
        if path.is_dir():
            suffix = next((p.suffix for p in sorted(path.iterdir()) if p.suffix.lower() in SUFFIXES), ".MP4")
            todo = f"give its videos, such as {path}/*{suffix}"
            raise _refuse(path, "video-missing", "a folder", "video files", todo)
        if not path.is_file():
            raise _refuse(path, "video-missing", "no such file", "a video file", "check the path")
        try:
            options = {"format_whitelist": _CONTAINERS, "protocol_whitelist": "file"}
            container = self._av.open(str(path), mode="r", options=options)
        except (self._av.error.FFmpegError, ValueError, OSError) as error:
            found = f"cannot be opened ({_reason(error)})"
            todo = "copy the file from the card again: a truncated MP4 lacks the index at its end"
            raise _refuse(path, "video-unreadable", found, "a video that FFmpeg can read", todo) from error
        stream = container.streams.best("video")
        if stream is None or stream.codec_context is None:
            kinds = ", ".join(sorted({s.type for s in container.streams})) or "no stream"
            container.close()
            raise _refuse(path, "video-none", f"no video stream, only {kinds}", "a video", "give the video file")
        return container, stream

    def _scan(self) -> Timeline:
        stamps: list[int | None] = []
        with contextlib.suppress(self._av.error.FFmpegError):  # what follows is missing when decoded, too
            for packet in self._container.demux(self._stream):
                if packet.size and not packet.is_discard:
                    stamps.append(packet.pts if packet.pts is not None else packet.dts)
        if not stamps:
            found = "a video stream without frames"
            todo = "copy the file from the card again"
            raise _refuse(self.path, "video-none", found, "at least one frame", todo)
        begin = min((s for s in stamps if s is not None), default=0)
        self._begin_s = float(begin * (self._stream.time_base or 0))
        base = self._stream.time_base
        rate = self._stream.average_rate or self._stream.guessed_rate
        known = sorted(s for s in stamps if s is not None)
        if len(known) == len(stamps) and base:
            repeated = len(known) - len({*known})
            times = np.array([float((s - known[0]) * base) for s in known], np.float64)
            return Timeline(times, {} if repeated else {s: k for k, s in enumerate(known)}, repeated)
        if not rate:
            found = "frames without times, and no frame rate"
            todo = "convert it to MP4 or MKV"
            raise _refuse(self.path, "video-times", found, "a container with times", todo)
        return Timeline(np.arange(len(stamps)) / float(rate), {})

    def subtitles(self) -> str:
        """Return the first track of text subtitles as the text of an SRT file, timed from the first frame, or "".

        Tracks beyond `MAX_LOG_BYTES` are cut there; one that cannot be read ends at the fault.
        """
        container, _ = self._open()
        blocks: list[str] = []
        left = MAX_LOG_BYTES
        with container, contextlib.suppress(self._av.error.FFmpegError):
            tracks = [s for s in container.streams.subtitles if s.codec_context is not None]
            track = next((s for s in tracks if s.codec_context.name in _TEXT_SUBTITLES), None)
            if track is None:
                return ""
            codec = track.codec_context.name
            for packet in container.demux(track):
                data = bytes(packet)
                left -= len(data)
                if left < 0:
                    break
                if data and packet.pts is not None and packet.time_base:
                    seconds = max(0.0, float(packet.pts * packet.time_base) - self._begin_s)
                    blocks.append(f"{_srt_time(seconds)} -->\n{_subtitle(data, codec)}\n")
        return "\n".join(blocks)

    def __enter__(self) -> Video:
        self._container, self._stream = self._open()
        return self

    def __exit__(self, *_: object) -> None:
        self._container.close()

    def frames(self) -> Iterator[Frame]:
        """Yield every frame that can be decoded, in order of presentation."""
        with contextlib.suppress(AttributeError, ValueError):
            self._stream.thread_type = "AUTO"
        times = self.timeline.times_s
        number = -1
        for picture in self._pictures():
            number = self.timeline.numbers.get(picture.pts, number + 1)
            if (picture.width, picture.height) != self.size_wh:
                self.other_size += 1
                continue
            self.turned = self.turned or bool(getattr(picture, "rotation", 0))
            if number < len(times):
                yield Frame(number, float(times[number]), picture)

    def _pictures(self) -> Iterator[Any]:
        """Yield decoded pictures; packets that cannot be decoded are counted."""
        error_type = self._av.error.FFmpegError
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets)
            except StopIteration:
                return
            except error_type:
                self.damaged += 1
                return
            try:
                pictures = packet.decode()
            except error_type:
                self.damaged += 1
                continue
            for picture in pictures:
                if getattr(picture, "is_corrupt", False):
                    self.damaged += 1
                else:
                    yield picture

    def problems(self) -> list[Problem]:
        """Return the faults of the video that were seen so far."""
        where = self.path.name
        again = "copy the file from the card again"
        frames = len(self.timeline.times_s)
        repeated = self.timeline.repeated
        missing = f"{self.damaged} frame(s) that cannot be decoded, missing"
        early = f"ends after {frames} of {self.announced} frames"
        other = f"{self.other_size} frame(s) of another size than {self.size_wh[0]}x{self.size_wh[1]}, left out"
        turned = "the container asks to turn the picture; pixels are taken as stored"
        same = f"{repeated} frame(s) with the time of the frame before"
        faults = (
            (self.damaged, Problem(where, "video-damaged", missing, "an intact video", again)),
            (frames < self.announced, Problem(where, "video-truncated", early, "a complete video", again)),
            (repeated, Problem(where, "video-times", same, "times that increase", severity="warning")),
            (self.other_size, Problem(where, "image-size", other, "frames of one size")),
            (self.turned, Problem(where, "video-turned", turned, "no rotation", severity="warning")),
        )
        return [problem for there, problem in faults if there]


def write_video(path: Path, pictures: Iterable[NDArray[np.uint8] | NDArray[np.uint16]], rate: float) -> None:
    """Write (h, w) grey pictures as an H.264 video that browsers play; the same pictures give the same bytes.

    Pictures of another size than the first are scaled to it; 16-bit ones show their own range.

    Raises:
        MissingDependencyError: PyAV is not installed.
        OutputError: The file cannot be written.
    """
    av = require_av()
    with replace_atomically(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1001))
        # One thread, so that the bytes do not depend on the machine's cores.
        stream.options = {"crf": "18", "preset": "veryfast", "threads": "1"}
        stream.pix_fmt = "yuv420p"
        for pixels in pictures:
            shown = _eight_bit(pixels)
            if not stream.codec_context.is_open:
                stream.width, stream.height = (n // 2 * 2 for n in shown.shape[::-1])  # 4:2:0 needs even sizes
            if shown.shape != (stream.height, stream.width):
                shown = np.asarray(cv2.resize(shown, (stream.width, stream.height), interpolation=cv2.INTER_AREA))
            planes = np.full((stream.height * 3 // 2, stream.width), 128, np.uint8)
            planes[: stream.height] = cv2.LUT(shown, _LIMITED)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(planes, format="yuv420p")))
        container.mux(stream.encode())


def _eight_bit(pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.uint8]:
    if pixels.dtype == np.uint8:
        return np.asarray(pixels, np.uint8)
    low, high = (float(v) for v in np.percentile(pixels, [0.1, 99.9]))
    return np.asarray(np.clip((pixels - low) * (255 / max(high - low, 1)), 0, 255), np.uint8)


def _pixels(picture: Any) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return a picture without loss: grey as grey, more than 8 bits as 16, other colour as 8-bit RGB.

    Grey in a colour format is its luminance; the narrow range of video (16 to 235) is spread to 0 to 255.
    """
    name = str(picture.format.name)
    planes = _PLANES.get(name, name.removesuffix("be") + "le" if name.startswith("yuv") and name.endswith("be") else "")
    if planes:
        name = planes
        picture = picture.reformat(format=planes)
    if name.startswith("gray"):
        levels: NDArray[Any] = picture.to_ndarray()
        return np.ascontiguousarray(levels)
    planar = list(picture.format.components) if name.startswith("yuv") else []
    if len(planar) >= 3 and not name.startswith("yuva"):
        bits = int(planar[0].bits)
        luminance = _plane(picture, 0, bits)
        chroma = [_plane(picture, k, bits) for k in (1, 2)] if len(picture.planes) == 3 else []
        middle = 1 << (bits - 1)
        slack = _NEUTRAL << (bits - 8)
        if chroma and all(np.abs(c.astype(np.int32) - middle).max(initial=0) <= slack for c in chroma):
            full = name.startswith("yuvj") or int(getattr(picture, "color_range", 0) or 0) == 2
            if bits > 8:
                return luminance.astype(np.uint16)
            return luminance.astype(np.uint8) if full else _FULL_RANGE[luminance]
    if max((int(c.bits) for c in picture.format.components), default=8) > 8 and not planar:
        deep = grey_of_rgb(picture.to_ndarray(format="rgb48le"))
        if deep.ndim == 2:
            return deep
    return grey_of_rgb(picture.to_ndarray(format="rgb24"))


_FULL_RANGE = np.clip(np.rint((np.arange(256) - 16) * 255 / 219), 0, 255).astype(np.uint8)


def _plane(picture: Any, number: int, bits: int) -> NDArray[Any]:
    """Return one plane as (h, w) without the padding of its lines."""
    plane = picture.planes[number]
    kind = np.dtype(np.uint8) if bits <= 8 else np.dtype("<u2")
    lines = np.frombuffer(plane, kind).reshape(-1, plane.line_size // kind.itemsize)
    return np.ascontiguousarray(lines[: plane.height, : plane.width])


def _subtitle(data: bytes, codec: str) -> str:
    """Return the text of one subtitle packet; those of MP4 have a length before the text, and styles after it."""
    if codec == "mov_text":
        data = data[2 : 2 + int.from_bytes(data[:2], "big")]
    coding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8"
    return data.decode(coding, "replace").replace("\0", "")


def _srt_time(seconds: float) -> str:
    whole, thousandths = divmod(round(seconds * 1000), 1000)
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d},{thousandths:03d}"


def _created(container: Any, stream: Any) -> datetime | None:
    """Return the creation time of a container or stream; None for none and for the zero of MP4."""
    for source in (container, stream):
        text = (source.metadata or {}).get("creation_time")
        if text:
            with contextlib.suppress(ValueError):
                when = datetime.fromisoformat(str(text).replace("Z", "+00:00"))
                when = when if when.tzinfo is not None else when.replace(tzinfo=UTC)
                if when.year > 1971:
                    return when
    return None


def _reason(error: BaseException) -> str:
    return str(getattr(error, "strerror", None) or error or type(error).__name__)


def _refuse(path: Path, code: str, found: str, expected: str, todo: str) -> DatasetError:
    return DatasetError(f"{path}: {found}", [Problem(path.name, code, found, expected, todo)])
