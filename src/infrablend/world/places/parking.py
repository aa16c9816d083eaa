"""A car park."""

from __future__ import annotations

import math
from dataclasses import replace

from infrablend.world.ground_cover import Patch
from infrablend.world.places.roadside import (
    add_road,
    building_row,
    cold_mark,
    cycle_row,
    hedge_row,
    lamps,
    tree_row,
    walkers,
)
from infrablend.world.site import Site
from infrablend.world.vehicles import CARS


def parking(site: Site) -> str:
    """Fill a site with four rows of parking bays along an aisle, trees and buildings behind them."""
    draws, weather = site.draws, site.weather
    u = draws.uniform
    road = add_road(site, u(3.0, 4.2), u(0.0, 2.0), curved=False, through=0.05)
    road = replace(road, markings=False, surface="asphalt")
    site.roads[-1] = road
    h = road.heading_rad
    bay, depth = u(2.45, 2.7), u(5.0, 5.5)
    occupancy, lit = u(0.35, 0.85), draws.chance(0.6)
    rows: list[tuple[float, int]] = []
    aisle = 2 * road.half_width_m
    edge = road.half_width_m
    hedge = u(1.4, 2.6) if draws.chance(0.6) else 0.0
    # Bays face the aisle on both sides; behind them a hedge and the next aisle's bays.
    for side in (-1, 1):
        offset = edge
        rows.append((side * (offset + depth / 2), side))
        offset += depth + hedge
        if hedge:
            hedge_row(site, road, side * (offset - hedge / 2), hedge)
        rows.append((side * (offset + depth / 2), -side))
        offset += depth + aisle
        behind = side * (offset + u(1.5, 4))
        if draws.chance(0.5):
            tree_row(site, road, behind, u(4, 7), ("crown", "crown", "bare"))
        else:
            building_row(site, replace(road, half_width_m=offset, pavement_m=0.0), side, u(3, 9))
        x, y, _ = road.at(0.0, side * (edge + (offset - edge) / 2))
        site.patches.insert(0, Patch("rect", x, y, h, 4 * site.reach, offset - edge + 0.4, "asphalt", 0.0, 0.1))
    line = -0.5 if weather.night else -2.2
    for left, side in rows:
        s = -site.reach
        k = 0
        while s < site.reach:
            x, y, _ = road.at(s, left)
            if site.seen(x, y, depth / 2, 1.5):
                mx, my, _ = road.at(s - bay / 2, left)
                site.patches.append(Patch("rect", mx, my, h + math.pi / 2, depth, 0.12, None, line, 0.04))
                if draws.chance(occupancy):
                    kind = draws.one_of(CARS)
                    nose = h + side * math.pi / 2 + (math.pi if draws.chance(0.6) else 0) + u(-0.05, 0.05)
                    site.add_vehicle(kind, x + u(-0.15, 0.15), y + u(-0.15, 0.15), nose, warm=draws.chance(0.12))
                elif draws.chance(0.45):
                    cold_mark(site, x, y, h + math.pi / 2)
            s += bay
            k += 1
    for _ in range(draws.integer(0, 3)):
        x, y, hh = road.at(u(-0.6, 0.6) * site.reach, u(-0.3, 0.3) * edge)
        site.add_vehicle("sedan", x, y, hh + (math.pi if draws.chance(0.5) else 0), driven=True)
    walkers(site, replace(road, pavement_m=0.0), draws.integer(2, 12))
    if lit:
        lamps(site, road, 1)
    if draws.chance(0.4):
        cycle_row(site, replace(road, pavement_m=1.0), 1, u(-0.4, 0.2) * site.reach, draws.integer(4, 10))
    return "grass"
