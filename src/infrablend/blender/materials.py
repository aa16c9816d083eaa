"""Materials of inserted objects, and InfraredEffect: the node group of the artistic thermal look.

The paper builds the effect by hand for each object from Emission, Color Ramp and Fresnel nodes. Here one group serves
all parts and is driven by two physical quantities, the temperature and the emissivity of the part.

    level(T)   = ColorRamp( (T - Cold) / (Hot - Cold) )                       0 = black, 1 = white
    eps(theta) = Emissivity * (1 - Fresnel(IOR, theta))                       largest at normal incidence
    emission   = eps * level(Temperature) + (1 - eps) * level(Surroundings)   reflection dominates at grazing angles

The rim therefore takes the grey level of its surroundings, as with real paint and plastic, and does not turn black.
An IOR of 1 removes the dependence on the angle: rough surfaces such as fur, cloth and grass have no Fresnel rim.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from infrablend.blender.physical import SKY, add_inputs, emission_alone, physical_group, two_sided_ior
from infrablend.core.files import replace_atomically

GROUP_NAME = "InfraredEffect"
# Name, default, minimum, maximum and description, in the order of the sockets.
SOCKETS = (
    ("Temperature", 25.0, -100.0, 1000.0, "Surface temperature, degrees Celsius"),
    ("Emissivity", 0.95, 0.0, 1.0, "Emissivity at normal incidence"),
    (
        "Surroundings",
        0.0,
        -100.0,
        1000.0,
        "Apparent temperature of the surroundings that the surface mirrors, degrees Celsius",
    ),
    ("IOR", 1.5, 1.0, 5.0, "Refractive index of the surface; 1 for rough surfaces such as fur and cloth"),
    ("Cold", 5.0, -100.0, 1000.0, "Temperature shown black, degrees Celsius"),
    ("Hot", 40.0, -100.0, 1000.0, "Temperature shown white, degrees Celsius"),
)


def infrared_effect_group() -> bpy.types.ShaderNodeTree:
    """Return the InfraredEffect node group, built on first use."""
    group = bpy.data.node_groups.get(GROUP_NAME)
    if group is not None:
        return group
    group = bpy.data.node_groups.new(GROUP_NAME, "ShaderNodeTree")
    add_inputs(group, SOCKETS)
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    level_out = group.interface.new_socket("Level", in_out="OUTPUT", socket_type="NodeSocketFloat")
    level_out.description = "The emitted level, 0 cold to 1 hot"

    new, link = group.nodes.new, group.links.new
    inputs = new("NodeGroupInput")
    inputs.location = (-1100, 0)
    outputs = new("NodeGroupOutput")
    outputs.location = (700, 0)

    def ramp_of(temperature: bpy.types.NodeSocket, label: str, y: float) -> bpy.types.NodeSocket:
        span = new("ShaderNodeMapRange")
        span.clamp = True
        span.label, span.location = f"{label}: Cold..Hot to 0..1", (-850, y)
        link(temperature, span.inputs["Value"])
        link(inputs.outputs["Cold"], span.inputs["From Min"])
        link(inputs.outputs["Hot"], span.inputs["From Max"])
        ramp = new("ShaderNodeValToRGB")
        ramp.label, ramp.location = f"{label}: grey of a temperature", (-620, y)
        link(span.outputs["Result"], ramp.inputs["Fac"])
        return ramp.outputs["Color"]

    own = ramp_of(inputs.outputs["Temperature"], "Surface", 250)
    mirrored = ramp_of(inputs.outputs["Surroundings"], "Surroundings", -50)

    fresnel = new("ShaderNodeFresnel")
    fresnel.location = (-620, -350)
    link(inputs.outputs["IOR"], fresnel.inputs["IOR"])
    keep = new("ShaderNodeMath")
    keep.operation, keep.label, keep.location = "SUBTRACT", "1 - Fresnel", (-420, -350)
    keep.inputs[0].default_value = 1.0
    link(fresnel.outputs["Fac"], keep.inputs[1])
    emissivity = new("ShaderNodeMath")
    emissivity.operation, emissivity.use_clamp = "MULTIPLY", True
    emissivity.label, emissivity.location = "Emissivity at this angle", (-220, -250)
    link(inputs.outputs["Emissivity"], emissivity.inputs[0])
    link(keep.outputs["Value"], emissivity.inputs[1])

    mix = new("ShaderNodeMix")
    mix.data_type, mix.label, mix.location = "RGBA", "Emitted + mirrored", (0, 100)
    mix.clamp_factor = True
    link(emissivity.outputs["Value"], mix.inputs[0])
    link(mirrored, mix.inputs[6])
    link(own, mix.inputs[7])
    emission = new("ShaderNodeEmission")
    emission.location = (250, 100)
    link(mix.outputs[2], emission.inputs["Color"])
    grey = new("ShaderNodeRGBToBW")
    grey.location = (250, -100)
    link(mix.outputs[2], grey.inputs["Color"])
    link(emission.outputs["Emission"], outputs.inputs["Shader"])
    link(grey.outputs["Val"], outputs.inputs["Level"])
    return group


def object_material(
    slot: int, *, physical: bool = False, translucent: bool = False, two_sided: bool = False
) -> bpy.types.Material:
    """Return the material of one object of a scene: the node group of the look, driven by mesh attributes.

    Attributes per face corner: `temperature_c`, `emissivity`, `ior` and `label`; in the physical look also `roughness`
    and `metal`; for translucent objects also `opacity`. Custom properties of the object: `cold_c`, `hot_c` and
    `surroundings_c` in the artistic look; those listed in `physical.SKY` in the physical look. The material writes
    `label` to the AOV `coverage_<slot>`.

    Args:
        slot: Number of the object in the scene.
        physical: Whether the scene has the physical look.
        translucent: Whether the object has translucent parts.
        two_sided: Whether the backs of faces look like their fronts.
    """
    name = (
        f"{'physical' if physical else 'artistic'}_{slot}"
        + ("_translucent" if translucent else "")
        + ("_two_sided" if two_sided else "")
    )
    material = bpy.data.materials.get(name)
    if material is not None:
        return material
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    new, link = tree.nodes.new, tree.links.new
    effect = new("ShaderNodeGroup")
    effect.node_tree = physical_group() if physical else infrared_effect_group()

    def attribute(attribute_name: str, kind: str = "GEOMETRY") -> bpy.types.NodeSocket:
        node = new("ShaderNodeAttribute")
        node.attribute_type, node.attribute_name = kind, attribute_name
        return node.outputs["Fac"]

    celsius, emissivity, ior = (attribute(n) for n in ("temperature_c", "emissivity", "ior"))
    if two_sided:
        ior = two_sided_ior(tree, ior)
    link(celsius, effect.inputs["Temperature"])
    link(emissivity, effect.inputs["Emissivity"])
    link(ior, effect.inputs["IOR"])
    if physical:
        link(attribute("roughness"), effect.inputs["Roughness"])
        link(attribute("metal"), effect.inputs["Metal"])
    else:
        link(attribute("surroundings_c", "OBJECT"), effect.inputs["Surroundings"])
        link(attribute("cold_c", "OBJECT"), effect.inputs["Cold"])
        link(attribute("hot_c", "OBJECT"), effect.inputs["Hot"])
    shown = effect.outputs["Shader"]
    if translucent:
        opacity, clear = attribute("opacity"), new("ShaderNodeBsdfTransparent")
        sky = {n: attribute(n, "OBJECT") for n in SKY if physical}
        thin = emission_alone(tree, celsius, emissivity, ior, sky) if physical else shown
        thin = _mixed_shaders(tree, opacity, clear.outputs["BSDF"], thin)
        opaque = new("ShaderNodeMath")
        opaque.operation = "GREATER_THAN"
        link(opacity, opaque.inputs[0])
        opaque.inputs[1].default_value = 0.9999
        shown = _mixed_shaders(tree, opaque.outputs["Value"], thin, shown)
    output = new("ShaderNodeOutputMaterial")
    link(shown, output.inputs["Surface"])
    aov = new("ShaderNodeOutputAOV")
    aov.aov_name = aov_name(slot)
    link(attribute("label"), aov.inputs["Value"])
    return material


def _mixed_shaders(tree: bpy.types.NodeTree, share: Any, none: Any, full: Any) -> Any:
    """Return a shader that mixes `none` (share 0) and `full` (share 1)."""
    mix = tree.nodes.new("ShaderNodeMixShader")
    for socket, value in zip(mix.inputs, (share, none, full), strict=True):
        tree.links.new(value, socket)
    return mix.outputs["Shader"]


def aov_name(slot: int) -> str:
    """Return the name of the pass that contains the coverage of an object."""
    return f"coverage_{slot}"


def write_infrared_effect(path: Path) -> Path:
    """Write a .blend file to append from, with both node groups and an example material for each."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for group, what in (
        (infrared_effect_group(), "Thermal look of a surface from its temperature and emissivity (InfraBlend)"),
        (physical_group(), "Band radiance of a surface that mirrors its surroundings, 1 at 300 K (InfraBlend)"),
    ):
        group.use_fake_user = True
        group.asset_mark()
        group.asset_data.description = what
        material = bpy.data.materials.new(f"{group.name} example")
        material.use_fake_user = True
        material.use_nodes = True
        tree = material.node_tree
        tree.nodes.clear()
        node = tree.nodes.new("ShaderNodeGroup")
        node.node_tree = group
        output = tree.nodes.new("ShaderNodeOutputMaterial")
        output.location = (250, 0)
        tree.links.new(node.outputs["Shader"], output.inputs["Surface"])
    with replace_atomically(path) as temporary:
        bpy.ops.wm.save_as_mainfile(filepath=str(temporary), copy=True, compress=False)
    return path
