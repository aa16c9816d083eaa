"""A scene under construction: places things where there is room and the camera sees them."""

from __future__ import annotations

import math

import numpy as np

from infrablend.core.camera import CameraSpec
from infrablend.lab.world.buildings import Building, draw_building
from infrablend.lab.world.fixtures import Furniture, Tree, TreeKind, draw_tree, draw_tree_size
from infrablend.lab.world.ground_cover import Patch, Road
from infrablend.lab.world.people import EVERYDAY_POSES, Cycle, Person, Pose, draw_cycle, draw_person
from infrablend.lab.world.setting import Draws, Weather, ground_points
from infrablend.lab.world.vehicles import Vehicle, VehicleKind, draw_vehicle


class Site:
    """A scene under construction: the objects placed so far, and the remaining room.

    Things that the camera cannot see are not kept; solid things do not overlap.
    """

    def __init__(self, draws: Draws, camera: CameraSpec, weather: Weather) -> None:
        """Start with empty ground that covers the camera's view."""
        self.draws = draws
        self.camera = camera
        self.weather = weather
        w, h = camera.size_wh
        corners = ground_points(camera, np.array([[0.0, 0], [w, 0], [0, h], [w, h]]))
        self.x0, self.y0 = (float(v) for v in corners.min(axis=0))
        self.x1, self.y1 = (float(v) for v in corners.max(axis=0))
        self.reach = float(np.abs(corners).max() * 1.1 + 12)
        self.roads: list[Road] = []
        self.patches: list[Patch] = []
        self.vehicles: list[Vehicle] = []
        self.people: list[Person] = []
        self.cycles: list[Cycle] = []
        self.trees: list[Tree] = []
        self.buildings: list[Building] = []
        self.furniture: list[Furniture] = []
        # (x, y, heading, half length, half width) of the footprint of each thing that stands on the ground.
        self.taken: list[tuple[float, float, float, float, float]] = []

    def seen(self, x: float, y: float, radius_m: float, height_m: float) -> bool:
        """Return whether an upright body at a point can be inside the frame."""
        points = np.array([[x, y, 0.0], [x, y, height_m]])
        xy, depth = self.camera.project(points)
        if not (depth > 1).all():
            return False
        margin = radius_m * self.camera.focal_px / float(depth.min()) + 2
        w, h = self.camera.size_wh
        low, high = xy.min(axis=0) - margin, xy.max(axis=0) + margin
        return bool(low[0] < w and high[0] > 0 and low[1] < h and high[1] > 0)

    def room(self, x: float, y: float, radius_m: float) -> bool:
        """Return whether a disc at a point is clear of everything placed so far."""
        for ox, oy, heading, half_length, half_width in self.taken:
            c, s = math.cos(heading), math.sin(heading)
            dx, dy = x - ox, y - oy
            far = math.hypot(max(abs(dx * c + dy * s) - half_length, 0.0), max(abs(dy * c - dx * s) - half_width, 0.0))
            if far < radius_m:
                return False
        return True

    def clear_of_roads(self, x: float, y: float, gap_m: float, besides: Road | None = None) -> bool:
        """Return whether a point keeps `gap_m` from every carriageway except `besides`."""
        return all(
            r is besides or r.offset_m(x, y) > r.half_width_m + gap_m for r in self.roads
        )  # pavements may be shared

    def add_vehicle(
        self, kind: VehicleKind, x: float, y: float, heading: float, driven: bool = False, warm: bool = False
    ) -> bool:
        """Place a vehicle if there is room; return whether there was."""
        v = draw_vehicle(self.draws, self.weather, kind, (x, y, heading), driven, warm)
        # Three discs approximate the body.
        c, s = math.cos(heading), math.sin(heading)
        for f in (-0.36, 0.0, 0.36):
            if not self.room(x + f * v.length_m * c, y + f * v.length_m * s, v.width_m / 2 + 0.1):
                return False
        self.taken.append((x, y, heading, v.length_m / 2, v.width_m / 2))
        if self.seen(x, y, v.length_m / 2, v.height_m):
            self.vehicles.append(v)
            halo = (0.9, 2.3) if self.weather.night else (-5.0, -3.0)
            # The ground beside a car keeps warm at night (it does not see the sky) and is cool by day.
            self.patches.append(
                Patch("rect", x, y, heading, v.length_m + 0.5, v.width_m + 0.5, None, self.draws.uniform(*halo), 0.7)
            )
        return True

    def add_person(self, x: float, y: float, heading: float, pose: Pose | None = None) -> bool:
        """Place a person if there is room."""
        if not self.room(x, y, 0.3) or not self.seen(x, y, 0.5, 1.8):
            return False
        drawn: Pose = self.draws.one_of(EVERYDAY_POSES) if pose is None else pose
        self.people.append(draw_person(self.draws, self.weather, x, y, heading, drawn))
        self.taken.append((x, y, heading, 0.3, 0.3))
        return True

    def add_cycle(self, x: float, y: float, heading: float, ridden: bool = False) -> bool:
        """Place a two-wheeler if there is room."""
        if not self.room(x, y, 0.28) or not self.seen(x, y, 1.0, 1.7):
            return False
        self.cycles.append(draw_cycle(self.draws, self.weather, x, y, heading, ridden))
        self.taken.append((x, y, heading, 0.85, 0.22))
        return True

    def add_tree(self, kind: TreeKind, x: float, y: float, size: float = 1.0) -> bool:
        """Place a tree if its trunk has room."""
        height, radius = draw_tree_size(self.draws, kind, size)
        if not self.room(x, y, 0.5) or not self.seen(x, y, radius, height):
            return False
        self.trees.append(draw_tree(self.draws, self.weather, kind, x, y, (height, radius)))
        self.taken.append((x, y, 0.0, 0.3, 0.3))
        if kind == "crown":
            amount = self.draws.uniform(0.6, 1.6) if self.weather.night else self.draws.uniform(-1.5, 0.0)
            self.patches.append(Patch("ellipse", x, y, 0.0, 2.2 * radius, 2.2 * radius, None, amount, 1.6))
        return True

    def add_building(self, x: float, y: float, heading: float, length: float, width: float, height: float) -> bool:
        """Place a building if its outline is free."""
        c, s = math.cos(heading), math.sin(heading)
        for fl in np.linspace(-0.5, 0.5, 5):
            for fw in np.linspace(-0.5, 0.5, 4):
                px, py = x + fl * length * c - fw * width * s, y + fl * length * s + fw * width * c
                if not self.room(px, py, 1.0) or not self.clear_of_roads(px, py, 2.0):
                    return False
        self.taken.append((x, y, heading, length / 2, width / 2))
        if not self.seen(x, y, math.hypot(length, width) / 2, height):
            return True
        self.buildings.append(draw_building(self.draws, self.weather, x, y, heading, (length, width, height)))
        # Walls keep the ground in front of them warmer, because they block its view of the sky.
        amount = self.draws.uniform(0.8, 2.0) if self.weather.night else -2.0
        self.patches.append(Patch("rect", x, y, heading, length + 1.5, width + 1.5, None, amount, 2.5))
        return True
