"""Kinds of surface in a picture: what lies or stands at a pixel, for the virtual world and for maps of places."""

from __future__ import annotations

from typing import Literal, get_args

SurfaceKind = Literal[
    "road", "path", "track", "grass", "soil", "shrub", "tree", "structure", "water", "object", "sky", "margin"
]
"""`road`: carriageway, car park, runway; `path`: other paved ground, such as pavements, courts and plazas; `track`:
unpaved way; `soil`: bare or ploughed; `structure`: building, wall, mast; `object`: vehicle, person, two-wheeler;
`margin`: where the camera saw nothing."""

SURFACES: tuple[SurfaceKind, ...] = get_args(SurfaceKind)
"""All kinds; the number of a kind is its place here."""
