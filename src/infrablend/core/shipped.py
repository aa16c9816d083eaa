"""Names of the recipes and experiments that come with InfraBlend; light, because shell completion imports it."""

from __future__ import annotations

from importlib import resources
from typing import Literal

Scale = Literal["smoke", "small", "medium", "paper"]
"""Scale of an experiment."""

SCALES: tuple[Scale, ...] = ("smoke", "small", "medium", "paper")
NAME_PATTERN = r"^[a-z0-9][a-z0-9-]*$"
"""Names of experiments, and of what is in them."""


def shipped_names(folder: Literal["recipes", "experiments"]) -> list[str]:
    """Return the names of the shipped YAML files of one folder, sorted."""
    shipped = resources.files("infrablend") / "config" / folder
    return sorted(p.name.removesuffix(".yaml") for p in shipped.iterdir() if p.name.endswith(".yaml"))
