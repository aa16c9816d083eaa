"""Tracks and videos of a run whose objects move through sequences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from infrablend.core.dataset import Category, ImageRecord
from infrablend.core.run_folder import TRACKS, VIDEO
from infrablend.errors import MissingDependencyError, Problem
from infrablend.formats import writing
from infrablend.formats.labels.mot import ASSUMED_RATE
from infrablend.formats.pictures.images import load_background
from infrablend.formats.pictures.video import write_video
from infrablend.formats.sequence_writing import Frames, by_sequence, places_of
from infrablend.formats.write_settings import WriteSettings


def with_own_sequence(image: ImageRecord, configuration: int | None) -> ImageRecord:
    """Return a frame as one of the sequence of its configuration: each has tracks of its own."""
    name = image.capture.sequence
    if name is None:
        return image
    own = f"{name}_original" if configuration is None else f"{name}_c{configuration}"
    return replace(image, capture=replace(image.capture, sequence=own))


def write_tracks(root: Path, images: Sequence[ImageRecord], categories: Sequence[Category]) -> list[Problem]:
    """Write `tracks/<split>/<sequence>/gt/gt.txt` as MOTChallenge has it, and `video/<split>/<sequence>.mp4`.

    Returns:
        Warnings.
    """
    # The pictures are in `images` already.
    written = writing.write("mot", root / TRACKS, images, categories, settings=WriteSettings(pictures=False))
    return [*written.problems, *_write_videos(root / VIDEO, images)]


def _write_videos(out: Path, images: Sequence[ImageRecord]) -> list[Problem]:
    for folder, group in by_sequence(places_of(images)).items():
        frames = Frames(images, group)
        times = [t for i in frames if (t := i.capture.time_s) is not None]
        steps = np.diff(times) if len(times) == len(frames) > 1 else np.array([1 / ASSUMED_RATE])
        steps = steps if (steps > 0).all() else np.array([1 / ASSUMED_RATE])
        pictures = (load_background(i.path, i.size_wh).pixels for i in frames)
        try:
            write_video(out / f"{folder}.mp4", pictures, 1 / max(float(np.median(steps)), 1e-3))
        except MissingDependencyError as error:
            return [Problem(VIDEO, "video-unwritten", "PyAV is not installed", "PyAV", error.message, "warning")]
    return []
