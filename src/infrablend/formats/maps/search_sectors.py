"""Reads the sectors of a search from GeoJSON: polygons, each with its name.

Rings may run either way round, and need not be closed. What a map would show in the wrong place is refused: other
coordinates than WGS 84, positions off the earth, rings that cross or touch themselves, and sectors far from the flight.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.files import load_json
from infrablend.core.ground_position import EARTH_M
from infrablend.core.mesh import FloatArray
from infrablend.errors import DatasetError, Problem

FARTHEST_M = 20_000.0
"""Sectors farther from every picture belong to another search."""
# What programs write for WGS 84; in GeoJSON the longitude comes first with each of them.
_CRS84 = (
    "urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:OGC::CRS84", "OGC:CRS84", "EPSG:4326",
    "urn:ogc:def:crs:EPSG::4326",
)  # fmt: skip
_EXPECTED = "rings of [longitude, latitude] in degrees, at least three corners each"


@dataclass(frozen=True, eq=False)
class Sector:
    """An area of a search.

    Attributes:
        name: Its `title` or `name`, else its `id`, else its number.
        rings: (n, 2) latitude and longitude of the corners of each ring, outer ones and holes.
    """

    name: str
    rings: tuple[FloatArray, ...]

    def contains(self, latlon: FloatArray) -> NDArray[np.bool_]:
        """Mark which of (n, 2) latitudes and longitudes are in the sector and in none of its holes."""
        inside = np.zeros(len(latlon), np.bool_)
        y, x = latlon[:, 0], latlon[:, 1]
        for ring in self.rings:
            for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
                between = (a[0] > y) != (b[0] > y)
                rise = b[0] - a[0] if b[0] != a[0] else 1.0
                inside ^= between & (x < a[1] + (y - a[0]) / rise * (b[1] - a[1]))
        return inside


def read_sectors(path: Path, cameras: FloatArray) -> tuple[list[Sector], list[Problem]]:
    """Return the sectors of a GeoJSON file, and a warning about each that lies elsewhere, which is left out.

    Args:
        path: The file.
        cameras: (n, 2) latitude and longitude of the flight's pictures, n at least 1.

    Raises:
        DatasetError: The file cannot be used; `problems` lists all that is wrong with it.
    """
    try:
        data = load_json(path)
    except (OSError, ValueError) as error:
        raise _refused(path, [Problem(path.name, "sectors", f"cannot be read: {error}"[:200], "GeoJSON")]) from error
    problems = []
    if isinstance(data, dict) and (crs := _coordinates_of(data.get("crs"))):
        todo = "export the layer in WGS 84 (EPSG:4326) as GeoJSON of RFC 7946"
        problems.append(Problem(path.name, "sectors", f"coordinates in {crs}", "WGS 84, without crs", todo))
    near = []
    elsewhere = []
    found = list(_features(data))
    if not found:
        problems.append(Problem(path.name, "sectors", "no features", "a FeatureCollection of polygons"))
    for number, (properties, geometry) in enumerate(found, 1):
        name = str(properties.get("title") or properties.get("name") or properties.get("id") or f"sector {number}")
        where = f"{path.name}, feature {number} ({name[:40]})"
        rings, faults = _rings(geometry)
        problems += [Problem(where, "sectors", *fault) for fault in faults]
        if faults:
            continue
        away_m = _distance_m(rings, cameras)
        if away_m <= FARTHEST_M:
            near.append(Sector(name, rings))
        else:
            swapped = _distance_m(tuple(r[:, ::-1] for r in rings), cameras) <= FARTHEST_M
            todo = "swap the coordinates: GeoJSON has the longitude first" if swapped else ""
            text = f"{away_m / 1000:.0f} km from the nearest picture, left out"
            expected = f"a sector within {FARTHEST_M / 1000:.0f} km"
            elsewhere.append(Problem(where, "sectors", text, expected, todo, "warning"))
    if problems or not near:
        raise _refused(path, [*problems, *elsewhere])
    return near, elsewhere


def _refused(path: Path, problems: list[Problem]) -> DatasetError:
    return DatasetError(f"{path}: the sectors cannot be used", problems)


def _features(data: Any) -> Iterator[tuple[Mapping[str, object], Any]]:
    """Yield properties, with the id, and geometry of each feature; of a geometry alone, without properties."""
    if not isinstance(data, dict):
        return
    features = data.get("features") if data.get("type") == "FeatureCollection" else [data]
    for one in features if isinstance(features, list) else ():
        if isinstance(one, dict) and one.get("type") == "Feature":
            properties = one.get("properties")
            yield {"id": one.get("id"), **(properties if isinstance(properties, dict) else {})}, one.get("geometry")
        else:
            yield {}, one


def _coordinates_of(crs: object) -> str | None:
    """Return what a `crs` says that is not WGS 84 with the longitude first."""
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else crs
    return None if crs is None or name in _CRS84 else str(name)[:60]


def _rings(geometry: Any) -> tuple[tuple[FloatArray, ...], list[tuple[str, str]]]:
    """Return (n, 2) latitude and longitude of each ring of a geometry, and what is wrong with it."""
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    if kind not in ("Polygon", "MultiPolygon"):
        return (), [(f"a geometry of type {kind}", "Polygon or MultiPolygon")]
    parts = [geometry.get("coordinates")] if kind == "Polygon" else geometry.get("coordinates")
    rings = []
    faults = []
    try:
        for ring in (np.array([p[:2] for p in r], np.float64) for part in parts for r in part):
            corners = ring.reshape(-1, 2)[:, ::-1]
            # The corner that closes a ring, and those that are written twice, are no edges.
            rings.append(corners[(corners != np.roll(corners, -1, axis=0)).any(axis=1)])
    except (TypeError, ValueError, IndexError):
        return (), [("coordinates that are no positions", _EXPECTED)]
    if not rings or min(map(len, rings)) < 3:
        faults.append(("a ring of fewer than three corners", _EXPECTED))
    for ring in rings:
        off = ring[~((np.abs(ring) <= (90.0, 180.0)).all(axis=1))]
        if len(off):
            at = f"longitude {off[0, 1]:g}, latitude {off[0, 0]:g}"
            faults.append((at, "longitudes of -180 to 180 and latitudes of -90 to 90, in this order"))
        elif (crossing := _crossing(ring)) is not None:
            at = f"a ring that crosses or touches itself near longitude {crossing[1]:.5f}, latitude {crossing[0]:.5f}"
            faults.append((at, "a simple outline"))
    return tuple(rings), faults


def _crossing(ring: FloatArray) -> FloatArray | None:
    """Return the first corner of an edge that another one than its neighbours crosses or touches; None without any."""
    a = ring - ring[0]
    b = np.roll(a, -1, axis=0)
    for k in range(len(a)):
        meets = (_side(a[k], b[k], a) * _side(a[k], b[k], b) <= 0) & (_side(a, b, a[k]) * _side(a, b, b[k]) <= 0)
        # Edges along one line have a side of 0, however far apart.
        meets &= ((np.minimum(a, b) <= np.maximum(a[k], b[k])) & (np.maximum(a, b) >= np.minimum(a[k], b[k]))).all(
            axis=1
        )
        meets[[k - 1, k, (k + 1) % len(a)]] = False
        if meets.any():
            return np.asarray(ring[k])
    return None


def _side(a: FloatArray, b: FloatArray, points: FloatArray) -> FloatArray:
    """Return on which side of the line from a to b points are, as a sign."""
    along = b - a
    off = points - a
    return np.asarray(along[..., 0] * off[..., 1] - along[..., 1] * off[..., 0])


def _distance_m(rings: tuple[FloatArray, ...], cameras: FloatArray) -> float:
    """Return metres from the box around the rings to the nearest camera."""
    corners = np.concatenate(rings)
    nearest = np.clip(cameras, corners.min(axis=0), corners.max(axis=0))
    (lat, lon), (camera_lat, camera_lon) = np.radians(nearest).T, np.radians(cameras).T
    half = np.sin((lat - camera_lat) / 2) ** 2 + np.cos(lat) * np.cos(camera_lat) * np.sin((lon - camera_lon) / 2) ** 2
    return float(2 * EARTH_M * np.arcsin(np.sqrt(half.clip(0, 1))).min())
