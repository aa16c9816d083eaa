"""Renders scenes of the virtual world: temperatures per pixel and the number of the nearest thing.

The caller lays the world out. Every surface emits its own temperature in kelvin, plus a mirrored share of the sky; no
light bounces, so a few samples per pixel are exact up to antialiasing.
"""

from __future__ import annotations

from typing import Any

import bpy
import mathutils
import numpy as np

from infrablend.blender import session
from infrablend.blender.nodes import new_material
from infrablend.core.wire import Message

ATTRIBUTES = ("kelvin", "mirror", "solar_k", "grain_k")


class WorldScenes:
    """Renders scenes of the world, one after the other; owns the Blender scene of the process."""

    def __init__(self, stage: session.Stage) -> None:
        """Render on a stage, see `session.Stage`."""
        self._stage = stage
        s = self._scene = stage.scene
        s.render.film_transparent = False
        s.cycles.seed = 0
        s.view_layers[0].use_pass_object_index = True
        self._thing_material = thing_material()
        self._ground_material = ground_material()
        self._prototypes: dict[str, bpy.types.Mesh] = {}
        self._objects: list[bpy.types.Object] = []
        self._meshes: list[bpy.types.Mesh] = []
        self._image: bpy.types.Image | None = None

    def render(self, job: Message) -> dict[str, float]:
        """Render a scene to `0.exr`.

        Args:
            job: `camera` and `oversample`, see `Stage.set_camera`; `samples`; `ground` and `reach_m`, see `_ground`;
                `things`, surfaces with the `index` in the pass of object numbers, 0 for none; `prototypes`, surfaces by
                name, sent once; `copies` of prototypes by `name`, each with its `index`, its `matrix` (4, 4), `kelvin`
                to add and `sun`, the share that reaches it; `air_k`, `sky_drop_k`, and `sun`, the direction towards it.
                A surface has `vertices_m` in the world, `triangles`, and (T,) arrays by the names in `ATTRIBUTES`.
        """
        self._scene.cycles.samples = job["samples"]
        try:
            self._ground(job["ground"], job["reach_m"])
            for given in job["things"]:
                self._add(given)
            for name, surface in job["prototypes"].items():
                self._prototypes[name] = self._mesh(name, surface)
            for copy in job["copies"]:
                thing = self._object(self._prototypes[copy["name"]])
                thing.matrix_world = mathutils.Matrix(copy["matrix"].tolist())
                thing.color = (copy["kelvin"], copy["sun"], 0.0, 0.0)
                thing.pass_index = copy["index"]
            self._set_lights(job)
            self._stage.set_camera(job["camera"], job["oversample"])
            self._stage.render("virtual world")
        finally:
            self._clear()
        return {}

    def _mesh(self, name: str, s: Message) -> bpy.types.Mesh:
        mesh = bpy.data.meshes.new(name)
        session.fill_mesh(mesh, s["vertices_m"], s["triangles"])
        for attribute in ATTRIBUTES:
            mesh.attributes.new(attribute, "FLOAT", "FACE").data.foreach_set("value", s[attribute])
        mesh.update(calc_edges=True)
        mesh.materials.append(self._thing_material)
        return mesh

    def _object(self, mesh: bpy.types.Mesh) -> bpy.types.Object:
        thing = bpy.data.objects.new(mesh.name, mesh)
        self._scene.collection.objects.link(thing)
        self._objects.append(thing)
        return thing

    def _add(self, surface: Message) -> None:
        mesh = self._mesh(f"thing {len(self._meshes):04d}", surface)
        self._meshes.append(mesh)
        thing = self._object(mesh)
        thing.pass_index = surface["index"]
        thing.color = (0.0, 1.0, 0.0, 0.0)

    def _ground(self, kelvin: Any, reach_m: float) -> None:
        """Add the ground: a square textured with its (h, w) temperatures as the camera sees them (window coordinates).

        It reaches `reach_m` from the middle to each side.
        """
        h, w = kelvin.shape
        if self._image is None:
            self._image = bpy.data.images.new("ground", w, h, float_buffer=True, is_data=True)
            self._ground_material.node_tree.nodes["ground"].image = self._image
        pixels = np.ones((h, w, 4), np.float32)
        pixels[..., :3] = kelvin[::-1, :, None]
        self._image.pixels.foreach_set(pixels.ravel())
        self._image.update()
        x = reach_m
        mesh = bpy.data.meshes.new("ground")
        mesh.from_pydata([(-x, -x, 0), (x, -x, 0), (x, x, 0), (-x, x, 0)], [], [(0, 1, 2, 3)])
        mesh.materials.append(self._ground_material)
        self._meshes.append(mesh)
        self._object(mesh)

    def _set_lights(self, job: Message) -> None:
        nodes = self._thing_material.node_tree.nodes
        nodes["air"].outputs[0].default_value = job["air_k"]
        nodes["sky drop"].outputs[0].default_value = job["sky_drop_k"]
        for k in range(3):
            nodes["sun"].inputs[k].default_value = job["sun"][k]

    def _clear(self) -> None:
        for thing in self._objects:
            bpy.data.objects.remove(thing)
        for mesh in self._meshes:
            bpy.data.meshes.remove(mesh)
        self._objects.clear()
        self._meshes.clear()


def thing_material() -> bpy.types.Material:
    """Create the material of all things: emission of T + F (T_env - T).

    T is the own temperature, F the share of the sky or the surroundings (T_env) that the surface mirrors. Face
    attributes: `kelvin`, `mirror` (F at normal incidence), `solar_k`, `grain_k`. Trees share meshes: the object colour
    adds to their temperature (red) and scales the sun (green).
    """
    material, nodes = new_material("thermal thing")
    maths = nodes.math
    link = nodes.link
    attribute = nodes.attribute
    geometry = nodes.new("ShaderNodeNewGeometry")
    info = nodes.new("ShaderNodeObjectInfo")
    colour = nodes.new("ShaderNodeSeparateColor")
    link(info.outputs["Color"], colour.inputs[0])
    sun = nodes.add("ShaderNodeCombineXYZ", name="sun")
    normal = geometry.outputs["Normal"]
    incoming = geometry.outputs["Incoming"]

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
