"""The two materials of the virtual world in Blender: things and ground, both emitting temperatures."""

from __future__ import annotations

from typing import Any

import bpy


def thing_material() -> bpy.types.Material:
    """Create the material of all things: emission of T + F (T_env - T).

    T is the own temperature, F the share of the sky or the surroundings (T_env) that the surface mirrors. Face
    attributes: `kelvin`, `mirror` (F at normal incidence), `solar_k`, `grain_k`. Trees share meshes: the object colour
    adds to their temperature (red) and scales the sun (green).
    """
    material = bpy.data.materials.new("thermal thing")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    new, link = tree.nodes.new, tree.links.new

    def value(name: str) -> Any:
        node = new("ShaderNodeValue")
        node.name = name
        return node.outputs[0]

    def attribute(name: str) -> Any:
        node = new("ShaderNodeAttribute")
        node.attribute_name = name
        return node.outputs["Fac"]

    def maths(operation: str, *inputs: Any, clamp: bool = False) -> Any:
        node = new("ShaderNodeMath")
        node.operation = operation
        node.use_clamp = clamp
        for slot, i in zip(node.inputs, inputs, strict=False):
            if isinstance(i, (int, float)):
                slot.default_value = i
            else:
                link(i, slot)
        return node.outputs[0]

    def vectors(operation: str, a: Any, b: Any, output: str) -> Any:
        node = new("ShaderNodeVectorMath")
        node.operation = operation
        link(a, node.inputs[0])
        link(b, node.inputs[1])
        return node.outputs[output]

    geometry = new("ShaderNodeNewGeometry")
    info = new("ShaderNodeObjectInfo")
    colour = new("ShaderNodeSeparateColor")
    link(info.outputs["Color"], colour.inputs[0])
    sun = new("ShaderNodeCombineXYZ")
    sun.name = "sun"
    normal, incoming = geometry.outputs["Normal"], geometry.outputs["Incoming"]

    pattern = new("ShaderNodeTexNoise")
    pattern.inputs["Scale"].default_value = 3.0
    pattern.inputs["Detail"].default_value = 1.5
    link(geometry.outputs["Position"], pattern.inputs["Vector"])
    grain = maths("MULTIPLY", maths("MULTIPLY_ADD", pattern.outputs["Fac"], 4.0, -2.0), attribute("grain_k"))
    facing_sun = maths("MAXIMUM", vectors("DOT_PRODUCT", normal, sun.outputs[0], "Value"), 0.0)
    solar = maths("MULTIPLY", colour.outputs[1], attribute("solar_k"))
    heated = maths("MULTIPLY", facing_sun, solar)
    kelvin = maths("ADD", maths("ADD", attribute("kelvin"), colour.outputs[0]), maths("ADD", grain, heated))

    cosine = maths("ABSOLUTE", vectors("DOT_PRODUCT", normal, incoming, "Value"))
    grazing = maths("POWER", maths("SUBTRACT", 1.0, cosine), 4.0)
    mirror = maths("MULTIPLY", attribute("mirror"), maths("MULTIPLY_ADD", grazing, 6.0, 1.0), clamp=True)
    # Mirrored direction of the ray to the camera: 2 (n.i) n - i; only its height matters.
    up = new("ShaderNodeSeparateXYZ")
    link(normal, up.inputs[0])
    towards = new("ShaderNodeSeparateXYZ")
    link(incoming, towards.inputs[0])
    height = maths("SUBTRACT", maths("MULTIPLY", maths("MULTIPLY", cosine, 2.0), up.outputs[2]), towards.outputs[2])
    # The sky is coldest overhead and takes the air's temperature at the horizon; below it are things near air.
    depth = maths("POWER", maths("MAXIMUM", height, 0.0), 0.6)
    environment = maths("SUBTRACT", value("air"), maths("MULTIPLY", depth, value("sky drop")))
    total = maths("ADD", kelvin, maths("MULTIPLY", mirror, maths("SUBTRACT", environment, kelvin)))
    _emit(tree, total)
    return material


def ground_material() -> bpy.types.Material:
    """Create the material of the ground: emission of an image of temperatures, mapped in window coordinates."""
    material = bpy.data.materials.new("thermal ground")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    image = tree.nodes.new("ShaderNodeTexImage")
    image.name = "ground"
    image.interpolation = "Closest"
    image.extension = "EXTEND"
    tree.links.new(coordinates.outputs["Window"], image.inputs["Vector"])
    split = tree.nodes.new("ShaderNodeSeparateColor")
    tree.links.new(image.outputs["Color"], split.inputs[0])
    _emit(tree, split.outputs[0])
    return material


def _emit(tree: bpy.types.ShaderNodeTree, strength: Any) -> None:
    emission = tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(strength, emission.inputs["Strength"])
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
