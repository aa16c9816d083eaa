"""Pictures of maps of places: surfaces in colour, beside and over the picture."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.surface_kinds import SURFACES, SurfaceKind
from infrablend.report.preview import Rgb, grid, legend, titled, to_rgb, write_sheet

COLOURS: dict[SurfaceKind, tuple[int, int, int]] = {
    "road": (150, 150, 160),
    "path": (222, 214, 200),
    "track": (196, 160, 110),
    "grass": (120, 196, 90),
    "soil": (150, 110, 70),
    "shrub": (120, 140, 50),
    "tree": (20, 100, 40),
    "structure": (210, 70, 60),
    "water": (60, 120, 220),
    "object": (255, 214, 0),
    "sky": (170, 220, 255),
    "margin": (40, 40, 40),
}
_CELL_WIDTH_PX = 360
_COLUMNS = 2


def coloured(kinds: NDArray[np.uint8]) -> Rgb:
    """Return (h, w, 3) the colours of the (h, w) kinds of surface at each pixel."""
    return np.array([COLOURS[kind] for kind in SURFACES], np.uint8)[kinds]


def place_cell(title: str, pixels: NDArray[np.uint8] | NDArray[np.uint16], kinds: NDArray[np.uint8]) -> Rgb:
    """Return a picture and its surfaces side by side, under a title."""
    h, w = pixels.shape
    size = (_CELL_WIDTH_PX, max(1, round(h * _CELL_WIDTH_PX / w)))
    plain = cv2.resize(to_rgb(pixels), size, interpolation=cv2.INTER_AREA)
    map_ = cv2.resize(coloured(kinds), size, interpolation=cv2.INTER_NEAREST)
    return titled(np.hstack([plain, map_]), title)


def write_place_sheet(path: Path, cells: Iterable[Rgb]) -> Path:
    """Write cells with a legend of the colours as a PNG; return its path."""
    body = grid(list(cells), _COLUMNS)
    return write_sheet(path, np.vstack([legend(body.shape[1], {kind: COLOURS[kind] for kind in SURFACES}), body]))
