"""Sampling of scenes from a background, a recipe and a seed: camera, objects, temperatures, places, paths."""
