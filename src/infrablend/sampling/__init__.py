"""Sampling of scenes from a background, a recipe and a seed: all of a frame's randomness is here."""
