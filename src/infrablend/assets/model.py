"""The interface of object models: draw parameters, build a mesh from them, give each part its thermal role.

Materials have an emissivity in the thermal band and a reflection. Emissivities are for 8-14 um at normal incidence.
Sources: the emissivity tables of FLIR (T505002), testo, ired.co.uk and Ideal Industries (HeatSeeker manual), and a
study of horses' coats for fur. "Computed" values follow from the refractive index; "est." marks estimates.
`docs/how_to/infrared_effect.md` shows this table. `SUNLIT` has the response to sunlight: what
docs/explanation/physical_look.md says under "Sunlight", with its sources.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from infrablend.core.mesh import Mesh
from infrablend.core.surface_kinds import GROUND, Affinity
from infrablend.thermal.daytime import between

Params = Mapping[str, Any]
# Moments of a cycle of legs that meshes are built for: few enough to keep their pieces in memory.
MOMENTS = 48
# Parameter of objects with a thermal shadow; see `ObjectModel.casts_shadow`.
SHADOW_PARAM = "shadow_xy"
TIMES = ("night", "day", "dusk", "dawn")
LOW_SUN = ("dusk", "dawn")
Range = tuple[float, float]


@dataclass(frozen=True)
class SunResponse:
    """Response of a part to sunlight, for scenes with a sun: its temperature then follows from its orientation.

    Attributes:
        shade_k: (low, high) surface minus air temperature without sunlight.
        rise_k: (low, high) rise by an irradiance of 1 kW/m², kelvin.
        surface: Name shared by the parts of one surface (a garment, a coat of paint), which absorb the same share.
        overcast_k: The same as `shade_k` under a closed cloud cover, where that differs.
    """

    shade_k: Range
    rise_k: Range
    surface: str
    overcast_k: Range | None = None


def sun_response(
    kind: str, shade_k: Range, surface: str, absorptivity: Range | None = None, exchange_w_m2_k: float | None = None
) -> SunResponse:
    """Return the response of a part of a material to sunlight.

    `shade_k` is surface minus air temperature without sunlight; absorptivity and exchange are by default those of the
    material.
    """
    low, high = absorptivity or SUNLIT[kind].absorptivity
    exchange = exchange_w_m2_k or SUNLIT[kind].exchange_w_m2_k
    return SunResponse(shade_k, (1000 * low / exchange, 1000 * high / exchange), surface)


@dataclass(frozen=True)
class PartRange:
    """Thermal role of a part: ranges from which each frame draws, and its surface. See also `part_role`.

    Attributes:
        delta_t_k: (low, high) surface minus air temperature.
        emissivity: (low, high) at normal incidence, in [0, 1].
        label: Whether boxes and masks include the part.
        what: Short description of the part and the source of its numbers.
        ior: Refractive index near 10 um of a smooth surface; 1 for rough ones (fur, cloth), which have no rim.
        kind: Name of a material in `materials.MATERIALS`; empty for none of them.
        roughness: Roughness of reflections on smooth surfaces and metals.
        metal: Whether the surface reflects at all angles.
        opacity: In (0, 1]; a part below 1 is translucent, and labels ignore it.
        sun: Response to sunlight, which replaces `delta_t_k` in scenes with a sun; None for none.
        glow: Whether a translucent part is ground that the object warms, see `core.scene.PartState`.
        ground: Whether it is ground beside the object, which has no part in the temperature of the whole object.
        sheltered: Whether it is warm because the object shields it from the sky, which closed clouds do as well.

    Raises:
        ValueError: A range is reversed or a value is outside its limits.
    """

    delta_t_k: tuple[float, float]
    emissivity: tuple[float, float]
    label: bool = True
    what: str = ""
    ior: float = 1.5
    kind: str = ""
    roughness: float = 0.1
    metal: bool = False
    opacity: float = 1.0
    sun: SunResponse | None = None
    glow: bool = False
    ground: bool = False
    sheltered: bool = False

    def __post_init__(self) -> None:
        cold, warm = self.delta_t_k
        low, high = self.emissivity
        if not cold <= warm:
            raise ValueError(f"delta_t_k {self.delta_t_k}: the low end must not be above the high end")
        if not 0 <= low <= high <= 1:
            raise ValueError(f"emissivity {self.emissivity}: expected 0 <= low <= high <= 1")
        if not 0 < self.opacity <= 1 or (self.opacity < 1 and self.label):
            raise ValueError(f"opacity {self.opacity}: expected a number above 0 and up to 1, below 1 with label False")


def part_role(
    kind: str,
    delta_t_k: tuple[float, float],
    what: str = "",
    *,
    emissivity: tuple[float, float] | None = None,
    ior: float | None = None,
    label: bool = True,
    opacity: float = 1.0,
) -> PartRange:
    """Return the role of a part of a material; emissivity and refractive index default to those of the material.

    Raises:
        KeyError: The material is unknown.
        ValueError: See `PartRange`.
    """
    m = MATERIALS[kind]
    return PartRange(
        delta_t_k,
        emissivity or m.emissivity,
        label,
        what,
        m.ior if ior is None else ior,
        kind,
        m.roughness,
        m.metal,
        opacity,
    )


def warm_ground_role(
    kind: str, delta_t_k: tuple[float, float], what: str, opacity: float, *, sheltered: bool = False
) -> PartRange:
    """Return the role of a sheet of ground that an object warms; `sheltered` as in `PartRange`.

    It is black, because the sky that ground mirrors is part of its apparent temperature already.
    """
    role = part_role(kind, delta_t_k, what, emissivity=(1.0, 1.0), ior=1.0, label=False, opacity=opacity)
    return replace(role, glow=True, ground=True, sheltered=sheltered)


@dataclass(frozen=True)
class ObjectModel:
    """Kind of object that can be inserted into a scene.

    Attributes:
        name: Name in the catalogue.
        category: Class of its labels unless a recipe renames it.
        description: Description in one sentence.
        origin: Position of the model's origin, in words.
        stands: Whether it stands on the ground, with its origin on the ground.
        parts: Thermal role of every part that `build` may name.
        sample: Function that draws `params` (JSON values only) from a stream; `options` fixes some of them. ModelError
            if an option is unknown or its value is invalid.
        build: Function that builds the mesh of `params`, without randomness; equal params give equal arrays. ModelError
            if a parameter is missing, unknown or out of range.
        options: Options that a recipe may set: name -> allowed values or range, in words.
        parts_for: Function that returns the thermal roles of the individual with given `params`, for models whose roles
            differ between individuals. It covers every part of the mesh with the same `label` as `parts`, which then
            contains typical roles.
        casts_shadow: Function that returns whether an individual stands still for long enough to throw a thermal shadow
            on the ground. `build` and `parts_for` then take `shadow_xy` in addition (`SHADOW_PARAM`): the shift of the
            shadow per metre of height, in the object's frame. None for models that always move.
        surfaces: Ground that a model stands on, by kind.
        needs: Function that returns the only ground, by kind, that an individual may stand on, whatever a recipe says
            about surfaces; None for one that is not bound. None for models without such individuals.
        animate: Function that returns the parameters of an individual at a phase in [0, 1) of its movement: a step of
            each leg, a beat of the wings. The same at phase 0 and 1, and unchanged for one that keeps still. None for
            models that never move so.
        stride_m: Function that returns how far an individual goes in one cycle, so that its feet do not slide; 0 for
            one that stays where it is. None for models without legs.
        cycle_hz: Function that returns the cycles per second of what moves independently of the ground, such as wings;
            0 for one whose phase follows from its way or that keeps still.
        skin_limit_c: Warmest that the skin of a living body gets, degrees Celsius; None without one. The roles of such
            a model are those in cool air.
    """

    name: str
    category: str
    description: str
    origin: str
    stands: bool
    parts: Mapping[str, PartRange]
    sample: Callable[[np.random.Generator, Params], Params]
    build: Callable[[Params], Mesh]
    options: Mapping[str, str] = field(default_factory=dict)
    parts_for: Callable[[Params], Mapping[str, PartRange]] | None = None
    casts_shadow: Callable[[Params], bool] | None = None
    surfaces: Affinity = field(default_factory=lambda: GROUND)
    needs: Callable[[Params], Affinity | None] | None = None
    animate: Callable[[Params, float], Params] | None = None
    stride_m: Callable[[Params], float] | None = None
    cycle_hz: Callable[[Params], float] | None = None
    skin_limit_c: float | None = None

    def roles(self, params: Params) -> Mapping[str, PartRange]:
        """Return the thermal role of every part of the individual with these parameters."""
        return self.parts if self.parts_for is None else self.parts_for(params)

    def needed_ground(self, params: Params) -> Affinity | None:
        """Return the only ground that the individual may stand on; None if it is not bound."""
        return None if self.needs is None else self.needs(params)


def moment(phase: float) -> float:
    """Return the phase in [0, 1) of the nearest moment of a cycle."""
    return round(phase * MOMENTS) % MOMENTS / MOMENTS


def warmed_by_sun(parts: Mapping[str, PartRange], sun_k: Range, shares: Mapping[str, float]) -> dict[str, PartRange]:
    """Return the thermal roles of a coat in the sun.

    `sun_k` is the rise of the back, kelvin, for scenes without a sun; parts without a share of it keep their role.
    """
    low, high = sun_k
    warmed = dict(parts)
    for name, share in shares.items():
        role = parts[name]
        coldest, warmest = role.delta_t_k
        delta = (coldest + share * low, warmest + share * high)
        warmed[name] = replace(role, delta_t_k=delta, sun=sun_response(role.kind, role.delta_t_k, "coat"))
    return warmed


def at_low_sun(night: Mapping[str, PartRange], day: Mapping[str, PartRange], time_of_day: str) -> dict[str, PartRange]:
    """Return the thermal roles at dusk or dawn of surfaces that follow the air within minutes.

    Without sunlight they are as by night at dawn, and halfway between that and the shade by day at dusk (est.).
    """
    share = 0.5 if time_of_day == "dusk" else 0.0
    roles = {}
    for name, role in night.items():
        sun = day[name].sun
        shade_k = role.delta_t_k if sun is None else between(role.delta_t_k, sun.shade_k, share)
        roles[name] = replace(role, delta_t_k=shade_k, sun=None if sun is None else replace(sun, shade_k=shade_k))
    return roles


@dataclass(frozen=True)
class Material:
    """Optical properties of one kind of surface.

    Attributes:
        emissivity: (low, high) at normal incidence.
        source: Source of the numbers.
        ior: Refractive index near 10 um of a smooth surface, which reflects more towards its rim; 1 for rough surfaces
            and metals, whose emissivity is the same at all angles.
        roughness: Roughness of reflections in [0, 1]; without effect on rough surfaces.
        metal: Whether the surface reflects at all angles, however rough it is.
    """

    emissivity: Range
    source: str
    ior: float = 1.0
    roughness: float = 0.1
    metal: bool = False


# Glass and carbon composites absorb: 1.7 + 0.8i and 2.0 + 0.6i. The real indices here reproduce their dependence on the
# angle within 3 % of the emissivity up to 75 degrees.
MATERIALS: Mapping[str, Material] = {
    "plastic": Material((0.94, 0.95), "PE, PP, PVC, ABS, PC; testo, ired.co.uk", 1.5, 0.15),
    "painted": Material((0.92, 0.96), "oil paint of any colour; testo", 1.5, 0.2),
    "car_paint": Material((0.92, 0.94), "any colour; HeatSeeker", 1.5, 0.05),
    "glass": Material((0.84, 0.88), "window glass, computed for the band: 0.86; testo: 0.86-0.94", 1.7, 0.02),
    "lens": Material((0.84, 0.90), "glass or coated plastic in front of a sensor (est.)", 1.5, 0.02),
    "polished_aluminium": Material((0.04, 0.06), "FLIR", 1.0, 0.05, True),
    "bare_aluminium": Material((0.06, 0.18), "rough sheet; FLIR", 1.0, 0.15, True),
    "weathered_aluminium": Material((0.83, 0.94), "old conductors and masts; FLIR", 1.0),
    "black_anodised": Material((0.94, 0.96), "aluminium, black anodised: 0.95; FLIR", 1.5, 0.3),
    "grey_anodised": Material((0.96, 0.98), "aluminium, light grey anodised: 0.97; FLIR", 1.5, 0.3),
    "galvanised_steel": Material((0.20, 0.30), "new: 0.25 (est.)", 1.0, 0.2, True),
    "weathered_steel": Material((0.60, 0.90), "galvanised, weathered (est.)", 1.0, 0.3, True),
    "oxidised_steel": Material((0.80, 0.90), "exhausts, rust (est.)"),
    "lacquered_metal": Material((0.80, 0.92), "wheel rims (est.)", 1.5, 0.1),
    "cfrp": Material((0.80, 0.90), "carbon fibre in epoxy, matt to glossy; computed 0.86 (est.)", 1.5, 0.1),
    "circuit_board": Material((0.88, 0.94), "lacquered boards, windings (est.)", 1.5, 0.2),
    "cavity": Material((0.94, 0.98), "openings, grilles, vents: many reflections inside (est.)"),
    "rubber": Material((0.93, 0.95), "tyres: 0.94; testo"),
    "fur": Material((0.97, 0.99), "coats of animals 0.95-0.98, a cavity at this scale (est.)"),
    "hair": Material((0.96, 0.98), "0.95-0.99; coats of horses"),
    "skin": Material((0.97, 0.985), "0.95-0.98; HeatSeeker, testo"),
    "eye": Material((0.97, 0.98), "wet, smooth (est.)", 1.33, 0.02),
    "antler": Material((0.94, 0.96), "antler, horn, bone, hoof: 0.95 (est.)"),
    "cloth": Material((0.94, 0.97), "cotton, wool, technical cloth: 0.95; testo"),
    "leather": Material((0.93, 0.96), "shoes (est.)"),
    "wood": Material((0.90, 0.95), "sawn, weathered (est.)"),
    "porcelain": Material((0.91, 0.93), "insulators, glazed: 0.92; testo", 1.5, 0.05),
    "concrete": Material((0.92, 0.93), "FLIR, testo"),
    "brick": Material((0.92, 0.94), "0.93; FLIR, testo"),
    "asphalt": Material((0.95, 0.97), "FLIR, testo"),
    "soil": Material((0.92, 0.95), "dry to wet; HeatSeeker"),
    "grass": Material((0.97, 0.99), "grass, leaves, canopy (est.)"),
    "water": Material((0.98, 0.99), "computed", 1.25, 0.02),
    "snow": Material((0.85, 0.98), "HeatSeeker"),
}


@dataclass(frozen=True)
class Sunlit:
    """Response of a material to sunlight.

    Attributes:
        absorptivity: (low, high) share of sunlight that it absorbs.
        exchange_w_m2_k: Heat that it loses per kelvin above its temperature in the shade, W m^-2 K^-1: to the air, by
            radiation, and inwards.
    """

    absorptivity: Range
    exchange_w_m2_k: float


# Radiation takes 4.5 W m^-2 K^-1 and moving air 10.3 v^0.6, v in m/s: about 15 to 20 together at 1 to 2 m/s.
# What is behind the surface takes the rest: little under hair and thick cloth, much under skin, where blood flows.
SUNLIT: Mapping[str, Sunlit] = {
    "cloth": Sunlit((0.30, 0.90), 25.0),
    "hair": Sunlit((0.80, 0.95), 20.0),
    "leather": Sunlit((0.60, 0.95), 28.0),
    "skin": Sunlit((0.55, 0.80), 45.0),
    "fur": Sunlit((0.60, 0.85), 27.0),
    "antler": Sunlit((0.50, 0.80), 30.0),
    "wood": Sunlit((0.50, 0.80), 22.0),
    "car_paint": Sunlit((0.30, 0.95), 22.0),
    "plastic": Sunlit((0.70, 0.95), 22.0),
    "painted": Sunlit((0.70, 0.95), 25.0),
    "glass": Sunlit((0.20, 0.50), 24.0),
    "rubber": Sunlit((0.85, 0.95), 30.0),
    "lacquered_metal": Sunlit((0.40, 0.80), 35.0),
    "oxidised_steel": Sunlit((0.70, 0.90), 35.0),
    "cavity": Sunlit((0.70, 0.95), 40.0),
}
