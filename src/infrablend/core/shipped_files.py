"""Names and texts of the YAML files that come with InfraBlend; light, because shell completion imports it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from importlib.resources.abc import Traversable


@dataclass(frozen=True)
class ShippedFiles:
    """The YAML files of one kind.

    Attributes:
        noun: What one of them is called, such as `recipe`.
        folder: Their folder below the package.
    """

    noun: str
    folder: str

    @cached_property
    def names(self) -> list[str]:
        """Names without the suffix, sorted."""
        return sorted(p.name.removesuffix(".yaml") for p in self._folder.iterdir() if p.name.endswith(".yaml"))

    def text(self, name: str) -> str:
        """Return the text of one of them."""
        return (self._folder / f"{name}.yaml").read_text("utf-8")

    @property
    def _folder(self) -> Traversable:
        return resources.files("infrablend") / self.folder


RECIPES = ShippedFiles("recipe", "config/recipes")
