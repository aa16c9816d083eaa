"""Rendering and importing with Blender: the only package that imports bpy; runs as a server, in a process of its own."""
