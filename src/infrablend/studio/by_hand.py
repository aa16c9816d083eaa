"""Inserts moved by hand: from a scene and a move to the recipe's field `frames`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from infrablend.core.scene import ObjectSpec, SceneSpec


@dataclass(frozen=True)
class Move:
    """A move of one insert.

    Attributes:
        dx_px: Move to the right, pixels.
        dy_px: Move down, pixels.
        turn_deg: Turn counter-clockwise seen from above, degrees.
        away: Factor on the distance from the camera.
    """

    dx_px: float = 0.0
    dy_px: float = 0.0
    turn_deg: float = 0.0
    away: float = 1.0


def origin_px(scene: SceneSpec, number: int) -> tuple[float, float]:
    """Return where the origin of an object is in the picture."""
    ((x, y),), _ = scene.camera.project(np.array([scene.objects[number].position_m]))
    return float(x), float(y)


def can_move(scene: SceneSpec) -> bool:
    """Return whether the numbers of the scene's objects are those of the recipe: none was left out."""
    return bool(scene.draws.get("wanted") == len(scene.objects))


def moved(frames: Mapping[str, Any], scene: SceneSpec, number: int, move: Move, *, stands: bool) -> dict[str, Any]:
    """Return the recipe's field `frames` with one object of a scene moved.

    Args:
        frames: The field before.
        scene: The scene as it is shown.
        number: Number of the object.
        move: The move.
        stands: Whether the object stands on real ground, whose distance follows from its place.
    """
    o: ObjectSpec = scene.objects[number]
    x, y = origin_px(scene, number)
    turned = math.degrees(o.yaw_rad) + move.turn_deg
    entry = {"x_px": round(x + move.dx_px, 2), "y_px": round(y + move.dy_px, 2),
             "yaw_deg": round((turned + 180) % 360 - 180, 2)}  # fmt: skip
    if not stands:
        away = float(np.linalg.norm(np.asarray(o.position_m) - scene.camera.position_m))
        entry["range_m"] = round(away * move.away, 3)
    entries = list((frames.get(scene.frame_id) or {}).get("objects", ()))
    entries += [{}] * (number + 1 - len(entries))
    entries[number] = entry
    return {**frames, scene.frame_id: {"objects": entries}}


def released(frames: Mapping[str, Any], scene: SceneSpec, number: int) -> dict[str, Any]:
    """Return the recipe's field `frames` with one object of a scene as drawn again."""
    entries = list((frames.get(scene.frame_id) or {}).get("objects", ()))
    if number < len(entries):
        entries[number] = {}
    while entries and not entries[-1]:
        entries.pop()
    rest = {k: v for k, v in frames.items() if k != scene.frame_id}
    return {**rest, scene.frame_id: {"objects": entries}} if entries else rest
