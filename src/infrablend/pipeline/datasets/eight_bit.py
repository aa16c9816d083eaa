"""Copies of 16-bit pictures in 8 bits, by an automatic gain control: for datasets and for trainers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from infrablend.config.agc import Agc
from infrablend.core.dataset import ImageRecord
from infrablend.core.file_names import join_inside
from infrablend.core.files import write_bytes
from infrablend.core.spool import Spool, StoredImages
from infrablend.formats.pictures.images import load_background, png_bytes


def eight_bit_copies(images: Sequence[ImageRecord], folder: Path, agc: Agc) -> tuple[Sequence[ImageRecord], int]:
    """Write an 8-bit PNG per picture to `folder`/<split>/; equal pictures give equal bytes.

    Returns:
        The images with these pictures, and the number of pictures that had 8 bits already and keep their levels.

    Raises:
        DatasetError: A picture cannot be read.
        OutputError: A file cannot be written.
        ValueError: A fixed range of temperatures, and a picture without a scale.
    """
    copies: Spool[ImageRecord] = Spool(folder)
    as_they_are = 0
    for image in images:
        pixels = load_background(image.path, image.size_wh).pixels
        if pixels.dtype == np.uint16:
            scale = image.capture.scale
            levels = agc.apply(np.asarray(pixels, np.uint16), scale)
        else:
            levels = np.asarray(pixels, np.uint8)
            as_they_are += 1
        name = str(PurePosixPath(image.name).with_suffix(".png"))
        path = write_bytes(join_inside(folder / image.split, name), png_bytes(levels))
        known = replace(image.capture, radiometry=None)
        copies.append(replace(image, path=path, file_name=name, capture=known))
    stored = isinstance(images, StoredImages)
    return StoredImages(copies, range(len(copies))) if stored else list(copies), as_they_are
