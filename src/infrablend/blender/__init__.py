"""Rendering and importing with Blender: the only package that imports bpy, and a server in a process of its own."""
