"""Pictures that a reader makes from files of a dataset: frames of videos, also without their object, and crops.

They are PNG files in the user's cache folder, made once and found again by the path, size and time of the source. The
dataset's own folder is never written to.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from infrablend.core.file_names import file_name
from infrablend.core.files import cache_folder, read_object, sha256_of_json, write_bytes, write_json
from infrablend.core.mesh import FloatArray
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures.images import load_background, png_bytes
from infrablend.formats.pictures.video import Video
from infrablend.imaging.paint_out import HOWS, REACH, SAMPLES, STEP, How, Shown, find_written, paint_out

FOLDER = "pictures"
# Counts up when the same source would give other pixels.
_VERSION = 1


def derived_folder(source: Path, form: str) -> Path:
    """Return the folder of the pictures made from a file; another one if the file changes."""
    status = source.stat()
    text = f"{_VERSION}|{source.resolve()}|{status.st_size}|{status.st_mtime_ns}|{form}"
    digest = hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()[:24]
    return cache_folder() / FOLDER / f"{file_name(source.stem)[:40]}-{digest}"


def video_frames(source: Path, numbers: Collection[int], left: float = 1.0) -> tuple[Mapping[int, Path], list[Problem]]:
    """Return the pictures of some frames of a video by their numbers, and the faults of the video.

    Frames that do not exist or cannot be decoded are missing in the result. `left` is the share of the width that is
    kept, from the left edge.

    Raises:
        MissingDependencyError: PyAV is not installed.
        DatasetError: The video cannot be opened.
        OutputError: The cache folder cannot be written.
    """
    if not numbers:
        return {}, []
    folder = derived_folder(source, f"frames {left}")
    paths = {n: folder / f"{n:06d}.png" for n in sorted(numbers)}
    missing = {n for n, path in paths.items() if not path.is_file()}
    # What is wrong with these frames is said each time they are read, not only when they are decoded.
    faults = folder / f"faults-{sha256_of_json(sorted(numbers))[:16]}.json"
    known = _known_faults(faults)
    if known is not None and missing == known[0]:
        return {n: path for n, path in paths.items() if n not in missing}, known[1]
    if not missing:
        return paths, []
    with Video(source) as video:
        for frame in video.frames():
            if frame.number in missing:
                pixels = frame.pixels
                pixels = pixels[:, : round(pixels.shape[1] * left)]
                write_bytes(paths[frame.number], png_bytes(pixels.copy(), 1))
            if frame.number >= max(missing):
                break
        problems = video.problems()
    made = {n: path for n, path in paths.items() if path.is_file()}
    if problems or len(made) < len(paths):
        lost = sorted(paths.keys() - made.keys())
        write_json(faults, {"lost": lost, "problems": [p.to_json() for p in problems]})
    return made, problems


def _known_faults(path: Path) -> tuple[set[int], list[Problem]] | None:
    """Return the frames that could not be decoded and the faults of their video; None if that is not known."""
    record = read_object(path)
    try:
        return None if record is None else ({*record["lost"]}, [Problem(**p) for p in record["problems"]])
    except (KeyError, TypeError):  # damaged
        return None


def painted_frames(
    source: Path, numbers: Collection[int], boxes: Sequence[FloatArray | None]
) -> tuple[Mapping[int, tuple[Path, How]], list[Problem]]:
    """Return the pictures of some frames of a video without their object, see `paint_out`, and the video's faults.

    `boxes` has the object's box in each frame, None for no object. Errors as in `video_frames`.
    """
    rows = [[-1.0] if b is None else b.tolist() for b in boxes]
    folder = derived_folder(source, f"painted {json.dumps(rows)}")
    made = {
        n: (path, how) for n in sorted(numbers) for how in HOWS if (path := folder / how / f"{n:06d}.png").is_file()
    }
    waiting = [n for n in sorted(numbers) if n not in made]
    if not waiting:
        return made, []
    over_all = {*range(0, len(boxes), max(STEP, len(boxes) // SAMPLES))}
    with Video(source) as video:
        samples = {f.number: Shown(f.pixels, boxes[f.number]) for f in video.frames() if f.number in over_all}
    written = find_written(list(samples.values()))

    def paint(number: int, recent: Mapping[int, Shown]) -> None:
        near = {k: s for k, s in recent.items() if k % STEP == 0 and abs(k - number) <= REACH} | samples
        others = [(k - number, near[k]) for k in sorted(near.keys() - {number}, key=lambda k: (abs(k - number), k))]
        pixels, how = paint_out(recent[number], others, written)
        made[number] = write_bytes(folder / how / f"{number:06d}.png", png_bytes(pixels, 1)), how

    with Video(source) as video:
        recent: dict[int, Shown] = {}
        for frame in video.frames():
            while waiting and frame.number > waiting[0] + REACH:
                first = waiting.pop(0)
                if first in recent:
                    paint(first, recent)
                recent = {k: s for k, s in recent.items() if waiting and k >= waiting[0] - REACH}
            if not waiting:
                break
            reached = waiting[0] - REACH <= frame.number < len(boxes)
            if reached and (frame.number % STEP == 0 or frame.number in waiting):
                recent[frame.number] = Shown(frame.pixels, boxes[frame.number])
        for number in waiting:
            if number in recent:
                paint(number, recent)
        problems = video.problems()
    return made, problems


def crop(source: Path, border_px: int) -> Path:
    """Return a picture without a border of some pixels on every side.

    Raises:
        DatasetError: The picture cannot be decoded, or is not larger than the border.
        OutputError: The cache folder cannot be written.
    """
    path = derived_folder(source, f"crop {border_px}") / f"{file_name(source.stem)}.png"
    if path.is_file():
        return path
    picture = load_background(source)
    pixels = picture.pixels[border_px : -border_px or None, border_px : -border_px or None]
    if not pixels.size:
        found = f"{picture.size_wh[0]}x{picture.size_wh[1]} px, all of it border"
        raise DatasetError(f"{source}: {found}", [Problem(source.name, "image-size", found, "a larger picture")])
    return write_bytes(path, png_bytes(pixels.copy(), 1))
