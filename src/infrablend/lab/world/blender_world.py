"""Renders plans of the virtual world, by Blender or without it: temperatures per pixel and labels.

The scene is rendered at twice the resolution of the frame, so the object ids have four samples per pixel.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.camera import CameraSpec
from infrablend.core.mesh import FloatArray, IntArray
from infrablend.core.operating_system import take_core
from infrablend.core.surface_kinds import SURFACES
from infrablend.core.tasks import Task
from infrablend.lab.world.buildings import building
from infrablend.lab.world.fixtures import TREE_KINDS, Tree, furniture, tree_matrix, tree_prototype
from infrablend.lab.world.frame_files import FinishedFrame, Label, VisibleSamples, label_object, make_frame
from infrablend.lab.world.ground import Field, ground_kelvin, ground_surfaces
from infrablend.lab.world.lattice_world import Body, draw_bodies
from infrablend.lab.world.people import cycle, person
from infrablend.lab.world.scene_plan import WorldPlan
from infrablend.lab.world.thermal_surfaces import Surface, placed
from infrablend.lab.world.vehicles import vehicle
from infrablend.lab.world.world_flight import Flight, begin_flight, flight_frame
from infrablend.lab.world.world_frames import Engine
from infrablend.lab.world.world_survey import SurveyFlight, begin_survey, survey_frame
from infrablend.rendering.engine.process import BlenderProcess
from infrablend.rendering.engine.programs import find_blender
from infrablend.rendering.engine.renderer import camera_message, channel

OVERSAMPLE = 2
SAMPLES = 3
ATTRIBUTES = ("kelvin", "mirror", "solar_k", "grain_k")  # as in `blender.world`
_WHAT = "virtual world"
# First number in the pass of object numbers of things without a class; Blender's largest is 32767.
_OTHERS = 20_000

_Labelled = tuple[str, FloatArray, IntArray]


class WorldRenderer:
    """Renderer of plans, one after the other, with a Blender of its own or by the lattice, which needs none."""

    def __init__(self, engine: Engine = "blender") -> None:
        """Start Blender if it is to render.

        Raises:
            MissingDependencyError: There is none.
        """
        self._process = BlenderProcess(find_blender()) if engine == "blender" else None
        if self._process is not None:
            self._process.open("world", "cpu")
        self._sent: set[str] = set()  # prototypes of trees that Blender has

    def close(self) -> None:
        """End Blender's process."""
        if self._process is not None:
            self._process.close()

    def render(self, plan: WorldPlan) -> tuple[NDArray[np.float32], list[Label]]:
        """Return the (h, w) float32 temperatures of a frame in kelvin, and a label for every thing with a class."""
        kelvin, ids, labelled = self._render(plan)
        return kelvin, [_label(plan.camera, k + 1, *thing, ids) for k, thing in enumerate(labelled)]

    def render_surfaces(self, plan: WorldPlan) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Return the (h, w) temperatures of a frame in kelvin, and the kind of surface at each pixel, uint8.

        Kinds are numbers in `SURFACES`; of the four samples of a pixel, the most frequent one counts.
        """
        kelvin, ids, _ = self._render(plan)
        of_thing = np.full(_OTHERS + len(SURFACES), SURFACES.index("object"), np.uint8)
        of_thing[_OTHERS:] = np.arange(len(SURFACES))
        kinds = np.where(ids == 0, ground_surfaces(plan, OVERSAMPLE), of_thing[ids])
        h, w = kelvin.shape
        samples = kinds.reshape(h, OVERSAMPLE, w, OVERSAMPLE)
        counts = np.stack([(samples == k).sum(axis=(1, 3)) for k in range(len(SURFACES))])
        return kelvin, np.asarray(counts.argmax(axis=0), np.uint8)

    def _render(self, plan: WorldPlan) -> tuple[NDArray[np.float32], NDArray[np.int32], list[_Labelled]]:
        """Return temperatures, the number of the thing at each sample (see `_things`), and the labelled things."""
        labelled, things = _things(plan)
        ground = ground_kelvin(plan, OVERSAMPLE)
        if self._process is None:
            kelvin, ids = draw_bodies(plan, ground, itertools.chain(things, _tree_bodies(plan)), OVERSAMPLE)
        else:
            kelvin, ids = self._render_in_blender(self._process, plan, ground, things)
        w, h = plan.camera.size_wh
        frame = kelvin.reshape(h, OVERSAMPLE, w, OVERSAMPLE).mean(axis=(1, 3), dtype=np.float32)
        return np.asarray(frame, np.float32), ids, labelled

    def _render_in_blender(
        self, process: BlenderProcess, plan: WorldPlan, ground: Field, things: Sequence[Body]
    ) -> tuple[Field, NDArray[np.int32]]:
        """Return the temperature in kelvin and the number of the thing at each sample, see `draw_bodies`."""
        prototypes, copies = self._trees(plan)
        camera = plan.camera
        job = {
            "camera": camera_message(camera, (1.0, 10 * camera.distance_m)),
            "oversample": OVERSAMPLE,
            "samples": SAMPLES,
            "ground": ground,
            "reach_m": 4 * camera.distance_m,
            "things": [{**_message(t.surface, t.vertices_m), "index": t.index} for t in things],
            "prototypes": prototypes,
            "copies": copies,
            "air_k": plan.air_k,
            "sky_drop_k": plan.sky_drop_k,
            "sun": plan.sun if plan.sun is not None else (0.0, 0.0, -1.0),
        }
        process.ask("render", job)
        self._sent |= prototypes.keys()
        channels = process.channels()
        ids = np.round(channel(channels, _WHAT, ".indexob.x")).astype(np.int32)
        return channel(channels, _WHAT, ".combined.r"), ids

    def _trees(self, plan: WorldPlan) -> tuple[dict[str, object], list[dict[str, object]]]:
        """Return the prototypes that Blender does not have yet, and the trees, which are copies of prototypes."""
        prototypes: dict[str, object] = {}
        copies = []
        for t in plan.trees:
            number = t.prototype % TREE_KINDS[t.kind]
            name = f"{t.kind} {number}"
            if name not in self._sent and name not in prototypes:
                surface = tree_prototype(t.kind, number)
                prototypes[name] = _message(surface, surface.vertices_m)
            matrix = tree_matrix(t)
            copies.append(
                {"name": name, "matrix": matrix, "kelvin": t.kelvin, "sun": t.solar_k, "index": _tree_index(t)}
            )
        return prototypes, copies


def _tree_index(tree: Tree) -> int:
    return _OTHERS + SURFACES.index("shrub" if tree.kind == "shrub" else "tree")


def _tree_bodies(plan: WorldPlan) -> Iterator[Body]:
    for t in plan.trees:
        surface = _prototype(t.kind, t.prototype % TREE_KINDS[t.kind])
        matrix = tree_matrix(t)
        vertices = surface.vertices_m @ matrix[:3, :3].T + matrix[:3, 3]
        yield Body(surface, vertices, _tree_index(t), t.kelvin, t.solar_k)


_prototype = cache(tree_prototype)


def _things(plan: WorldPlan) -> tuple[list[_Labelled], list[Body]]:
    """Return class, world vertices and triangles of the labelled things, in id order from 1; and all as bodies.

    The number of each of the others is `_OTHERS` and that of its kind of surface.
    """
    classed: list[tuple[Surface, Any]] = [(vehicle(v), v) for v in plan.vehicles]
    classed += [(person(p), p) for p in plan.people]
    classed += [(cycle(c), c) for c in plan.cycles]
    others: list[tuple[Surface, Any]] = [(building(b), b) for b in plan.buildings]
    others += [(furniture(f), f) for f in plan.furniture]
    labelled: list[_Labelled] = []
    bodies = []
    for surface, thing in classed:
        vertices = placed(surface, thing.x_m, thing.y_m, thing.heading_rad)
        labelled.append((thing.category, vertices, surface.triangles))
        bodies.append(Body(surface, vertices, len(labelled)))
    for surface, other in others:
        vertices = placed(surface, other.x_m, other.y_m, other.heading_rad)
        bodies.append(Body(surface, vertices, _OTHERS + SURFACES.index("structure")))
    return labelled, bodies


def _message(surface: Surface, vertices_m: FloatArray) -> dict[str, object]:
    values = {name: np.asarray(getattr(surface, name), np.float32) for name in ATTRIBUTES}
    return {"vertices_m": np.asarray(vertices_m, np.float32), "triangles": surface.triangles, **values}


def _label(
    camera: CameraSpec,
    index: int,
    category: str,
    vertices_m: FloatArray,
    triangles: IntArray,
    ids: NDArray[np.int32],
) -> Label:
    xy, _ = camera.project(vertices_m)
    h, w = ids.shape
    x0, y0 = np.clip(np.floor(np.nanmin(xy, axis=0) * OVERSAMPLE).astype(int) - 1, 0, (w, h))
    x1, y1 = np.clip(np.ceil(np.nanmax(xy, axis=0) * OVERSAMPLE).astype(int) + 1, 0, (w, h))
    visible = VisibleSamples(ids[y0:y1, x0:x1] == index, (int(x0), int(y0)), OVERSAMPLE)
    return label_object(category, camera, vertices_m, triangles, visible, upright=category == "Person")


class WorldWorker:
    """Renders frames of one virtual dataset, see `WorldRenderer`."""

    def __init__(self, seed: int, folder: Path, engine: Engine = "blender") -> None:
        """Start Blender if it is to render; images go to `folder`/<split>/."""
        self._seed = seed
        self._folder = folder
        self._renderer = WorldRenderer(engine)
        self._flight: Flight | None = None
        self._survey: SurveyFlight | None = None

    def __call__(self, task: Task) -> FinishedFrame:
        """Render the `FrameFacts` in the payload of a task."""
        if not task.payload.flight:
            return make_frame(task.payload, self._seed, self._renderer, self._folder)
        if task.payload.survey is not None:
            if self._survey is None:
                self._survey = begin_survey(task.payload, self._seed, self._renderer)
            return survey_frame(self._survey, task.payload, self._folder)
        if self._flight is None:
            self._flight = begin_flight(task.payload, self._seed, self._renderer)
        return flight_frame(self._flight, task.payload, self._folder)

    def close(self) -> None:
        """End Blender's process."""
        self._renderer.close()


def make_world_worker(settings: Mapping[str, Any]) -> WorldWorker:
    """Create a worker from `seed`, `folder` and `engine`."""
    take_core()
    return WorldWorker(settings["seed"], Path(settings["folder"]), settings["engine"])
