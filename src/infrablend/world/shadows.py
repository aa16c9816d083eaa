"""Thermal shadows: ground that stayed cold because something kept the sun off it."""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.world.buildings import Building
from infrablend.world.people import Person
from infrablend.world.plan import WorldPlan
from infrablend.world.trees import Tree
from infrablend.world.vehicles import Vehicle

Field = NDArray[np.float32]
Fill = Callable[[NDArray[np.float64], float], None]


def shade(plan: WorldPlan, oversample: int) -> Field:
    """Return the share in [0, 1] of the sun's heat that shadows kept from the ground, float32.

    The shape is (h * `oversample`, w * `oversample`) for an image of (h, w). Moving cars and walking people leave no
    shadow, because asphalt needs minutes to cool.
    """
    assert plan.sun is not None
    w, h = plan.camera.size_wh
    mask = np.zeros((h * oversample, w * oversample), np.float32)
    sx, sy = -plan.sun[0] / plan.sun[2], -plan.sun[1] / plan.sun[2]

    def fill(points_xy: NDArray[np.float64], depth: float) -> None:
        world = np.concatenate([points_xy, np.zeros((len(points_xy), 1))], axis=1)
        xy, z = plan.camera.project(world)
        if (z <= 0.5).any():
            return
        hull = cv2.convexHull(np.round(xy * oversample * 16).astype(np.int32).reshape(-1, 1, 2))
        layer = mask if depth >= 1 else np.zeros_like(mask)
        cv2.fillConvexPoly(layer, hull, depth, lineType=cv2.LINE_AA, shift=4)
        if layer is not mask:
            np.maximum(mask, layer, out=mask)

    def box(b: Building | Vehicle | Person, length: float, width: float, height: float, depth: float) -> None:
        c, s = math.cos(b.heading_rad), math.sin(b.heading_rad)
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (length / 2, width / 2)
        base = np.stack(
            [b.x_m + corners[:, 0] * c - corners[:, 1] * s, b.y_m + corners[:, 0] * s + corners[:, 1] * c], 1
        )
        fill(np.concatenate([base, base + np.array([sx, sy]) * height]), depth)

    # Trees first, in several lobes, so that their outline is not a clean ellipse.
    t = 2 * np.pi * np.arange(12) / 12
    ring = np.stack([np.cos(t), np.sin(t)], 1)
    for tree in plan.trees:
        _tree_shadow(tree, ring, (sx, sy), fill)
    for b in plan.buildings:
        box(b, b.length_m, b.width_m, b.height_m, 1.0)
    for v in plan.vehicles:
        box(v, v.length_m * 0.96, v.width_m * 0.96, v.height_m * 0.85, 1.0)
    for q in plan.furniture:
        if q.kind in ("lamp", "hoop"):
            base = np.array([[q.x_m, q.y_m]])
            fill(np.concatenate([base - 0.06, base + 0.06, base + np.array([sx, sy]) * q.height_m]), 1.0)
    soft = max(0.25 * plan.camera.focal_px / plan.camera.distance_m * oversample, 0.8)
    return np.asarray(cv2.GaussianBlur(mask, (0, 0), soft), np.float32)


def _tree_shadow(tree: Tree, ring: NDArray[np.float64], slope: tuple[float, float], fill: Fill) -> None:
    base = np.array([tree.x_m, tree.y_m])
    s = np.array(slope)
    if tree.kind == "bare":
        fill(np.stack([base - 0.08, base + 0.08, base + s * tree.height_m]), 1.0)
        return
    fill(np.concatenate([base + 0.1 * ring, base + s * 0.6 * tree.height_m + 0.1 * ring]), 1.0)
    for k in range(7):
        a = 2.4 * k + tree.heading_rad
        r = 0.55 * tree.radius_m if k else 0.0
        centre = base + s * tree.height_m * (0.62 + 0.12 * math.sin(1.7 * a)) + r * np.array([math.cos(a), math.sin(a)])
        fill(centre + 0.5 * tree.radius_m * ring * (1 + 0.15 * np.sin(3 * np.arange(12) + a))[:, None], 1.0)
