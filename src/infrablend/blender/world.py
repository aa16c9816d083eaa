"""Renders plans of the virtual world in Blender: temperatures per pixel and labels.

Every surface emits its own temperature in kelvin, plus a mirrored share of the sky; no light bounces, so a few samples
per pixel are exact up to antialiasing. The scene is rendered at twice the resolution of the frame, so the object ids
have four samples per pixel.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np
from numpy.typing import NDArray

from infrablend.blender import session
from infrablend.blender.nodes import new_material
from infrablend.core.camera import CameraSpec
from infrablend.core.machine import take_core
from infrablend.core.mesh import FloatArray, IntArray
from infrablend.core.tasks import Task
from infrablend.world.buildings import building
from infrablend.world.fixtures import TREE_KINDS, Tree, furniture, tree_matrix, tree_prototype
from infrablend.world.frame_files import FinishedFrame, make_frame
from infrablend.world.ground import ground_kelvin
from infrablend.world.labels import Label, VisibleSamples, label_object
from infrablend.world.people import cycle, person
from infrablend.world.plan import WorldPlan
from infrablend.world.surfaces import Surface, placed
from infrablend.world.vehicles import vehicle

OVERSAMPLE = 2
SAMPLES = 3
ATTRIBUTES = ("kelvin", "mirror", "solar_k", "grain_k")


class WorldRenderer:
    """Renderer of plans, one after the other; owns the Blender scene of the process."""

    def __init__(self) -> None:
        """Start from an empty Blender scene."""
        self._stage = session.Stage("cpu")
        s = self._scene = self._stage.scene
        s.render.film_transparent = False
        s.cycles.samples = SAMPLES
        s.cycles.seed = 0
        s.view_layers[0].use_pass_object_index = True
        self._thing_material = thing_material()
        self._ground_material = ground_material()
        self._prototypes: dict[tuple[str, int], bpy.types.Mesh] = {}
        self._objects: list[bpy.types.Object] = []
        self._meshes: list[bpy.types.Mesh] = []
        self._image: bpy.types.Image | None = None

    def close(self) -> None:
        """Remove from Blender everything that this renderer created."""
        self._clear()
        for mesh in self._prototypes.values():
            bpy.data.meshes.remove(mesh)
        self._prototypes.clear()
        if self._image is not None:
            bpy.data.images.remove(self._image)
            self._image = None
        self._stage.close()

    def render(self, plan: WorldPlan) -> tuple[NDArray[np.float32], list[Label]]:
        """Return the (h, w) float32 temperatures of a frame in kelvin, and a label for every thing with a class."""
        try:
            labelled = self._build(plan)
            kelvin, ids = self._render(plan.camera)
        finally:
            self._clear()
        w, h = plan.camera.size_wh
        frame = kelvin.reshape(h, OVERSAMPLE, w, OVERSAMPLE).mean(axis=(1, 3), dtype=np.float32)
        return np.asarray(frame, np.float32), [
            self._label(plan.camera, k + 1, category, vertices, triangles, ids)
            for k, (category, vertices, triangles) in enumerate(labelled)
        ]

    # Scene ----------------------------------------------------------------------------------------------------

    def _build(self, plan: WorldPlan) -> list[tuple[str, FloatArray, IntArray]]:
        """Fill the scene; return class, world vertices and triangles of the labelled things, in id order from 1."""
        labelled: list[tuple[str, FloatArray, IntArray]] = []

        def classed(category: str, surface: Surface, x_m: float, y_m: float, heading_rad: float) -> None:
            vertices = placed(surface, x_m, y_m, heading_rad)
            labelled.append((category, vertices, surface.triangles))
            self._add(surface, vertices, len(labelled))

        self._ground(plan)
        for v in plan.vehicles:
            classed(v.category, vehicle(v), v.x_m, v.y_m, v.heading_rad)
        for q in plan.people:
            classed(q.category, person(q), q.x_m, q.y_m, q.heading_rad)
        for c in plan.cycles:
            classed(c.category, cycle(c), c.x_m, c.y_m, c.heading_rad)
        for b in plan.buildings:
            surface = building(b)
            self._add(surface, placed(surface, b.x_m, b.y_m, b.heading_rad), 0)
        for f in plan.furniture:
            surface = furniture(f)
            self._add(surface, placed(surface, f.x_m, f.y_m, f.heading_rad), 0)
        for t in plan.trees:
            self._tree(t)
        self._add_lights(plan)
        return labelled

    def _tree(self, t: Tree) -> None:
        """Add a tree: trees of the same prototype share a mesh."""
        number = t.prototype % TREE_KINDS[t.kind]
        mesh = self._prototypes.get((t.kind, number))
        if mesh is None:
            prototype = tree_prototype(t.kind, number)
            mesh = self._mesh(f"{t.kind} {number}", prototype, prototype.vertices_m)
            self._prototypes[t.kind, number] = mesh
        tree = self._object(mesh)
        tree.matrix_world = mathutils.Matrix(tree_matrix(t).tolist())
        tree.color = (t.kelvin, t.solar_k, 0.0, 0.0)

    def _mesh(self, name: str, s: Surface, vertices_m: FloatArray) -> bpy.types.Mesh:
        mesh = bpy.data.meshes.new(name)
        session.fill_mesh(mesh, vertices_m, s.triangles)
        for attribute in ATTRIBUTES:
            mesh.attributes.new(attribute, "FLOAT", "FACE").data.foreach_set("value", getattr(s, attribute))
        mesh.update(calc_edges=True)
        mesh.materials.append(self._thing_material)
        return mesh

    def _object(self, mesh: bpy.types.Mesh) -> bpy.types.Object:
        thing = bpy.data.objects.new(mesh.name, mesh)
        self._scene.collection.objects.link(thing)
        self._objects.append(thing)
        return thing

    def _add(self, s: Surface, vertices_m: FloatArray, index: int) -> None:
        mesh = self._mesh(f"thing {len(self._meshes):04d}", s, vertices_m)
        self._meshes.append(mesh)
        thing = self._object(mesh)
        thing.pass_index = index
        thing.color = (0.0, 1.0, 0.0, 0.0)

    def _ground(self, plan: WorldPlan) -> None:
        """Add the ground: a plane textured with its temperatures as the camera sees them (window coordinates)."""
        kelvin = ground_kelvin(plan, OVERSAMPLE)
        h, w = kelvin.shape
        if self._image is None:
            self._image = bpy.data.images.new("ground", w, h, float_buffer=True, is_data=True)
            self._ground_material.node_tree.nodes["ground"].image = self._image
        pixels = np.ones((h, w, 4), np.float32)
        pixels[..., :3] = kelvin[::-1, :, None]
        self._image.pixels.foreach_set(pixels.ravel())
        self._image.update()
        reach = 4 * plan.camera.distance_m
        mesh = bpy.data.meshes.new("ground")
        mesh.from_pydata(
            [(-reach, -reach, 0), (reach, -reach, 0), (reach, reach, 0), (-reach, reach, 0)], [], [(0, 1, 2, 3)]
        )
        mesh.materials.append(self._ground_material)
        self._meshes.append(mesh)
        self._object(mesh)

    def _add_lights(self, plan: WorldPlan) -> None:
        nodes = self._thing_material.node_tree.nodes
        nodes["air"].outputs[0].default_value = plan.air_k
        nodes["sky drop"].outputs[0].default_value = plan.sky_drop_k
        sun = plan.sun if plan.sun is not None else (0.0, 0.0, -1.0)
        for k in range(3):
            nodes["sun"].inputs[k].default_value = sun[k]

    # Rendering ------------------------------------------------------------------------------------------------

    def _render(self, camera: CameraSpec) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        self._stage.set_camera(camera, (1.0, 10 * camera.distance_m), OVERSAMPLE)
        self._stage.render("virtual world")
        channels = self._stage.channels()
        ids = session.channel(channels, "virtual world", ".indexob.x")
        return session.channel(channels, "virtual world", ".combined.r"), np.round(ids).astype(np.int32)

    def _clear(self) -> None:
        for thing in self._objects:
            bpy.data.objects.remove(thing)
        for mesh in self._meshes:
            bpy.data.meshes.remove(mesh)
        self._objects.clear()
        self._meshes.clear()

    def _label(
        self,
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


def thing_material() -> bpy.types.Material:
    """Create the material of all things: emission of T + F (T_env - T).

    T is the own temperature, F the share of the sky or the surroundings (T_env) that the surface mirrors. Face
    attributes: `kelvin`, `mirror` (F at normal incidence), `solar_k`, `grain_k`. Trees share meshes: the object colour
    adds to their temperature (red) and scales the sun (green).
    """
    material, nodes = new_material("thermal thing")
    maths, link, attribute = nodes.math, nodes.link, nodes.attribute
    geometry = nodes.new("ShaderNodeNewGeometry")
    info = nodes.new("ShaderNodeObjectInfo")
    colour = nodes.new("ShaderNodeSeparateColor")
    link(info.outputs["Color"], colour.inputs[0])
    sun = nodes.add("ShaderNodeCombineXYZ", name="sun")
    normal, incoming = geometry.outputs["Normal"], geometry.outputs["Incoming"]

    pattern = nodes.new("ShaderNodeTexNoise")
    pattern.inputs["Scale"].default_value = 3.0
    pattern.inputs["Detail"].default_value = 1.5
    link(geometry.outputs["Position"], pattern.inputs["Vector"])
    grain = maths("MULTIPLY", maths("MULTIPLY_ADD", pattern.outputs["Fac"], 4.0, -2.0), attribute("grain_k"))
    facing_sun = maths("MAXIMUM", nodes.dot(normal, sun.outputs[0]), 0.0)
    heated = maths("MULTIPLY", facing_sun, maths("MULTIPLY", colour.outputs[1], attribute("solar_k")))
    kelvin = maths("ADD", maths("ADD", attribute("kelvin"), colour.outputs[0]), maths("ADD", grain, heated))

    cosine = maths("ABSOLUTE", nodes.dot(normal, incoming))
    grazing = maths("POWER", maths("SUBTRACT", 1.0, cosine), 4.0)
    mirror = maths("MULTIPLY", attribute("mirror"), maths("MULTIPLY_ADD", grazing, 6.0, 1.0), clamp=True)
    # Mirrored direction of the ray to the camera: 2 (n.i) n - i; only its height matters.
    twice = maths("MULTIPLY", maths("MULTIPLY", cosine, 2.0), nodes.upward(normal))
    height = maths("SUBTRACT", twice, nodes.upward(incoming))
    # The sky is coldest overhead and takes the air's temperature at the horizon; below it are things near air.
    depth = maths("POWER", maths("MAXIMUM", height, 0.0), 0.6)
    environment = maths("SUBTRACT", nodes.value("air"), maths("MULTIPLY", depth, nodes.value("sky drop")))
    total = maths("ADD", kelvin, maths("MULTIPLY", mirror, maths("SUBTRACT", environment, kelvin)))
    nodes.surface(nodes.emission(total))
    return material


def ground_material() -> bpy.types.Material:
    """Create the material of the ground: emission of an image of temperatures, mapped in window coordinates."""
    material, nodes = new_material("thermal ground")
    image = nodes.add("ShaderNodeTexImage", name="ground", interpolation="Closest", extension="EXTEND")
    nodes.link(nodes.new("ShaderNodeTexCoord").outputs["Window"], image.inputs["Vector"])
    split = nodes.new("ShaderNodeSeparateColor")
    nodes.link(image.outputs["Color"], split.inputs[0])
    nodes.surface(nodes.emission(split.outputs[0]))
    return material


class WorldWorker:
    """Renders frames of one virtual dataset; owns the Blender scene of its process."""

    def __init__(self, seed: int, folder: Path) -> None:
        """Start Blender; images go to `folder`/<split>/."""
        self._seed, self._folder = seed, folder
        self._renderer = WorldRenderer()

    def __call__(self, task: Task) -> FinishedFrame:
        """Render the `FrameFacts` in the payload of a task."""
        return make_frame(task.payload, self._seed, self._renderer, self._folder)

    def close(self) -> None:
        """Release Blender's scene."""
        self._renderer.close()


def make_world_worker(settings: Mapping[str, Any]) -> WorldWorker:
    """Create a worker from `seed` and `folder`."""
    take_core()
    return WorldWorker(settings["seed"], Path(settings["folder"]))
