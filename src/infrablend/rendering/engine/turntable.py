"""Renders a sheet of views of a model: rows by pitch, columns by heading, other individuals, small views, and parts.

The small views have passed the blur and grain of a thermal camera, which leave little of an object of 8 to 30 pixels.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.assets.catalogue import load_model
from infrablend.assets.model import ObjectModel, Params
from infrablend.compositing.mapping import GreyMapping
from infrablend.compositing.overlay import compose, make_layer
from infrablend.compositing.sensor import Sensor, apply_sensor, grain
from infrablend.core.camera import CameraSpec
from infrablend.core.files import write_bytes
from infrablend.core.mesh import Mesh
from infrablend.core.render import PlacedScene, place
from infrablend.core.rng import stream
from infrablend.core.scene import Appearance, ObjectSpec, PartState, SceneSpec
from infrablend.core.tasks import Task
from infrablend.rendering.engine.renderer import BlenderRenderer

# Depression of the camera: below, level, above. Animals, people and cars are hardly ever seen from far below.
FLYING_PITCHES_DEG = (-90, -30, 0, 30, 90)
STANDING_PITCHES_DEG = (-20, 0, 30, 60, 90)
YAWS_DEG = (0, 45, 90, 135, 180, 225, 270, 315)
CELL_PX = 220
PARTS_PX = 480
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


def draw_model(name: str) -> NDArray[np.uint8]:
    """Return (CELL_PX, CELL_PX) grey levels of one individual of a model that fills them, seen from above.

    Raises:
        ModelError: There is no such model.
        RenderError: The renderer fails.
    """
    (first, *_) = _individuals(load_model(name), name, 0, {})
    with contextlib.closing(BlenderRenderer()) as renderer:
        return _large(renderer, first, 30, 30)


def write_turntable(renderer: BlenderRenderer, individuals: Sequence[_Individual], out: Path) -> None:
    """Write the sheet as a PNG: the first individual from all sides, the others, then the first at 8 to 60 px."""
    first = individuals[0]
    stands = first.model.stands
    rows = []
    for pitch in STANDING_PITCHES_DEG if stands else FLYING_PITCHES_DEG:
        cells = [_large(renderer, first, pitch, yaw) for yaw in YAWS_DEG]
        rows.append(_row(cells, [f"pitch {pitch}, yaw {yaw}" for yaw in YAWS_DEG]))
    others = []
    titles = []
    for k, other in enumerate(individuals[1:], start=1):
        for pitch in (30, 75) if stands else (-40, 40):
            others.append(_large(renderer, other, pitch, 30 + 90 * k))
            titles.append(f"individual {k}, pitch {pitch}")
    rows.append(_row(others, titles))
    small = []
    titles = []
    for pitch in SMALL_STANDING_DEG if stands else SMALL_FLYING_DEG:
        for size in SMALL_PX:
            small.append(_small(renderer, first, pitch, 25, size))
            titles.append(f"{size} px, pitch {pitch}")
    half = len(YAWS_DEG)
    rows += [_row(small[:half], titles[:half]), _row(small[half:], titles[half:])]
    rows.append(_parts(renderer, first, rows[0].shape[1]))
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
    params: Params
    mesh: Mesh


def _individuals(model: ObjectModel, name: str, seed: int, options: Params) -> list[_Individual]:
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


def _parts(renderer: BlenderRenderer, one: _Individual, width: int) -> NDArray[np.uint8]:
    """Render a view with numbered parts, beside a scale of temperatures and the names of the parts."""
    pitch = 30 if one.model.stands else -30
    scene = _scene(one, pitch, 30, 1.1, PARTS_PX)
    behind = np.full((PARTS_PX, PARTS_PX), _behind(one.model, pitch), np.uint8)
    view = np.asarray(compose(behind, make_layer(renderer.render(scene), MAPPING, 0.45)), np.uint8)
    roles = one.model.roles(one.params)
    places = _part_places(scene)
    line = 18
    rows_per_column = (PARTS_PX - 90) // line
    sheet = np.full((max(PARTS_PX, 90 + line), width), 30, np.uint8)
    look = scene.spec.appearance
    _scale(sheet, PARTS_PX + 20, (look.cold_k, look.hot_k))
    for n, name in enumerate(sorted(one.mesh.part_names), start=1):
        low, high = roles[name].delta_t_k
        if name in places:
            _write(view, str(n), places[name], 0.45, 255, outline=True)
        x = PARTS_PX + 20 + (n - 1) // rows_per_column * 420
        y = 96 + (n - 1) % rows_per_column * line
        coldest, warmest = (_grey(AIR_K + t, (look.cold_k, look.hot_k)) for t in (low, high))
        sheet[y - 11 : y + 3, x + 26 : x + 86] = np.linspace(coldest, warmest, 60).round().astype(np.uint8)
        _write(sheet, str(n), (x, y), 0.42, 220)
        _write(sheet, f"{name}  {low:+g} to {high:+g} K", (x + 96, y), 0.42, 220)
    sheet[:PARTS_PX, :PARTS_PX] = view
    return sheet


def _part_places(scene: PlacedScene) -> dict[str, tuple[int, int]]:
    """Return a pixel (column, row) well inside the visible area of each part that can be seen."""
    placed = scene.objects[0]
    mesh = scene.objects[0].mesh
    seen = np.full((PARTS_PX, PARTS_PX), -1, np.int32)
    corners = np.round(placed.xy[mesh.triangles]).astype(np.int32)
    # From far to near: what is in front is drawn over what is behind.
    for t in np.argsort(-placed.depth_m[mesh.triangles].mean(axis=1), kind="stable"):
        cv2.fillConvexPoly(seen, corners[t], int(mesh.part_of_triangle[t]))
    found = {}
    for n, name in enumerate(mesh.part_names):
        inside = cv2.distanceTransform((seen == n).astype(np.uint8), cv2.DIST_L2, 3)
        row, column = np.unravel_index(int(inside.argmax()), inside.shape)
        if inside[row, column] > 0:
            found[name] = (int(column) - 5, int(row) + 5)
    return found


def _scale(sheet: NDArray[np.uint8], x: int, ends_k: tuple[float, float]) -> None:
    """Draw a scale from temperature, kelvin above the air, to grey level."""
    wide = 600
    _write(sheet, "temperature of a black surface, K above the air", (x, 16), 0.42, 220)
    sheet[24:44, x : x + wide] = [_grey(t, ends_k) for t in np.linspace(ends_k[0], ends_k[1], wide)]
    span = ends_k[1] - ends_k[0]
    step = next((s for s in (2, 5, 10, 20, 50) if span / s <= 10), 100)
    low, high = ends_k[0] - AIR_K, ends_k[1] - AIR_K
    for t in range(math.ceil(low / step) * step, math.floor(high) + 1, step):
        at = x + round(wide * (t - low) / span)
        sheet[44:49, at] = 220
        _write(sheet, f"{t:+d}" if t else "0", (at - 8, 62), 0.4, 220)


def _grey(temperature_k: float, ends_k: tuple[float, float]) -> int:
    """Return the level at which the sheet shows a black surface."""
    share = min(max((temperature_k - ends_k[0]) / (ends_k[1] - ends_k[0]), 0.0), 1.0)
    return round(MAPPING.dark + (MAPPING.bright - MAPPING.dark) * share)


def _write(
    picture: NDArray[np.uint8], text: str, at: tuple[int, int], size: float, level: int, outline: bool = False
) -> None:
    if outline:
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, 0, 4, cv2.LINE_AA)
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, level, 1, cv2.LINE_AA)


def _behind(model: ObjectModel, pitch_deg: float) -> int:
    """Return the grey level behind the object: sky behind what flies, unless the camera looks down."""
    return SKY if pitch_deg <= 0 and not model.stands else GROUND


def _scene(one: _Individual, pitch_deg: float, yaw_deg: float, fill: float, side_px: int = CELL_PX) -> PlacedScene:
    """Return a scene in which a sphere around the object takes the share `fill` of the cell."""
    mesh = one.mesh
    model = one.model
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
    camera = CameraSpec(distance, math.radians(pitch_deg), 0.0, focal_mm, 36.0, (side_px, side_px))
    scene = SceneSpec("show", "show", "train", 0, camera, (spec,), AIR_K, _example_appearance(model, one.params), 0, 1)
    return place(scene, [mesh])


def _example_appearance(model: ObjectModel, params: Params) -> Appearance:
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
