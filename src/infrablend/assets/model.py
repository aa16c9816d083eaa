"""What an object model is: parameters drawn from a stream, a mesh built from them, a thermal role for each part."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from infrablend.assets.materials import MATERIALS
from infrablend.core.mesh import Mesh

Params = Mapping[str, Any]


@dataclass(frozen=True)
class PartRange:
    """Thermal role of a part: ranges from which each frame draws, and what its surface is. See also `made_of`.

    Attributes:
        delta_t_k: (low, high) surface minus air temperature.
        emissivity: (low, high) at normal incidence, in [0, 1].
        label: False for parts that neither boxes nor masks count.
        what: A few words on what the part is and where the numbers come from.
        ior: Refractive index near 10 um of a smooth surface; 1 for rough ones (fur, cloth), which have no rim.
        kind: Name in `materials.MATERIALS`; empty if it is none of these.
        roughness: Of the mirror image on smooth surfaces and metals.
        metal: Mirrors at all angles.
        opacity: In (0, 1]; below 1 what lies behind shows through, and labels count neither the part nor what it hides.

    Raises:
        ValueError: A range is upside down or something lies outside its limits.
    """

    delta_t_k: tuple[float, float]
    emissivity: tuple[float, float]
    label: bool = True
    what: str = ""
    ior: float = 1.5
    kind: str = ""
    roughness: float = 0.1
    metal: bool = False
    opacity: float = 1.0

    def __post_init__(self) -> None:
        (cold, warm), (low, high) = self.delta_t_k, self.emissivity
        if not cold <= warm:
            raise ValueError(f"delta_t_k {self.delta_t_k}: the low end must not be above the high end")
        if not 0 <= low <= high <= 1:
            raise ValueError(f"emissivity {self.emissivity}: expected 0 <= low <= high <= 1")
        if not 0 < self.opacity <= 1 or (self.opacity < 1 and self.label):
            raise ValueError(f"opacity {self.opacity}: expected a number above 0 and up to 1, below 1 with label False")


def made_of(
    kind: str,
    delta_t_k: tuple[float, float],
    what: str = "",
    *,
    emissivity: tuple[float, float] | None = None,
    ior: float | None = None,
    label: bool = True,
    opacity: float = 1.0,
) -> PartRange:
    """The role of a part of this material; emissivity and refractive index are the material's unless given.

    Raises:
        KeyError: There is no such material.
        ValueError: See `PartRange`.
    """
    m = MATERIALS[kind]
    return PartRange(
        delta_t_k, emissivity or m.emissivity, label, what, m.ior if ior is None else ior, kind, m.roughness, m.metal,
        opacity,
    )  # fmt: skip


@dataclass(frozen=True)
class ObjectModel:
    """An object that can be put into a scene.

    Attributes:
        name: In the catalogue.
        category: The class its labels carry unless a recipe says otherwise.
        description: One sentence.
        origin: Where the model's origin lies, in words.
        stands: True if it stands on the ground with its origin there.
        parts: Thermal role of every part that `build` may name.
        sample: Draws `params` (JSON values only) from a stream; `options` fixes some of them.
        build: The mesh of given `params`: pure, no randomness; equal params give equal arrays.
        options: What a recipe may fix: option name -> allowed values or range, in words.
        parts_for: Thermal roles of one individual of given `params`, where they differ between individuals: all names
            that its mesh has, with the labels they have in `parts`, which then holds a typical one's.
    """

    name: str
    category: str
    description: str
    origin: str
    stands: bool
    parts: Mapping[str, PartRange]
    sample: Callable[[np.random.Generator, Params], dict[str, Any]]
    build: Callable[[Params], Mesh]
    options: Mapping[str, str] = field(default_factory=dict)
    parts_for: Callable[[Params], Mapping[str, PartRange]] | None = None

    def roles(self, params: Params) -> Mapping[str, PartRange]:
        """Thermal role of every part of the individual of these parameters."""
        return self.parts if self.parts_for is None else self.parts_for(params)
