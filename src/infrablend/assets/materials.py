"""Surface materials: emissivity in the thermal band and reflection.

Emissivities are for 8-14 um at normal incidence. Sources: the emissivity tables of FLIR (T505002), testo,
ired.co.uk and Ideal Industries (HeatSeeker manual), and a study of horses' coats for fur. "Computed" values follow from
the refractive index; "est." marks estimates. `docs/how_to/infrared_effect.md` shows this table.

`SUNLIT` has the response to sunlight: what docs/explanation/physical_look.md says under "Sunlight", with its sources.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

Range = tuple[float, float]


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
