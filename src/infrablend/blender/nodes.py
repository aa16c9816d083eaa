"""Builds node trees of shaders: an input is a number, or the output socket of another node."""

from __future__ import annotations

from typing import Any

import bpy


class Nodes:
    """Adds nodes to a tree."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        """Add to a tree; `new` and `link` are Blender's own functions."""
        self.new = tree.nodes.new
        self.link = tree.links.new

    def add(self, kind: str, **settings: Any) -> Any:
        """Add a node with settings and return it."""
        node = self.new(kind)
        for name, setting in settings.items():
            setattr(node, name, setting)
        return node

    def value(self, name: str) -> Any:
        """Add a number to be set later by the name of its node; return its socket."""
        return self.add("ShaderNodeValue", name=name).outputs[0]

    def attribute(self, name: str, kind: str = "GEOMETRY") -> Any:
        """Return the socket of a mesh attribute, or of a custom property if `kind` is OBJECT."""
        return self.add("ShaderNodeAttribute", attribute_type=kind, attribute_name=name).outputs["Fac"]

    def math(self, operation: str, *values: Any, clamp: bool = False) -> Any:
        """Return the result of an operation."""
        node = self.add("ShaderNodeMath", operation=operation, use_clamp=clamp)
        for socket, given in zip(node.inputs, values, strict=False):
            if isinstance(given, int | float):
                socket.default_value = given
            else:
                self.link(given, socket)
        return node.outputs["Value"]

    def dot(self, a: Any, b: Any) -> Any:
        """Return the dot product of two vectors."""
        node = self.add("ShaderNodeVectorMath", operation="DOT_PRODUCT")
        self.link(a, node.inputs[0])
        self.link(b, node.inputs[1])
        return node.outputs["Value"]

    def upward(self, vector: Any) -> Any:
        """Return the upward component of a vector."""
        node = self.new("ShaderNodeSeparateXYZ")
        self.link(vector, node.inputs["Vector"])
        return node.outputs["Z"]

    def emission(self, strength: Any) -> Any:
        """Return a white emission of a strength."""
        node = self.new("ShaderNodeEmission")
        node.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
        self.link(strength, node.inputs["Strength"])
        return node.outputs["Emission"]

    def mixed(self, share: Any, none: Any, full: Any) -> Any:
        """Return a shader that is `none` where the share is 0, and `full` where it is 1."""
        node = self.new("ShaderNodeMixShader")
        for socket, given in zip(node.inputs, (share, none, full), strict=True):
            if given is not None:
                self.link(given, socket)
        return node.outputs["Shader"]

    def surface(self, shader: Any) -> None:
        """Make a shader the material's surface."""
        self.link(shader, self.new("ShaderNodeOutputMaterial").inputs["Surface"])


def new_material(name: str) -> tuple[bpy.types.Material, Nodes]:
    """Create a material without nodes; return it, and what adds nodes to it."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    material.node_tree.nodes.clear()
    return material, Nodes(material.node_tree)
