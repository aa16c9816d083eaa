"""A dirt road through fields."""

from __future__ import annotations

import math
from dataclasses import replace

from infrablend.world.ground_cover import Patch
from infrablend.world.places.roadside import (
    add_road,
    tree_row,
    walkers,
    wood,
)
from infrablend.world.site import Site
from infrablend.world.vehicles import CARS, VehicleKind


def dirt_road(site: Site) -> str:
    """Fill a site with a dirt track through fields: bushes and trees beside it, a few vehicles and people on it."""
    draws = site.draws
    u = draws.uniform
    road = add_road(site, u(1.4, 2.2), 0.0, curved=True, through=0.2)
    road = replace(road, markings=False, surface="soil", lanes=1)
    site.roads[-1] = road
    if draws.chance(0.5):  # a ploughed field on one side
        side = 1 if draws.chance(0.5) else -1
        x, y, h = road.at(0.0, side * (road.half_width_m + 4 + site.reach))
        site.patches.insert(0, Patch("rect", x, y, h, 4 * site.reach, 2 * site.reach, "bed", 0.0, 0.5))
    for _ in range(draws.integer(1, 4)):
        x, y, h = road.at(u(-0.6, 0.6) * site.reach, u(-0.4, 0.4))
        kind: VehicleKind = "truck" if draws.chance(0.2) else draws.one_of(CARS)
        site.add_vehicle(kind, x, y, h + (math.pi if draws.chance(0.5) else 0), driven=draws.chance(0.7))
    walkers(site, road, draws.integer(2, 8))
    for side in (-1, 1):
        if draws.chance(0.6):
            tree_row(
                site, road, side * (road.half_width_m + u(1.0, 2.5)), u(2.5, 7), ("shrub", "shrub", "bare", "crown")
            )
    wood(site, int(u(0.002, 0.012) * (2 * site.reach) ** 2), 2.0, ("crown", "bare", "shrub"), lambda x, y: True)
    return "grass"
