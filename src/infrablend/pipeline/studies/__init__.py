"""Readings of datasets and runs that change nothing: inspect, check, profile, realism."""
