"""Traces of use on the ground."""

from __future__ import annotations

import math

from infrablend.world.ground_cover import Patch
from infrablend.world.site import Site


def wear(site: Site) -> None:
    """Add traces of use to the ground: cracks, stains and repairs."""
    draws, weather = site.draws, site.weather
    for _ in range(draws.integer(2, 6)):  # cracks wander
        x, y, a = draws.uniform(site.x0, site.x1), draws.uniform(site.y0, site.y1), draws.uniform(0, 6.28)
        amount = draws.uniform(-1.2, -0.5) if weather.night else draws.uniform(1.2, 3.0)
        for _ in range(draws.integer(6, 22)):
            step = draws.uniform(0.4, 1.2)
            x, y = x + step * math.cos(a), y + step * math.sin(a)
            site.patches.append(Patch("rect", x, y, a, 1.15 * step, 0.05, None, amount, 0.05))
            a += draws.uniform(-0.5, 0.5)
    for _ in range(draws.integer(6, 15)):
        x, y = draws.uniform(site.x0, site.x1), draws.uniform(site.y0, site.y1)
        k = 1.0 if weather.night else 2.5
        if draws.chance(0.5):
            site.patches.insert(
                0,
                Patch("ellipse", x, y, draws.uniform(0, 3.1), draws.uniform(0.8, 5), draws.uniform(0.5, 3), None,
                      k * draws.uniform(-0.7, 0.6), draws.uniform(0.4, 1.5)),
            )  # fmt: skip
        else:
            heading = site.roads[0].heading_rad if site.roads else 0.0
            site.patches.insert(
                0,
                Patch("rect", x, y, heading, draws.uniform(1, 6), draws.uniform(0.8, 2.5), None,
                      k * draws.uniform(-0.5, 0.5), 0.15),
            )  # fmt: skip
