"""Where real objects stand: the level and the clutter of the ground around them, as an aim for inserted ones.

People walk along kerbs, between parked scooters and past trees; places drawn uniformly over a picture are more often on
an empty lawn. A detector that is trained on such places takes clutter as a sign that nothing is there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infrablend.config.recipe import RealGround
from infrablend.core.mesh import FloatArray
from infrablend.core.outline import ring_levels
from infrablend.sampling.site import Site

# Shares of the real objects below each of a recipe's quantiles.
_SHARES = (0.05, 0.25, 0.5, 0.75, 0.95)
# An aim spans this share of the real objects on either side of a drawn one.
_REACH = 0.15
# Shares of the attempts, from the first, that look for level and clutter of the aim, and for its clutter alone.
_BOTH = 0.5
_CLUTTER = 0.75


@dataclass(frozen=True)
class Ground:
    """Ground around a box, 8-bit levels.

    Attributes:
        level: Median of the ring around the box minus the picture's median; positive is warmer.
        clutter: Standard deviation of the ring.
    """

    level: float
    clutter: float


def ground_around(site: Site, box_xyxy: FloatArray, annotated: FloatArray) -> Ground | None:
    """Measure the ground around the (4,) box of an object; None if too little of it is free of (n, 4) other boxes."""
    ring = ring_levels(site.pixels, box_xyxy, annotated)
    if ring is None:
        return None
    level = (float(np.median(ring)) - site.median_level) / site.grey_unit
    return Ground(-level if site.black_hot else level, float(ring.std()) / site.grey_unit)


@dataclass(frozen=True)
class GroundAim:
    """Ground to look for.

    Attributes:
        level: Range of levels that are aimed at.
        clutter: Range of clutter that is aimed at.
        possible: Range of levels that any place must have.
    """

    level: tuple[float, float]
    clutter: tuple[float, float]
    possible: tuple[float, float]

    def accepts(self, ground: Ground, tried: float, beside: bool) -> bool:
        """Return whether an object may stand there.

        `tried` is the share of the attempts that have been made; `beside` whether the place is beside an object that
        has found its ground.
        """
        if not self.possible[0] <= ground.level <= self.possible[1]:
            return False
        if beside:
            return True
        if tried < _CLUTTER and not self.clutter[0] <= ground.clutter <= self.clutter[1]:
            return False
        return tried >= _BOTH or self.level[0] <= ground.level <= self.level[1]


def draw_aim(real: RealGround, rng: np.random.Generator) -> GroundAim:
    """Draw a real object, and return the ground of those like it."""
    level, clutter = (float(u) for u in rng.random(2))
    possible = real.level_grey[0], real.level_grey[-1]
    return GroundAim(_range_around(level, real.level_grey), _range_around(clutter, real.clutter_grey), possible)


def _range_around(share: float, quantiles: tuple[float, ...]) -> tuple[float, float]:
    low, high = np.interp([share - _REACH, share + _REACH], _SHARES, quantiles)
    # The least and the most cluttered twentieth are as likely as any other.
    return (-np.inf if share < _SHARES[0] else float(low), np.inf if share > _SHARES[-1] else float(high))
