"""Recognise radiometric JPEG files, which contain temperatures beside the picture that is shown."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.errors import Problem

# Only these formats hold pictures of any camera; those of the public datasets are known.
ANY_CAMERA = ("folder", "yolo", "coco", "voc", "dota", "masks")
_LOOKED_AT = 8
# DJI stores two bytes per pixel in segments APP3; other programs put no more than a few hundred bytes there.
_DJI_LEAST_BYTES = 32_768


def camera_of_radiometric(path: Path) -> str | None:
    """Return `FLIR` or `DJI` if a file is a radiometric JPEG of such a camera, else None; nothing is decoded."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path, formats=("JPEG",)) as picture:
                segments: list[tuple[str, bytes]] = getattr(picture, "applist", [])
    except Exception:  # unreadable pictures are reported where they are read
        return None
    if any(name == "APP1" and data.startswith(b"FLIR\0") for name, data in segments):
        return "FLIR"
    if sum(len(data) for name, data in segments if name == "APP3") >= _DJI_LEAST_BYTES:
        return "DJI"
    return None


def radiometric_warnings(dataset: Dataset) -> list[Problem]:
    """Return a warning if pictures contain temperatures, which are not used yet; only a few pictures are opened."""
    if dataset.format not in ANY_CAMERA:
        return []
    jpegs = [i for i in dataset.images if i.path.suffix.lower() in (".jpg", ".jpeg") and _is_regular(i.path)]
    looked_at = _spread(jpegs)
    cameras = [c for i in looked_at if (c := camera_of_radiometric(i.path)) is not None]
    if not cameras:
        return []
    which = " or ".join(sorted(set(cameras)))
    found = f"radiometric JPEG files ({which}; {len(cameras)} of {len(looked_at)} looked at), read as plain pictures"
    expected = "pictures whose grey levels are all that is needed"
    todo = "go on if the grey levels suffice: the temperatures in these files are not used yet"
    return [Problem(dataset.root.name, "image-radiometric", found, expected, todo, "warning")]


def _spread(images: Sequence[ImageRecord]) -> Sequence[ImageRecord]:
    return images[:: max(1, len(images) // _LOOKED_AT)][:_LOOKED_AT]


def _is_regular(path: Path) -> bool:
    """Return whether a path is a file and no link; opening a pipe would wait for ever."""
    return path.is_file() and not path.is_symlink()
