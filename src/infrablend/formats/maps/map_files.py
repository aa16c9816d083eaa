"""Writes places and areas for maps: GeoJSON (RFC 7946), KML and GPX 1.1.

GeoJSON has the names that CalTopo gives to properties (`title`, `description`, `marker-color`, `stroke`), beside those
of the feature. Positions are WGS 84, longitude first, with seven decimals (1 cm); rings are closed and run
counter-clockwise. The same features give the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from infrablend.core.files import write_json, write_text
from infrablend.core.mesh import FloatArray

_DECIMALS = 7


@dataclass(frozen=True, eq=False)
class MapFeature:
    """A place or an area on a map.

    Attributes:
        id: Name that is unique in its file.
        title: What maps write beside it.
        description: Further text.
        outline: (n, 2) latitude and longitude, degrees: of a place if n is 1, else of the corners of an area.
        colour: Colour as `#rrggbb`.
        properties: Further properties, JSON values by name.
    """

    id: str
    title: str
    description: str
    outline: FloatArray
    colour: str = "#d55e00"
    properties: Mapping[str, object] = field(default_factory=dict)

    @property
    def is_place(self) -> bool:
        """Whether it is a point."""
        return len(self.outline) == 1


def write_geojson(path: Path, features: Iterable[MapFeature]) -> Path:
    """Write features as a GeoJSON file.

    Raises:
        OutputError: The file cannot be written.
    """
    rows = []
    for f in features:
        look = {"marker-color": f.colour, "marker-size": "medium"} if f.is_place else {"stroke": f.colour}
        named = {"title": f.title, "description": f.description}
        rows.append(
            {"type": "Feature", "id": f.id, "geometry": _geometry(f), "properties": {**look, **named, **f.properties}}
        )
    return write_json(path, {"type": "FeatureCollection", "features": rows})


def write_kml(path: Path, name: str, features: Iterable[MapFeature]) -> Path:
    """Write features as a KML file, whose things lie on the ground.

    Raises:
        OutputError: The file cannot be written.
    """
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Document>',
        f"<name>{_text(name)}</name>",
    ]
    for f in features:
        # KML's colours are opacity, blue, green and red.
        colour = f"ff{f.colour[5:7]}{f.colour[3:5]}{f.colour[1:3]}"
        style = f"<IconStyle><color>{colour}</color></IconStyle><LineStyle><color>{colour}</color></LineStyle>"
        style += "<PolyStyle><fill>0</fill></PolyStyle>"
        lines += [
            f"<Placemark><name>{_text(f.title)}</name>",
            f"<description>{_text(f.description)}</description><Style>{style}</Style>",
            f"{_kml_geometry(f)}</Placemark>",
        ]
    return write_text(path, "\n".join([*lines, "</Document></kml>", ""]))


def write_gpx(path: Path, places: Iterable[MapFeature]) -> Path:
    """Write places as waypoints of a GPX file, which knows no areas: what belongs to a place is in its description.

    Raises:
        OutputError: The file cannot be written.
    """
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<gpx version="1.1" creator="InfraBlend" xmlns="http://www.topografix.com/GPX/1/1">',
    ]
    for f in places:
        ((longitude, latitude),) = _positions(f)
        named = f"<name>{_text(f.title)}</name><desc>{_text(f.description)}</desc>"
        lines.append(f'<wpt lat="{latitude:.7f}" lon="{longitude:.7f}">{named}</wpt>')
    return write_text(path, "\n".join([*lines, "</gpx>", ""]))


def _printable(text: str) -> str:
    """Return the text without control characters, which XML cannot hold."""
    return "".join(c if c.isprintable() else " " for c in text)


def _text(text: str) -> str:
    return escape(_printable(text))


def _positions(f: MapFeature) -> Sequence[tuple[float, float]]:
    """Return longitude and latitude of a place, or those of the closed ring of an area, counter-clockwise."""
    ring = f.outline[:, ::-1]
    if not f.is_place:
        x, y = (ring - ring[0]).T
        turns_left = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) >= 0
        ring = ring if turns_left else ring[::-1]
        ring = np.vstack([ring, ring[:1]])
    # Without negative zeros.
    return [(round(x, _DECIMALS) + 0.0, round(y, _DECIMALS) + 0.0) for x, y in ring.tolist()]


def _geometry(f: MapFeature) -> dict[str, object]:
    positions = _positions(f)
    if f.is_place:
        return {"type": "Point", "coordinates": positions[0]}
    return {"type": "Polygon", "coordinates": [positions]}


def _kml_geometry(f: MapFeature) -> str:
    text = " ".join(f"{x:.7f},{y:.7f}" for x, y in _positions(f))
    clamped = "<altitudeMode>clampToGround</altitudeMode>"
    if f.is_place:
        return f"<Point>{clamped}<coordinates>{text}</coordinates></Point>"
    ring = f"<LinearRing><coordinates>{text}</coordinates></LinearRing>"
    return f"<Polygon>{clamped}<outerBoundaryIs>{ring}</outerBoundaryIs></Polygon>"
