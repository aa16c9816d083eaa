"""The virtual thermal world in Blender: builds the scene of a plan and renders its temperatures and object ids."""
