"""Poses of objects that the recipe places by hand, instead of the drawn ones."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from infrablend.config.recipe import ObjectByHand, Recipe
from infrablend.core.camera import CameraSpec
from infrablend.core.ground_plane import ground_point, pixel_ray
from infrablend.core.scene import View
from infrablend.errors import Problem, RecipeError
from infrablend.sampling.placement import PlacementRequest, Pose


def place_by_hand(
    frame_id: str,
    recipe: Recipe,
    wanted: Sequence[PlacementRequest],
    drawn: Sequence[Pose | None],
    camera: CameraSpec,
    view: View | None,
) -> tuple[list[Pose | None], set[int]]:
    """Return the poses of a frame's objects, with those that the recipe states, and the numbers of these objects.

    The other objects keep their drawn poses: all are drawn as if nothing were placed by hand.

    Raises:
        RecipeError: A place does not exist, or there are more entries than objects.
    """
    given = recipe.frames.get(frame_id)
    if given is None or not wanted:
        return list(drawn), set()
    where = f"frames.{frame_id}.objects"
    if len(given.objects) > len(wanted):
        raise _wrong(recipe, where, f"found {len(given.objects)} entries", f"at most {len(wanted)}, one per object")
    poses = list(drawn)
    placed = set()
    for k, entry in enumerate(given.objects):
        if entry == ObjectByHand():
            continue
        stands = view is not None and wanted[k].model.stands
        if stands and entry.range_m is not None:
            expected = f"no range: {wanted[k].kind.model} stands on the ground at x_px, y_px"
            raise _wrong(recipe, f"{where}.{k}.range_m", f"found {entry.range_m:g}", expected)
        place = _on_ground(entry, drawn[k], camera, view) if stands else _in_air(entry, drawn[k], camera)
        if place is None:
            at = f"found {entry.x_px:g}, {entry.y_px:g}" if entry.x_px is not None else "found no place"
            raise _wrong(recipe, f"{where}.{k}", at, "x_px and y_px of a point on the ground, below the horizon")
        yaw = drawn[k][3] if drawn[k] is not None else 0.0  # type: ignore[index]
        poses[k] = (*place, yaw if entry.yaw_deg is None else math.radians(entry.yaw_deg))
        placed.add(k)
    return poses, placed


def _on_ground(
    entry: ObjectByHand, drawn: Pose | None, camera: CameraSpec, view: View | None
) -> tuple[float, float, float] | None:
    assert view is not None
    if entry.x_px is None or entry.y_px is None:
        return None if drawn is None else drawn[:3]
    below = ground_point(camera, entry.x_px, entry.y_px, view.ground_z_m)
    if below is None:
        return None
    return float(below[0]), float(below[1]), view.ground_z_m if drawn is None else drawn[2]


def _in_air(entry: ObjectByHand, drawn: Pose | None, camera: CameraSpec) -> tuple[float, float, float] | None:
    if entry.x_px is not None and entry.y_px is not None:
        ray = pixel_ray(camera, entry.x_px, entry.y_px)
    elif drawn is None:
        return None
    else:
        ray = np.asarray(drawn[:3]) - camera.position_m
        ray = ray / np.linalg.norm(ray)
    away = entry.range_m
    if away is None:
        away = camera.distance_m if drawn is None else float(np.linalg.norm(np.asarray(drawn[:3]) - camera.position_m))
    x, y, z = (float(v) for v in camera.position_m + away * ray)
    return x, y, z


def _wrong(recipe: Recipe, where: str, found: str, expected: str) -> RecipeError:
    return RecipeError(
        f"recipe {recipe.name}: a place that does not exist", [Problem(where, "recipe-value", found, expected)]
    )
