"""Finds the surfaces of a picture with the shipped model: road, grass, trees, roofs, water, and what stands on them.

The model is a small network that `scripts/train_surfaces.py` trains on the virtual world alone, which knows what each
of its pixels is. OpenCV runs it. Its output is rounded to 8 bits, so that the same machine repeats itself to the byte.
"""

from __future__ import annotations

import functools
import hashlib
import lzma
from dataclasses import dataclass
from importlib import resources

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import boxes_mask
from infrablend.core.mesh import FloatArray
from infrablend.core.surface_kinds import GROUND, SURFACES, Affinity, SurfaceKind
from infrablend.imaging.margin import find_margin

Grey = NDArray[np.uint8] | NDArray[np.uint16]
Share = NDArray[np.float32]

# The longer side of pictures that the model sees, px; it has learnt from 320x256.
_LONGER_PX = 320
# Sides are multiples of this, as the model's levels halve them.
_STEP_PX = 64
# Contrast below which a picture is even: it is not spread further, levels as a share of the whole range.
_LEAST_SPREAD = 4 / 255
# How far one can stand and drive on each kind.
STAND: Affinity = GROUND
DRIVE: Affinity = {"road": 1.0, "path": 0.3, "track": 0.3}
# Power of the probabilities in `suitability`: where two kinds are about as likely, as at the edge of a road, the
# likelier one decides.
_SHARPER = 3.0
# Cells where surfaces with any affinity are less likely than this are out of the question.
_LIKELY = 0.5


@dataclass(frozen=True, eq=False)
class SurfaceMap:
    """What lies at each cell of a picture.

    Attributes:
        shares: (len(SURFACES), h', w') uint8, probability of each kind times 255, at a lower resolution.
        size_wh: Size of the picture.
    """

    shares: NDArray[np.uint8]
    size_wh: tuple[int, int]

    def share(self, kinds: Affinity) -> Share:
        """Return the (h, w) probability, in [0, 1], of some kinds of surface with their weights, at full size."""
        weights = np.array([kinds.get(kind, 0.0) for kind in SURFACES], np.float32)
        small = np.tensordot(weights, self.shares.astype(np.float32), axes=1) / 255
        return np.asarray(np.clip(cv2.resize(small, self.size_wh, interpolation=cv2.INTER_LINEAR), 0, 1), np.float32)

    def suitability(self, affinity: Affinity) -> Share:
        """Return the (h', w') affinity, in [0, 1], to what lies at each cell; 0 where it is likely to have none."""
        weights = np.array([affinity.get(kind, 0.0) for kind in SURFACES], np.float32)
        suits = np.tensordot(weights, self.sharp(), axes=1)
        suits[self.shares[weights > 0].sum(axis=0, dtype=np.int64) < _LIKELY * 255] = 0
        return np.asarray(suits, np.float32)

    def sharp(self) -> Share:
        """Return the (len(SURFACES), h', w') probabilities, in [0, 1], with those of the likelier kinds enlarged."""
        sharp = (self.shares.astype(np.float32) / 255) ** _SHARPER
        return np.asarray(sharp / np.maximum(sharp.sum(axis=0), 1e-6), np.float32)

    def set(self, cells: NDArray[np.bool_], kind: SurfaceKind) -> None:
        """State, in place, that cells are of a kind."""
        number = SURFACES.index(kind)
        for k, share in enumerate(self.shares):
            share[cells] = 255 if k == number else 0

    def shares_of_kinds(self) -> dict[SurfaceKind, float]:
        """Return the share of the picture of each kind of surface that is the most probable one somewhere."""
        kinds = self.shares.argmax(axis=0)
        found = {kind: float((kinds == k).mean()) for k, kind in enumerate(SURFACES)}
        return {kind: share for kind, share in found.items() if share}

    def kinds(self) -> NDArray[np.uint8]:
        """Return the (h, w) most probable kind at each pixel, a number in `SURFACES`."""
        kinds = self.shares.argmax(axis=0).astype(np.uint8)
        return np.asarray(cv2.resize(kinds, self.size_wh, interpolation=cv2.INTER_NEAREST), np.uint8)


def find_surfaces(
    pixels: Grey, boxes_xyxy: FloatArray | None = None, sky: NDArray[np.bool_] | None = None
) -> SurfaceMap:
    """Return what lies where in a picture.

    Args:
        pixels: (h, w) grey levels of 8 or 16 bits.
        boxes_xyxy: (n, 4) boxes of its annotated objects.
        sky: (h, w) mask of its sky, which the model does not know; none by default.
    """
    h, w = pixels.shape
    level = _spread(pixels)
    scale = _LONGER_PX / max(h, w)
    size = (max(1, round(w * scale / _STEP_PX)) * _STEP_PX, max(1, round(h * scale / _STEP_PX)) * _STEP_PX)
    small = cv2.resize(level, size, interpolation=cv2.INTER_AREA)
    small -= small.mean()
    small /= max(float(small.std()), _LEAST_SPREAD)
    net = _net()
    net.setInput(small[None, None])
    scores = net.forward()[0]
    shares = np.exp(scores - scores.max(axis=0))
    shares /= shares.sum(axis=0)
    cells = np.zeros((len(SURFACES), *shares.shape[1:]), np.uint8)
    cells[: len(shares)] = np.rint(255 * shares)
    found = SurfaceMap(cells, (w, h))
    if boxes_xyxy is not None and len(boxes_xyxy):
        found.set(_at_cells(boxes_mask(boxes_xyxy, (h, w)), cells.shape), "object")
    if sky is not None:
        found.set(_at_cells(sky, cells.shape), "sky")
    margin = find_margin(pixels, 1.0 if pixels.dtype == np.uint8 else float(np.ptp(pixels)) / 255)
    if margin is not None:
        found.set(_at_cells(margin, cells.shape), "margin")
    return found


def _at_cells(mask: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return the cells of which at least half is inside an (h, w) mask."""
    share = cv2.resize(mask.astype(np.float32), (shape[2], shape[1]), interpolation=cv2.INTER_AREA)
    return np.asarray(share >= 0.5)


def _spread(pixels: Grey) -> Share:
    """Return the levels as a share of the range: of 8 bits, or of what the 16-bit picture uses."""
    if pixels.dtype == np.uint8:
        return np.asarray(pixels / 255, np.float32)
    low, high = np.percentile(pixels, (0.5, 99.5))
    return np.asarray(np.clip((pixels.astype(np.float32) - low) / max(high - low, 1.0), 0, 1), np.float32)


@functools.cache
def _model_bytes() -> bytes:
    return (resources.files(__package__) / "surfaces.onnx.xz").read_bytes()


@functools.cache
def model_version() -> str:
    """Return the version of the model: the start of its file's digest."""
    return hashlib.sha256(_model_bytes()).hexdigest()[:12]


@functools.cache
def _net() -> cv2.dnn.Net:
    return cv2.dnn.readNetFromONNX(np.frombuffer(lzma.decompress(_model_bytes()), np.uint8))
