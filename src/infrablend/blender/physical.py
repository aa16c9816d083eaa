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

from infrablend.core.scene import Weather
from infrablend.thermal.radiometry import ZERO_C_K, band_radiance
from infrablend.thermal.sky import window_transmittance

GROUP_NAME = "InfraredEffect Physical"
REFERENCE_K = 300.0
UNIT_W_M2_SR = float(band_radiance(REFERENCE_K))
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
    powers = np.vander(REFERENCE_K / t - 1, _FIT_DEGREE + 1, increasing=True)
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
    new, link = group.nodes.new, group.links.new
    inputs, outputs = new("NodeGroupInput"), new("NodeGroupOutput")

    deviation = _math(group, "MULTIPLY", _pattern(group, inputs.outputs["Texture Size"]), inputs.outputs["Texture"])
    celsius = _math(group, "ADD", inputs.outputs["Temperature"], deviation)
    radiance = _radiance_of(group, _math(group, "ADD", celsius, ZERO_C_K))

    # The emissivity of metals is constant, which is expressed by an IOR of 1.
    dielectric = _math(group, "SUBTRACT", 1.0, inputs.outputs["Metal"])
    ior = _math(group, "MULTIPLY_ADD", _math(group, "SUBTRACT", inputs.outputs["IOR"], 1.0), dielectric, 1.0)
    emissivity = _emissivity_at_angle(group, inputs.outputs["Emissivity"], ior)

    emission = new("ShaderNodeEmission")
    emission.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    link(_math(group, "MULTIPLY", radiance, emissivity), emission.inputs["Strength"])
    diffuse, glossy, kind = new("ShaderNodeBsdfDiffuse"), new("ShaderNodeBsdfAnisotropic"), new("ShaderNodeMixShader")
    # White, with the share as a mix factor: a grey surface would lose light in every bounce between its own facets.
    for node in (diffuse, glossy):
        node.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    glossy.distribution = "MULTI_GGX"  # plain GGX loses energy at grazing angles
    link(inputs.outputs["Roughness"], glossy.inputs["Roughness"])
    # `two_sided_ior` is below 1 on the backs of smooth surfaces.
    smooth = _math(group, "GREATER_THAN", _math(group, "ABSOLUTE", _math(group, "SUBTRACT", ior, 1.0)), 1e-4)
    link(_math(group, "MAXIMUM", smooth, inputs.outputs["Metal"]), kind.inputs["Fac"])
    link(diffuse.outputs["BSDF"], kind.inputs[1])
    link(glossy.outputs["BSDF"], kind.inputs[2])
    mirror = new("ShaderNodeMixShader")
    link(_math(group, "SUBTRACT", 1.0, emissivity), mirror.inputs["Fac"])
    link(kind.outputs["Shader"], mirror.inputs[2])
    both = new("ShaderNodeAddShader")
    link(emission.outputs["Emission"], both.inputs[0])
    link(mirror.outputs["Shader"], both.inputs[1])
    link(both.outputs["Shader"], outputs.inputs["Shader"])
    return group


def _emissivity_at_angle(tree: bpy.types.NodeTree, straight_on: Any, ior: Any) -> Any:
    """Return eps(theta) = eps0 (1 - F(theta)) / (1 - F(0)).

    Nearly constant up to about 50 degrees, 0 at grazing angles; with IOR 1 constant at all angles.
    """
    fresnel = tree.nodes.new("ShaderNodeFresnel")
    tree.links.new(ior, fresnel.inputs["IOR"])
    less, more = (_math(tree, op, ior, 1.0) for op in ("SUBTRACT", "ADD"))
    ratio = _math(tree, "DIVIDE", less, more)
    through = _math(tree, "MULTIPLY_ADD", ratio, _math(tree, "MULTIPLY", ratio, -1.0), 1.0)
    share = _math(tree, "DIVIDE", _math(tree, "SUBTRACT", 1.0, fresnel.outputs["Fac"]), through)
    emissivity = _math(tree, "MULTIPLY", straight_on, share)
    emissivity.node.use_clamp = True
    return emissivity


def two_sided_ior(tree: bpy.types.NodeTree, ior: Any) -> Any:
    """Return the refractive index for which Fresnel nodes reflect at the backs of faces as at their fronts.

    Cycles inverts the index at backs, as if the camera were inside the body: total reflection from 42 degrees on.
    """
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    return _math(tree, "POWER", ior, _math(tree, "MULTIPLY_ADD", geometry.outputs["Backfacing"], -2.0, 1.0))


def _pattern(tree: bpy.types.NodeTree, size_m: Any) -> Any:
    """Return smooth noise in [-1, 1] in object coordinates."""
    where, noise = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeTexNoise")
    noise.normalize = True
    noise.inputs["Detail"].default_value = 0.0
    tree.links.new(where.outputs["Object"], noise.inputs["Vector"])
    tree.links.new(_math(tree, "DIVIDE", 1.0, size_m), noise.inputs["Scale"])
    return _math(tree, "MULTIPLY_ADD", noise.outputs["Fac"], 2.0, -1.0)


def emission_alone(tree: bpy.types.NodeTree, celsius: Any, emissivity: Any, ior: Any, sky: Mapping[str, Any]) -> Any:
    """Return the shader of a translucent surface, which emits its own radiance and the reflection of sky and ground.

    A scattering shader mixed with a Transparent node is sampled at random, which makes alpha and coverage noisy; an
    emission is exact. Reflections of other parts are missing.

    Args:
        tree: Node tree of the material.
        celsius: Socket of the temperature, degrees Celsius.
        emissivity: Socket of the emissivity at normal incidence.
        ior: Socket of the refractive index.
        sky: Socket for each name of `sky_values`.
    """
    geometry, dot = tree.nodes.new("ShaderNodeNewGeometry"), tree.nodes.new("ShaderNodeVectorMath")
    dot.operation = "DOT_PRODUCT"
    upward = []
    for i, name in enumerate(("Incoming", "Normal")):
        tree.links.new(geometry.outputs[name], dot.inputs[i])
        parts = tree.nodes.new("ShaderNodeSeparateXYZ")
        tree.links.new(geometry.outputs[name], parts.inputs["Vector"])
        upward.append(parts.outputs["Z"])
    # The mirrored direction is 2 (N I) N - I, with I from the surface to the eye.
    twice = _math(tree, "MULTIPLY", dot.outputs["Value"], 2.0)
    up = _math(tree, "SUBTRACT", _math(tree, "MULTIPLY", twice, upward[1]), upward[0])
    eps = _emissivity_at_angle(tree, emissivity, ior)
    own, mirrored = _radiance_of(tree, _math(tree, "ADD", celsius, ZERO_C_K)), _sky(tree, up, sky)
    shown = _math(tree, "MULTIPLY_ADD", eps, _math(tree, "SUBTRACT", own, mirrored), mirrored)
    emission = tree.nodes.new("ShaderNodeEmission")
    emission.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    tree.links.new(shown, emission.inputs["Strength"])
    return emission.outputs["Emission"]


def add_inputs(group: bpy.types.ShaderNodeTree, sockets: Sequence[tuple[str, float, float, float, str]]) -> None:
    """Add float inputs to a node group, each given by name, default, minimum, maximum and description."""
    for name, default, low, high, description in sockets:
        socket = group.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat")
        socket.default_value, socket.min_value, socket.max_value = default, low, high
        socket.description = description


SKY = ("clear_at_zenith", "air", "cloud", "cover", "ground")


def sky_values(weather: Weather) -> dict[str, float]:
    """Return the values of the sky's nodes for this weather, by the names in `SKY`; radiances in units of L(300 K)."""
    air, cloud, ground = (
        float(band_radiance(k)) / UNIT_W_M2_SR for k in (weather.air_k, weather.cloud_base_k, weather.ground_k)
    )
    through = window_transmittance(weather.air_k, weather.dew_point_k)
    return dict(zip(SKY, (through, air, cloud, weather.cloud, ground), strict=True))


def set_world(scene: bpy.types.Scene, weather: Weather) -> None:
    """Set the World to the sky above the horizon and the ground below it, in this weather."""
    world = bpy.data.worlds.get("thermal_sky") or _build_world()
    scene.world = world
    for name, value in sky_values(weather).items():
        world.node_tree.nodes[name].outputs[0].default_value = value


def _build_world() -> bpy.types.World:
    world = bpy.data.worlds.new("thermal_sky")
    world.use_nodes = True
    # Only reflections see the World. Sampling it as a light would cost a table per render without any effect.
    world.cycles.sampling_method = "NONE"
    tree = world.node_tree
    tree.nodes.clear()
    new, link = tree.nodes.new, tree.links.new

    def value(name: str) -> Any:
        node = new("ShaderNodeValue")
        node.name = name
        return node.outputs[0]

    values = {name: value(name) for name in SKY}
    direction, parts = new("ShaderNodeTexCoord"), new("ShaderNodeSeparateXYZ")
    link(direction.outputs["Generated"], parts.inputs["Vector"])
    background, output = new("ShaderNodeBackground"), new("ShaderNodeOutputWorld")
    background.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)  # Blender's own is 0.8
    link(_sky(tree, parts.outputs["Z"], values), background.inputs["Strength"])
    link(background.outputs["Background"], output.inputs["Surface"])
    return world


def _sky(tree: bpy.types.NodeTree, up: Any, values: Mapping[str, Any]) -> Any:
    """Return the radiance from a direction with this upward component; `values` holds a socket for each of `SKY`."""
    clear, air, cloud, cover, ground = (values[name] for name in SKY)
    cos = _math(tree, "MAXIMUM", up, float(np.cos(np.radians(89.0))))
    through = _math(tree, "POWER", clear, _math(tree, "DIVIDE", 1.0, cos))
    sky = _math(tree, "MULTIPLY", air, _math(tree, "SUBTRACT", 1.0, through))
    covered = _math(tree, "MULTIPLY_ADD", cover, _math(tree, "SUBTRACT", cloud, sky), sky)
    above = _math(tree, "GREATER_THAN", up, 0.0)
    return _math(tree, "MULTIPLY_ADD", above, _math(tree, "SUBTRACT", covered, ground), ground)


def _radiance_of(tree: bpy.types.NodeTree, kelvin: Any) -> Any:
    """Return L(T) in units of L(300 K), from `radiance_coefficients` by Horner's rule."""
    x = _math(tree, "SUBTRACT", _math(tree, "DIVIDE", REFERENCE_K, kelvin), 1.0)
    *lower, highest = radiance_coefficients()
    sum_ = _math(tree, "MULTIPLY_ADD", x, highest, lower.pop())
    while lower:
        sum_ = _math(tree, "MULTIPLY_ADD", x, sum_, lower.pop())
    return _math(tree, "EXPONENT", sum_)


def _math(tree: bpy.types.NodeTree, operation: str, *values: Any) -> Any:
    """Add a Math node and return its output; each value is a number or a socket."""
    node = tree.nodes.new("ShaderNodeMath")
    node.operation = operation
    for i, v in enumerate(values):
        if isinstance(v, int | float):
            node.inputs[i].default_value = v
        else:
            tree.links.new(v, node.inputs[i])
    return node.outputs["Value"]
