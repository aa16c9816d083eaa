"""The plan of a virtual thermal scene: what stands where and how warm it is. Pure numpy, no Blender.

World: Z up, metres, ground at z = 0. The scene origin is the ground point in the middle of the picture; the camera
looks at it along +Y from above (`core.camera.CameraSpec`). Temperatures are kelvin. The numbers are priors for a
cool season, clear sky: surfaces minus air of a few kelvin at night, up to tens of kelvin in the sun.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from infrablend.core.camera import CameraSpec
from infrablend.core.dataset import TimeOfDay
from infrablend.core.mesh import FloatArray

SIZE_WH = (640, 512)
# HIT-UAV's measured effective focal length; 36 mm is the sensor width the camera type counts with.
FOCAL_PX = 2060.0
SENSOR_WIDTH_MM = 36.0

Kind = Literal["street", "parking", "court", "park", "runway", "dirtroad"]
# The places of a town, drawn from; the others are asked for by name.
KINDS: tuple[Kind, ...] = ("street", "parking", "court", "park")
KIND_SHARES = (0.42, 0.22, 0.18, 0.18)
VehicleKind = Literal["sedan", "suv", "van", "bus", "truck"]
Pose = Literal["stand", "walk", "run", "reach", "ride"]
TreeKind = Literal["crown", "bare", "shrub"]
# What is drawn from, equally likely: repeated entries are more common.
CARS: tuple[VehicleKind, ...] = ("sedan", "sedan", "suv", "suv", "van")
POSES: tuple[Pose, ...] = ("stand", "stand", "walk", "walk", "walk", "run")
PLAY: tuple[Pose, ...] = ("stand", "run", "run", "reach", "walk")


T = TypeVar("T")


@dataclass(frozen=True)
class Material:
    """A kind of ground: temperature, and the pattern on it (amplitude in kelvin, size of its grain in metres)."""

    name: str
    kelvin: float
    stain_k: float
    grain_k: float
    grain_m: float


@dataclass(frozen=True)
class Road:
    """A road along a circular arc (curvature 0: straight line) through (x, y), heading along it."""

    x_m: float
    y_m: float
    heading_rad: float
    curvature_per_m: float
    half_width_m: float
    pavement_m: float
    lanes: int
    surface: str
    markings: bool

    def along(self, x_m: NDArray[np.floating[Any]], y_m: NDArray[np.floating[Any]]) -> tuple[FloatArray, FloatArray]:
        """Arc length and offset to the left of the centre line, metres, of ground points of any shape."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        dx, dy = x_m - self.x_m, y_m - self.y_m
        forward, left = dx * c + dy * s, dy * c - dx * s
        k = self.curvature_per_m
        if abs(k) < 1e-6:
            return np.asarray(forward), np.asarray(left)
        radius, sign = 1 / abs(k), math.copysign(1.0, k)
        # Seen from the arc's centre, which lies at `sign * radius` to the left.
        inward = radius - sign * left
        return np.asarray(radius * np.arctan2(forward, inward)), np.asarray(sign * (radius - np.hypot(forward, inward)))

    def offset_m(self, x_m: float, y_m: float) -> float:
        """Distance of one point from the centre line."""
        return abs(float(self.along(np.asarray(x_m), np.asarray(y_m))[1]))

    def at(self, along_m: float, left_m: float) -> tuple[float, float, float]:
        """x, y and the road's heading at an arc length and an offset to the left."""
        k, h = self.curvature_per_m, self.heading_rad
        if abs(k) < 1e-6:
            forward, left, turn = along_m, left_m, 0.0
        else:
            turn = k * along_m
            forward = math.sin(turn) * (1 / k - left_m)
            left = 1 / k - math.cos(turn) * (1 / k - left_m)
        c, s = math.cos(h), math.sin(h)
        return self.x_m + forward * c - left * s, self.y_m + forward * s + left * c, h + turn


@dataclass(frozen=True)
class Paint:
    """Something flat on the ground.

    Attributes:
        shape: `rect` and `ellipse` fill length x width; `ring` is a circle line of diameter `length_m`.
        material: What it is made of; None adds `amount_k` to what is there.
        amount_k: Added to the temperature (of the material, too).
        soft_m: Width of its edge.
        line_m: Width of a ring's line.
    """

    shape: Literal["rect", "ellipse", "ring"]
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    width_m: float
    material: str | None = None
    amount_k: float = 0.0
    soft_m: float = 0.05
    line_m: float = 0.0


@dataclass(frozen=True)
class Vehicle:
    """A car, van, bus or truck; temperatures before sun and sky reflection."""

    kind: VehicleKind
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    width_m: float
    height_m: float
    paint_k: float
    glass_k: float
    bonnet_k: float
    wheel_k: float
    under_k: float
    solar_k: float

    @property
    def category(self) -> str:
        """The label's class."""
        return "OtherVehicle" if self.kind in ("bus", "truck") else "Car"


@dataclass(frozen=True)
class Person:
    """A person; `stride` in [-1, 1] is the phase of the step, `spread` how far the arms are raised."""

    x_m: float
    y_m: float
    heading_rad: float
    height_m: float
    girth: float
    pose: Pose
    stride: float
    spread: float
    skin_k: float
    hair_k: float
    top_k: float
    legs_k: float
    solar_k: float

    @property
    def category(self) -> str:
        """The label's class."""
        return "Person"


@dataclass(frozen=True)
class Cycle:
    """A bicycle or scooter, perhaps with its rider, who belongs to its label as in HIT-UAV."""

    kind: Literal["bicycle", "scooter"]
    x_m: float
    y_m: float
    heading_rad: float
    body_k: float
    seat_k: float
    motor_k: float
    solar_k: float
    cover: bool
    rider: Person | None

    @property
    def category(self) -> str:
        """The label's class."""
        return "Bicycle"


@dataclass(frozen=True)
class Tree:
    """A tree or shrub, one of a few prototypes placed, turned and scaled."""

    kind: TreeKind
    prototype: int
    x_m: float
    y_m: float
    heading_rad: float
    height_m: float
    radius_m: float
    kelvin: float
    solar_k: float


@dataclass(frozen=True)
class Building:
    """A block with windows; `seed` fixes the pattern of its windows and what stands on the roof."""

    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    width_m: float
    height_m: float
    roof: Literal["flat", "gable", "arrays"]
    roof_k: float
    wall_k: float
    window_k: float
    lit_share: float
    solar_k: float
    seed: int


@dataclass(frozen=True)
class Post:
    """Street furniture: a lamp, a basketball hoop, a bin, a bollard or a bench."""

    kind: Literal["lamp", "hoop", "bin", "bollard", "bench", "fence"]
    x_m: float
    y_m: float
    heading_rad: float
    height_m: float
    length_m: float
    pole_k: float
    head_k: float


@dataclass(frozen=True)
class WorldPlan:
    """All that is needed to render one frame.

    Attributes:
        camera: Looks at the origin.
        pitch_deg, altitude_m, time_of_day: As asked for.
        kind: What the place is.
        air_k: Air temperature.
        sky_drop_k: How much colder than the air the sky overhead looks.
        sun: Unit vector to the sun, or None at night.
        shade_k: What ground in full shade loses (positive), by day.
        gain_per_k: Grey levels per kelvin that the automatic gain starts from.
        mean_grey: Mean grey level of the picture.
        std_grey: Deviation of grey levels that the gain aims at.
        seed: Of the patterns on the ground and of the sensor's noise.
        base: Name of the material everywhere else.
        materials: The ground's materials.
    """

    camera: CameraSpec
    pitch_deg: float
    altitude_m: float
    time_of_day: TimeOfDay
    kind: Kind
    air_k: float
    sky_drop_k: float
    sun: tuple[float, float, float] | None
    shade_k: float
    gain_per_k: float
    mean_grey: float
    std_grey: float
    seed: int
    base: str
    materials: tuple[Material, ...]
    roads: tuple[Road, ...] = ()
    paints: tuple[Paint, ...] = ()
    vehicles: tuple[Vehicle, ...] = ()
    people: tuple[Person, ...] = ()
    cycles: tuple[Cycle, ...] = ()
    trees: tuple[Tree, ...] = ()
    buildings: tuple[Building, ...] = ()
    posts: tuple[Post, ...] = ()

    def material(self, name: str) -> Material:
        """The material of that name; KeyError if there is none."""
        for m in self.materials:
            if m.name == name:
                return m
        raise KeyError(name)


def world_camera(pitch_deg: float, altitude_m: float, size_wh: tuple[int, int] = SIZE_WH) -> CameraSpec:
    """HIT-UAV's camera at `altitude_m` above ground, looking down at `pitch_deg` (90 is straight down).

    Another `size_wh` gives more or fewer pixels of the same horizontal field of view.
    """
    pitch = math.radians(pitch_deg)
    return CameraSpec(
        distance_m=altitude_m / math.sin(pitch),
        pitch_rad=pitch,
        roll_rad=0.0,
        focal_length_mm=FOCAL_PX / SIZE_WH[0] * SENSOR_WIDTH_MM,
        sensor_width_mm=SENSOR_WIDTH_MM,
        size_wh=size_wh,
    )


def ground_points(camera: CameraSpec, pixels_xy: FloatArray) -> FloatArray:
    """(N, 2) world x and y where the rays through (N, 2) pixel positions meet the ground."""
    w, h = camera.size_wh
    rays = np.stack(
        [
            (pixels_xy[:, 0] - w / 2) / camera.focal_px,
            (pixels_xy[:, 1] - h / 2) / camera.focal_px,
            np.ones(len(pixels_xy)),
        ],
        axis=1,
    )
    world = rays @ camera.world_to_camera
    eye = camera.position_m
    return np.asarray(eye[:2] - world[:, :2] * (eye[2] / world[:, 2])[:, None])


def sample_world(
    rng: np.random.Generator,
    pitch_deg: float,
    altitude_m: float,
    time_of_day: TimeOfDay,
    kind: Kind | None = None,
    size_wh: tuple[int, int] = SIZE_WH,
) -> WorldPlan:
    """Draw a scene.

    Args:
        rng: The frame's stream.
        pitch_deg: Camera depression angle, 0 < pitch <= 90.
        altitude_m: Camera height above the ground.
        time_of_day: `day` has the sun up; at night the sky cools what faces it.
        kind: The place; drawn from `KINDS` if None.
        size_wh: Of the picture, in pixels.
    """
    if not 10 <= pitch_deg <= 90:
        raise ValueError(f"pitch_deg {pitch_deg} not in [10, 90]: the horizon or the sky would be in the picture")
    if not altitude_m > 0:
        raise ValueError(f"altitude_m {altitude_m} must be positive")
    if kind is None:
        kind = KINDS[int(rng.choice(len(KINDS), p=KIND_SHARES))]
    return _Sampler(rng, pitch_deg, altitude_m, time_of_day, kind, size_wh).plan()


class _Sampler:
    """Fills one plan. Objects that cannot be seen are not kept; solid ones do not overlap."""

    def __init__(
        self,
        rng: np.random.Generator,
        pitch_deg: float,
        altitude_m: float,
        time_of_day: TimeOfDay,
        kind: Kind,
        size_wh: tuple[int, int],
    ) -> None:
        self.rng = rng
        self.night = time_of_day == "night"
        self.kind = kind
        self.camera = world_camera(pitch_deg, altitude_m, size_wh)
        self.pitch_deg, self.altitude_m, self.time_of_day = pitch_deg, altitude_m, time_of_day
        w, h = self.camera.size_wh
        corners = ground_points(self.camera, np.array([[0.0, 0], [w, 0], [0, h], [w, h]]))
        self.x0, self.y0 = corners.min(axis=0)
        self.x1, self.y1 = corners.max(axis=0)
        self.reach = float(np.abs(corners).max() * 1.1 + 12)
        self.roads: list[Road] = []
        self.paints: list[Paint] = []
        self.vehicles: list[Vehicle] = []
        self.people: list[Person] = []
        self.cycles: list[Cycle] = []
        self.trees: list[Tree] = []
        self.buildings: list[Building] = []
        self.posts: list[Post] = []
        # (x, y, heading, half length, half width) of what stands there.
        self.taken: list[tuple[float, float, float, float, float]] = []
        u = rng.uniform
        self.air_k = 273.15 + float(u(5, 16) if self.night else u(10, 20))
        clear = float(u(0.35, 1.0))
        self.clear = clear
        self.sky_drop_k = 48 * clear
        self.sun: tuple[float, float, float] | None = None
        self.solar = 0.0
        if not self.night:
            height, azimuth = math.radians(float(u(28, 62))), float(u(0, 2 * math.pi))
            self.sun = (
                math.cos(height) * math.cos(azimuth),
                math.cos(height) * math.sin(azimuth),
                math.sin(height),
            )
            self.solar = float(u(0.6, 1.1))
        self.materials = self._materials()

    def u(self, low: float, high: float) -> float:
        """Uniform in [low, high)."""
        return float(self.rng.uniform(low, high))

    def pick(self, share: float) -> bool:
        """True with probability `share`."""
        return bool(self.rng.random() < share)

    def one_of(self, options: Sequence[T]) -> T:
        """One of the options, all equally likely."""
        return options[int(self.rng.integers(len(options)))]

    # What things are like -------------------------------------------------------------------------------------

    def _materials(self) -> tuple[Material, ...]:
        if self.night:
            c = self.clear
            table = {
                "asphalt": (3.6, 0.55, 0.28, 0.5),
                "concrete": (4.4, 0.5, 0.25, 0.4),
                "paving": (3.4, 0.5, 0.35, 0.35),
                "court": (1.6, 0.4, 0.22, 0.5),
                "grass": (-1.6 - 3.2 * c, 0.75, 0.4, 0.5),
                "soil": (-0.4, 0.7, 0.6, 0.7),
                "bed": (-3.2 - 2.5 * c, 0.6, 0.8, 0.4),
            }
        else:
            s = self.solar
            table = {
                "asphalt": (10.0 * s, 1.1, 0.5, 0.6),
                "concrete": (8.5 * s, 1.0, 0.5, 0.5),
                "paving": (8.0 * s, 1.1, 0.7, 0.4),
                "court": (10.0 * s, 1.1, 0.4, 0.6),
                "grass": (3.5 * s, 1.3, 0.9, 0.4),
                "soil": (8.0 * s, 1.5, 1.0, 0.6),
                "bed": (2.5 * s, 1.2, 1.2, 0.4),
            }
        # Laid by different hands: hard grounds differ more from place to place than grass does.
        spread = {"paving": 1.5, "concrete": 1.2, "court": 1.5} if self.night else {"paving": 3.5, "court": 2.5}
        rest = 0.5 if self.night else 1.5
        return tuple(
            Material(n, self.air_k + dt + self.u(-1, 1) * spread.get(n, rest), stain, grain, size)
            for n, (dt, stain, grain, size) in table.items()
        )

    def _vehicle(self, kind: VehicleKind, x: float, y: float, heading: float, driven: bool, warm: bool) -> Vehicle:
        u, a = self.u, self.air_k
        size = {
            "sedan": (4.35, 4.85, 1.74, 1.86, 1.42, 1.5),
            "suv": (4.1, 4.75, 1.78, 1.92, 1.58, 1.75),
            "van": (4.5, 5.3, 1.8, 2.0, 1.85, 2.2),
            "bus": (9.5, 12.0, 2.45, 2.55, 2.9, 3.2),
            "truck": (6.0, 8.5, 2.1, 2.45, 2.5, 3.3),
        }[kind]
        length, width, height = u(*size[:2]), u(*size[2:4]), u(*size[4:])
        if self.night:
            paint = a - 0.6 - 4.2 * self.clear + u(-1.0, 1.0)
            glass = paint + u(-1.0, 3.2)
            bonnet = (
                a + (u(8, 22) if self.pick(0.35) else u(-3, 6))
                if driven
                else a + u(3, 10)
                if warm
                else paint + u(-0.3, 2.0)
            )
            wheel = a + (u(5, 12) if driven else u(-1.5, 1.5))
            under, solar = a + (u(4, 10) if driven else u(0.5, 3)), 0.0
        else:
            # Dark paint takes up to three times what white paint takes of the sun.
            solar = self.solar * u(1, 26)
            paint = a + u(1, 5)
            glass = a + u(-2, 8)
            bonnet = paint + (u(6, 16) if driven else u(0, 3))
            wheel, under = a + u(5, 14), a + u(0, 6)
        return Vehicle(kind, x, y, heading, length, width, height, paint, glass, bonnet, wheel, under, solar)

    def _person(self, x: float, y: float, heading: float, pose: Pose) -> Person:
        u, a = self.u, self.air_k
        skin = a + min(306.0 - a, 30.0) * u(0.75, 0.95)
        if self.night:
            top = a + u(8.5, 16)
            legs, hair, solar = a + u(8, 15), a + u(8, 14), 0.0
        else:
            # Dark cloth in the sun glows, light cloth does not; top and trousers differ.
            top, legs = a + u(7, 17), a + u(5, 15)
            hair, solar = a + u(8, 13), self.solar * u(5, 20)
        return Person(
            x_m=x, y_m=y, heading_rad=heading, height_m=u(1.56, 1.84), girth=u(1.05, 1.4), pose=pose,
            stride=u(-1, 1), spread=u(0.05, 0.35) if pose != "reach" else u(0.6, 1.0),
            skin_k=skin, hair_k=hair, top_k=top, legs_k=legs, solar_k=solar,
        )  # fmt: skip

    def _cycle(self, x: float, y: float, heading: float, ridden: bool) -> Cycle:
        u, a = self.u, self.air_k
        scooter = self.pick(0.8)
        if self.night:
            body, seat, solar = a - 0.6 - 3.6 * self.clear + u(-0.8, 0.8), a - 1 - 2.5 * self.clear, 0.0
        else:
            body, seat, solar = a + u(0, 4), a + u(2, 8), self.solar * u(6, 22)
        motor = a + (u(8, 20) if ridden else u(-1, 1))
        rider = replace(self._person(x, y, heading, "ride"), stride=0.0) if ridden else None
        return Cycle(
            "scooter" if scooter else "bicycle", x, y, heading, body, seat, motor, solar,
            cover=scooter and self.pick(0.5), rider=rider,
        )  # fmt: skip

    def _tree_kelvin(self) -> float:
        return self.air_k + (-0.4 - 1.9 * self.clear + self.u(-0.5, 0.5) if self.night else self.u(-2.0, 1.0))

    # Where there is room --------------------------------------------------------------------------------------

    def seen(self, x: float, y: float, radius_m: float, height_m: float) -> bool:
        """Whether an upright body there can be inside the frame."""
        points = np.array([[x, y, 0.0], [x, y, height_m]])
        xy, depth = self.camera.project(points)
        if not (depth > 1).all():
            return False
        margin = radius_m * self.camera.focal_px / float(depth.min()) + 2
        w, h = self.camera.size_wh
        low, high = xy.min(axis=0) - margin, xy.max(axis=0) + margin
        return bool(low[0] < w and high[0] > 0 and low[1] < h and high[1] > 0)

    def room(self, x: float, y: float, radius_m: float) -> bool:
        """Whether a disc there touches nothing that stands."""
        for ox, oy, heading, half_length, half_width in self.taken:
            c, s = math.cos(heading), math.sin(heading)
            dx, dy = x - ox, y - oy
            far = math.hypot(max(abs(dx * c + dy * s) - half_length, 0.0), max(abs(dy * c - dx * s) - half_width, 0.0))
            if far < radius_m:
                return False
        return True

    def clear_of_roads(self, x: float, y: float, gap_m: float, besides: Road | None = None) -> bool:
        """Whether a point keeps `gap_m` from every carriageway but one."""
        return all(
            r is besides or r.offset_m(x, y) > r.half_width_m + gap_m for r in self.roads
        )  # pavements may be shared

    def add_vehicle(
        self, kind: VehicleKind, x: float, y: float, heading: float, driven: bool = False, warm: bool = False
    ) -> bool:
        """Place a vehicle if there is room; True if it was placed."""
        v = self._vehicle(kind, x, y, heading, driven, warm)
        # Three discs stand for the body.
        c, s = math.cos(heading), math.sin(heading)
        for f in (-0.36, 0.0, 0.36):
            if not self.room(x + f * v.length_m * c, y + f * v.length_m * s, v.width_m / 2 + 0.1):
                return False
        self.taken.append((x, y, heading, v.length_m / 2, v.width_m / 2))
        if self.seen(x, y, v.length_m / 2, v.height_m):
            self.vehicles.append(v)
            halo = (0.9, 2.3) if self.night else (-5.0, -3.0)
            # The ground beside a car keeps warm at night (it does not see the sky) and is cool by day.
            self.paints.append(
                Paint("rect", x, y, heading, v.length_m + 0.5, v.width_m + 0.5, None, self.u(*halo), 0.7)
            )
        return True

    def add_person(self, x: float, y: float, heading: float, pose: Pose | None = None) -> bool:
        """Place a person if there is room."""
        if not self.room(x, y, 0.3) or not self.seen(x, y, 0.5, 1.8):
            return False
        drawn: Pose = self.one_of(POSES) if pose is None else pose
        self.people.append(self._person(x, y, heading, drawn))
        self.taken.append((x, y, heading, 0.3, 0.3))
        return True

    def add_cycle(self, x: float, y: float, heading: float, ridden: bool = False) -> bool:
        """Place a two-wheeler if there is room."""
        if not self.room(x, y, 0.28) or not self.seen(x, y, 1.0, 1.7):
            return False
        self.cycles.append(self._cycle(x, y, heading, ridden))
        self.taken.append((x, y, heading, 0.85, 0.22))
        return True

    def add_tree(self, kind: TreeKind, x: float, y: float, size: float = 1.0) -> bool:
        """Place a tree if its trunk has room."""
        u = self.u
        height = {"crown": u(4.5, 8.5), "bare": u(5.0, 8.5), "shrub": u(0.9, 1.9)}[kind] * size
        radius = height * {"crown": u(0.32, 0.46), "bare": u(0.3, 0.4), "shrub": u(0.5, 0.75)}[kind]
        if not self.room(x, y, 0.5) or not self.seen(x, y, radius, height):
            return False
        kelvin = self._tree_kelvin() - (1.2 * self.clear if kind == "shrub" and self.night else 0)
        self.trees.append(
            Tree(kind, int(self.rng.integers(64)), x, y, u(0, 2 * math.pi), height, radius,
                 kelvin + (1.6 if kind == "bare" and self.night else 0), self.solar * u(1, 3.5))
        )  # fmt: skip
        self.taken.append((x, y, 0.0, 0.3, 0.3))
        if kind == "crown":
            amount = self.u(0.6, 1.6) if self.night else self.u(-1.5, 0.0)
            self.paints.append(Paint("ellipse", x, y, 0.0, 2.2 * radius, 2.2 * radius, None, amount, 1.6))
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
        u, a = self.u, self.air_k
        if not self.seen(x, y, math.hypot(length, width) / 2, height):
            return True
        if self.night:
            roof, wall = a - 1.5 - 4.0 * self.clear + u(-1, 1), a + u(0.8, 3.2)
            window, solar = a + u(-1.5, 3.0), 0.0
        else:
            roof, wall = a + u(2, 8), a + u(2, 5)
            window, solar = a + u(0, 4), self.solar * u(7, 18)
        roofs: tuple[Literal["flat", "gable", "arrays"], ...] = ("flat", "flat", "gable", "arrays")
        kind = "gable" if height < 5 and self.pick(0.5) else self.one_of(roofs)
        self.buildings.append(
            Building(x, y, heading, length, width, height, kind, roof, wall, window,
                     u(0.0, 0.35) if self.night else 0.0, solar, int(self.rng.integers(2**31)))
        )  # fmt: skip
        # Walls give the ground in front of them back what the sky would take.
        self.paints.append(
            Paint("rect", x, y, heading, length + 1.5, width + 1.5, None, u(0.8, 2.0) if self.night else -2.0, 2.5)
        )
        return True

    # Places ---------------------------------------------------------------------------------------------------

    def plan(self) -> WorldPlan:
        """Draw everything."""
        places = {
            "street": self._street, "parking": self._parking, "court": self._court, "park": self._park,
            "runway": self._runway, "dirtroad": self._dirtroad,
        }  # fmt: skip
        base = places[self.kind]()
        self._spills()
        u = self.u
        return WorldPlan(
            camera=self.camera, pitch_deg=self.pitch_deg, altitude_m=self.altitude_m,
            time_of_day=self.time_of_day, kind=self.kind, air_k=self.air_k, sky_drop_k=self.sky_drop_k,
            sun=self.sun, shade_k=0.0 if self.night else u(5.0, 10.0) * self.solar,
            gain_per_k=u(5.6, 8.2) if self.night else u(4.6, 7.4),
            mean_grey=float(np.clip(self.rng.normal(126 if self.night else 129, 10 if self.night else 17), 96, 162)),
            std_grey=float(np.clip((35 if self.night else 45) * np.exp(self.rng.normal(0, 0.28)), 19, 58)),
            seed=int(self.rng.integers(2**31)), base=base, materials=self.materials, roads=tuple(self.roads),
            paints=tuple(self.paints), vehicles=tuple(self.vehicles), people=tuple(self.people),
            cycles=tuple(self.cycles), trees=tuple(self.trees), buildings=tuple(self.buildings),
            posts=tuple(self.posts),
        )  # fmt: skip

    def _spills(self) -> None:
        """Traces of use: stains and repairs on hard ground."""
        for _ in range(int(self.rng.integers(2, 6))):  # cracks wander
            x, y, a = self.u(self.x0, self.x1), self.u(self.y0, self.y1), self.u(0, 6.28)
            amount = self.u(-1.2, -0.5) if self.night else self.u(1.2, 3.0)
            for _ in range(int(self.rng.integers(6, 22))):
                step = self.u(0.4, 1.2)
                x, y = x + step * math.cos(a), y + step * math.sin(a)
                self.paints.append(Paint("rect", x, y, a, 1.15 * step, 0.05, None, amount, 0.05))
                a += self.u(-0.5, 0.5)
        for _ in range(int(self.rng.integers(6, 15))):
            x, y = self.u(self.x0, self.x1), self.u(self.y0, self.y1)
            k = 1.0 if self.night else 2.5
            if self.pick(0.5):
                self.paints.insert(
                    0,
                    Paint("ellipse", x, y, self.u(0, 3.1), self.u(0.8, 5), self.u(0.5, 3), None,
                          k * self.u(-0.7, 0.6), self.u(0.4, 1.5)),
                )  # fmt: skip
            else:
                heading = self.roads[0].heading_rad if self.roads else 0.0
                self.paints.insert(
                    0,
                    Paint("rect", x, y, heading, self.u(1, 6), self.u(0.8, 2.5), None,
                          k * self.u(-0.5, 0.5), 0.15),
                )  # fmt: skip

    def _road(self, half_width: float, pavement: float, curved: bool, through: float) -> Road:
        u = self.u
        curvature = 0.0
        if curved and self.pick(0.55):
            curvature = (1 if self.pick(0.5) else -1) / u(1.6 * self.reach, 4 * self.reach)
        angle = u(-math.pi / 2, math.pi / 2)
        road = Road(
            u(-1, 1) * through * (self.x1 - self.x0), u(-1, 1) * through * (self.y1 - self.y0), angle,
            curvature, half_width, pavement, lanes=2 if half_width < 5.5 else 4,
            surface="asphalt" if self.pick(0.75) else "concrete", markings=half_width > 3.2 and self.pick(0.8),
        )  # fmt: skip
        self.roads.append(road)
        return road

    def _traffic(self, road: Road, gap_m: tuple[float, float]) -> None:
        """Driving cars and riders, keeping right."""
        lane = road.half_width_m * 2 / road.lanes
        for k in range(road.lanes):
            left = -road.half_width_m + lane * (k + 0.5)
            onward = left < 0
            s = -self.reach + self.u(0, gap_m[1])
            while s < self.reach:
                x, y, h = road.at(s, left + self.u(-0.25, 0.25))
                heading = h + (0.0 if onward else math.pi) + self.u(-0.03, 0.03)
                roll = self.rng.random()
                if roll < 0.2:
                    x, y, h = road.at(s, left + (-1 if onward else 1) * lane * 0.3)
                    self.add_cycle(x, y, heading, ridden=True)
                else:
                    kind: VehicleKind = (
                        "bus" if roll < 0.24 else "truck" if roll < 0.28 else "van" if roll < 0.38
                        else "suv" if roll < 0.65 else "sedan"
                    )  # fmt: skip
                    self.add_vehicle(kind, x, y, heading, driven=True)
                s += self.u(*gap_m)

    def _kerb_parking(self, road: Road, side: int, occupancy: float) -> None:
        """Cars parked along the kerb, and cold marks where some have left."""
        s = -self.reach + self.u(0, 6)
        while s < self.reach:
            x, y, h = road.at(s, side * (road.half_width_m - 1.15))
            heading = h + (0.0 if side < 0 else math.pi) + self.u(-0.03, 0.03)
            if self.pick(occupancy) and self.clear_of_roads(x, y, 3.0, besides=road):
                kind = self.one_of(CARS)
                self.add_vehicle(kind, x, y, heading, warm=self.pick(0.15))
            elif self.pick(0.3):
                self._mark(x, y, heading)
            s += self.u(5.6, 7.2)

    def _mark(self, x: float, y: float, heading: float) -> None:
        """Where a car stood until lately: in its shade the ground stayed cold by day, and still is at night."""
        amount = self.u(-3.2, -1.2) if self.night else self.u(-5, -2)
        self.paints.append(
            Paint("rect", x, y, heading, self.u(3.9, 4.6), self.u(1.6, 1.9), None, amount, self.u(0.3, 0.9))
        )

    def _walkers(self, road: Road, count: int) -> None:
        """People on the pavements, some in groups, a few on the road; `count` of them in sight if there is room."""
        wanted = len(self.people) + count
        for _ in range(count * 6):
            if len(self.people) >= wanted:
                break
            side = 1 if self.pick(0.5) else -1
            s = self.u(-self.reach, self.reach)
            offset = side * (road.half_width_m + road.pavement_m * self.u(0.25, 0.8))
            if road.pavement_m < 0.6 or self.pick(0.12):
                offset = self.u(-0.8, 0.8) * road.half_width_m
            x, y, h = road.at(s, offset)
            heading = h + (math.pi if self.pick(0.5) else 0.0) + self.u(-0.3, 0.3)
            if self.add_person(x, y, heading) and self.pick(0.45):
                c, sn = math.cos(heading), math.sin(heading)
                for k in range(1, 2 if self.pick(0.7) else 3):
                    self.add_person(x - 0.7 * k * sn, y + 0.7 * k * c, heading + self.u(-0.15, 0.15))

    def _cycle_row(self, road: Road, side: int, s0: float, count: int) -> None:
        """Two-wheelers parked side by side on the pavement."""
        for k in range(count):
            if self.pick(0.15):
                continue
            x, y, h = road.at(s0 + 0.72 * k, side * (road.half_width_m + min(road.pavement_m * 0.45, 1.3)))
            if self.clear_of_roads(x, y, 0.3):
                self.add_cycle(x, y, h + side * (math.pi / 2 + self.u(-0.18, 0.18)) + self.u(-0.08, 0.08))

    def _alley(self, road: Road, left: float, spacing: float, kinds: Sequence[TreeKind], size: float = 1.0) -> None:
        """A row of trees beside a road."""
        s = -self.reach + self.u(0, spacing)
        while s < self.reach:
            x, y, _ = road.at(s + self.u(-0.4, 0.4), left)
            if self.clear_of_roads(x, y, 1.0):
                self.add_tree(self.one_of(kinds), x, y, size)
            s += spacing * self.u(0.9, 1.1)

    def _furniture(self, road: Road) -> None:
        """Manholes in the road, bins, benches and bollards beside it."""
        s = -self.reach
        k = 1.0 if self.night else 3.0
        while s < self.reach:
            s += self.u(9, 22)
            x, y, h = road.at(s, self.u(-0.8, 0.8) * road.half_width_m)
            self.paints.append(Paint("ellipse", x, y, 0.0, 0.7, 0.7, None, k * self.u(-1.4, 1.2), 0.08))
            if road.pavement_m < 1.0 or not self.pick(0.5):
                continue
            side = 1 if self.pick(0.5) else -1
            kind: Literal["bin", "bench"] = "bin" if self.pick(0.5) else "bench"
            x, y, h = road.at(s + 3, side * (road.half_width_m + 0.85 * road.pavement_m))
            if self.clear_of_roads(x, y, 0.5) and self.room(x, y, 1.0) and self.seen(x, y, 1, 1):
                height, length = (1.0, 0.6) if kind == "bin" else (0.45, 1.6)
                kelvin = self.air_k + (self.u(-4.5, -1) if self.night else self.u(0, 9))
                self.posts.append(Post(kind, x, y, h, height, length, kelvin, kelvin))
                self.taken.append((x, y, h, length / 2, 0.3))

    def _lamps(self, road: Road, side: int) -> None:
        s = -self.reach + self.u(0, 25)
        hot = self.night and self.pick(0.6)
        while s < self.reach:
            x, y, h = road.at(s, side * (road.half_width_m + 0.5))
            if self.clear_of_roads(x, y, 0.3) and self.room(x, y, 0.3) and self.seen(x, y, 2, 8):
                head = self.air_k + (self.u(10, 25) if hot else self.u(-6, -2) if self.night else self.u(3, 9))
                self.posts.append(
                    Post("lamp", x, y, h - side * math.pi / 2, self.u(6.5, 8), self.u(1.2, 2.0),
                         self.air_k + (self.u(-3, 0.5) if self.night else self.u(2, 6)), head)
                )  # fmt: skip
                self.taken.append((x, y, 0.0, 0.15, 0.15))
            s += self.u(20, 26)

    def _wood(
        self, count: int, gap_m: float, kinds: Sequence[TreeKind], inside: Callable[[float, float], bool]
    ) -> None:
        """Trees scattered where `inside` holds."""
        r = self.reach
        for _ in range(count):
            x, y = self.u(-r, r), self.u(-r, r)
            if inside(x, y) and self.clear_of_roads(x, y, gap_m):
                self.add_tree(self.one_of(kinds), x, y)

    def _block(self, road: Road, side: int, setback: float) -> None:
        """Buildings in a row behind the pavement."""
        s = -self.reach + self.u(0, 15)
        while s < self.reach:
            length, width, height = self.u(14, 32), self.u(9, 15), self.u(3.5, 11)
            x, y, h = road.at(s + length / 2, side * (road.half_width_m + road.pavement_m + setback + width / 2))
            self.add_building(x, y, h, length, width, height)
            s += length + self.u(5, 18)

    def _street(self) -> str:
        u = self.u
        road = self._road(u(3.6, 7.2), u(1.8, 3.6), curved=True, through=0.12)
        if self.pick(0.3):  # a crossing
            x, y, h = road.at(u(-0.4, 0.4) * self.reach, 0.0)
            self.roads.append(
                Road(x, y, h + math.pi / 2 + u(-0.12, 0.12), 0.0, u(2.8, 4.5), road.pavement_m, 2, road.surface, False)
            )
        sides = (-1, 1)
        behind = {s: "building" if self.pick(0.45) else "wood" for s in sides}
        for side in sides:
            if behind[side] == "building":
                self._block(road, side, u(2, 5) + 0.08 * self.reach * u(0, 1))
        parked = {s: self.pick(0.6) for s in sides}
        for side in sides:
            if parked[side]:
                self._kerb_parking(road, side, u(0.45, 0.9))
        self._traffic(road, (u(14, 22), u(30, 60)))
        for side in sides:
            self._lamps(road, side) if self.pick(0.5) else None
            if self.pick(0.35):
                edge = road.half_width_m + road.pavement_m
                self._strip(road, side * (edge + 1.0), 1.6, "bed")
                self._alley(road, side * (edge + 1.0), 1.1, ("shrub",))
            if self.pick(0.55):
                self._cycle_row(road, side, u(-0.45, 0.2) * self.reach, int(self.rng.integers(5, 20)))
            if self.pick(0.75):
                row: Sequence[TreeKind] = ("crown",) if self.pick(0.55) else ("bare", "bare", "crown")
                self._alley(road, side * (road.half_width_m + min(1.0, 0.35 * road.pavement_m)), u(5.5, 9), row, 0.8)
        self._furniture(road)
        self._walkers(road, int(self.rng.integers(4, 20)))
        woods = [s for s in sides if behind[s] == "wood"]
        if woods and self.pick(0.8):
            kinds: Sequence[TreeKind] = (
                ("crown", "crown", "bare") if self.pick(0.6) else ("bare", "bare", "crown", "shrub")
            )

            def inside(x: float, y: float) -> bool:
                left = float(road.along(np.asarray(x), np.asarray(y))[1])
                return (1 if left > 0 else -1) in woods

            self._wood(int(0.016 * (2 * self.reach) ** 2), road.pavement_m + 2.5, kinds, inside)
        return "grass" if self.pick(0.75) else "paving"

    def _strip(self, road: Road, left: float, width: float, material: str) -> None:
        """A bed along a road, in short pieces that follow its curve."""
        s = -self.reach
        while s < self.reach:
            x, y, h = road.at(s, left)
            if self.clear_of_roads(x, y, 0.3):
                self.paints.append(Paint("rect", x, y, h, 4.3, width, material, 0.0, 0.08))
            s += 4.0

    def _parking(self) -> str:
        u = self.u
        road = self._road(u(3.0, 4.2), u(0.0, 2.0), curved=False, through=0.05)
        road = replace(road, markings=False, surface="asphalt")
        self.roads[-1] = road
        h = road.heading_rad
        bay, depth = u(2.45, 2.7), u(5.0, 5.5)
        occupancy, lit = u(0.35, 0.85), self.pick(0.6)
        rows: list[tuple[float, int]] = []
        aisle = 2 * road.half_width_m
        edge = road.half_width_m
        hedge = u(1.4, 2.6) if self.pick(0.6) else 0.0
        # Bays face the aisle on both sides; behind them a hedge and the next aisle's bays.
        for side in (-1, 1):
            offset = edge
            rows.append((side * (offset + depth / 2), side))
            offset += depth + hedge
            if hedge:
                self._hedge_row(road, side * (offset - hedge / 2), hedge)
            rows.append((side * (offset + depth / 2), -side))
            offset += depth + aisle
            behind = side * (offset + u(1.5, 4))
            if self.pick(0.5):
                self._alley(road, behind, u(4, 7), ("crown", "crown", "bare"))
            else:
                self._block(replace(road, half_width_m=offset, pavement_m=0.0), side, u(3, 9))
            x, y, _ = road.at(0.0, side * (edge + (offset - edge) / 2))
            self.paints.insert(0, Paint("rect", x, y, h, 4 * self.reach, offset - edge + 0.4, "asphalt", 0.0, 0.1))
        line = -0.5 if self.night else -2.2
        for left, side in rows:
            s = -self.reach
            k = 0
            while s < self.reach:
                x, y, _ = road.at(s, left)
                if self.seen(x, y, depth / 2, 1.5):
                    mx, my, _ = road.at(s - bay / 2, left)
                    self.paints.append(Paint("rect", mx, my, h + math.pi / 2, depth, 0.12, None, line, 0.04))
                    if self.pick(occupancy):
                        kind = self.one_of(CARS)
                        nose = h + side * math.pi / 2 + (math.pi if self.pick(0.6) else 0) + u(-0.05, 0.05)
                        self.add_vehicle(kind, x + u(-0.15, 0.15), y + u(-0.15, 0.15), nose, warm=self.pick(0.12))
                    elif self.pick(0.45):
                        self._mark(x, y, h + math.pi / 2)
                s += bay
                k += 1
        for _ in range(int(self.rng.integers(0, 3))):
            x, y, hh = road.at(u(-0.6, 0.6) * self.reach, u(-0.3, 0.3) * edge)
            self.add_vehicle("sedan", x, y, hh + (math.pi if self.pick(0.5) else 0), driven=True)
        self._walkers(replace(road, pavement_m=0.0), int(self.rng.integers(2, 12)))
        if lit:
            self._lamps(road, 1)
        if self.pick(0.4):
            self._cycle_row(replace(road, pavement_m=1.0), 1, u(-0.4, 0.2) * self.reach, int(self.rng.integers(4, 10)))
        return "grass"

    def _hedge_row(self, road: Road, left: float, width: float) -> None:
        x, y, h = road.at(0.0, left)
        self.paints.append(Paint("rect", x, y, h, 4 * self.reach, width, "bed", 0.0, 0.08))
        self._alley(road, left, self.u(4.5, 8), ("crown", "bare") if self.pick(0.5) else ("crown",), 0.75)
        self._alley(road, left, 1.2, ("shrub",), 0.8)

    def _court(self) -> str:
        u = self.u
        h = u(-math.pi / 2, math.pi / 2)
        c, s = math.cos(h), math.sin(h)
        cx, cy = u(-0.15, 0.15) * (self.x1 - self.x0), u(-0.15, 0.15) * (self.y1 - self.y0)

        def at(x: float, y: float) -> tuple[float, float]:
            return cx + x * c - y * s, cy + x * s + y * c

        length, width, gap = 28.0, 15.0, u(3, 6)
        across = 3 if self.reach > 40 else 2
        along = 2 if self.reach > 40 else 1
        total = (along * (length + gap) + 6, across * (width + gap) + 6)
        self.paints.append(Paint("rect", cx, cy, h, total[0] + 7, total[1] + 7, "concrete", 0.0, 0.1))
        self.paints.append(Paint("rect", cx, cy, h, *total, "court", 0.0, 0.08))
        line = self.u(-1.3, -0.6) if self.night else -2.6
        if self.pick(0.4):
            line = -line
        sand, box = 0.08, self.paints.append
        for i in range(along):
            for j in range(across):
                ox, oy = (i - (along - 1) / 2) * (length + gap), (j - (across - 1) / 2) * (width + gap)
                for e in (-1, 1):
                    box(Paint("rect", *at(ox, oy + e * width / 2), h, length, sand, None, line, 0.03))
                    box(Paint("rect", *at(ox + e * length / 2, oy), h, sand, width, None, line, 0.03))
                    for f in (-1, 1):
                        box(
                            Paint(
                                "rect", *at(ox + e * (length / 2 - 2.9), oy + f * 2.45), h, 5.8, sand, None, line, 0.03
                            )
                        )
                    box(Paint("rect", *at(ox + e * (length / 2 - 5.8), oy), h, sand, 4.9, None, line, 0.03))
                    box(Paint("ring", *at(ox + e * (length / 2 - 5.8), oy), h, 3.6, 3.6, None, line, 0.03, sand))
                    x, y = at(ox + e * (length / 2 + 0.6), oy)
                    if self.seen(x, y, 2, 4):
                        self.posts.append(
                            Post("hoop", x, y, h + (math.pi if e > 0 else 0), 3.6, 1.9,
                                 self.air_k + (self.u(-4, -2) if self.night else u(2, 5)),
                                 self.air_k + (self.u(-5, -3) if self.night else u(2, 9)))
                        )  # fmt: skip
                        self.taken.append((x, y, 0.0, 0.5, 0.5))
                box(Paint("rect", *at(ox, oy), h, sand, width, None, line, 0.03))
                box(Paint("ring", *at(ox, oy), h, 3.6, 3.6, None, line, 0.03, sand))
                # A game around one hoop, or nobody.
                if self.pick(0.75):
                    end = 1 if self.pick(0.5) else -1
                    wanted = len(self.people) + int(self.rng.integers(3, 11))
                    for _ in range(60):
                        if len(self.people) >= wanted:
                            break
                        x, y = at(ox + end * u(-2, length / 2), oy + u(-0.45, 0.45) * width)
                        pose = self.one_of(PLAY)
                        self.add_person(x, y, u(0, 2 * math.pi), pose)
        for side in (-1, 1):
            fx, fy = at(0.0, side * (total[1] / 2 + 1.0))
            self.posts.append(
                Post("fence", fx, fy, h, 2.6, total[0], self.air_k + (-2.5 if self.night else 3), self.air_k)
            )
        # Beside it a running track or a field, a path with people, parked two-wheelers.
        path_y = total[1] / 2 + 6.5
        px, py = at(0.0, path_y)
        road = Road(px, py, h, 0.0, u(1.8, 3.0), 0.9, 2, "concrete", False)
        self.roads.append(road)
        self._walkers(replace(road, pavement_m=0.0), int(self.rng.integers(2, 10)))
        self._cycle_row(road, 1, u(-0.3, 0.1) * self.reach, int(self.rng.integers(4, 14)))
        self._alley(road, road.half_width_m + 3.0, u(4.5, 8), ("crown", "bare", "crown"))
        self._alley(road, -(total[1] + 13.0) - road.half_width_m, u(5, 9), ("crown", "bare"))
        if self.pick(0.5):
            bx, by = at(u(-10, 10), path_y + road.half_width_m + 16)
            self.add_building(bx, by, h, u(18, 34), u(10, 15), u(4, 9))
        return "grass"

    def _park(self) -> str:
        u = self.u
        road = self._road(u(1.6, 3.0), 0.0, curved=True, through=0.1)
        road = replace(road, markings=False, lanes=2, surface="concrete" if self.pick(0.5) else "paving")
        self.roads[-1] = road
        if self.pick(0.6):
            x, y, h = road.at(u(-0.3, 0.3) * self.reach, 0.0)
            self.roads.append(Road(x, y, h + u(0.8, 2.2), 0.0, u(1.0, 2.0), 0.0, 1, road.surface, False))
        x, y = u(0.3, 0.9) * self.x1, u(-0.6, 0.6) * self.y1
        if self.pick(0.5):
            self.add_building(x, y, road.heading_rad, u(9, 20), u(7, 11), u(3.2, 6))
        if self.pick(0.6):  # a plaza
            x, y, h = road.at(u(-0.3, 0.3) * self.reach, u(-4, 4))
            d = u(7, 15)
            self.paints.append(Paint("ellipse", x, y, h, d, d, "paving", 0.0, 0.08))
            for _ in range(int(self.rng.integers(2, 8))):
                a, r = u(0, 2 * math.pi), u(0, 0.45) * d
                self.add_person(x + r * math.cos(a), y + r * math.sin(a), u(0, 2 * math.pi))
        for side in (-1, 1):
            if self.pick(0.6):
                self._alley(road, side * (road.half_width_m + u(0.8, 1.6)), 1.1, ("shrub",), 0.8)
        self._walkers(road, int(self.rng.integers(5, 16)))
        for _ in range(int(self.rng.integers(1, 4))):
            x, y, h = road.at(u(-1, 1) * self.reach, u(-0.5, 0.5) * road.half_width_m)
            self.add_cycle(x, y, h + (math.pi if self.pick(0.5) else 0), ridden=True)
        self._lamps(road, 1 if self.pick(0.5) else -1)
        kinds: tuple[Sequence[TreeKind], ...] = (
            ("crown", "crown", "bare"),
            ("bare", "bare", "crown", "shrub"),
            ("crown", "shrub"),
        )
        density = u(0.006, 0.028)
        chosen = self.one_of(kinds)
        self._wood(int(density * (2 * self.reach) ** 2), 1.6, chosen, lambda x, y: True)
        return "grass"

    def _runway(self) -> str:
        """An airfield: a wide strip with marks in open grass, a few cars and people on and beside it."""
        u = self.u
        road = self._road(u(9, 14), 0.0, curved=False, through=0.15)
        road = replace(road, markings=False, surface="concrete" if self.pick(0.5) else "asphalt", lanes=2)
        self.roads[-1] = road
        line = u(-1.2, -0.5) if self.night else u(-4, -2)
        s = -self.reach + u(0, 20)
        while s < self.reach:
            x, y, h = road.at(s, 0.0)
            self.paints.append(Paint("rect", x, y, h, 12.0, 0.5, None, line, 0.05))
            s += 30.0
        for side in (-1, 1):
            x, y, h = road.at(0.0, side * (road.half_width_m - 0.8))
            self.paints.append(Paint("rect", x, y, h, 4 * self.reach, 0.3, None, line, 0.05))
        for _ in range(int(self.rng.integers(2, 7))):
            x, y, h = road.at(u(-0.7, 0.7) * self.reach, u(-1.4, 1.4) * road.half_width_m)
            self.add_vehicle(self.one_of(CARS), x, y, h + u(-0.4, 0.4), driven=self.pick(0.5), warm=self.pick(0.5))
        self._walkers(road, int(self.rng.integers(3, 12)))
        self._wood(int(0.004 * (2 * self.reach) ** 2), 12.0, ("shrub", "bare", "crown"), lambda x, y: True)
        return "grass"

    def _dirtroad(self) -> str:
        """A track of soil through fields, bushes and trees beside it, now and then somebody on it."""
        u = self.u
        road = self._road(u(1.4, 2.2), 0.0, curved=True, through=0.2)
        road = replace(road, markings=False, surface="soil", lanes=1)
        self.roads[-1] = road
        if self.pick(0.5):  # a ploughed field on one side
            side = 1 if self.pick(0.5) else -1
            x, y, h = road.at(0.0, side * (road.half_width_m + 4 + self.reach))
            self.paints.insert(0, Paint("rect", x, y, h, 4 * self.reach, 2 * self.reach, "bed", 0.0, 0.5))
        for _ in range(int(self.rng.integers(1, 4))):
            x, y, h = road.at(u(-0.6, 0.6) * self.reach, u(-0.4, 0.4))
            kind: VehicleKind = "truck" if self.pick(0.2) else self.one_of(CARS)
            self.add_vehicle(kind, x, y, h + (math.pi if self.pick(0.5) else 0), driven=self.pick(0.7))
        self._walkers(road, int(self.rng.integers(2, 8)))
        for side in (-1, 1):
            if self.pick(0.6):
                self._alley(
                    road, side * (road.half_width_m + u(1.0, 2.5)), u(2.5, 7), ("shrub", "shrub", "bare", "crown")
                )
        self._wood(int(u(0.002, 0.012) * (2 * self.reach) ** 2), 2.0, ("crown", "bare", "shrub"), lambda x, y: True)
        return "grass"
