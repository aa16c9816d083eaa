"""Frames of videos: which to take, what the logs say of them, and the report."""
