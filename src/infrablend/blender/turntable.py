"""Renders a sheet of views of a model: rows by pitch, columns by heading, then other individuals and small views.

The small views have passed the blur and grain of a thermal camera, which leave little of an object of 8 to 30 pixels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
from infrablend.compositing.sensor import Sensor, apply_sensor, grain
from infrablend.core.camera import CameraSpec
from infrablend.core.files import write_bytes
from infrablend.core.mesh import Mesh
from infrablend.core.placed import PlacedScene, place
from infrablend.core.rng import stream
from infrablend.core.scene import Appearance, ObjectSpec, PartState, SceneSpec
from infrablend.core.tasks import Task

# Depression of the camera: below, level, above. Animals, people and cars are hardly ever seen from far below.
FLYING_PITCHES_DEG = (-90, -30, 0, 30, 90)
STANDING_PITCHES_DEG = (-20, 0, 30, 60, 90)
YAWS_DEG = (0, 45, 90, 135, 180, 225, 270, 315)
CELL_PX = 220
SMALL_PX = (8, 15, 30, 60)
SMALL_FLYING_DEG = (-60, 0, 30, 90)
SMALL_STANDING_DEG = (0, 30, 60, 90)
# Blur and grain of a HIT-UAV frame by night, for the small views.
SMALL_SENSOR = Sensor("sheet", blur_sigma_px=0.8, noise_grey=1.6)
AIR_K = 283.15
# HIT-UAV by night: mean grey level of the ground; grey levels of the coldest and the warmest part.
GROUND = 100
# A clear sky is far colder than any part of an aircraft.
SKY = 40
MAPPING = GreyMapping(54.0, 220.0)


def make_turntable(_settings: Any) -> Any:
    """Create a worker; the payload of its tasks is (model name, PNG to write, seed, options of the model)."""
    renderer = BlenderRenderer()

    def run(task: Task) -> str:
        name, out, seed, options = task.payload
        individuals = _individuals(load_model(name), name, seed, options)
        write_turntable(renderer, individuals, Path(out))
        return str(out)

    return run


def write_turntable(renderer: BlenderRenderer, individuals: Sequence[_Individual], out: Path) -> None:
    """Write the sheet as a PNG: the first individual from all sides, the others, then the first at 8 to 60 px."""
    first = individuals[0]
    stands = first.model.stands
    rows = []
    for pitch in STANDING_PITCHES_DEG if stands else FLYING_PITCHES_DEG:
        cells = [_large(renderer, first, pitch, yaw) for yaw in YAWS_DEG]
        rows.append(_row(cells, [f"pitch {pitch}, yaw {yaw}" for yaw in YAWS_DEG]))
    others, titles = [], []
    for k, other in enumerate(individuals[1:], start=1):
        for pitch in (30, 75) if stands else (-40, 40):
            others.append(_large(renderer, other, pitch, 30 + 90 * k))
            titles.append(f"individual {k}, pitch {pitch}")
    rows.append(_row(others, titles))
    small, titles = [], []
    for pitch in SMALL_STANDING_DEG if stands else SMALL_FLYING_DEG:
        for size in SMALL_PX:
            small.append(_small(renderer, first, pitch, 25, size))
            titles.append(f"{size} px, pitch {pitch}")
    half = len(YAWS_DEG)
    rows += [_row(small[:half], titles[:half]), _row(small[half:], titles[half:])]
    ok, data = cv2.imencode(".png", np.concatenate(rows))
    assert ok
    write_bytes(out, data.tobytes())


@dataclass(frozen=True, eq=False)
class _Individual:
    """One object of a model.

    Attributes:
        model: The model.
        name: Its name in the catalogue or path.
        params: Parameters of the individual.
        mesh: Its mesh.
    """

    model: ObjectModel
    name: str
    params: dict[str, Any]
    mesh: Mesh


def _individuals(model: ObjectModel, name: str, seed: int, options: Mapping[str, Any]) -> list[_Individual]:
    """Draw the five individuals of a sheet."""
    drawn = [model.sample(stream(seed, name, "turntable", k), options) for k in range(5)]
    return [_Individual(model, name, params, model.build(params)) for params in drawn]


def _large(renderer: BlenderRenderer, one: _Individual, pitch_deg: float, yaw_deg: float) -> NDArray[np.uint8]:
    """Render one view that the object fills."""
    scene = _scene(one, pitch_deg, yaw_deg, 0.86)
    behind = np.full((CELL_PX, CELL_PX), _behind(one.model, pitch_deg), np.uint8)
    return np.asarray(compose(behind, make_layer(renderer.render(scene), MAPPING, 0.45)), np.uint8)


def _small(
    renderer: BlenderRenderer, one: _Individual, pitch_deg: float, yaw_deg: float, size_px: int
) -> NDArray[np.uint8]:
    """Render one view in which the labelled object is `size_px` long, and enlarge it to a cell."""
    label = np.array([one.model.roles(one.params)[n].label for n in one.mesh.part_names])
    seen = np.unique(one.mesh.triangles[label[one.mesh.part_of_triangle]])
    xy = _scene(one, pitch_deg, yaw_deg, 1.0).objects[0].xy[seen]
    scene = _scene(one, pitch_deg, yaw_deg, size_px / float(np.ptp(xy, axis=0).max()))
    shape = (CELL_PX, CELL_PX)
    noise = grain(shape, SMALL_SENSOR.noise_grey, SMALL_SENSOR.noise_grain_px, 1)
    behind = np.round(_behind(one.model, pitch_deg) + noise).astype(np.uint8)
    layer = make_layer(renderer.render(scene), MAPPING, SMALL_SENSOR.layer_sigma_px(0.8))
    half = round(0.62 * size_px) + 8
    cut = slice(CELL_PX // 2 - half, CELL_PX // 2 + half)
    picture = apply_sensor(behind, layer, SMALL_SENSOR)[cut, cut]
    return np.asarray(cv2.resize(picture, shape, interpolation=cv2.INTER_NEAREST), np.uint8)


def _behind(model: ObjectModel, pitch_deg: float) -> int:
    """Return the grey level behind the object: sky behind what flies, unless the camera looks down."""
    return SKY if pitch_deg <= 0 and not model.stands else GROUND


def _scene(one: _Individual, pitch_deg: float, yaw_deg: float, fill: float) -> PlacedScene:
    """Return a scene in which a sphere around the object takes the share `fill` of the cell."""
    mesh, model = one.mesh, one.model
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
        for n, r in model.roles(one.params).items()
        if n in mesh.part_names
    }
    position = (-turned[0], -turned[1], -float(centre[2]))
    spec = ObjectSpec(one.name, model.category, one.params, parts, position, yaw)
    # With this focal length, a body of this radius fills the cell from any side.
    focal_mm = 36.0 * fill * distance / (2 * reach)
    camera = CameraSpec(distance, math.radians(pitch_deg), 0.0, focal_mm, 36.0, (CELL_PX, CELL_PX))
    scene = SceneSpec("show", "show", "train", 0, camera, (spec,), AIR_K, _example_appearance(model, one.params), 0, 1)
    return place(scene, [mesh])


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
