"""Datasets made from camera files: frames of videos, temperatures of radiometric pictures, the camera's movement."""
