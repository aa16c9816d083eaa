"""A street in a town."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from infrablend.world.places.roadside import (
    add_road,
    building_row,
    cycle_row,
    furniture,
    kerb_parking,
    lamps,
    planting_bed,
    traffic,
    tree_row,
    walkers,
    wood,
)
from infrablend.world.roads import Road
from infrablend.world.site import Site
from infrablend.world.trees import TreeKind


def street(site: Site) -> str:
    """Fill a site with a street: traffic, parked cars, people, and buildings or trees behind the pavements."""
    draws = site.draws
    u = draws.uniform
    road = add_road(site, u(3.6, 7.2), u(1.8, 3.6), curved=True, through=0.12)
    if draws.chance(0.3):  # a crossing
        x, y, h = road.at(u(-0.4, 0.4) * site.reach, 0.0)
        site.roads.append(
            Road(x, y, h + math.pi / 2 + u(-0.12, 0.12), 0.0, u(2.8, 4.5), road.pavement_m, 2, road.surface, False)
        )
    sides = (-1, 1)
    behind = {s: "building" if draws.chance(0.45) else "wood" for s in sides}
    for side in sides:
        if behind[side] == "building":
            building_row(site, road, side, u(2, 5) + 0.08 * site.reach * u(0, 1))
    parked = {s: draws.chance(0.6) for s in sides}
    for side in sides:
        if parked[side]:
            kerb_parking(site, road, side, u(0.45, 0.9))
    traffic(site, road, (u(14, 22), u(30, 60)))
    for side in sides:
        lamps(site, road, side) if draws.chance(0.5) else None
        if draws.chance(0.35):
            edge = road.half_width_m + road.pavement_m
            planting_bed(site, road, side * (edge + 1.0), 1.6, "bed")
            tree_row(site, road, side * (edge + 1.0), 1.1, ("shrub",))
        if draws.chance(0.55):
            cycle_row(site, road, side, u(-0.45, 0.2) * site.reach, draws.integer(5, 20))
        if draws.chance(0.75):
            row: Sequence[TreeKind] = ("crown",) if draws.chance(0.55) else ("bare", "bare", "crown")
            tree_row(site, road, side * (road.half_width_m + min(1.0, 0.35 * road.pavement_m)), u(5.5, 9), row, 0.8)
    furniture(site, road)
    walkers(site, road, draws.integer(4, 20))
    woods = [s for s in sides if behind[s] == "wood"]
    if woods and draws.chance(0.8):
        kinds: Sequence[TreeKind] = (
            ("crown", "crown", "bare") if draws.chance(0.6) else ("bare", "bare", "crown", "shrub")
        )

        def inside(x: float, y: float) -> bool:
            left = float(road.along(np.asarray(x), np.asarray(y))[1])
            return (1 if left > 0 else -1) in woods

        wood(site, int(0.016 * (2 * site.reach) ** 2), road.pavement_m + 2.5, kinds, inside)
    return "grass" if draws.chance(0.75) else "paving"
