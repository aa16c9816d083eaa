"""Shaders of the physical look: surfaces that emit band radiance and mirror sky and ground.

    leaving radiance = eps(theta) L(T) + (1 - eps(theta)) L_env(mirrored direction)

One shader adds emission and reflection. Cycles traces the reflection, so parts also mirror each other; the World emits
the radiance of the sky above the horizon and that of the ground below. Radiance is in units of L(300 K), which keeps
values near one.

Smooth dielectrics (IOR above 1) reflect more towards the rim, rough ones (IOR 1) scatter, and metals reflect at all
angles, blurred by their roughness.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import bpy
import numpy as np

from infrablend.blender.nodes import Nodes
from infrablend.thermal.radiometry import UNIT_K, UNIT_W_M2_SR, ZERO_C_K, band_radiance

GROUP_NAME = "InfraredEffect Physical"
# ln(L(T) / L(300 K)) is fitted by a polynomial in 300/T - 1; within 3e-4 of Planck's law from 230 to 400 K.
_FIT_K = (230.0, 400.0)
_FIT_DEGREE = 3
# Name, default, minimum, maximum and description, in the order of the sockets.
SOCKETS = (
    ("Temperature", 25.0, -80.0, 600.0, "Surface temperature, degrees Celsius"),
    ("Emissivity", 0.95, 0.0, 1.0, "Emissivity at normal incidence"),
    ("IOR", 1.5, 1.0, 5.0, "Refractive index of a smooth surface; 1 for rough ones (fur, cloth, soil): no rim"),
    ("Roughness", 0.1, 0.0, 1.0, "Roughness of the reflection on smooth surfaces and metals"),
    ("Metal", 0.0, 0.0, 1.0, "1 for bare metal: it mirrors at all angles, its emissivity does not depend on the angle"),
    ("Texture", 0.0, 0.0, 50.0, "Largest deviation of a smooth pattern from the temperature, kelvin"),
    ("Texture Size", 0.3, 0.001, 1000.0, "Size of the pattern's patches, metres in object coordinates"),
)


def radiance_coefficients() -> tuple[float, ...]:
    """Return the coefficients c_k of ln(L(T) / L(300 K)) = sum c_k (300/T - 1)^k."""
    t = np.linspace(*_FIT_K, 2000)
    powers = np.vander(UNIT_K / t - 1, _FIT_DEGREE + 1, increasing=True)
    fit, *_ = np.linalg.lstsq(powers, np.log(band_radiance(t) / UNIT_W_M2_SR), rcond=None)
    return tuple(float(c) for c in fit)


def physical_group() -> bpy.types.ShaderNodeTree:
    """Return the node group of the physical look, built on first use; it can also be used in the Shader Editor."""
    group = bpy.data.node_groups.get(GROUP_NAME)
    if group is not None:
        return group
    group = bpy.data.node_groups.new(GROUP_NAME, "ShaderNodeTree")
    add_inputs(group, SOCKETS)
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    nodes = Nodes(group)
    new = nodes.new
    link = nodes.link
    inputs = new("NodeGroupInput")
    outputs = new("NodeGroupOutput")

    deviation = nodes.math("MULTIPLY", _pattern(nodes, inputs.outputs["Texture Size"]), inputs.outputs["Texture"])
    celsius = nodes.math("ADD", inputs.outputs["Temperature"], deviation)
    radiance = _radiance_of(nodes, nodes.math("ADD", celsius, ZERO_C_K))

    # The emissivity of metals is constant, which is expressed by an IOR of 1.
    dielectric = nodes.math("SUBTRACT", 1.0, inputs.outputs["Metal"])
    ior = nodes.math("MULTIPLY_ADD", nodes.math("SUBTRACT", inputs.outputs["IOR"], 1.0), dielectric, 1.0)
    emissivity = _emissivity_at_angle(nodes, inputs.outputs["Emissivity"], ior)

    emission = nodes.emission(nodes.math("MULTIPLY", radiance, emissivity))
    diffuse = new("ShaderNodeBsdfDiffuse")
    glossy = new("ShaderNodeBsdfAnisotropic")
    # White, with the share as a mix factor: a grey surface would lose light in every bounce between its own facets.
    for node in (diffuse, glossy):
        node.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    glossy.distribution = "MULTI_GGX"  # plain GGX loses energy at grazing angles
    link(inputs.outputs["Roughness"], glossy.inputs["Roughness"])
    # `two_sided_ior` is below 1 on the backs of smooth surfaces.
    smooth = nodes.math("GREATER_THAN", nodes.math("ABSOLUTE", nodes.math("SUBTRACT", ior, 1.0)), 1e-4)
    kind = nodes.mixed(
        nodes.math("MAXIMUM", smooth, inputs.outputs["Metal"]), diffuse.outputs["BSDF"], glossy.outputs["BSDF"]
    )
    both = new("ShaderNodeAddShader")
    link(emission, both.inputs[0])
    link(nodes.mixed(nodes.math("SUBTRACT", 1.0, emissivity), None, kind), both.inputs[1])
    link(both.outputs["Shader"], outputs.inputs["Shader"])
    return group


def _emissivity_at_angle(nodes: Nodes, straight_on: Any, ior: Any) -> Any:
    """Return eps(theta) = eps0 (1 - F(theta)) / (1 - F(0)).

    Nearly constant up to about 50 degrees, 0 at grazing angles; with IOR 1 constant at all angles.
    """
    fresnel = nodes.new("ShaderNodeFresnel")
    nodes.link(ior, fresnel.inputs["IOR"])
    less, more = (nodes.math(op, ior, 1.0) for op in ("SUBTRACT", "ADD"))
    ratio = nodes.math("DIVIDE", less, more)
    through = nodes.math("MULTIPLY_ADD", ratio, nodes.math("MULTIPLY", ratio, -1.0), 1.0)
    share = nodes.math("DIVIDE", nodes.math("SUBTRACT", 1.0, fresnel.outputs["Fac"]), through)
    return nodes.math("MULTIPLY", straight_on, share, clamp=True)


def two_sided_ior(nodes: Nodes, ior: Any) -> Any:
    """Return the refractive index for which Fresnel nodes reflect at the backs of faces as at their fronts.

    Cycles inverts the index at backs, as if the camera were inside the body: total reflection from 42 degrees on.
    """
    geometry = nodes.new("ShaderNodeNewGeometry")
    return nodes.math("POWER", ior, nodes.math("MULTIPLY_ADD", geometry.outputs["Backfacing"], -2.0, 1.0))


def _pattern(nodes: Nodes, size_m: Any) -> Any:
    """Return smooth noise in [-1, 1] in object coordinates."""
    where = nodes.new("ShaderNodeTexCoord")
    noise = nodes.new("ShaderNodeTexNoise")
    noise.normalize = True
    noise.inputs["Detail"].default_value = 0.0
    nodes.link(where.outputs["Object"], noise.inputs["Vector"])
    nodes.link(nodes.math("DIVIDE", 1.0, size_m), noise.inputs["Scale"])
    return nodes.math("MULTIPLY_ADD", noise.outputs["Fac"], 2.0, -1.0)


def emission_alone(
    nodes: Nodes, celsius: Any, emissivity: Any, ior: Any, sky: Mapping[str, bpy.types.NodeSocket]
) -> Any:
    """Return the shader of a translucent surface, which emits its own radiance and the reflection of sky and ground.

    A scattering shader mixed with a Transparent node is sampled at random, which makes alpha and coverage noisy; an
    emission is exact. Reflections of other parts are missing. `sky` holds a socket for each of `SKY`.
    """
    geometry = nodes.new("ShaderNodeNewGeometry")
    incoming = geometry.outputs["Incoming"]
    normal = geometry.outputs["Normal"]
    # The mirrored direction is 2 (N I) N - I, with I from the surface to the eye.
    twice = nodes.math("MULTIPLY", nodes.dot(incoming, normal), 2.0)
    up = nodes.math("SUBTRACT", nodes.math("MULTIPLY", twice, nodes.upward(normal)), nodes.upward(incoming))
    eps = _emissivity_at_angle(nodes, emissivity, ior)
    own = _radiance_of(nodes, nodes.math("ADD", celsius, ZERO_C_K))
    mirrored = _sky(nodes, up, sky)
    return nodes.emission(nodes.math("MULTIPLY_ADD", eps, nodes.math("SUBTRACT", own, mirrored), mirrored))


def add_inputs(group: bpy.types.ShaderNodeTree, sockets: Sequence[tuple[str, float, float, float, str]]) -> None:
    """Add float inputs to a node group, each given by name, default, minimum, maximum and description."""
    for name, default, low, high, description in sockets:
        socket = group.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat")
        socket.default_value = default
        socket.min_value = low
        socket.max_value = high
        socket.description = description


# Values of the sky's nodes, which the caller gives: the transmittance of a clear sky at the zenith, the radiances of
# the air and of the base of clouds, the share of the sky that clouds cover, and the radiance of the ground.
SKY = ("clear_at_zenith", "air", "cloud", "cover", "ground")


def set_world(scene: bpy.types.Scene, sky: Mapping[str, float]) -> None:
    """Set the World to the sky above the horizon and the ground below it, from a value for each of `SKY`."""
    world = bpy.data.worlds.get("thermal_sky") or _build_world()
    scene.world = world
    for name, value in sky.items():
        world.node_tree.nodes[name].outputs[0].default_value = value


def _build_world() -> bpy.types.World:
    world = bpy.data.worlds.new("thermal_sky")
    world.use_nodes = True
    # Only reflections see the World. Sampling it as a light would cost a table per render without any effect.
    world.cycles.sampling_method = "NONE"
    world.node_tree.nodes.clear()
    nodes = Nodes(world.node_tree)
    values = {name: nodes.value(name) for name in SKY}
    up = nodes.upward(nodes.new("ShaderNodeTexCoord").outputs["Generated"])
    background = nodes.new("ShaderNodeBackground")
    output = nodes.new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)  # Blender's own is 0.8
    nodes.link(_sky(nodes, up, values), background.inputs["Strength"])
    nodes.link(background.outputs["Background"], output.inputs["Surface"])
    return world


def _sky(nodes: Nodes, up: Any, values: Mapping[str, bpy.types.NodeSocket]) -> Any:
    """Return the radiance from a direction with this upward component; `values` holds a socket for each of `SKY`."""
    clear, air, cloud, cover, ground = (values[name] for name in SKY)
    cos = nodes.math("MAXIMUM", up, float(np.cos(np.radians(89.0))))
    through = nodes.math("POWER", clear, nodes.math("DIVIDE", 1.0, cos))
    sky = nodes.math("MULTIPLY", air, nodes.math("SUBTRACT", 1.0, through))
    covered = nodes.math("MULTIPLY_ADD", cover, nodes.math("SUBTRACT", cloud, sky), sky)
    above = nodes.math("GREATER_THAN", up, 0.0)
    return nodes.math("MULTIPLY_ADD", above, nodes.math("SUBTRACT", covered, ground), ground)


def _radiance_of(nodes: Nodes, kelvin: Any) -> Any:
    """Return L(T) in units of L(300 K), from `radiance_coefficients` by Horner's rule."""
    x = nodes.math("SUBTRACT", nodes.math("DIVIDE", UNIT_K, kelvin), 1.0)
    *lower, highest = radiance_coefficients()
    sum_ = nodes.math("MULTIPLY_ADD", x, highest, lower.pop())
    while lower:
        sum_ = nodes.math("MULTIPLY_ADD", x, sum_, lower.pop())
    return nodes.math("EXPONENT", sum_)
