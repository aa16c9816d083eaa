"""Renders a sheet of views of a model: rows by pitch, columns by heading, then other individuals and small views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.assets.catalogue import load_model
from infrablend.assets.model import ObjectModel
from infrablend.blender.renderer import BlenderRenderer
from infrablend.compositing.mapping import GreyMapping
from infrablend.compositing.overlay import compose, make_layer
from infrablend.core.camera import CameraSpec
from infrablend.core.files import write_bytes
from infrablend.core.mesh import Mesh
from infrablend.core.placed import place
from infrablend.core.rng import stream
from infrablend.core.scene import Appearance, ObjectSpec, PartState, SceneSpec
from infrablend.core.tasks import Task

PITCHES_DEG = (0, 30, 60, 90)
YAWS_DEG = (0, 45, 90, 135, 180, 225, 270, 315)
CELL_PX = 220
SMALL_PX = (20, 40, 80)
AIR_K = 283.15
# HIT-UAV by night: mean grey level of the ground; grey levels of the coldest and the warmest part.
GROUND = 100
MAPPING = GreyMapping(54.0, 220.0)


def make_turntable(_settings: Any) -> Any:
    """Create a worker; the payload of its tasks is (model name, PNG to write, seed)."""
    renderer = BlenderRenderer()

    def run(task: Task) -> str:
        name, out, seed = task.payload
        write_turntable(renderer, load_model(name), name, Path(out), seed)
        return str(out)

    return run


def write_turntable(renderer: BlenderRenderer, model: ObjectModel, name: str, out: Path, seed: int = 0) -> None:
    """Write the sheet as a PNG: one individual from all sides, four others, then the first at 20 to 160 px."""
    params = model.sample(stream(seed, name, "turntable", 0), {})
    mesh = model.build(params)
    rows = []
    for pitch in PITCHES_DEG:
        cells = [_view(renderer, model, name, params, mesh, pitch, yaw) for yaw in YAWS_DEG]
        rows.append(_row(cells, [f"pitch {pitch}, yaw {yaw}" for yaw in YAWS_DEG]))
    others = []
    for k in range(1, 5):
        p = model.sample(stream(seed, name, "turntable", k), {})
        m = model.build(p)
        others += [_view(renderer, model, name, p, m, pitch, 30 + 90 * k) for pitch in (30, 75)]
    rows.append(_row(others, [f"individual {k}, pitch {p}" for k in range(1, 5) for p in (30, 75)]))
    small = []
    for pitch in (30, 75):
        for size in (*SMALL_PX, 160):
            view = _view(renderer, model, name, params, mesh, pitch, 60, fill=size / CELL_PX)
            half = max(size, 24)
            c = CELL_PX // 2
            cut = view[c - half // 2 - 4 : c + half // 2 + 4, c - half // 2 - 4 : c + half // 2 + 4]
            small.append(cv2.resize(cut, (CELL_PX, CELL_PX), interpolation=cv2.INTER_NEAREST))
    rows.append(_row(small, [f"{s} px, pitch {p}" for p in (30, 75) for s in (*SMALL_PX, 160)]))
    ok, data = cv2.imencode(".png", np.concatenate(rows))
    assert ok
    write_bytes(out, data.tobytes())


def _view(
    renderer: BlenderRenderer,
    model: ObjectModel,
    name: str,
    params: dict[str, Any],
    mesh: Mesh,
    pitch_deg: float,
    yaw_deg: float,
    fill: float = 0.86,
) -> NDArray[np.uint8]:
    """Render one view in which the object takes the share `fill` of the cell."""
    centre = (mesh.vertices_m.max(axis=0) + mesh.vertices_m.min(axis=0)) / 2
    yaw = math.radians(yaw_deg)
    turned = (
        centre[0] * math.cos(yaw) - centre[1] * math.sin(yaw),
        centre[0] * math.sin(yaw) + centre[1] * math.cos(yaw),
    )
    reach = float(np.linalg.norm(mesh.vertices_m - centre, axis=1).max())
    distance = 12 * reach
    parts = {
        n: PartState(
            AIR_K + sum(r.delta_t_k) / 2, sum(r.emissivity) / 2, r.label, r.ior, r.roughness, r.metal, r.opacity
        )
        for n, r in model.roles(params).items()
        if n in mesh.part_names
    }
    spec = ObjectSpec(name, model.category, params, parts, (-turned[0], -turned[1], -float(centre[2])), yaw)
    # With this focal length, a body of this radius fills the cell from any side.
    focal_mm = 36.0 * fill * distance / (2 * reach)
    camera = CameraSpec(distance, math.radians(pitch_deg), 0.0, focal_mm, 36.0, (CELL_PX, CELL_PX))
    scene = SceneSpec("show", "show", "train", 0, camera, (spec,), AIR_K, _example_appearance(model, params), 0, 1)
    ground = np.full((CELL_PX, CELL_PX), GROUND, np.uint8)
    picture = compose(ground, make_layer(renderer.render(place(scene, [mesh])), MAPPING, 0.45))
    return np.asarray(picture, np.uint8)


def _example_appearance(model: ObjectModel, params: dict[str, Any]) -> Appearance:
    """Return a look whose white end suits the individual: a deer is a few kelvin above air, motors are tens."""
    means = [sum(r.delta_t_k) / 2 for r in model.roles(params).values()]
    # A single hot part, such as a tail pipe, must not darken all others.
    hottest = min(0.55 * max(means), float(np.quantile(means, 0.9)))
    return Appearance(cold_k=AIR_K - 6, hot_k=AIR_K + max(8.0, hottest), surroundings_k=AIR_K - 10)


def _row(cells: Sequence[NDArray[np.uint8]], titles: Sequence[str]) -> NDArray[np.uint8]:
    framed = []
    for cell, title in zip(cells, titles, strict=True):
        bar = np.full((16, cell.shape[1]), 30, np.uint8)
        cv2.putText(bar, title, (4, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.36, 220, 1, cv2.LINE_AA)
        framed.append(cv2.copyMakeBorder(np.concatenate([bar, cell]), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=30))
    return np.concatenate(framed, axis=1)
