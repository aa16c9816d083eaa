"""More kinds of places, for training: woods, a river, houses in gardens, and sports grounds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from infrablend.lab.world.fixtures import TreeKind
from infrablend.lab.world.ground_cover import Patch, Road
from infrablend.lab.world.roadside import add_road, cold_mark, hedge_row, kerb_parking, traffic, tree_row, walkers
from infrablend.lab.world.scene_site import Site
from infrablend.lab.world.townscape import At, basketball
from infrablend.lab.world.vehicles import CARS

# Attempts to plant a tree in a wood; more take minutes, and show from so high up that single trees do not count.
_MOST_TREES = 1500


def forest(site: Site) -> str:
    """Fill a site with a wood, perhaps dense, with a clearing and a track or a road through it."""
    draws = site.draws
    u = draws.uniform
    kinds: Sequence[TreeKind] = ("crown",) if draws.chance(0.6) else ("crown", "bare", "shrub", "crown")
    if draws.chance(0.6):
        road = add_road(site, u(1.3, 2.2), 0.0, curved=True, through=0.3)
        site.roads[-1] = replace(road, markings=False, surface="soil", lanes=1)
    elif draws.chance(0.5):
        road = add_road(site, u(2.6, 4.0), 0.0, curved=True, through=0.3)
    gap = u(0.5, 3.5)
    clearing = (u(site.x0, site.x1), u(site.y0, site.y1), u(0.0, 0.6) * min(site.x1 - site.x0, site.y1 - site.y0))
    size = u(0.8, 2.0)
    spread = u(0.02, 0.12)
    for _ in range(min(int(spread / size * (2 * site.reach) ** 2), _MOST_TREES)):
        x, y = u(-site.reach, site.reach), u(-site.reach, site.reach)
        if math.hypot(x - clearing[0], y - clearing[1]) > clearing[2] and site.clear_of_roads(x, y, gap):
            site.add_tree(draws.one_of(kinds), x, y, size * u(0.7, 1.3))
    _strollers(site, draws.integer(0, 5))
    return "grass" if draws.chance(0.7) else "soil"


def river(site: Site) -> str:
    """Fill a site with a river between banks, perhaps with a bridge or a road along it, or a pond in a meadow."""
    draws = site.draws
    u = draws.uniform
    heading = u(-math.pi / 2, math.pi / 2)
    width = u(0.1, 0.9) * (site.x1 - site.x0)
    x, y = u(-0.4, 0.4) * (site.x1 - site.x0), u(-0.4, 0.4) * (site.y1 - site.y0)
    if draws.chance(0.3):
        site.patches.append(Patch("ellipse", x, y, heading, width, u(0.5, 1.0) * width, "water", 0.0, u(0.1, 1.0)))
        middle = Road(x, y, heading, 0.0, width / 2, 0.0, 1, "soil", False)
    else:
        curve = u(-1, 1) / (1.5 * site.reach)
        middle = Road(x, y, heading, curve, width / 2, 0.0, 1, "soil", False)
        s = -2 * site.reach
        while s < 2 * site.reach:  # in pieces that follow its bends
            px, py, h = middle.at(s, 0.0)
            site.patches.append(Patch("rect", px, py, h, 9.0, width + u(-1.5, 1.5), "water", 0.0, u(0.1, 0.8)))
            s += 4.0
    if draws.chance(0.35):
        road = add_road(site, u(2.6, 5.0), u(0, 2), curved=False, through=0.2)
        traffic(site, road, (u(14, 22), u(30, 60)))
    elif draws.chance(0.5):
        px, py, h = middle.at(0.0, width / 2 + u(3, 9))
        site.roads.append(Road(px, py, h, middle.curvature_per_m, u(0.9, 2.0), 0.0, 1, "soil", False))
    for side in (-1, 1):
        if draws.chance(0.6):
            kinds: Sequence[TreeKind] = ("shrub", "crown") if draws.chance(0.5) else ("crown", "bare", "shrub")
            tree_row(site, middle, side * (width / 2 + u(0.5, 4)), u(2.0, 8), kinds, u(0.8, 1.5))
    density = u(0.0, 0.03)
    kept = width / 2 + 1.0
    for _ in range(int(density * (2 * site.reach) ** 2)):
        px, py = u(-site.reach, site.reach), u(-site.reach, site.reach)
        if middle.offset_m(px, py) > kept and site.clear_of_roads(px, py, 2.0):
            site.add_tree(draws.one_of(("crown", "bare", "shrub")), px, py, u(0.7, 1.5))
    return "grass"


def suburb(site: Site) -> str:
    """Fill a site with houses in gardens along a street: hedges, drives, terraces, trees."""
    draws = site.draws
    u = draws.uniform
    road = add_road(site, u(2.6, 4.2), u(0.0, 2.2), curved=True, through=0.3)
    edge = road.half_width_m + road.pavement_m
    for side in (-1, 1):
        s = -site.reach + u(0, 15)
        hedge = draws.chance(0.5)
        while s < site.reach:
            length = u(8, 14)
            depth = u(7, 11)
            setback = u(3, 8)
            x, y, h = road.at(s + length / 2, side * (edge + setback + depth / 2))
            if draws.chance(0.85):
                site.add_building(x, y, h, length, depth, u(3, 7))
            if draws.chance(0.7):  # a drive beside the house, with a car in it or its mark
                x, y, h = road.at(s + length + 2.2, side * (edge + 4.0))
                paved = "paving" if draws.chance(0.6) else "asphalt"
                site.patches.append(Patch("rect", x, y, h + math.pi / 2, 8.4, u(2.6, 3.6), paved, u(-1, 1), 0.06))
                if draws.chance(0.6):
                    site.add_vehicle(draws.one_of(CARS), x, y, h + math.pi / 2 + u(-0.06, 0.06))
                elif draws.chance(0.3):
                    cold_mark(site, x, y, h + math.pi / 2)
            if draws.chance(0.6):  # a terrace behind it
                x, y, h = road.at(s + length / 2, side * (edge + setback + depth + 2.5))
                site.patches.append(Patch("rect", x, y, h, u(4, 8), u(2.5, 5), "paving", u(-1, 1), 0.06))
            s += length + u(5, 12)
        if hedge:
            tree_row(site, road, side * (edge + 0.9), 1.0, ("shrub",), u(0.7, 1.1))
        behind = replace(road, half_width_m=edge + 26, pavement_m=0.0)
        if draws.chance(0.5):
            hedge_row(site, behind, side * u(24, 34) if road.curvature_per_m == 0 else side * 30.0, u(1.0, 2.0))
        if draws.chance(0.5):
            kerb_parking(site, road, side, u(0.1, 0.6))
    for _ in range(int(u(0.002, 0.02) * (2 * site.reach) ** 2)):
        x, y = u(-site.reach, site.reach), u(-site.reach, site.reach)
        if site.clear_of_roads(x, y, road.pavement_m + 1.0) and site.room(x, y, 1.5):
            site.add_tree(draws.one_of(("crown", "crown", "bare", "shrub")), x, y, u(0.6, 1.3))
    traffic(site, road, (u(20, 40), u(60, 120)))
    walkers(site, road, draws.integer(1, 8))
    return "grass"


def courts(site: Site) -> str:
    """Fill a site with basketball courts in rows, back to back: hardly any edge, hoops, players, strips between."""
    draws = site.draws
    weather = site.weather
    u = draws.uniform
    h = u(-math.pi / 2, math.pi / 2)
    length = 28.0
    width = 15.0
    gap = u(0.5, 6)
    strip = u(1.5, 7)
    ox, oy = u(-0.5, 0.5) * length, u(-0.5, 0.5) * width
    c, s = math.cos(h), math.sin(h)

    def at(x: float, y: float) -> tuple[float, float]:
        return ox + x * c - y * s, oy + x * s + y * c

    along = draws.integer(2, 5)
    across = draws.integer(3, 7)
    total = along * (length + strip) + 2 * strip, across * (width + gap) + 2 * gap
    site.patches.append(Patch("rect", *at(0, 0), h, *total, "court", 0.0, u(0.05, 0.4)))
    line = u(-1.5, 1.5) * (1.0 if weather.night else 2.0)
    for i in range(along):
        x = (i - (along - 1) / 2) * (length + strip)
        if i and draws.chance(0.6):  # a gutter or a fence between two rows
            x_between = x - (length + strip) / 2
            site.patches.append(Patch("rect", *at(x_between, 0), h, u(0.3, 1.5), total[1], None, 1.5 * line, 0.1))
        for j in range(across):
            basketball(site, at, (x, (j - (across - 1) / 2) * (width + gap)), h, (length, width), line)
    for side in (-1, 1):
        beside = Road(*at(0, side * (total[1] / 2 + u(2, 8))), h, 0.0, u(1.0, 3.5), 0.0, 1, "concrete", False)
        if draws.chance(0.6):
            site.roads.append(beside)
        tree_row(site, beside, side * u(4.0, 8.0), u(3, 7), ("crown", "bare", "crown", "shrub"))
        if draws.chance(0.4):
            hedge_row(site, beside, -side * 1.5 - side * beside.half_width_m, u(0.8, 1.6))
    return "grass" if draws.chance(0.6) else "paving"


def athletics(site: Site) -> str:
    """Fill a site with a running track around a lawn, with runways, pits, people who walk on it, and stands."""
    draws = site.draws
    u = draws.uniform
    h = u(-math.pi / 2, math.pi / 2)
    straight = u(50, 90)
    radius = u(16, 37)
    track = u(5, 10)
    c, s = math.cos(h), math.sin(h)
    # A straight, a bend or the lawn is in the middle of the picture.
    cx, cy = u(-0.6, 0.6) * straight, draws.one_of((-1, 1)) * u(0.2, 1.3) * radius

    def at(x: float, y: float) -> tuple[float, float]:
        return cx + x * c - y * s, cy + x * s + y * c

    def oval(reach: float, material: str | None, amount: float) -> None:
        site.patches.append(Patch("rect", *at(0, 0), h, straight, 2 * reach, material, amount, 0.1))
        for end in (-1, 1):
            site.patches.append(
                Patch("ellipse", *at(end * straight / 2, 0), h, 2 * reach, 2 * reach, material, amount, 0.1)
            )

    around = "court" if draws.chance(0.5) else "paving"
    base = draws.one_of(("grass", "paving", "grass"))
    if draws.chance(0.5):  # the ground around it is paved as well
        site.patches.append(
            Patch("rect", *at(0, 0), h, straight + 3 * radius, 2 * (radius + track) + u(6, 20), around, 0.0, 0.1)
        )
    kerb = u(0.3, 1.6) * (1 if draws.chance(0.7) else -1)
    oval(radius + track + 0.4, "court", kerb)
    oval(radius + track, "court", 0.0)
    oval(radius + 0.4, "court", kerb)
    oval(radius, "grass", 0.0)
    for end in (-1, 1):  # the segment behind a goal is often paved, and straights go on beyond the bends
        if draws.chance(0.5):
            d = 2 * radius - 1.0
            site.patches.append(Patch("ellipse", *at(end * straight / 2, 0), h, d, d, "court", u(-0.3, 0.3), 0.1))
            site.patches.append(Patch("rect", *at(0, 0), h, straight, 2 * radius, "grass", 0.0, 0.1))
        if draws.chance(0.5):
            x, y = end * (straight / 2 + u(5, 15)), draws.one_of((-1, 1)) * (radius + track / 2)
            site.patches.append(Patch("rect", *at(x, y), h, 30.0, track, "court", 0.0, 0.1))
    lanes = u(-0.5, 0.5)
    for k in range(1, draws.integer(4, 9)):
        offset = radius + k * 1.22
        for side in (-1, 1):
            if offset < radius + track:
                site.patches.append(Patch("rect", *at(0, side * offset), h, straight, 0.06, None, lanes, 0.03))
    _jumpers_and_walkers(site, at, h, straight, (radius, track))
    _add_surroundings(site, at, h, radius + track)
    return base


def _add_surroundings(site: Site, at: At, h: float, reach_m: float) -> None:
    """Add a path with trees beside a running track, which reaches that far from its middle, and perhaps stands."""
    draws = site.draws
    u = draws.uniform
    x, y = at(0, draws.one_of((-1, 1)) * (reach_m + u(8, 16)))
    edge = Road(x, y, h, 0.0, u(1.5, 4.0), u(0, 1.5), 2, "concrete", False)
    site.roads.append(edge)
    tree_row(site, edge, u(4, 8) * draws.one_of((-1, 1)), u(4, 8), ("crown", "bare", "shrub"))
    if draws.chance(0.4):
        site.add_building(*at(u(-15, 15), reach_m + u(14, 22)), h, u(30, 60), u(8, 14), u(3, 8))


def _jumpers_and_walkers(site: Site, at: At, h: float, straight: float, across_m: tuple[float, float]) -> None:
    """Add runways with pits beside a track, and people on it and on its lawn; `across_m` is its radius and width."""
    draws, (radius, track) = site.draws, across_m
    u = draws.uniform
    for _ in range(draws.integer(0, 4)):
        x, y = u(-0.5, 0.5) * straight, draws.one_of((-1, 1)) * (radius + track + u(3, 8))
        site.patches.append(Patch("rect", *at(x, y), h, u(25, 40), 1.3, "court", u(-0.5, 0.5), 0.05))
        site.patches.append(Patch("rect", *at(x + 20, y), h, u(6, 9), u(2.7, 4), "soil", 0.0, 0.05))
    for _ in range(draws.integer(4, 30)):
        x, y = u(-0.5, 0.5) * straight, draws.one_of((-1, 1)) * (radius + u(0, track))
        site.add_person(*at(x, y), h + draws.one_of((0.0, math.pi)) + u(-0.3, 0.3))
    for _ in range(draws.integer(0, 15)):
        site.add_person(*at(u(-0.5, 0.5) * straight, u(-0.9, 0.9) * radius), u(0, 2 * math.pi))


def _strollers(site: Site, count: int) -> None:
    draws = site.draws
    for _ in range(count):
        x, y = draws.uniform(site.x0, site.x1), draws.uniform(site.y0, site.y1)
        site.add_person(x, y, draws.uniform(0, 2 * math.pi))
