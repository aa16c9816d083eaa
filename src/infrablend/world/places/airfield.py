"""An airfield."""

from __future__ import annotations

from dataclasses import replace

from infrablend.world.ground_cover import Patch
from infrablend.world.places.roadside import (
    add_road,
    walkers,
    wood,
)
from infrablend.world.site import Site
from infrablend.world.vehicles import CARS


def airfield(site: Site) -> str:
    """Fill a site with a marked runway in open grass, with a few cars and people on and beside it."""
    draws, weather = site.draws, site.weather
    u = draws.uniform
    road = add_road(site, u(9, 14), 0.0, curved=False, through=0.15)
    road = replace(road, markings=False, surface="concrete" if draws.chance(0.5) else "asphalt", lanes=2)
    site.roads[-1] = road
    line = u(-1.2, -0.5) if weather.night else u(-4, -2)
    s = -site.reach + u(0, 20)
    while s < site.reach:
        x, y, h = road.at(s, 0.0)
        site.patches.append(Patch("rect", x, y, h, 12.0, 0.5, None, line, 0.05))
        s += 30.0
    for side in (-1, 1):
        x, y, h = road.at(0.0, side * (road.half_width_m - 0.8))
        site.patches.append(Patch("rect", x, y, h, 4 * site.reach, 0.3, None, line, 0.05))
    for _ in range(draws.integer(2, 7)):
        x, y, h = road.at(u(-0.7, 0.7) * site.reach, u(-1.4, 1.4) * road.half_width_m)
        site.add_vehicle(draws.one_of(CARS), x, y, h + u(-0.4, 0.4), driven=draws.chance(0.5), warm=draws.chance(0.5))
    walkers(site, road, draws.integer(3, 12))
    wood(site, int(0.004 * (2 * site.reach) ** 2), 12.0, ("shrub", "bare", "crown"), lambda x, y: True)
    return "grass"
