"""Objects of known size, and the boxes that they have before a camera above level ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import KnownClass
from infrablend.core.mesh import FloatArray

HEADINGS_RAD = np.deg2rad(np.arange(0.0, 180.0, 7.5))
"""Headings that objects are tried with."""
_NEAREST_M = 0.1
_CUBE = np.array([(i, j, k) for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (-0.5, 0.5)])


@dataclass(frozen=True)
class Reference:
    """A class of known size.

    Attributes:
        size_m: Length, width, height of the object, metres.
        sd: Standard deviation of the logarithm of one reading.
        turns: Whether the heading shows in the box. If not (people), the expected box is a mean over headings.
        cabin: Begin and end of what is as high as the object, along its length, and height of the rest, as shares;
            None for a cuboid. From low cameras, the far end of a bonnet is not the top of the box.
    """

    size_m: tuple[float, float, float]
    sd: float
    turns: bool = True
    cabin: tuple[float, float, float] | None = None

    def corners(self, *, shaped: bool) -> FloatArray:
        """Return (n, 3) corners from its middle, metres: those of the cuboid, or of cabin and body."""
        if not shaped or self.cabin is None:
            return _CUBE * self.size_m
        begin, end, tall = self.cabin
        body = _CUBE * [1, 1, tall] - [0, 0, (1 - tall) / 2]
        cabin = _CUBE * [end - begin, 0.85, 1] + [(begin + end - 1) / 2, 0, 0]
        return np.concatenate([body, cabin]) * self.size_m


# 1.68 m people with 0.45 m shoulders (about 0.5 m wide and 0.4 m deep with arms and stride); 4.6 x 1.8 m cars; 1.75 m
# two-wheelers, most of them without a rider.
REFERENCES: Mapping[KnownClass, Reference] = {
    "person": Reference((0.4, 0.5, 1.68), 0.22, turns=False),
    "car": Reference((4.6, 1.8, 1.45), 0.10, cabin=(0.2, 0.65, 0.65)),
    "bicycle": Reference((1.75, 0.6, 1.05), 0.18),
}


def expected_sides(
    middles: FloatArray,
    to_camera: FloatArray,
    focal_px: float,
    corners_m: FloatArray,
    headings_rad: NDArray[np.float64] = HEADINGS_RAD,
) -> FloatArray:
    """Return (n, headings, 2) widths and heights, px, of the boxes around upright objects.

    Args:
        middles: (n, 3) their middles in camera coordinates, metres; NaN for none.
        to_camera: (n, 3, 3) rotations from the world, or (3, 3) for all.
        focal_px: Focal length in pixels.
        corners_m: (k, 3) corners from the middle, with the length along X.
        headings_rad: Headings, counter-clockwise from the world's +X.

    Returns:
        The sides; NaN where a corner is not before the camera.
    """
    c, s = np.cos(headings_rad)[:, None], np.sin(headings_rad)[:, None]
    x = corners_m[:, 0] * c - corners_m[:, 1] * s
    y = corners_m[:, 0] * s + corners_m[:, 1] * c
    z = np.broadcast_to(corners_m[:, 2], x.shape)
    corners = np.stack([x, y, z]).reshape(3, -1)
    right, down, depth = np.moveaxis(to_camera @ corners + middles[:, :, None], 1, 0)
    depth = np.where(depth > _NEAREST_M, depth, np.nan)
    seen = np.stack([right / depth, down / depth], axis=-1).reshape(len(middles), len(headings_rad), -1, 2)
    return np.asarray(focal_px * (seen.max(axis=2) - seen.min(axis=2)))


def alike_headings(sides: FloatArray, width: FloatArray, height: FloatArray) -> NDArray[np.int64]:
    """Return (n,) numbers of the headings whose boxes have proportions most like those of given boxes.

    Args:
        sides: (n, headings, 2) widths and heights of all headings; the first heading counts where they are NaN.
        width: (n,) widths of the boxes.
        height: (n,) heights of the boxes.
    """
    apart = np.abs(np.log(sides[..., 0] / sides[..., 1]) - np.log(width / height)[:, None])
    return np.asarray(np.argmin(np.nan_to_num(apart, nan=np.inf), axis=1))
