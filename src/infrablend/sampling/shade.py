"""Shade on the ground: objects that stand in it, and thermal shadows of objects that do not move."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from infrablend.assets.model import SHADOW_PARAM
from infrablend.core.camera import CameraSpec
from infrablend.core.dataset import Instance, boxes_of
from infrablend.core.mesh import FloatArray
from infrablend.core.scene import Sun
from infrablend.sampling.metric import feet_box
from infrablend.sampling.placement import PlacementRequest, Pose, is_covered
from infrablend.sampling.site import Site

# Ground by day that is this much darker than the picture's median lies in the shade, 8-bit levels: people there have
# no dark parts (HIT-UAV, train).
SHADE_GREY = 60.0
# Margin around the feet in which the ground is measured, px.
_MARGIN_PX = 6
# A lower sun throws no longer shadows.
_LOWEST_RAD = math.radians(15)


def in_shade(camera: CameraSpec, world_m: FloatArray, site: Site) -> bool:
    """Return whether the ground around the feet of a standing object is as dark as shade; not if it is not in view."""
    x0, y0, x1, y1 = feet_box(camera, world_m)
    if math.isnan(x0):
        return False
    h, w = site.pixels.shape
    left, top = (int(np.clip(math.floor(v) - _MARGIN_PX, 0, n - 1)) for v, n in ((x0, w), (y0, h)))
    right, bottom = (int(np.clip(math.ceil(v) + _MARGIN_PX, 1, n)) for v, n in ((x1, w), (y1, h)))
    around = site.pixels[top : max(bottom, top + 1), left : max(right, left + 1)]
    colder = site.median_level - float(np.median(around))
    return (-colder if site.black_hot else colder) > SHADE_GREY * site.grey_unit


def shadow_shift(sun: Sun, yaw_rad: float) -> tuple[float, float]:
    """Return the shift of a point's shadow on the ground per metre of its height, in the frame of an object."""
    length = 1 / math.tan(max(sun.elevation_rad, _LOWEST_RAD))
    away = sun.azimuth_rad + math.pi - yaw_rad
    return length * math.cos(away), length * math.sin(away)


def with_shadow(
    item: PlacementRequest, pose: Pose, camera: CameraSpec, sun: Sun, labels: Sequence[Instance]
) -> PlacementRequest:
    """Return an object with its thermal shadow, if it throws one that covers no annotated object; else as it is."""
    casts = item.model.casts_shadow
    if casts is None or not casts(item.params):
        return item
    params = {**item.params, SHADOW_PARAM: [*shadow_shift(sun, pose[3])]}
    shadowed = replace(item, params=params, mesh=item.model.build(params))
    xy, depth = camera.project(shadowed.in_world(pose))
    if (depth <= 0).any():
        return item
    box = np.concatenate([xy.min(axis=0), xy.max(axis=0)])
    return item if is_covered(box, boxes_of(labels), 0.0) else shadowed


def without_shadow(item: PlacementRequest) -> PlacementRequest:
    """Return an object without the thermal shadow that it threw at another place."""
    if SHADOW_PARAM not in item.params:
        return item
    params = {k: v for k, v in item.params.items() if k != SHADOW_PARAM}
    return replace(item, params=params, mesh=item.model.build(params))
