"""Small videos whose grey levels give the frame number, and logs whose heights give the time."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

av = pytest.importorskip("av")

SIZE_WH = (64, 48)
RATE = 10
FRAMES = 50


def write_video(
    path: Path,
    pictures: Sequence[np.ndarray] | None = None,
    *,
    frames: int = FRAMES,
    times_ms: Sequence[int] | None = None,
    created: str = "",
    colour: int = 0,
    codec: str = "libx264",
) -> Path:
    """Write a video without loss.

    Args:
        path: File; the suffix chooses the container.
        pictures: (h, w) luminance of each frame, 16 to 235; None for frames of one level, 16 + number.
        frames: Number of frames without `pictures`.
        times_ms: Time of each frame; None for `RATE`.
        created: Creation time for the container.
        colour: Distance of the colour planes from their neutral middle.
        codec: Codec.
    """
    if pictures is None:
        pictures = [np.full(SIZE_WH[::-1], 16 + k % 200, np.uint8) for k in range(frames)]
    height, width = pictures[0].shape
    tick = Fraction(1, RATE if path.suffix == ".avi" else 1000)  # AVI has frames at all ticks
    with av.open(str(path), "w") as out:
        if created:
            out.metadata["creation_time"] = created
        stream = out.add_stream(codec, rate=RATE)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.codec_context.time_base = tick
        if codec == "libx264":
            stream.options = {"qp": "0", "x264-params": "log-level=none"}
        for k, luminance in enumerate(pictures):
            frame = av.VideoFrame(width, height, "yuv420p")
            half = np.full((height // 2, width // 2), 128 + colour, np.uint8)
            for plane, values in zip(frame.planes, (luminance, half, half), strict=True):
                lines = np.zeros((plane.height, plane.line_size), np.uint8)
                lines[:, : plane.width] = values
                plane.update(lines.tobytes())
            frame.pts = k * tick.denominator // RATE if times_ms is None else times_ms[k]
            frame.time_base = tick
            out.mux(stream.encode(frame))
        out.mux(stream.encode())
    return path


def level(number: int) -> int:
    """Return the grey level of a frame of `write_video` in the full range."""
    return round((number % 200) * 255 / 219)


def timecode(seconds: float) -> str:
    whole, milliseconds = divmod(round(seconds * 1000), 1000)
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d},{milliseconds:03d}"


def write_srt(path: Path, line: Callable[[int, float], str], *, blocks: int = FRAMES, step_s: float = 1 / RATE) -> Path:
    """Write subtitles whose text is `line(number from 1, seconds)`."""
    text = "".join(
        f"{k + 1}\n{timecode(k * step_s)} --> {timecode((k + 1) * step_s)}\n{line(k + 1, k * step_s)}\n\n"
        for k in range(blocks)
    )
    path.write_text(text, "utf-8")
    return path


def bracketed(number: int, seconds: float) -> str:
    """Return one block of today's dialect: 10 m + 1 m/s, pitch -60, a yaw that passes 180 degrees."""
    yaw = 170.0 + 4 * seconds
    return (
        f'<font size="28">FrameCnt: {number}, DiffTime: 100ms\n2024-05-01 12:00:{seconds:06.3f}\n'
        f"[iso: 100] [shutter: 1/800.0] [fnum: 2.8] [focal_len: 24.00] [latitude: 45.5] [longitude: 15.25] "
        f"[rel_alt: {10 + seconds:.3f} abs_alt: 132.860] "
        f"[gb_yaw: {yaw if yaw <= 180 else yaw - 360:.1f} gb_pitch: -60.0 gb_roll: 0.0] </font>"
    )


def write_ground_truth(path: Path, boxes: Sequence[tuple[float, float, float, float] | None]) -> Path:
    """Write a file that holds boxes the way MATLAB's `groundTruth` objects do, as far as mcos-decoder looks."""

    def element(kind: int, payload: bytes) -> bytes:
        return struct.pack("<II", kind, len(payload)) + payload + bytes(-len(payload) % 8)

    def cell(box: tuple[float, float, float, float] | None) -> bytes:
        if box is None:
            return element(14, element(2, bytes(104)))
        return element(14, element(2, bytes(32)) + element(9, struct.pack("<4d", *box)))

    tree = b"".join(cell(b) for b in boxes)
    for _ in range(5):
        tree = element(14, tree)
    workspace = struct.pack("<II", 0x01000000, 0) + tree
    flags = element(6, struct.pack("<II", 9, 0))
    shape = element(5, struct.pack("<ii", 1, len(workspace)))
    array = element(14, flags + shape + element(1, b"") + element(2, workspace))
    head = b"MATLAB 5.0 MAT-file".ljust(116) + struct.pack("<Q", 128) + struct.pack("<HH", 0x0100, 0x4D49)
    path.write_bytes(head + array)
    return path
