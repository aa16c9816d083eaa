"""Measures of meshes that several tests share."""

from __future__ import annotations

import numpy as np

from infrablend.core.mesh import FloatArray, IntArray


def signed_volume(vertices: FloatArray, triangles: IntArray) -> float:
    """Return the enclosed volume; negative if the triangles run clockwise seen from outside."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)
