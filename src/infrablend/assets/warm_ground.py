"""Ground that a lying body has warmed: a translucent sheet under and beside it that adds light to the background.

Under a body that lies there for a time t, with a flow of heat q into the ground, the surface rises by
2 q sqrt(t / pi) / e (half-space with thermal effusivity e). When the body turns over or gets up, the rise falls to
2 q (sqrt(t + s) - sqrt(s)) / (e sqrt(pi)) after a time s. A flow of 30 to 60 W/m² and soil of 1,000
to 1,500 J m^-2 K^-1 s^-1/2 give 1 to 4 K after an hour, and half of that 10 minutes later.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from infrablend.assets.ground_sheet import hull_of, reach_of
from infrablend.assets.model import Params, PartRange, warm_ground_role
from infrablend.assets.params import Checks
from infrablend.assets.shapes import ring_strips
from infrablend.core.mesh import Mesh

PARAM = "warm_ground"
OPTION = (
    "share of those who lie or sleep around whom the ground is warm, because they have turned over in their place: a "
    "number from 0 to 1; by default 0"
)
# Outer distance of each ring from the body's outline, metres, and its opacity: the light of the sheet is its opacity
# times the excess, so that 0.55 of `_EXCESS_K` is seen in the middle.
_RINGS: Mapping[str, tuple[float, float]] = {"bed": (0.02, 0.55), "bed_rim": (0.10, 0.30), "bed_edge": (0.20, 0.08)}
_EXCESS_K = (1.0, 6.0)
_WHAT = "ground that the body has warmed (energy balance)"
PARTS: Mapping[str, PartRange] = {n: warm_ground_role("soil", _EXCESS_K, _WHAT, o) for n, (_, o) in _RINGS.items()}
_MOST_M = 0.35  # how far the body has moved from the middle of the warm ground
_CORNERS = 24
_LOW = 0.6  # share of its height below which a lying body touches the ground, or nearly


def drawn(rng: np.random.Generator, options: Params, checks: Checks, lies: bool) -> dict[str, Any]:
    """Draw where the ground is warm around an individual: the shift of its middle (x, y), metres; empty for nowhere.

    With the option, the stream gives three more numbers, whoever lies.
    """
    if PARAM not in options:
        return {}
    share = checks.number(f"option {PARAM}", options[PARAM], 0.0, 1.0)
    u, x, y = (float(v) for v in rng.random(3))
    return {PARAM: [_MOST_M * (2 * x - 1), _MOST_M * (2 * y - 1)]} if lies and u < share else {}


def check(params: Params, checks: Checks) -> None:
    """Raise ModelError if the shift is not two numbers of metres within its limits."""
    shift = params.get(PARAM)
    if shift is None:
        return
    if not isinstance(shift, list | tuple) or len(shift) != 2:
        raise checks.bad(f"parameter {PARAM}", shift, "[x, y] in metres")
    for value in shift:
        checks.number(f"parameter {PARAM}", value, -_MOST_M, _MOST_M)


def roles(params: Params) -> Mapping[str, PartRange]:
    """Return the thermal roles of the warm ground; empty for someone without."""
    return PARTS if params.get(PARAM) else {}


def with_warm_ground(mesh: Mesh, params: Params) -> Mesh:
    """Return the mesh of a lying body, metres, with the ground that it has warmed; as it is for one without."""
    if not params.get(PARAM):
        return mesh
    low = mesh.vertices_m[mesh.vertices_m[:, 2] <= _LOW * mesh.vertices_m[:, 2].max(), :2]
    hull = hull_of(low)
    centre = hull.mean(axis=0)
    around = np.linspace(0.0, 2 * np.pi, _CORNERS, endpoint=False)
    radius = reach_of(hull, centre, around)
    ways = np.stack([np.cos(around), np.sin(around)], axis=1)
    loops = [centre + (radius + out_m)[:, None] * ways for out_m, _ in _RINGS.values()]
    flat = np.concatenate([centre[None], *loops]) + np.asarray(params[PARAM], np.float64)
    i = np.arange(_CORNERS)
    fan = np.stack([np.zeros_like(i), i + 1, (i + 1) % _CORNERS + 1], axis=1)
    triangles = np.concatenate([fan, 1 + ring_strips(_CORNERS, len(loops))])
    first = len(mesh.part_names)
    parts = np.repeat(np.arange(first, first + len(_RINGS)), [_CORNERS, *[2 * _CORNERS] * (len(loops) - 1)])
    sheet = np.concatenate([flat, np.full((len(flat), 1), 0.005)], axis=1)
    return replace(
        mesh,
        vertices_m=np.concatenate([mesh.vertices_m, sheet]),
        triangles=np.concatenate([mesh.triangles, triangles + len(mesh.vertices_m)]).astype(np.int32),
        part_of_triangle=np.concatenate([mesh.part_of_triangle, parts]).astype(np.int32),
        part_names=(*mesh.part_names, *_RINGS),
        smooth=np.concatenate([mesh.smooth, np.ones(len(triangles), np.bool_)]),
    )
