"""Measure how well label boxes fit a silhouette that Cycles renders at sixteen times the resolution."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.annotation.labels import annotate
from infrablend.assets.catalogue import load_model
from infrablend.core.boxes import box_iou
from infrablend.core.camera import CameraSpec, object_to_world
from infrablend.core.mesh import Mesh
from infrablend.core.render import place
from infrablend.core.rng import stream
from infrablend.core.scene import Appearance, ObjectSpec, PartState, SceneSpec

FINER = 16
SIZE_WH = (640, 512)
AIR_K = 288.15
# A pose counts if its true size differs from the requested size by at most this share.
SIZE_TOLERANCE = 0.05


@dataclass(frozen=True)
class BoxFit:
    """Box fit of one pose.

    Attributes:
        iou: IoU of the label's box and the silhouette's.
        size_px: Longest side of the silhouette's box.
    """

    iou: float
    size_px: float


def measure_boxes(model: str, size_px: float, poses: int) -> list[BoxFit]:
    """Compare boxes over random shapes and poses of a model, seen from 0 to 90 degrees, at one size.

    The silhouette does not depend on the geometry code of the labels: Cycles renders it at `FINER` times the
    resolution, with one sample in the middle of each pixel and without a filter.
    """
    from infrablend.rendering.engine.renderer import BlenderRenderer

    class Silhouettes(BlenderRenderer):
        def _cycles(self, spec: SceneSpec, bounces: int) -> dict[str, Any]:
            # A box filter is always one pixel wide in Cycles; this one is a hundredth.
            middle = {"use_adaptive_sampling": False, "samples": 1}
            return super()._cycles(spec, bounces) | middle | {"pixel_filter_type": "GAUSSIAN", "filter_width": 0.01}

    renderer = Silhouettes()
    fits: list[BoxFit] = []
    for scene, mesh in random_poses(model, size_px):
        labels, _ = annotate(place(scene, (mesh,)))
        fine = replace(scene, camera=replace(scene.camera, size_wh=(SIZE_WH[0] * FINER, SIZE_WH[1] * FINER)))
        result = renderer.render(place(fine, (mesh,)))
        truth = extent(result.coverage[0] > 0.5, result.offset_xy) / FINER
        longest = float(max(truth[2] - truth[0], truth[3] - truth[1]))
        if abs(longest / size_px - 1) > SIZE_TOLERANCE:
            continue
        found = labels[0].box_xyxy if labels else np.zeros(4)
        fits.append(BoxFit(float(box_iou(found[None], truth[None])[0, 0]), longest))
        if len(fits) == poses:
            break
    return fits


def extent(mask: NDArray[np.bool_], offset_xy: tuple[int, int]) -> NDArray[np.float64]:
    """Return the (4,) half-open box around the True pixels of a crop; zeros if there are none."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return np.zeros(4)
    x, y = offset_xy
    return np.array([x + columns[0], y + rows[0], x + columns[-1] + 1, y + rows[-1] + 1], np.float64)


def random_poses(name: str, size_px: float) -> Iterator[tuple[SceneSpec, Mesh]]:
    """Yield scenes with one object in the middle half of the frame, at a distance that gives it about that size."""
    model = load_model(name)
    for number in range(100_000):
        rng = stream(0, "bench", "boxes", name, f"{size_px:g}", number)
        params = model.sample(rng, {})
        mesh = model.build(params)
        pitch, roll = rng.uniform(0, math.pi / 2), math.radians(rng.uniform(-10, 10))
        yaw = rng.uniform(0, 2 * math.pi)
        shift = rng.uniform(-0.25, 0.25, 2) * SIZE_WH
        distance_m = 900.0 * float(mesh.size_m.max()) / size_px
        for _ in range(4):
            camera = CameraSpec(distance_m, pitch, roll, 50.0, 36.0, SIZE_WH)
            # Shift by a share of the frame, sideways and up in the picture, in the plane of the scene's origin.
            offset = (shift[0] * camera.world_to_camera[0] + shift[1] * camera.world_to_camera[1]) * (
                distance_m / camera.focal_px
            )
            position = (float(offset[0]), float(offset[1]), float(offset[2]))
            xy, _ = camera.project(object_to_world(mesh.vertices_m, position, yaw))
            distance_m *= float(np.ptp(xy, axis=0).max()) / size_px
        parts = {
            part: PartState(AIR_K + 10.0, 0.95, role.label, role.ior)
            for part, role in model.parts.items()
            if part in mesh.part_names
        }
        spec = ObjectSpec(name, model.category, params, parts, position, float(yaw), 1.0)
        look = Appearance(AIR_K - 14, AIR_K + 24, AIR_K - 10, 0.0)
        yield SceneSpec(f"boxes/{name}_{number}", "none", "boxes", 0, camera, (spec,), AIR_K, look, 1, number, {}), mesh
