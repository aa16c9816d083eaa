"""Kinds of surface in a picture: what lies or stands at a pixel, for the virtual world and for maps of places."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

SurfaceKind = Literal[
    "road", "path", "track", "grass", "soil", "shrub", "tree", "structure", "water", "object", "sky", "margin"
]
"""`road`: carriageway, car park, runway; `path`: other paved ground, such as pavements, courts and plazas; `track`:
unpaved way; `soil`: bare or ploughed; `structure`: building, wall, mast; `object`: vehicle, person, two-wheeler;
`margin`: where the camera saw nothing."""

SURFACES: tuple[SurfaceKind, ...] = get_args(SurfaceKind)
"""All kinds; the number of a kind is its place here."""

Affinity = Mapping[SurfaceKind, float]
"""How often objects of some kind are on each kind of surface, where there is as much of each: 0 never, 1 most often.
Surfaces that are not named have none."""

GROUND: Affinity = {"road": 1.0, "path": 1.0, "track": 1.0, "grass": 1.0, "soil": 1.0}
"""All ground to stand on alike."""
