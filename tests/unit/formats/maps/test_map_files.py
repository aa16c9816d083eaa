"""GeoJSON, KML and GPX hold the places that they are given, as their standards ask."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from defusedxml import ElementTree

from infrablend.formats.maps.map_files import MapFeature, write_geojson, write_gpx, write_kml

PLACE = MapFeature("a/1.jpg 1", "person <0.9>", "4 m & \x07more", np.array([[-1.45851051, -48.44681041]]),
                   properties={"score": 0.9})  # fmt: skip
# Clockwise: north-west, north-east, south-east, south-west.
AREA = MapFeature("b", "picture", "", np.array([[1.0, 2.0], [1.0, 3.0], [0.0, 3.0], [0.0, 2.0]]), "#0072b2")
KML = "{http://www.opengis.net/kml/2.2}"
GPX = "{http://www.topografix.com/GPX/1/1}"


def signed_area(ring: list[list[float]]) -> float:
    x, y = np.array(ring[:-1]).T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2)


def test_geojson_has_longitude_first_and_rings_as_asked(tmp_path: Path) -> None:
    data = json.loads(write_geojson(tmp_path / "a.geojson", [PLACE, AREA]).read_text("utf-8"))
    place, area = data["features"]
    assert data.keys() == {"type", "features"}
    assert place["geometry"] == {"type": "Point", "coordinates": [-48.4468104, -1.4585105]}
    assert (place["id"], place["properties"]["score"], place["properties"]["title"]) == ("a/1.jpg 1", 0.9, PLACE.title)
    assert place["properties"]["marker-color"] == "#d55e00"
    (ring,) = area["geometry"]["coordinates"]
    assert ring[0] == ring[-1]
    assert signed_area(ring) == pytest.approx(1.0)
    assert area["properties"]["stroke"] == "#0072b2"


def test_kml_has_places_and_areas_on_the_ground(tmp_path: Path) -> None:
    top = ElementTree.parse(write_kml(tmp_path / "a.kml", "flight", [PLACE, AREA])).getroot()
    place, area = top.iter(f"{KML}Placemark")
    assert place.find(f"{KML}name").text == "person <0.9>"
    assert place.find(f"{KML}description").text == "4 m &  more"
    point = place.find(f".//{KML}Point")
    assert point.find(f"{KML}coordinates").text == "-48.4468104,-1.4585105"
    assert point.find(f"{KML}altitudeMode").text == "clampToGround"
    assert place.find(f".//{KML}color").text == "ff005ed5"
    assert len(area.find(f".//{KML}LinearRing/{KML}coordinates").text.split()) == 5


def test_gpx_has_waypoints(tmp_path: Path) -> None:
    top = ElementTree.parse(write_gpx(tmp_path / "a.gpx", [PLACE])).getroot()
    (point,) = top.iter(f"{GPX}wpt")
    assert point.attrib == {"lat": "-1.4585105", "lon": "-48.4468104"}
    assert point.find(f"{GPX}name").text == "person <0.9>"
    assert top.attrib["version"] == "1.1"


def test_the_same_features_give_the_same_bytes(tmp_path: Path) -> None:
    for name, write in (("a.geojson", write_geojson), ("a.gpx", write_gpx)):
        once = write(tmp_path / name, [PLACE]).read_bytes()
        assert write(tmp_path / f"again {name}", [PLACE]).read_bytes() == once
