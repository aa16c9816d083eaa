"""Street furniture: lamps, basketball hoops, fences, bins, bollards and benches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from infrablend.assets import shapes
from infrablend.world.surfaces import CLOTH, GLASS, METAL, PAINT, Surface, SurfaceBuilder


@dataclass(frozen=True)
class Furniture:
    """Street furniture: a lamp, a basketball hoop, a bin, a bollard or a bench."""

    kind: Literal["lamp", "hoop", "bin", "bollard", "bench", "fence"]
    x_m: float
    y_m: float
    heading_rad: float
    height_m: float
    length_m: float
    pole_k: float
    head_k: float


def furniture(q: Furniture) -> Surface:
    """Street furniture about its foot, arm or length along +X."""
    p = SurfaceBuilder()
    h = q.height_m
    if q.kind == "lamp":
        p.add(shapes.capsule((0, 0, 0), (0, 0, h), 0.1, 0.06, n=6), q.pole_k, METAL)
        p.add(shapes.capsule((0, 0, h), (q.length_m, 0, h + 0.25), 0.05, n=4), q.pole_k, METAL)
        p.add(shapes.moved(shapes.box((0.75, 0.32, 0.14), 0.04), (q.length_m + 0.2, 0, h + 0.24)), q.head_k, METAL)
    elif q.kind == "hoop":
        p.add(shapes.moved(shapes.box((1.5, 0.9, 0.4), 0.05), (-0.4, 0, 0.2)), q.pole_k, PAINT)
        p.add(shapes.capsule((0, 0, 0.3), (0.5, 0, h - 0.3), 0.11, n=6), q.pole_k, METAL)
        p.add(shapes.capsule((0.5, 0, h - 0.35), (q.length_m, 0, h - 0.2), 0.07, n=6), q.pole_k, METAL)
        p.add(shapes.moved(shapes.box((0.06, 1.8, 1.05), 0.01), (q.length_m, 0, h)), q.head_k, GLASS)
        ring = shapes.lathe([(0.22, -0.02), (0.25, -0.02), (0.25, 0.02), (0.22, 0.02)], 12, wrap=True)
        p.add(shapes.moved(ring, (q.length_m + 0.35, 0, h - 0.4)), q.pole_k, METAL)
    elif q.kind == "fence":
        half = q.length_m / 2
        for x in np.arange(-half, half + 0.1, 3.0):
            p.add(shapes.capsule((x, 0, 0), (x, 0, h), 0.045, n=4), q.pole_k, METAL)
        for z in (0.15, h / 2, h):
            p.add(shapes.sweep([(-half, 0, z), (half, 0, z)], 0.03, n=4), q.pole_k, METAL)
    elif q.kind == "bin":
        p.add(shapes.cylinder(0.3, 0, h, 8), q.pole_k, PAINT)
    elif q.kind == "bollard":
        p.add(shapes.cylinder(0.1, 0, h, 6), q.pole_k, PAINT)
    else:
        p.add(shapes.moved(shapes.box((q.length_m, 0.5, 0.1), 0.02), (0, 0, h)), q.pole_k, CLOTH)
    return p.surface()
