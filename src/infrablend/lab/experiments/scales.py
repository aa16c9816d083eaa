"""Scales and names of experiments; light, because shell completion imports it."""

from __future__ import annotations

from typing import Literal

from infrablend.core.shipped_files import ShippedFiles

EXPERIMENTS = ShippedFiles("experiment", "lab/experiments/shipped")

Scale = Literal["smoke", "small", "medium", "paper"]
"""Scale of an experiment."""

SCALES: tuple[Scale, ...] = ("smoke", "small", "medium", "paper")
NAME_PATTERN = r"^[a-z0-9][a-z0-9-]*$"
"""Names of experiments, and of what is in them."""
