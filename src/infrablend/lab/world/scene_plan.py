"""The plan of a virtual thermal scene: what it contains, where, and how warm each thing is.

World: Z up, metres, ground at z = 0. The scene origin is the ground point in the middle of the image; the camera looks
at it along +Y from above (`core.camera.CameraSpec`). Temperatures are kelvin. The numbers are priors for a cool season
and a clear sky: surfaces are a few kelvin off the air at night, up to tens of kelvin above it in the sun.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from infrablend.core.camera import CameraSpec
from infrablend.core.capture import TimeOfDay
from infrablend.lab.world.buildings import Building
from infrablend.lab.world.fixtures import Furniture, Tree
from infrablend.lab.world.ground_cover import GroundMaterial, Patch, Road
from infrablend.lab.world.people import Cycle, Person
from infrablend.lab.world.vehicles import Vehicle

PlaceKind = Literal[
    "street", "parking", "court", "park", "runway", "dirtroad", "forest", "river", "suburb", "courts", "athletics"
]  # fmt: skip


@dataclass(frozen=True)
class WorldPlan:
    """Everything needed to render one frame.

    Attributes:
        camera: Camera; it looks at the origin.
        pitch_deg, altitude_m, time_of_day: Requested view and time.
        kind: Kind of place.
        air_k: Air temperature.
        sky_drop_k: How much colder than the air the sky overhead looks.
        sun: Unit vector to the sun, or None at night.
        shade_k: Temperature that ground in full shade loses by day (positive).
        gain_per_k: Grey levels per kelvin that the automatic gain starts from.
        mean_grey: Mean grey level of the picture.
        std_grey: Target deviation of grey levels.
        seed: Seed of the patterns on the ground.
        base: Name of the material everywhere else.
        materials: The ground's materials.
    """

    camera: CameraSpec
    pitch_deg: float
    altitude_m: float
    time_of_day: TimeOfDay
    kind: PlaceKind
    air_k: float
    sky_drop_k: float
    sun: tuple[float, float, float] | None
    shade_k: float
    gain_per_k: float
    mean_grey: float
    std_grey: float
    seed: int
    base: str
    materials: tuple[GroundMaterial, ...]
    roads: tuple[Road, ...] = ()
    patches: tuple[Patch, ...] = ()
    vehicles: tuple[Vehicle, ...] = ()
    people: tuple[Person, ...] = ()
    cycles: tuple[Cycle, ...] = ()
    trees: tuple[Tree, ...] = ()
    buildings: tuple[Building, ...] = ()
    furniture: tuple[Furniture, ...] = ()

    def material(self, name: str) -> GroundMaterial:
        """Return the material with a given name; KeyError if there is none."""
        for m in self.materials:
            if m.name == name:
                return m
        raise KeyError(name)
