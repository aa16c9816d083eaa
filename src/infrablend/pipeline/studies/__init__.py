"""Readings that leave datasets and runs as they are: inspect, check, profile, maps of surfaces; and `doctor`."""
