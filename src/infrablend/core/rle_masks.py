"""Binary masks in COCO's run-length encoding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pycocotools import mask as _coco


@dataclass(frozen=True)
class Mask:
    """A binary mask of a whole image.

    Attributes:
        counts: Column-major run lengths in COCO's compressed text.
        size_hw: Height and width of the image, pixels.
    """

    counts: str
    size_hw: tuple[int, int]

    @classmethod
    def from_array(cls, mask: NDArray[np.bool_]) -> Mask:
        """Encode a (h, w) boolean array."""
        rle = _coco.encode(np.asfortranarray(mask, np.uint8))
        return cls(rle["counts"].decode("ascii"), (int(mask.shape[0]), int(mask.shape[1])))

    def to_array(self) -> NDArray[np.bool_]:
        """Decode to a (h, w) boolean array."""
        # Not by pycocotools, whose decoder numpy 2 deprecates.
        lengths = run_lengths(self.counts)
        ones = np.arange(len(lengths)) % 2 == 1
        return np.asarray(np.repeat(ones, lengths).reshape(self.size_hw, order="F"), np.bool_)

    def to_coco(self) -> dict[str, object]:
        """Return the mask in COCO's form, `{"size": [h, w], "counts": "..."}`."""
        return {"size": list(self.size_hw), "counts": self.counts}

    @classmethod
    def from_coco(cls, value: object, size_hw: tuple[int, int]) -> Mask:
        """Return the mask of an untrusted `{"size": ..., "counts": ...}`, with compressed or plain run lengths.

        The run lengths are checked first, because pycocotools reads and writes out of bounds if they do not fill the
        frame exactly.

        Raises:
            ValueError: The value has another form or size, or its run lengths do not fill the frame.
        """
        counts = value.get("counts") if isinstance(value, dict) else None
        if not isinstance(value, dict) or not isinstance(counts, str | list):
            raise ValueError("neither polygons nor size and counts")
        if value.get("size") != list(size_hw):
            raise ValueError(f"size {value.get('size')!r}, not {list(size_hw)}"[:80])
        if isinstance(counts, str):
            lengths = run_lengths(counts)
        elif all(type(n) is int and 0 <= n <= 2**31 for n in counts):
            lengths = np.array(counts, np.int64)
        else:
            raise ValueError("run lengths that are not whole numbers of at least 0")
        if (lengths < 0).any() or int(lengths.sum()) != size_hw[0] * size_hw[1]:
            raise ValueError(f"run lengths that do not fill {size_hw[1]}x{size_hw[0]} px")
        if isinstance(counts, str):
            return cls(counts, size_hw)
        rle = _coco.frPyObjects({"size": list(size_hw), "counts": counts}, *size_hw)
        return cls(rle["counts"].decode("ascii"), size_hw)

    @classmethod
    def from_rings(cls, rings: object, size_hw: tuple[int, int]) -> Mask:
        """Return the mask of untrusted polygons, lists of x, y, x, y, ..., as pycocotools rasterises them.

        Raises:
            ValueError: The value has another form, or a corner is farther from the frame than the frame's own size.
                pycocotools walks along edges pixel by pixel, so such corners could use any amount of memory.
        """
        h, w = size_hw
        polygons = []
        for ring in rings if isinstance(rings, list) else ():
            if not isinstance(ring, list) or len(ring) < 6 or len(ring) % 2:
                raise ValueError("a polygon that is not a list of three or more x, y pairs")
            points = np.array([float(v) for v in ring], np.float64).reshape(-1, 2)
            if not (np.isfinite(points).all() and (np.abs(points - [w / 2, h / 2]) <= [1.5 * w, 1.5 * h]).all()):
                raise ValueError("a polygon with corners far outside the frame")
            polygons.append(points.ravel().tolist())
        if not polygons:
            raise ValueError("no polygon")
        rle = _coco.merge(_coco.frPyObjects(polygons, h, w))
        return cls(rle["counts"].decode("ascii"), size_hw)

    @classmethod
    def union(cls, masks: Sequence[Mask]) -> Mask:
        """Return the pixels of any of some masks of one size."""
        return cls(_coco.merge([m.to_coco() for m in masks])["counts"].decode("ascii"), masks[0].size_hw)

    @property
    def area_px(self) -> int:
        """Number of pixels in the mask."""
        return int(_coco.area(self.to_coco()))

    @property
    def box_xyxy(self) -> NDArray[np.float64] | None:
        """Edges (4,) of the pixels in the mask; None for an empty mask."""
        x, y, w, h = (float(v) for v in _coco.toBbox(self.to_coco()))
        return np.array([x, y, x + w, y + h]) if w and h else None


def run_lengths(counts: str) -> NDArray[np.int64]:
    """Decode COCO's compressed run lengths.

    Each character holds six bits, the lowest come first. Lengths after the third are stored as differences from the
    last but one.

    Raises:
        ValueError: The text is not valid, or a length is too large.
    """
    bits = np.frombuffer(counts.encode("ascii", "replace"), np.uint8).astype(np.int64) - 48
    if not len(bits):
        return np.zeros(0, np.int64)
    ends = np.flatnonzero((bits & 32) == 0)
    if (bits < 0).any() or (bits > 63).any() or not len(ends) or ends[-1] != len(bits) - 1:
        raise ValueError("run lengths that are not valid COCO text")
    starts = np.concatenate([[0], ends[:-1] + 1])
    place = np.arange(len(bits)) - np.repeat(starts, ends - starts + 1)
    if place.max() > 6:
        raise ValueError("run lengths too large")
    values = np.add.reduceat((bits & 31) << (5 * place), starts)
    values -= np.where(bits[ends] & 16, np.int64(1) << (5 * (ends - starts + 1)), 0)
    values[1::2] = np.cumsum(values[1::2])
    values[2::2] = np.cumsum(values[2::2])
    return values


def row_corners(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the (n, 2) corners of the first and last pixel in each row of a mask; they have the mask's convex hull."""
    rows = np.flatnonzero(mask.any(axis=1))
    first, last = mask[rows].argmax(axis=1), mask.shape[1] - mask[rows, ::-1].argmax(axis=1)
    ends = [np.stack([x, y], axis=1) for x in (first, last) for y in (rows, rows + 1)]
    return np.asarray(np.concatenate(ends), np.float64)
