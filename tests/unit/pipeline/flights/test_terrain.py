"""Rays meet a height model where geometry says; what it does not cover is refused or named."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord
from infrablend.core.ground_position import LocalFrame
from infrablend.detection.detections import Predictions, detections
from infrablend.errors import DatasetError, MissingDependencyError
from infrablend.formats.maps.height_model import HeightGrid, read_heights
from infrablend.pipeline.flights.flight_poses import find_poses
from infrablend.pipeline.flights.place_settings import PlaceSettings
from infrablend.pipeline.flights.placed_detections import place_detections, place_flight
from infrablend.pipeline.flights.terrain import drop_m, on_terrain

pytest.importorskip("rasterio")

FRAME = LocalFrame(46.5, 11.3)
SIZE = (640, 512)


def write_model(
    path: Path, height: Callable[[np.ndarray, np.ndarray], np.ndarray], *, utm: bool = False, side_m: float = 3000
) -> Path:
    """Write heights, as a function of metres east and north, in cells of about 10 m."""
    import rasterio
    from rasterio.warp import transform

    n = int(side_m / 10)
    if utm:
        (x,), (y,) = transform("EPSG:4326", "EPSG:32632", [11.3], [46.5])
        bounds = (x - side_m / 2, y - side_m / 2, x + side_m / 2, y + side_m / 2)
        crs = "EPSG:32632"
    else:
        west, south = FRAME.to_degrees(-side_m / 2, -side_m / 2)[::-1]
        east, north = FRAME.to_degrees(side_m / 2, side_m / 2)[::-1]
        bounds = (west, south, east, north)
        crs = "EPSG:4326"
    west, south, east, north = bounds
    placed = rasterio.Affine((east - west) / n, 0, west, 0, (south - north) / n, north)
    columns, rows = np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5)
    xs, ys = placed.c + placed.a * columns.ravel(), placed.f + placed.e * rows.ravel()
    longitudes, latitudes = transform(crs, "EPSG:4326", xs.tolist(), ys.tolist())
    en = FRAME.to_metres(np.array(latitudes), np.array(longitudes))
    heights = height(en[:, 0], en[:, 1]).reshape(n, n).astype(np.float32)
    with rasterio.open(path, "w", driver="GTiff", width=n, height=n, count=1, dtype="float32", crs=crs,
                       transform=placed, nodata=-9999) as out:  # fmt: skip
        out.write(heights, 1)
    return path


def a_picture(name: str = "a", **facts: object) -> ImageRecord:
    known = {"pitch_deg": 45.0, "altitude_m": 80.0, "hfov_deg": 45.0, "latitude_deg": 46.5, "longitude_deg": 11.3,
             "yaw_deg": 90.0, "roll_deg": 0.0, "altitude_from": "take-off", "sequence": "f"}  # fmt: skip
    return ImageRecord(name, Path(f"{name}.jpg"), "test", SIZE, (), Capture(**{**known, **facts}))


def middle_of(*names: str) -> Predictions:
    found = {f"test/{n}.jpg": detections([[310, 256, 330, 256]], [0.9], [0]) for n in names}
    return Predictions("detect", ("person",), found, dict.fromkeys(found, SIZE))


def ramp(east: np.ndarray, north: np.ndarray) -> np.ndarray:
    return 1000 + 0.2 * east + 0.1 * north


@pytest.mark.parametrize("utm", [False, True])
def test_a_grid_has_the_heights_of_the_model(tmp_path: Path, *, utm: bool) -> None:
    path = write_model(tmp_path / "m.tif", ramp, utm=utm)
    grid = read_heights(path, FRAME, np.array([-500.0, -500.0]), np.array([500.0, 500.0]))
    en = np.array([[0.0, 0.0], [123.0, -456.0], [-333.0, 250.0], [900.0, 0.0]])
    # Resampling keeps a plane but for the turn of the coordinates within a cell.
    assert grid.at(en)[:3] == pytest.approx(ramp(*en[:3].T), abs=0.1)
    assert math.isnan(grid.at(en)[3])


@pytest.mark.parametrize("east_camera", [0.0, 200.0])
def test_a_ray_up_a_slope_ends_early(tmp_path: Path, east_camera: float) -> None:
    """At 45 degrees along a rise of 0.2, a camera 80 m above it sees the ground at 80 / 1.2 m."""
    longitude = float(FRAME.to_degrees(east_camera, 0.0)[1])
    images = [a_picture("a", captured="2024-05-01T10:00:00"),
              a_picture("b", captured="2024-05-01T10:01:00", longitude_deg=longitude)]  # fmt: skip
    poses, terrain = on_terrain(write_model(tmp_path / "m.tif", ramp), images, find_poses(images), None)
    placed, nowhere = place_detections(middle_of("b"), poses, terrain)
    # The camera keeps its height above take-off, so the slope rises below it.
    above = 80 - 0.2 * east_camera
    en = FRAME.to_metres(placed[0].latitude_deg, placed[0].longitude_deg)
    assert en == pytest.approx([east_camera + above / 1.2, 0], abs=0.6)
    assert poses.known["test/b.jpg"].height_m == pytest.approx(above / 1.2, abs=0.6)
    assert poses.known["test/b.jpg"].errors["height_m"].source == "height above take-off, height model"
    assert nowhere == 0


def test_a_given_take_off_and_a_laser_count(tmp_path: Path) -> None:
    model = write_model(tmp_path / "m.tif", ramp)
    take_off = tuple(FRAME.to_degrees(-300.0, 0.0).tolist())
    image = a_picture(pitch_deg=90.0)
    lower, _ = on_terrain(model, [image], find_poses([image]), take_off)
    assert lower.known["test/a.jpg"].height_m == pytest.approx(20, abs=0.2)
    laser = a_picture(altitude_from="laser")
    same, _ = on_terrain(model, [laser], find_poses([laser]), take_off)
    assert same.known["test/a.jpg"].height_m == pytest.approx(80, abs=0.1)
    assert same.known["test/a.jpg"].errors["height_m"].source == "laser"


def test_a_hill_hides_what_is_behind() -> None:
    heights = np.zeros((100, 100))
    heights[:, 60:63] = 50.0
    grid = HeightGrid(heights, np.array([0.0, 0.0]), 10.0)
    ray = np.array([1.0, 0.0, -0.1])
    # From 60 m at 105 m east, the ray meets the near slope of the hill between 595 and 605 m east.
    drop = drop_m(grid, np.array([105.0, 500.0]), 60.0, ray)
    east = 105 + drop * 10
    assert east == pytest.approx(595 + (60 - drop) / 50 * 10, abs=1e-6)
    assert math.isnan(drop_m(grid, np.array([605.0, 500.0]), 40.0, ray))
    assert math.isnan(drop_m(grid, np.array([700.0, 500.0]), 60.0, ray))
    assert math.isnan(drop_m(HeightGrid(heights * np.nan, grid.low, 10.0), np.array([105.0, 500.0]), 60.0, ray))


def test_what_the_model_does_not_cover_is_refused_or_named(tmp_path: Path) -> None:
    image = a_picture()
    poses = find_poses([image])
    with pytest.raises(DatasetError) as caught:
        on_terrain(write_model(tmp_path / "m.tif", ramp), [image], poses, (46.6, 11.3))
    assert "no height at take-off, 46.60000, 11.30000" in str(caught.value.problems[0])
    small, _ = on_terrain(write_model(tmp_path / "s.tif", ramp, side_m=100), [image], poses, None)
    assert "height model" in small.lacking["test/a.jpg"]
    deep = a_picture(altitude_m=30.0, longitude_deg=float(FRAME.to_degrees(400.0, 0.0)[1]))
    below, _ = on_terrain(tmp_path / "m.tif", [deep], find_poses([deep]), (46.5, 11.3))
    assert below.known == {}
    (tmp_path / "x.tif").write_bytes(b"II*\0")
    with pytest.raises(DatasetError, match="not a height model"):
        on_terrain(tmp_path / "x.tif", [image], poses, None)


def test_detections_stay_where_the_model_is_refused(tmp_path: Path) -> None:
    settings = PlaceSettings(terrain=write_model(tmp_path / "m.tif", ramp), take_off=(46.6, 11.3))
    places = place_flight("flight", [a_picture()], middle_of("a"), settings)
    assert [(p.code, p.severity) for p in places.problems] == [("terrain", "error")]
    assert (len(places.placed), places.to_json()["pictures"]) == (0, 0)
    assumed = place_flight("flight", [a_picture()], middle_of("a"), PlaceSettings(terrain=settings.terrain))
    assert [p.code for p in assumed.problems] == ["take-off"]
    assert len(assumed.placed) == 1


def test_rasterio_is_named_where_it_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(MissingDependencyError, match=r"infrablend\[terrain\]"):
        read_heights(tmp_path / "m.tif", FRAME, np.zeros(2), np.ones(2))
