"""Sectors of a search are read whichever way they run; what is wrong with a file is named, all at once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infrablend.errors import DatasetError
from infrablend.formats.maps.search_sectors import read_sectors

CAMERAS = np.array([[46.5, 11.3], [46.501, 11.301]])
SQUARE = [[11.2, 46.4], [11.4, 46.4], [11.4, 46.6], [11.2, 46.6], [11.2, 46.4]]
HOLE = [[11.29, 46.49], [11.29, 46.51], [11.31, 46.51], [11.31, 46.49], [11.29, 46.49]]


def feature(rings: Any, kind: str = "Polygon", **properties: object) -> dict[str, object]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": rings}}


def a_file(folder: Path, *features: object, **more: object) -> Path:
    path = folder / "sectors.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features, **more}))
    return path


def refused(path: Path) -> list[str]:
    with pytest.raises(DatasetError) as caught:
        read_sectors(path, CAMERAS)
    return [str(p) for p in caught.value.problems]


@pytest.mark.parametrize("ring", [SQUARE, SQUARE[::-1], SQUARE[:-1]])
def test_rings_may_run_either_way_and_be_open(tmp_path: Path, ring: list[list[float]]) -> None:
    (sector,), problems = read_sectors(a_file(tmp_path, feature([ring, HOLE], title="A")), CAMERAS)
    assert (sector.name, problems) == ("A", [])
    places = np.array([[46.45, 11.25], [46.5, 11.3], [46.5, 11.5], [46.59, 11.39], [46.7, 11.3]])
    assert sector.contains(places).tolist() == [True, False, False, True, False]


def test_several_polygons_are_one_sector(tmp_path: Path) -> None:
    east = [[x + 0.5, y] for x, y in SQUARE]
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}}
    (sector,), _ = read_sectors(a_file(tmp_path, feature([[SQUARE], [east]], "MultiPolygon"), crs=crs), CAMERAS)
    assert sector.name == "sector 1"
    assert sector.contains(np.array([[46.5, 11.3], [46.5, 11.8], [46.5, 11.5]])).tolist() == [True, True, False]


def test_all_faults_are_named_at_once(tmp_path: Path) -> None:
    crossed = [SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3], SQUARE[0]]
    swapped = [[46.4, 111.2], [46.6, 111.2], [46.6, 111.4]]
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
    features = [
        feature([crossed], name="crossed"), feature([swapped]), feature([SQUARE[:2]]), feature(SQUARE, "LineString"),
        feature([["a"]]), None,
    ]  # fmt: skip
    found = refused(a_file(tmp_path, *features, crs=crs))
    assert len(found) == 7
    for text, part in zip(found, ("EPSG::25832", "crosses or touches itself near longitude 11.20000, latitude 46.40000",
                                  "longitude 46.4, latitude 111.2", "fewer than three", "LineString", "no positions",
                                  "type None"), strict=True):  # fmt: skip
        assert part in text
    assert "feature 1 (crossed)" in found[1]


def test_rings_that_touch_themselves_are_refused_and_double_corners_are_not(tmp_path: Path) -> None:
    bowtie = [[11.2, 46.4], [11.3, 46.5], [11.4, 46.4], [11.4, 46.6], [11.3, 46.5], [11.2, 46.6]]
    on_an_edge = [*SQUARE[:2], [11.4, 46.5], [11.3, 46.4], [11.2, 46.6]]
    for ring in (bowtie, on_an_edge):
        (found,) = refused(a_file(tmp_path, feature([ring])))
        assert "crosses or touches itself" in found
    halves = [[11.2, 46.4], [11.25, 46.4], [11.3, 46.4], [11.4, 46.4], [11.4, 46.4], [11.4, 46.6], [11.2, 46.6]]
    (sector,), _ = read_sectors(a_file(tmp_path, feature([halves])), CAMERAS)
    assert len(sector.rings[0]) == 6


def test_a_sector_elsewhere_is_left_out_and_named(tmp_path: Path) -> None:
    far = [[x + 2, y] for x, y in SQUARE]
    kept, problems = read_sectors(a_file(tmp_path, feature([SQUARE]), feature([far], title="B")), CAMERAS)
    assert [s.name for s in kept] == ["sector 1"]
    assert "feature 2 (B): 145 km from the nearest picture, left out" in str(problems[0])
    swapped = [[y, x] for x, y in SQUARE]
    (found,) = refused(a_file(tmp_path, feature([swapped])))
    assert "Swap the coordinates" in found


@pytest.mark.parametrize("text", ["", "[1]", "{}", '{"type": "FeatureCollection", "features": 3, "crs": 4}', "{nan"])
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.geojson"
    path.write_text(text)
    assert refused(path)
