"""Ground cover: materials with their temperatures and patterns, and flat patches of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from infrablend.world.draws import Draws
from infrablend.world.weather import Weather


@dataclass(frozen=True)
class GroundMaterial:
    """A kind of ground: temperature, and the pattern on it (amplitude in kelvin, size of its grain in metres)."""

    name: str
    kelvin: float
    stain_k: float
    grain_k: float
    grain_m: float


@dataclass(frozen=True)
class Patch:
    """Flat patch on the ground.

    Attributes:
        shape: `rect` and `ellipse` fill length x width; `ring` is a circle line of diameter `length_m`.
        material: Material of the patch; None adds `amount_k` to the temperature of the ground below.
        amount_k: Temperature to add, also to that of the material.
        soft_m: Width of the soft edge.
        line_m: Line width of a ring.
    """

    shape: Literal["rect", "ellipse", "ring"]
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    width_m: float
    material: str | None = None
    amount_k: float = 0.0
    soft_m: float = 0.05
    line_m: float = 0.0


def draw_materials(draws: Draws, weather: Weather) -> tuple[GroundMaterial, ...]:
    """Draw the temperature of every ground material of a scene."""
    if weather.night:
        c = weather.clear_sky
        table = {
            "asphalt": (3.6, 0.55, 0.28, 0.5),
            "concrete": (4.4, 0.5, 0.25, 0.4),
            "paving": (3.4, 0.5, 0.35, 0.35),
            "court": (1.6, 0.4, 0.22, 0.5),
            "grass": (-1.6 - 3.2 * c, 0.75, 0.4, 0.5),
            "soil": (-0.4, 0.7, 0.6, 0.7),
            "bed": (-3.2 - 2.5 * c, 0.6, 0.8, 0.4),
        }
    else:
        s = weather.solar
        table = {
            "asphalt": (10.0 * s, 1.1, 0.5, 0.6),
            "concrete": (8.5 * s, 1.0, 0.5, 0.5),
            "paving": (8.0 * s, 1.1, 0.7, 0.4),
            "court": (10.0 * s, 1.1, 0.4, 0.6),
            "grass": (3.5 * s, 1.3, 0.9, 0.4),
            "soil": (8.0 * s, 1.5, 1.0, 0.6),
            "bed": (2.5 * s, 1.2, 1.2, 0.4),
        }
    # Hard grounds differ more from place to place than grass does.
    spread = {"paving": 1.5, "concrete": 1.2, "court": 1.5} if weather.night else {"paving": 3.5, "court": 2.5}
    rest = 0.5 if weather.night else 1.5
    return tuple(
        GroundMaterial(n, weather.air_k + dt + draws.uniform(-1, 1) * spread.get(n, rest), stain, grain, size)
        for n, (dt, stain, grain, size) in table.items()
    )
