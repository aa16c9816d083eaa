"""Rendering and importing with Blender: the only package that imports bpy; workers load its modules by name."""
