"""What goes along a road: traffic, parked cars, people, trees, lamps and buildings."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal

from infrablend.lab.world.fixtures import Furniture, TreeKind
from infrablend.lab.world.ground_cover import Patch, Road
from infrablend.lab.world.scene_site import Site
from infrablend.lab.world.vehicles import CARS, VehicleKind


def add_road(site: Site, half_width: float, pavement: float, curved: bool, through: float) -> Road:
    """Add a road through the middle of the site, at most `through` of its size off the centre."""
    draws = site.draws
    u = draws.uniform
    curvature = 0.0
    if curved and draws.chance(0.55):
        curvature = (1 if draws.chance(0.5) else -1) / u(1.6 * site.reach, 4 * site.reach)
    angle = u(-math.pi / 2, math.pi / 2)
    road = Road(
        u(-1, 1) * through * (site.x1 - site.x0), u(-1, 1) * through * (site.y1 - site.y0), angle,
        curvature, half_width, pavement, lanes=2 if half_width < 5.5 else 4,
        surface="asphalt" if draws.chance(0.75) else "concrete", markings=half_width > 3.2 and draws.chance(0.8),
    )  # fmt: skip
    site.roads.append(road)
    return road


def traffic(site: Site, road: Road, gap_m: tuple[float, float]) -> None:
    """Add moving cars and riders that keep right, `gap_m` (least, most) apart."""
    draws = site.draws
    lane = road.half_width_m * 2 / road.lanes
    for k in range(road.lanes):
        left = -road.half_width_m + lane * (k + 0.5)
        onward = left < 0
        s = -site.reach + draws.uniform(0, gap_m[1])
        while s < site.reach:
            x, y, h = road.at(s, left + draws.uniform(-0.25, 0.25))
            heading = h + (0.0 if onward else math.pi) + draws.uniform(-0.03, 0.03)
            roll = draws.share()
            if roll < 0.2:
                x, y, h = road.at(s, left + (-1 if onward else 1) * lane * 0.3)
                site.add_cycle(x, y, heading, ridden=True)
            else:
                kind: VehicleKind = (
                    "bus" if roll < 0.24 else "truck" if roll < 0.28 else "van" if roll < 0.38
                    else "suv" if roll < 0.65 else "sedan"
                )  # fmt: skip
                site.add_vehicle(kind, x, y, heading, driven=True)
            s += draws.uniform(*gap_m)


def kerb_parking(site: Site, road: Road, side: int, occupancy: float) -> None:
    """Add cars parked along the kerb, and cold marks where some have left."""
    draws = site.draws
    s = -site.reach + draws.uniform(0, 6)
    while s < site.reach:
        x, y, h = road.at(s, side * (road.half_width_m - 1.15))
        heading = h + (0.0 if side < 0 else math.pi) + draws.uniform(-0.03, 0.03)
        if draws.chance(occupancy) and site.clear_of_roads(x, y, 3.0, besides=road):
            kind = draws.one_of(CARS)
            site.add_vehicle(kind, x, y, heading, warm=draws.chance(0.15))
        elif draws.chance(0.3):
            cold_mark(site, x, y, heading)
        s += draws.uniform(5.6, 7.2)


def cold_mark(site: Site, x: float, y: float, heading: float) -> None:
    """Add the mark of a car that left recently: its shade kept the ground cold by day, and still shows at night."""
    draws = site.draws
    weather = site.weather
    amount = draws.uniform(-3.2, -1.2) if weather.night else draws.uniform(-5, -2)
    length = draws.uniform(3.9, 4.6)
    width = draws.uniform(1.6, 1.9)
    soft = draws.uniform(0.3, 0.9)
    site.patches.append(Patch("rect", x, y, heading, length, width, None, amount, soft))


def walkers(site: Site, road: Road, count: int) -> None:
    """Add up to `count` people in sight: on the pavements, some in groups, a few on the road."""
    draws = site.draws
    wanted = len(site.people) + count
    for _ in range(count * 6):
        if len(site.people) >= wanted:
            break
        side = 1 if draws.chance(0.5) else -1
        s = draws.uniform(-site.reach, site.reach)
        offset = side * (road.half_width_m + road.pavement_m * draws.uniform(0.25, 0.8))
        if road.pavement_m < 0.6 or draws.chance(0.12):
            offset = draws.uniform(-0.8, 0.8) * road.half_width_m
        x, y, h = road.at(s, offset)
        heading = h + (math.pi if draws.chance(0.5) else 0.0) + draws.uniform(-0.3, 0.3)
        if site.add_person(x, y, heading) and draws.chance(0.45):
            c, sn = math.cos(heading), math.sin(heading)
            for k in range(1, 2 if draws.chance(0.7) else 3):
                site.add_person(x - 0.7 * k * sn, y + 0.7 * k * c, heading + draws.uniform(-0.15, 0.15))


def cycle_row(site: Site, road: Road, side: int, s0: float, count: int) -> None:
    """Add two-wheelers parked side by side on the pavement."""
    draws = site.draws
    for k in range(count):
        if draws.chance(0.15):
            continue
        x, y, h = road.at(s0 + 0.72 * k, side * (road.half_width_m + min(road.pavement_m * 0.45, 1.3)))
        if site.clear_of_roads(x, y, 0.3):
            site.add_cycle(x, y, h + side * (math.pi / 2 + draws.uniform(-0.18, 0.18)) + draws.uniform(-0.08, 0.08))


def tree_row(site: Site, road: Road, left: float, spacing: float, kinds: Sequence[TreeKind], size: float = 1.0) -> None:
    """Add a row of trees along a road, `left` metres off its centre line."""
    draws = site.draws
    s = -site.reach + draws.uniform(0, spacing)
    while s < site.reach:
        x, y, _ = road.at(s + draws.uniform(-0.4, 0.4), left)
        if site.clear_of_roads(x, y, 1.0):
            site.add_tree(draws.one_of(kinds), x, y, size)
        s += spacing * draws.uniform(0.9, 1.1)


def furniture(site: Site, road: Road) -> None:
    """Add manholes in the road, and bins and benches beside it."""
    draws = site.draws
    weather = site.weather
    s = -site.reach
    k = 1.0 if weather.night else 3.0
    while s < site.reach:
        s += draws.uniform(9, 22)
        x, y, h = road.at(s, draws.uniform(-0.8, 0.8) * road.half_width_m)
        site.patches.append(Patch("ellipse", x, y, 0.0, 0.7, 0.7, None, k * draws.uniform(-1.4, 1.2), 0.08))
        if road.pavement_m < 1.0 or not draws.chance(0.5):
            continue
        side = 1 if draws.chance(0.5) else -1
        kind: Literal["bin", "bench"] = "bin" if draws.chance(0.5) else "bench"
        x, y, h = road.at(s + 3, side * (road.half_width_m + 0.85 * road.pavement_m))
        if site.clear_of_roads(x, y, 0.5) and site.room(x, y, 1.0) and site.seen(x, y, 1, 1):
            height, length = (1.0, 0.6) if kind == "bin" else (0.45, 1.6)
            kelvin = weather.air_k + (draws.uniform(-4.5, -1) if weather.night else draws.uniform(0, 9))
            site.furniture.append(Furniture(kind, x, y, h, height, length, kelvin, kelvin))
            site.taken.append((x, y, h, length / 2, 0.3))


def lamps(site: Site, road: Road, side: int) -> None:
    """Add street lamps along one side of a road."""
    draws = site.draws
    weather = site.weather
    s = -site.reach + draws.uniform(0, 25)
    hot = weather.night and draws.chance(0.6)
    while s < site.reach:
        x, y, h = road.at(s, side * (road.half_width_m + 0.5))
        if site.clear_of_roads(x, y, 0.3) and site.room(x, y, 0.3) and site.seen(x, y, 2, 8):
            head = weather.air_k + (
                draws.uniform(10, 25) if hot else draws.uniform(-6, -2) if weather.night else draws.uniform(3, 9)
            )
            site.furniture.append(
                Furniture("lamp", x, y, h - side * math.pi / 2, draws.uniform(6.5, 8), draws.uniform(1.2, 2.0),
                     weather.air_k + (draws.uniform(-3, 0.5) if weather.night else draws.uniform(2, 6)), head)
            )  # fmt: skip
            site.taken.append((x, y, 0.0, 0.15, 0.15))
        s += draws.uniform(20, 26)


def wood(
    site: Site, count: int, gap_m: float, kinds: Sequence[TreeKind], inside: Callable[[float, float], bool]
) -> None:
    """Scatter trees where `inside(x, y)` holds."""
    draws = site.draws
    r = site.reach
    for _ in range(count):
        x, y = draws.uniform(-r, r), draws.uniform(-r, r)
        if inside(x, y) and site.clear_of_roads(x, y, gap_m):
            site.add_tree(draws.one_of(kinds), x, y)


def building_row(site: Site, road: Road, side: int, setback: float) -> None:
    """Add a row of buildings behind the pavement."""
    draws = site.draws
    s = -site.reach + draws.uniform(0, 15)
    while s < site.reach:
        length = draws.uniform(14, 32)
        width = draws.uniform(9, 15)
        height = draws.uniform(3.5, 11)
        x, y, h = road.at(s + length / 2, side * (road.half_width_m + road.pavement_m + setback + width / 2))
        site.add_building(x, y, h, length, width, height)
        s += length + draws.uniform(5, 18)


def planting_bed(site: Site, road: Road, left: float, width: float, material: str) -> None:
    """Add a bed along a road, in short pieces that follow its curve."""
    s = -site.reach
    while s < site.reach:
        x, y, h = road.at(s, left)
        if site.clear_of_roads(x, y, 0.3):
            site.patches.append(Patch("rect", x, y, h, 4.3, width, material, 0.0, 0.08))
        s += 4.0


def hedge_row(site: Site, road: Road, left: float, width: float) -> None:
    """Add a hedge with trees along a straight road."""
    draws = site.draws
    x, y, h = road.at(0.0, left)
    site.patches.append(Patch("rect", x, y, h, 4 * site.reach, width, "bed", 0.0, 0.08))
    tree_row(site, road, left, draws.uniform(4.5, 8), ("crown", "bare") if draws.chance(0.5) else ("crown",), 0.75)
    tree_row(site, road, left, 1.2, ("shrub",), 0.8)
