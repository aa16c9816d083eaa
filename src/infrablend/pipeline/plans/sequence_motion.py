"""How the camera moves through the sequences of a dataset: found from the backgrounds, and kept in the cache."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import boxes_mask
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.file_names import real_path
from infrablend.core.files import cache_folder, load_json, sha256_of, write_json
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures.images import load_background
from infrablend.imaging.camera_path import (
    MOST_ERROR_PX,
    Expected,
    Moment,
    follow_camera,
    moment_from_json,
    moment_to_json,
)
from infrablend.imaging.camera_shift import View
from infrablend.imaging.overlap import looks_down, places_of, seen_middle
from infrablend.imaging.paint_out import Shown, Written, find_written

VERSION = 3
"""Part of the cache's key. Raise it when the same pictures give another movement."""
# Frames in which text and reticle are looked for.
_SAMPLES = 12
# Change of the mid level between two frames that is a jump of the gain, 8-bit levels.
_JUMP_LEVELS = 15.0
# A frame is blurred if its second derivative varies less than this share of that of the frames around it, so many.
_BLURRED = 0.5
_AROUND = 12


@dataclass(frozen=True, eq=False)
class SequenceMotion:
    """How the camera moves through one sequence.

    Attributes:
        name: Name of the sequence.
        frames: Numbers of the frames, ascending.
        moments: What is known of the camera in each of them.
        size_wh: Size of the pictures, px.
        other_sizes_wh: Size of the pictures by span, where it is another one.
        levels: Levels of the pictures that the moments' gains and offsets take for 0 and 255.
        unread: Frames that cannot be read, with the reason.
    """

    name: str
    frames: tuple[int, ...]
    moments: tuple[Moment, ...]
    size_wh: tuple[int, int]
    other_sizes_wh: Mapping[int, tuple[int, int]] = field(default_factory=dict)
    levels: tuple[float, float] = (0.0, 255.0)
    unread: Mapping[int, str] = field(default_factory=dict)

    def in_own_levels(self) -> list[Moment]:
        """Return the moments with gains and offsets of the pictures' own levels, such as those of 16 bits."""
        low, high = self.levels
        unit = (high - low) / 255
        return [replace(m, offset=m.offset * unit + low * (1 - m.gain)) for m in self.moments]

    def spans(self) -> list[dict[str, int]]:
        """Return number, first and last frame, and number of known frames of each span."""
        found: dict[int, list[int]] = {}
        for n, m in zip(self.frames, self.moments, strict=True):
            if m.known:
                found.setdefault(m.span, []).append(n)
        return [{"span": s, "first": of[0], "last": of[-1], "frames": len(of)} for s, of in found.items()]

    def level_jumps(self) -> list[int]:
        """Return the frames whose levels differ by a jump from those of the frame before."""
        mid = [m.gain * 128 + m.offset for m in self.moments]
        pairs = zip(self.frames[1:], self.moments, self.moments[1:], mid, mid[1:], strict=False)
        return [n for n, a, b, x, y in pairs if a.known and a.span == b.span and abs(y - x) > _JUMP_LEVELS]

    def blurred(self) -> list[int]:
        """Return the frames that are much less sharp than those around them."""
        sharp = np.array([m.sharpness for m in self.moments])
        around = [np.median(sharp[max(0, k - _AROUND) : k + _AROUND + 1]) for k in range(len(sharp))]
        return [n for n, s, a in zip(self.frames, sharp, around, strict=True) if s < _BLURRED * a]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "sequence": self.name,
            "size_wh": list(self.size_wh),
            "states": dict(sorted(Counter(m.state for m in self.moments).items())),
            "spans": self.spans(),
            "level_jumps": self.level_jumps(),
            "blurred": self.blurred(),
            "frames": [{"frame": n, **moment_to_json(m)} for n, m in zip(self.frames, self.moments, strict=True)],
        }


Follow = Callable[[str, Sequence[ImageRecord]], SequenceMotion]
"""Returns how the camera moves through the pictures of a sequence, given its name."""


def sequences_of(dataset: Dataset) -> dict[str, list[ImageRecord]]:
    """Return the pictures of each sequence in the order of their frames; those without sequence or number are left out.

    Sequences of two splits are two, whatever their names: `train/NAME` and `val/NAME` then.

    Raises:
        DatasetError: No picture has both, or two pictures of a sequence have one number.
    """
    of_split: dict[tuple[str, str], list[ImageRecord]] = {}
    for image in dataset.images:
        if image.capture.sequence is not None and image.capture.frame is not None:
            of_split.setdefault((image.split, image.capture.sequence), []).append(image)
    times = Counter(name for _, name in of_split)
    found = {f"{s}/{name}" if times[name] > 1 else name: images for (s, name), images in of_split.items()}
    if not found:
        raise DatasetError(
            f"{dataset.root}: no picture has a sequence and a frame number; expected clips, unlabelled pictures whose "
            "names end in running numbers, labels that state both, or metadata.csv with file, sequence and frame"
        )
    problems = []
    for name, images in found.items():
        images.sort(key=_frame)
        twice = [a for a, b in pairwise(images) if _frame(a) == _frame(b)]
        problems += [
            Problem(f"sequence {name}", "frame-repeated", f"frame {_frame(a)} twice: {a.id}", "each frame once")
            for a in twice[:1]
        ]
    if problems:
        raise DatasetError(f"{dataset.root}: sequences with repeated frames", problems)
    return found


def _frame(image: ImageRecord) -> int:
    assert image.capture.frame is not None
    return image.capture.frame


def find_motion(
    name: str, images: Sequence[ImageRecord], *, on_frame: Callable[[], None] = lambda: None
) -> SequenceMotion:
    """Return how the camera moves through a sequence, from the cache if these pictures were followed before.

    Raises:
        DatasetError: A picture cannot be read.
    """
    key = _key(images)
    kept = cache_folder() / "motion" / f"{key}.json"
    numbers = tuple(_frame(i) for i in images)
    if kept.is_file():
        for _ in images:
            on_frame()
    else:
        views = _Views(images, on_frame)
        moments = follow_camera(views, stated_middles(images))
        sizes = {m.span: size for m, size in zip(moments, views.sizes_wh, strict=True) if m.known}
        saved = {
            "size_wh": views.size_wh,
            "other_sizes_wh": [[span, *size] for span, size in sizes.items() if size != views.size_wh],
            "levels": views.levels,
            "unread": list(views.unread.items()),
            "frames": [moment_to_json(m) for m in moments],
        }
        write_json(kept, saved)
    saved = load_json(kept)  # what a later run will read, to the last digit
    known = tuple(moment_from_json(m) for m in saved["frames"])
    other = {span: (w, h) for span, w, h in saved["other_sizes_wh"]}
    size_wh = tuple(saved["size_wh"])
    levels = tuple(saved["levels"])
    return SequenceMotion(name, numbers, known, size_wh, other, levels, dict(saved["unread"]))


def stated_middles(images: Sequence[ImageRecord]) -> Expected:
    """Return what pictures that look straight down state of where they show the middle of others."""
    captures = [i.capture for i in images]
    size_wh = images[0].size_wh

    def middle(one: int, other: int) -> tuple[float, float] | None:
        pair = (captures[one], captures[other])
        lens = pair[1].hfov_deg
        if size_wh is None or lens is None or not all(looks_down(c) and c.altitude_m is not None for c in pair):
            return None
        before, after = places_of(pair, size_wh)
        return seen_middle(before, after, size_wh, lens)

    return middle


def sequence_views(images: Sequence[ImageRecord], on_frame: Callable[[], None] = lambda: None) -> Iterator[View]:
    """Yield the pictures of a sequence as the estimate sees them: without labelled objects, text and reticle.

    Pictures that cannot be read are plain, so that nothing follows from them.

    Raises:
        DatasetError: No picture can be read.
    """
    return iter(_Views(images, on_frame))


class _Views:
    """The pictures of a sequence as the estimate sees them, read one by one.

    Attributes:
        size_wh: Size of the first picture.
        levels: Levels that become 0 and 255.
        sizes_wh: Size of each picture so far.
        unread: Frames so far that cannot be read, with the reason.
    """

    def __init__(self, images: Sequence[ImageRecord], on_frame: Callable[[], None]) -> None:
        """Look at some pictures for text, reticle and levels."""
        some = sample_of(images) or [*islice(_readable(images), 1)] or [_pixels(images[0])]
        self.levels = _range_of(some)
        self._written = find_written([_shown(p, *self.levels) for p in some if p.shape == some[0].shape])
        self._images = images
        self._on_frame = on_frame
        self.size_wh = (int(some[0].shape[1]), int(some[0].shape[0]))
        self.sizes_wh: list[tuple[int, int]] = []
        self.unread: dict[int, str] = {}

    def __iter__(self) -> Iterator[View]:
        """Yield the views."""
        for image in self._images:
            try:
                view = _view(image, self._written, *self.levels)
            except DatasetError as error:
                self.unread[_frame(image)] = "; ".join(f"{p.where}: {p.found}" for p in error.problems) or str(error)
                width, height = self.sizes_wh[-1] if self.sizes_wh else self.size_wh
                view = View(np.zeros((height, width), np.uint8), np.ones((height, width), np.bool_))
            self.sizes_wh.append(view.size_wh)
            yield view
            self._on_frame()


def sample_of(images: Sequence[ImageRecord]) -> list[NDArray[np.uint8] | NDArray[np.uint16]]:
    """Return some pictures of a sequence in which to look for text and reticle; those that cannot be read are left out.

    The first and the last are among them, between which the scene differs most.
    """
    chosen = np.unique(np.linspace(0, len(images) - 1, _SAMPLES).round().astype(int))
    return [*_readable(images[k] for k in chosen)]


def _readable(images: Iterable[ImageRecord]) -> Iterator[NDArray[np.uint8] | NDArray[np.uint16]]:
    for image in images:
        with contextlib.suppress(DatasetError):
            yield _pixels(image)


def _key(images: Sequence[ImageRecord]) -> str:
    digest = hashlib.sha256(f"{VERSION} {cv2.__version__}".encode())
    for image in images:
        boxes = [i.box_xyxy.tolist() for i in image.instances]
        sha256 = None
        with contextlib.suppress(OSError):  # named where it is read
            sha256 = sha256_of(real_path(image.path))
        c = image.capture
        # What `stated_middles` follows from, where it is stated.
        stated = [c.place, c.yaw_deg, c.roll_deg, c.pitch_deg, c.altitude_m, c.hfov_deg] if looks_down(c) else []
        digest.update(json.dumps([_frame(image), sha256, boxes, *stated]).encode())
    return digest.hexdigest()[:32]


def _pixels(image: ImageRecord) -> NDArray[np.uint8] | NDArray[np.uint16]:
    return load_background(image.path, image.size_wh).pixels


def _range_of(some: Sequence[NDArray[np.uint8] | NDArray[np.uint16]]) -> tuple[float, float]:
    """Return the levels that become 0 and 255: those of 8-bit pictures as they are, the used range of 16-bit ones."""
    if all(p.dtype == np.uint8 for p in some):
        return 0.0, 255.0
    low, high = (float(f(np.percentile(p, q) for p in some)) for f, q in ((min, 0.5), (max, 99.5)))
    return low, max(high, low + 1)


def _shown(pixels: NDArray[np.uint8] | NDArray[np.uint16], low: float, high: float) -> Shown:
    if pixels.dtype != np.uint8 or (low, high) != (0.0, 255.0):
        pixels = np.clip((pixels.astype(np.float32) - low) * (255 / (high - low)), 0, 255).astype(np.uint8)
    return Shown(pixels, None)


def _view(image: ImageRecord, written: Written, low: float, high: float) -> View:
    shown = _shown(_pixels(image), low, high)
    blocked = np.zeros(shown.pixels.shape[:2], np.bool_)
    if written.marked.shape == blocked.shape:
        blocked |= cv2.dilate(written.marked.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    grown = []
    for i in image.instances:
        grow = 4 + 0.2 * (i.box_xyxy[2:] - i.box_xyxy[:2])
        grown.append(np.concatenate([i.box_xyxy[:2] - grow, i.box_xyxy[2:] + grow]))
    return View(shown.grey, blocked | boxes_mask(grown, blocked.shape))


def motion_problems(motion: SequenceMotion) -> Iterator[Problem]:
    """Yield warnings for frames that are not known, and for spans that cannot be related to each other."""
    where = f"sequence {motion.name}"
    if motion.unread:
        number, reason = next(iter(motion.unread.items()))
        found = f"{len(motion.unread)} frame(s) that cannot be read, such as {number} ({reason})"
        todo = "fetch them again"
        yield Problem(where, "frames-lost", found, "intact pictures", todo, "warning")
    if motion.other_sizes_wh:
        sizes = ", ".join(f"{w}x{h}" for w, h in dict.fromkeys((motion.size_wh, *motion.other_sizes_wh.values())))
        found = f"pictures of {sizes} px"
        todo = "no track goes from one size into the other"
        yield Problem(where, "image-size", found, "one size per sequence", todo, "warning")
    lost = [n for n, m in zip(motion.frames, motion.moments, strict=True) if not m.known]
    if len(lost) == len(motion.frames):
        todo = "state the camera's movement, or choose a clip with ground, trees or buildings in view"
        yield Problem(where, "no-motion", "no frame shows how the camera moves", "a background with details", todo)
    elif lost:
        found = f"{len(lost)} of {len(motion.frames)} frames, {lost[0]} the first, do not show how the camera moves"
        yield Problem(where, "motion-lost", found, "a background with details", "they stay without tracks", "warning")
    if len(spans := motion.spans()) > 1:
        begins = ", ".join(str(s["first"]) for s in spans[1:6])
        found = f"{len(spans)} spans; new ones begin at frame {begins}"
        yield Problem(where, "motion-cut", found, "one scene", "no track goes from one into the other", "warning")
    uncertain = [
        n for n, m in zip(motion.frames, motion.moments, strict=True) if m.known and m.error_px > MOST_ERROR_PX
    ]
    if uncertain:
        found = f"{len(uncertain)} frames, {uncertain[0]} the first, are known to no better than {MOST_ERROR_PX:g} px"
        yield Problem(where, "motion-uncertain", found, "less", "look at the page", "warning")
