"""Everything that needs Blender: the only package that imports bpy; worker processes load it by dotted name."""
