"""Basketball courts."""

from __future__ import annotations

import math
from dataclasses import replace

from infrablend.world.furniture import Furniture
from infrablend.world.ground_cover import Patch
from infrablend.world.people import GAME_POSES
from infrablend.world.places.roadside import (
    cycle_row,
    tree_row,
    walkers,
)
from infrablend.world.roads import Road
from infrablend.world.site import Site


def court(site: Site) -> str:
    """Fill a site with basketball courts, games, a fence, a path and trees."""
    draws, weather = site.draws, site.weather
    u = draws.uniform
    h = u(-math.pi / 2, math.pi / 2)
    c, s = math.cos(h), math.sin(h)
    cx, cy = u(-0.15, 0.15) * (site.x1 - site.x0), u(-0.15, 0.15) * (site.y1 - site.y0)

    def at(x: float, y: float) -> tuple[float, float]:
        return cx + x * c - y * s, cy + x * s + y * c

    length, width, gap = 28.0, 15.0, u(3, 6)
    across = 3 if site.reach > 40 else 2
    along = 2 if site.reach > 40 else 1
    total = (along * (length + gap) + 6, across * (width + gap) + 6)
    site.patches.append(Patch("rect", cx, cy, h, total[0] + 7, total[1] + 7, "concrete", 0.0, 0.1))
    site.patches.append(Patch("rect", cx, cy, h, *total, "court", 0.0, 0.08))
    line = draws.uniform(-1.3, -0.6) if weather.night else -2.6
    if draws.chance(0.4):
        line = -line
    sand, box = 0.08, site.patches.append
    for i in range(along):
        for j in range(across):
            ox, oy = (i - (along - 1) / 2) * (length + gap), (j - (across - 1) / 2) * (width + gap)
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
            # A game around one hoop, or nobody.
            if draws.chance(0.75):
                end = 1 if draws.chance(0.5) else -1
                wanted = len(site.people) + draws.integer(3, 11)
                for _ in range(60):
                    if len(site.people) >= wanted:
                        break
                    x, y = at(ox + end * u(-2, length / 2), oy + u(-0.45, 0.45) * width)
                    pose = draws.one_of(GAME_POSES)
                    site.add_person(x, y, u(0, 2 * math.pi), pose)
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
