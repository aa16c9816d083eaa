"""The virtual thermal world, without Blender: plans of outdoor scenes, their temperatures, labels and datasets."""
