"""Geometry shared by the deer and the person: unit vectors, smooth steps, and the joint between two bones."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from infrablend.core.mesh import FloatArray


def unit(v: ArrayLike) -> FloatArray:
    """Return a vector scaled to length 1."""
    a = np.asarray(v, np.float64)
    return a / float(np.linalg.norm(a))


def smoothstep(x: FloatArray) -> FloatArray:
    """Return a smooth ramp: 0 up to x = 0, 1 from x = 1 on."""
    t = np.clip(x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def joint(a: FloatArray, b: FloatArray, bones: tuple[float, float], side: FloatArray) -> FloatArray:
    """Return the joint between two bones that connect two points.

    Args:
        a: Start of the first bone.
        b: End of the second bone.
        bones: Lengths of the two bones; they stretch if the points are too far apart.
        side: Unit vector at right angles to b - a: the direction in which the joint bends.
    """
    reach = b - a
    span = float(np.linalg.norm(reach))
    stretch = max(1.0, span / (0.999 * sum(bones)))
    upper, lower = (bone * stretch for bone in bones)
    along = (span**2 + upper**2 - lower**2) / (2 * span)
    direction = reach / span
    return np.asarray(a + along * direction + math.sqrt(max(upper**2 - along**2, 0.0)) * side)
