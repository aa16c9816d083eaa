"""The kinds of places: street, car park, court, park, airfield and dirt road. Each function fills a site."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from infrablend.lab.world.fixtures import Furniture, TreeKind
from infrablend.lab.world.ground_cover import Patch, Road
from infrablend.lab.world.people import GAME_POSES
from infrablend.lab.world.roadside import (
    add_road,
    building_row,
    cold_mark,
    cycle_row,
    furniture,
    hedge_row,
    kerb_parking,
    lamps,
    planting_bed,
    traffic,
    tree_row,
    walkers,
    wood,
)
from infrablend.lab.world.scene_site import Site
from infrablend.lab.world.vehicles import CARS, VehicleKind

At = Callable[[float, float], tuple[float, float]]


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
        if draws.chance(0.5):
            lamps(site, road, side)
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


def parking(site: Site) -> str:
    """Fill a site with four rows of parking bays along an aisle, trees and buildings behind them."""
    draws = site.draws
    u = draws.uniform
    road = add_road(site, u(3.0, 4.2), u(0.0, 2.0), curved=False, through=0.05)
    road = replace(road, markings=False, surface="asphalt")
    site.roads[-1] = road
    h = road.heading_rad
    bay = u(2.45, 2.7)
    depth = u(5.0, 5.5)
    occupancy = u(0.35, 0.85)
    lit = draws.chance(0.6)
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
    for left, side in rows:
        _bays(site, road, left, side, (bay, depth), occupancy)
    for _ in range(draws.integer(0, 3)):
        x, y, hh = road.at(u(-0.6, 0.6) * site.reach, u(-0.3, 0.3) * edge)
        site.add_vehicle("sedan", x, y, hh + (math.pi if draws.chance(0.5) else 0), driven=True)
    walkers(site, replace(road, pavement_m=0.0), draws.integer(2, 12))
    if lit:
        lamps(site, road, 1)
    if draws.chance(0.4):
        cycle_row(site, replace(road, pavement_m=1.0), 1, u(-0.4, 0.2) * site.reach, draws.integer(4, 10))
    return "grass"


def _bays(site: Site, road: Road, left: float, side: int, bay_m: tuple[float, float], occupancy: float) -> None:
    """Add a row of bays of a width and depth, `left` metres off the centre line: lines, cars, and marks of cars."""
    draws, (bay, depth), h = site.draws, bay_m, road.heading_rad
    u = draws.uniform
    line = -0.5 if site.weather.night else -2.2
    s = -site.reach
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


def court(site: Site) -> str:
    """Fill a site with basketball courts, games, a fence, a path and trees."""
    draws = site.draws
    weather = site.weather
    u = draws.uniform
    h = u(-math.pi / 2, math.pi / 2)
    c, s = math.cos(h), math.sin(h)
    cx, cy = u(-0.15, 0.15) * (site.x1 - site.x0), u(-0.15, 0.15) * (site.y1 - site.y0)

    def at(x: float, y: float) -> tuple[float, float]:
        return cx + x * c - y * s, cy + x * s + y * c

    length = 28.0
    width = 15.0
    gap = u(3, 6)
    across = 3 if site.reach > 40 else 2
    along = 2 if site.reach > 40 else 1
    total = (along * (length + gap) + 6, across * (width + gap) + 6)
    site.patches.append(Patch("rect", cx, cy, h, total[0] + 7, total[1] + 7, "concrete", 0.0, 0.1))
    site.patches.append(Patch("rect", cx, cy, h, *total, "court", 0.0, 0.08))
    line = draws.uniform(-1.3, -0.6) if weather.night else -2.6
    if draws.chance(0.4):
        line = -line
    for i in range(along):
        for j in range(across):
            ox, oy = (i - (along - 1) / 2) * (length + gap), (j - (across - 1) / 2) * (width + gap)
            basketball(site, at, (ox, oy), h, (length, width), line)
    for side in (-1, 1):
        fx, fy = at(0.0, side * (total[1] / 2 + 1.0))
        site.furniture.append(
            Furniture("fence", fx, fy, h, 2.6, total[0], weather.air_k + (-2.5 if weather.night else 3), weather.air_k)
        )
    # Beside it a running track or a field, a path with people, parked two-wheelers.
    path_y = total[1] / 2 + 6.5
    px, py = at(0.0, path_y)
    road = Road(px, py, h, 0.0, u(1.8, 3.0), 0.9, 2, "concrete", False)
    site.roads.append(road)
    walkers(site, replace(road, pavement_m=0.0), draws.integer(2, 10))
    cycle_row(site, road, 1, u(-0.3, 0.1) * site.reach, draws.integer(4, 14))
    tree_row(site, road, road.half_width_m + 3.0, u(4.5, 8), ("crown", "bare", "crown"))
    tree_row(site, road, -(total[1] + 13.0) - road.half_width_m, u(5, 9), ("crown", "bare"))
    if draws.chance(0.5):
        bx, by = at(u(-10, 10), path_y + road.half_width_m + 16)
        site.add_building(bx, by, h, u(18, 34), u(10, 15), u(4, 9))
    return "grass"


def basketball(
    site: Site, at: At, middle: tuple[float, float], h: float, size_m: tuple[float, float], line: float
) -> None:
    """Add one court with its middle at a point: its lines and hoops, and a game around one hoop, or nobody.

    `at` gives the place on the site of a point along and across all courts; lines are `line` kelvin warmer than the
    ground.
    """
    draws = site.draws
    weather = site.weather
    u = draws.uniform
    (ox, oy), (length, width), sand, box = middle, size_m, 0.08, site.patches.append
    for e in (-1, 1):
        box(Patch("rect", *at(ox, oy + e * width / 2), h, length, sand, None, line, 0.03))
        box(Patch("rect", *at(ox + e * length / 2, oy), h, sand, width, None, line, 0.03))
        for f in (-1, 1):
            box(Patch("rect", *at(ox + e * (length / 2 - 2.9), oy + f * 2.45), h, 5.8, sand, None, line, 0.03))
        box(Patch("rect", *at(ox + e * (length / 2 - 5.8), oy), h, sand, 4.9, None, line, 0.03))
        box(Patch("ring", *at(ox + e * (length / 2 - 5.8), oy), h, 3.6, 3.6, None, line, 0.03, sand))
        x, y = at(ox + e * (length / 2 + 0.6), oy)
        if site.seen(x, y, 2, 4):
            site.furniture.append(
                Furniture("hoop", x, y, h + (math.pi if e > 0 else 0), 3.6, 1.9,
                     weather.air_k + (draws.uniform(-4, -2) if weather.night else u(2, 5)),
                     weather.air_k + (draws.uniform(-5, -3) if weather.night else u(2, 9)))
            )  # fmt: skip
            site.taken.append((x, y, 0.0, 0.5, 0.5))
    box(Patch("rect", *at(ox, oy), h, sand, width, None, line, 0.03))
    box(Patch("ring", *at(ox, oy), h, 3.6, 3.6, None, line, 0.03, sand))
    if draws.chance(0.75):
        end = 1 if draws.chance(0.5) else -1
        wanted = len(site.people) + draws.integer(3, 11)
        for _ in range(60):
            if len(site.people) >= wanted:
                break
            x, y = at(ox + end * u(-2, length / 2), oy + u(-0.45, 0.45) * width)
            pose = draws.one_of(GAME_POSES)
            site.add_person(x, y, u(0, 2 * math.pi), pose)


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


def airfield(site: Site) -> str:
    """Fill a site with a marked runway in open grass, with a few cars and people on and beside it."""
    draws = site.draws
    weather = site.weather
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
