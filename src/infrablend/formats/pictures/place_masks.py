"""Masks of where objects may stand: a grey picture of the size of each background, bright where they may."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import ImageRecord
from infrablend.core.files import write_bytes
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures.images import load_background, png_bytes

_BRIGHT = 128


def find_mask(folder: Path, image: ImageRecord) -> Path | None:
    """Return the mask of a background, `<split>/<id>.png` or `<id>.png`; None if there is none."""
    places = (folder / image.split / f"{image.id}.png", folder / f"{image.id}.png")
    return next((path for path in places if path.is_file()), None)


def read_mask(folder: Path, image: ImageRecord, size_wh: tuple[int, int]) -> NDArray[np.bool_] | None:
    """Return the (h, w) pixels of a background where objects may stand; None if it has no mask.

    Raises:
        DatasetError: The mask cannot be read, has another size, colours or 16 bits.
    """
    path = find_mask(folder, image)
    if path is None:
        return None
    mask = load_background(path, size_wh)
    if mask.problems or mask.bit_depth != 8:
        found = mask.problems[0].found if mask.problems else "16 bits"
        problem = Problem(
            str(path), "mask-levels", found, "8-bit grey levels, 255 where objects may stand", "convert it"
        )
        raise DatasetError(f"mask {path}: found {found}; expected 8-bit grey levels", [problem])
    return np.asarray(mask.pixels >= _BRIGHT)


def write_mask(folder: Path, image: ImageRecord, allowed: NDArray[np.bool_]) -> Path:
    """Write the mask of a background, `<split>/<id>.png`, from the (h, w) pixels where objects may stand.

    Raises:
        OutputError: It cannot be written.
    """
    return write_bytes(folder / image.split / f"{image.id}.png", png_bytes(allowed.astype(np.uint8) * 255))
