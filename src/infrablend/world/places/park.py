"""A park."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from infrablend.world.ground_cover import Patch
from infrablend.world.places.roadside import (
    add_road,
    lamps,
    tree_row,
    walkers,
    wood,
)
from infrablend.world.roads import Road
from infrablend.world.site import Site
from infrablend.world.trees import TreeKind


def park(site: Site) -> str:
    """Fill a site with a path through trees, perhaps a plaza and a building, and people."""
    draws = site.draws
    u = draws.uniform
    road = add_road(site, u(1.6, 3.0), 0.0, curved=True, through=0.1)
    road = replace(road, markings=False, lanes=2, surface="concrete" if draws.chance(0.5) else "paving")
    site.roads[-1] = road
    if draws.chance(0.6):
        x, y, h = road.at(u(-0.3, 0.3) * site.reach, 0.0)
        site.roads.append(Road(x, y, h + u(0.8, 2.2), 0.0, u(1.0, 2.0), 0.0, 1, road.surface, False))
    x, y = u(0.3, 0.9) * site.x1, u(-0.6, 0.6) * site.y1
    if draws.chance(0.5):
        site.add_building(x, y, road.heading_rad, u(9, 20), u(7, 11), u(3.2, 6))
    if draws.chance(0.6):  # a plaza
        x, y, h = road.at(u(-0.3, 0.3) * site.reach, u(-4, 4))
        d = u(7, 15)
        site.patches.append(Patch("ellipse", x, y, h, d, d, "paving", 0.0, 0.08))
        for _ in range(draws.integer(2, 8)):
            a, r = u(0, 2 * math.pi), u(0, 0.45) * d
            site.add_person(x + r * math.cos(a), y + r * math.sin(a), u(0, 2 * math.pi))
    for side in (-1, 1):
        if draws.chance(0.6):
            tree_row(site, road, side * (road.half_width_m + u(0.8, 1.6)), 1.1, ("shrub",), 0.8)
    walkers(site, road, draws.integer(5, 16))
    for _ in range(draws.integer(1, 4)):
        x, y, h = road.at(u(-1, 1) * site.reach, u(-0.5, 0.5) * road.half_width_m)
        site.add_cycle(x, y, h + (math.pi if draws.chance(0.5) else 0), ridden=True)
    lamps(site, road, 1 if draws.chance(0.5) else -1)
    kinds: tuple[Sequence[TreeKind], ...] = (
        ("crown", "crown", "bare"),
        ("bare", "bare", "crown", "shrub"),
        ("crown", "shrub"),
    )
    density = u(0.006, 0.028)
    chosen = draws.one_of(kinds)
    wood(site, int(density * (2 * site.reach) ** 2), 1.6, chosen, lambda x, y: True)
    return "grass"
