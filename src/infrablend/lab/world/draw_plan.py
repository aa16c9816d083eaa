"""Draws the plan of a whole scene: weather, place, what stands there, traces of use, and the camera's gain."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from infrablend.core.capture import TimeOfDay
from infrablend.lab.world.countryside import athletics, courts, forest, river, suburb
from infrablend.lab.world.ground_cover import Patch, draw_materials, draw_water
from infrablend.lab.world.scene_plan import PlaceKind, WorldPlan
from infrablend.lab.world.scene_site import Site
from infrablend.lab.world.setting import FOCAL_PX, SIZE_WH, Draws, draw_weather, world_camera
from infrablend.lab.world.townscape import airfield, court, dirt_road, park, parking, street

# Each fills a site and returns the name of the material that covers the rest of the ground.
PLACES: dict[PlaceKind, Callable[[Site], str]] = {
    "street": street,
    "parking": parking,
    "court": court,
    "park": park,
    "runway": airfield,
    "dirtroad": dirt_road,
    "forest": forest,
    "river": river,
    "suburb": suburb,
    "courts": courts,
    "athletics": athletics,
}
# Places drawn at random; the others have to be asked for by name.
TOWN: tuple[PlaceKind, ...] = ("street", "parking", "court", "park")
TOWN_SHARES = (0.42, 0.22, 0.18, 0.18)


def sample_world(
    rng: np.random.Generator,
    pitch_deg: float,
    altitude_m: float,
    time_of_day: TimeOfDay,
    kind: PlaceKind | None = None,
    size_wh: tuple[int, int] = SIZE_WH,
    focal_px: float = FOCAL_PX,
) -> WorldPlan:
    """Draw the plan of a scene.

    Pitches are depression angles in [10, 90], so that neither horizon nor sky shows; 90 looks straight down. Without a
    kind, one is drawn from `TOWN`. `focal_px` is the focal length in pixels of a picture 640 wide.
    """
    if kind is None:
        kind = TOWN[int(rng.choice(len(TOWN), p=TOWN_SHARES))]
    draws = Draws(rng)
    weather = draw_weather(draws, time_of_day)
    materials = draw_materials(draws, weather) + ((draw_water(draws, weather),) if kind == "river" else ())
    site = Site(draws, world_camera(pitch_deg, altitude_m, size_wh, focal_px), weather)
    base = PLACES[kind](site)
    wear(site)
    u = draws.uniform
    night = weather.night
    return WorldPlan(
        camera=site.camera,
        pitch_deg=pitch_deg,
        altitude_m=altitude_m,
        time_of_day=time_of_day,
        kind=kind,
        air_k=weather.air_k,
        sky_drop_k=weather.sky_drop_k,
        sun=weather.sun,
        shade_k=0.0 if night else u(5.0, 10.0) * weather.solar,
        gain_per_k=u(5.6, 8.2) if night else u(4.6, 7.4),
        mean_grey=float(np.clip(draws.normal(126 if night else 129, 10 if night else 17), 96, 162)),
        std_grey=float(np.clip((35 if night else 45) * np.exp(draws.normal(0, 0.28)), 19, 58)),
        seed=draws.integer(2**31),
        base=base,
        materials=materials,
        roads=tuple(site.roads),
        patches=tuple(site.patches),
        vehicles=tuple(site.vehicles),
        people=tuple(site.people),
        cycles=tuple(site.cycles),
        trees=tuple(site.trees),
        buildings=tuple(site.buildings),
        furniture=tuple(site.furniture),
    )


def wear(site: Site) -> None:
    """Add traces of use to the ground: cracks, stains and repairs."""
    draws = site.draws
    weather = site.weather
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
