"""The only place that imports Blender (bpy, mathutils). Workers load it by dotted name; nobody else may."""
