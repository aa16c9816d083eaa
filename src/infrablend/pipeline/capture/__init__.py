"""Datasets from a camera: frames of videos, temperatures of radiometric pictures, the virtual world."""
