"""Mixed drone model: every object is one of the drones that people fly, from a folding quadrotor to a fixed wing.

Each shape is one of the other drone models with certain options, and gives exactly the objects of that model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from infrablend.assets import camera_quad, drone, fixed_wing, hexacopter, racer, shapes
from infrablend.assets.model import ObjectModel, Params, PartRange
from infrablend.assets.params import Checks
from infrablend.assets.rotors import PROPELLERS
from infrablend.core.mesh import Mesh

_CHECKS = Checks("drones")


@dataclass(frozen=True)
class Shape:
    """One kind of drone.

    Attributes:
        model: Model that draws and builds it.
        odds: Default share of this kind among the objects.
        options: Options of the model for this kind.
    """

    model: ObjectModel
    odds: float
    options: Params = field(default_factory=dict)


# Folding camera drones are by far the most common; shares of the rest are estimates.
SHAPES: Mapping[str, Shape] = {
    "folding-quad": Shape(
        drone.MODEL,
        0.34,
        {
            "size_m": [0.21, 0.42], "body": "shell", "arm": "moulded", "layout": ["x", "deadcat"], "legs": "feet",
            "batteries": 1, "antennas": 0, "mast": False, "camera": True,
        },
    ),
    "camera-quad": Shape(camera_quad.MODEL, 0.16),
    "quad": Shape(drone.MODEL, 0.14, {"size_m": [0.42, 0.75]}),
    "large-quad": Shape(
        drone.MODEL, 0.10, {"size_m": [0.85, 1.25], "body": "industrial", "layout": ["x", "deadcat"], "arm": "tube"}
    ),
    "hexacopter": Shape(hexacopter.MODEL, 0.08),
    "racer": Shape(racer.MODEL, 0.08),
    "fixed-wing": Shape(fixed_wing.MODEL, 0.10),
}  # fmt: skip
# Attitude of level models, in cruise or moving sideways: nose down by `lean_deg`, right side down by `bank_deg`.
TILT_DEG: Mapping[str, tuple[float, float]] = {"lean_deg": (-4.0, 18.0), "bank_deg": (-10.0, 10.0)}
OPTIONS: Mapping[str, str] = {
    "shape": "one of " + ", ".join(SHAPES) + ", a list of several, or each with its weight; by default folding quads "
    "are the most common",
    "size_m": "motor diagonal or wingspan: a number or [low, high]; by default that of the shape",
    "propellers": "still (default), spinning, or a list of both; spinning ones are discs that labels ignore",
}


def sample_params(rng: np.random.Generator, options: Params) -> Params:
    """Draw the parameters of one drone of any shape, JSON values only."""
    _CHECKS.known("option", options, tuple(OPTIONS))
    odds = [shape.odds for shape in SHAPES.values()]
    name = _CHECKS.choose("shape", options, tuple(SHAPES), odds, float(rng.random()))
    shape = SHAPES[name]
    own = {k: v for k, v in options.items() if k != "shape"}
    if "propellers" in own:
        _CHECKS.some_of("option propellers", own["propellers"], PROPELLERS)
    params = {"shape": name, **shape.model.sample(rng, {**shape.options, **own})}
    tilt = {key: low + (high - low) * float(rng.random()) for key, (low, high) in TILT_DEG.items()}
    return {**params, **tilt} if _is_level(shape) else params


def build(params: Params) -> Mesh:
    """Build the mesh of one drone.

    Its origin is the centre of its bounding box without propellers and antennas, before it is tilted.
    """
    shape = _shape(params)
    mesh = shape.model.build(_own(params))
    if not _is_level(shape):
        return mesh
    _CHECKS.complete(params, tuple(TILT_DEG))
    lean, bank = (_CHECKS.number(f"parameter {key}", params[key], -45, 45) for key in TILT_DEG)
    turn = shapes.attitude(-lean, bank)
    return replace(mesh, vertices_m=np.ascontiguousarray(mesh.vertices_m @ turn.T))


def parts_for(params: Params) -> Mapping[str, PartRange]:
    """Return the thermal role of every part of this drone."""
    return _shape(params).model.roles(_own(params))


def _shape(params: Params) -> Shape:
    _CHECKS.complete(params, ("shape",))
    return SHAPES[_CHECKS.one_of("parameter shape", params["shape"], tuple(SHAPES))]


def _is_level(shape: Shape) -> bool:
    return shape.model is drone.MODEL


def _own(params: Params) -> Params:
    other = {"shape", *(TILT_DEG if _is_level(_shape(params)) else ())}
    return {k: v for k, v in params.items() if k not in other}


def _typical_parts() -> dict[str, PartRange]:
    """Return the parts of all shapes; if several shapes have a part of the same name, the first shape's is used."""
    parts: dict[str, PartRange] = {}
    for shape in SHAPES.values():
        parts = {**shape.model.parts, **parts}
    return parts


MODEL = ObjectModel(
    name="drones",
    category="drone",
    description="A drone of any shape: folding, moulded, medium or large quadrotor, hexacopter, racer or fixed wing.",
    origin="the centre of its bounding box without propellers and antennas",
    stands=False,
    parts=_typical_parts(),
    sample=sample_params,
    build=build,
    options=OPTIONS,
    parts_for=parts_for,
)
