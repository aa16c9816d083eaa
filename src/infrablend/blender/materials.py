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

from collections.abc import Mapping

import bpy

from infrablend.blender.nodes import Nodes, new_material
from infrablend.blender.physical import SKY, add_inputs, emission_alone, physical_group, two_sided_ior

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

    nodes = Nodes(group)
    link = nodes.link
    inputs = nodes.add("NodeGroupInput", location=(-1100, 0))
    outputs = nodes.add("NodeGroupOutput", location=(700, 0))

    def ramp_of(temperature: bpy.types.NodeSocket, label: str, y: float) -> bpy.types.NodeSocket:
        span = nodes.add("ShaderNodeMapRange", clamp=True, label=f"{label}: Cold..Hot to 0..1", location=(-850, y))
        link(temperature, span.inputs["Value"])
        link(inputs.outputs["Cold"], span.inputs["From Min"])
        link(inputs.outputs["Hot"], span.inputs["From Max"])
        ramp = nodes.add("ShaderNodeValToRGB", label=f"{label}: grey of a temperature", location=(-620, y))
        link(span.outputs["Result"], ramp.inputs["Fac"])
        return ramp.outputs["Color"]

    own = ramp_of(inputs.outputs["Temperature"], "Surface", 250)
    mirrored = ramp_of(inputs.outputs["Surroundings"], "Surroundings", -50)

    fresnel = nodes.add("ShaderNodeFresnel", location=(-620, -350))
    link(inputs.outputs["IOR"], fresnel.inputs["IOR"])
    keep = nodes.math("SUBTRACT", 1.0, fresnel.outputs["Fac"])
    keep.node.label = "1 - Fresnel"
    keep.node.location = (-420, -350)
    emissivity = nodes.math("MULTIPLY", inputs.outputs["Emissivity"], keep, clamp=True)
    emissivity.node.label = "Emissivity at this angle"
    emissivity.node.location = (-220, -250)

    mix = nodes.add("ShaderNodeMix", data_type="RGBA", clamp_factor=True, label="Emitted + mirrored", location=(0, 100))
    link(emissivity, mix.inputs[0])
    link(mirrored, mix.inputs[6])
    link(own, mix.inputs[7])
    emission = nodes.add("ShaderNodeEmission", location=(250, 100))
    link(mix.outputs[2], emission.inputs["Color"])
    grey = nodes.add("ShaderNodeRGBToBW", location=(250, -100))
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
    `label` to the AOV `coverage_<slot>`. `two_sided` makes the backs of faces look like their fronts.
    """
    name = (
        f"{'physical' if physical else 'artistic'}_{slot}"
        + ("_translucent" if translucent else "")
        + ("_two_sided" if two_sided else "")
    )
    material = bpy.data.materials.get(name)
    if material is not None:
        return material
    material, nodes = new_material(name)
    # Surfaces and sky emit on all sides, so following reflections finds their light. Aiming at a random triangle, too,
    # would double the cost of a sample and leave as much noise.
    material.cycles.emission_sampling = "NONE"
    attribute = nodes.attribute
    link = nodes.link
    effect = nodes.add("ShaderNodeGroup", node_tree=physical_group() if physical else infrared_effect_group())
    celsius, emissivity, ior = (attribute(n) for n in ("temperature_c", "emissivity", "ior"))
    if two_sided:
        ior = two_sided_ior(nodes, ior)
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
        opacity = attribute("opacity")
        clear = nodes.new("ShaderNodeBsdfTransparent")
        thin = shown
        if physical:
            thin = emission_alone(nodes, celsius, emissivity, ior, {n: attribute(n, "OBJECT") for n in SKY})
        thin = nodes.mixed(opacity, clear.outputs["BSDF"], thin)
        shown = nodes.mixed(nodes.math("GREATER_THAN", opacity, 0.9999), thin, shown)
    nodes.surface(shown)
    link(attribute("label"), nodes.add("ShaderNodeOutputAOV", aov_name=aov_name(slot)).inputs["Value"])
    return material


def aov_name(slot: int) -> str:
    """Return the name of the pass that contains the coverage of an object."""
    return f"coverage_{slot}"


def write_infrared_effect(job: Mapping[str, str]) -> None:
    """Write a .blend `file` to append from, with both node groups and an example material for each."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for group, what in (
        (infrared_effect_group(), "Thermal look of a surface from its temperature and emissivity (InfraBlend)"),
        (physical_group(), "Band radiance of a surface that mirrors its surroundings, 1 at 300 K (InfraBlend)"),
    ):
        group.use_fake_user = True
        group.asset_mark()
        group.asset_data.description = what
        material, nodes = new_material(f"{group.name} example")
        material.use_fake_user = True
        output = nodes.add("ShaderNodeOutputMaterial", location=(250, 0))
        nodes.link(nodes.add("ShaderNodeGroup", node_tree=group).outputs["Shader"], output.inputs["Surface"])
    bpy.ops.wm.save_as_mainfile(filepath=job["file"], copy=True, compress=False)
