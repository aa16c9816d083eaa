"""Detections lie where their pictures saw them; pictures without a pose are named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord
from infrablend.core.ground_position import LocalFrame, Pose, PoseErrors, pixels_of_ground
from infrablend.detection.detections import Predictions, detections
from infrablend.errors import ArgumentError
from infrablend.pipeline.flights.flight_poses import find_poses
from infrablend.pipeline.flights.place_settings import PlaceSettings
from infrablend.pipeline.flights.placed_detections import (
    draw_maps,
    ground_contact,
    place_detections,
    place_flight,
    write_maps,
)

SIZE = (640, 512)


def a_picture(name: str, **facts: object) -> ImageRecord:
    known = {"pitch_deg": 90.0, "altitude_m": 50.0, "hfov_deg": 45.0, "latitude_deg": 46.5, "longitude_deg": 11.3,
             "yaw_deg": 0.0, "roll_deg": 0.0}  # fmt: skip
    return ImageRecord(name, Path(f"{name}.jpg"), "test", SIZE, (), Capture(**{**known, **facts}))


def predictions(boxes: dict[str, list[list[float]]]) -> Predictions:
    found = {f"test/{k}.jpg": detections(b, [0.9 - 0.1 * n for n in range(len(b))], [0] * len(b))
             for k, b in boxes.items()}  # fmt: skip
    return Predictions("detect", ("person",), found, dict.fromkeys(found, SIZE))


@pytest.mark.parametrize("yaw", [0.0, 75.0, -160.0])
@pytest.mark.parametrize(("pitch", "height"), [(90.0, 50.0), (45.0, 80.0)])
def test_a_detection_lies_where_it_was_seen(yaw: float, pitch: float, height: float) -> None:
    frame = LocalFrame(46.5, 11.3)
    poses = find_poses([a_picture("a", yaw_deg=yaw, pitch_deg=pitch, altitude_m=height)])
    pose = poses.known["test/a.jpg"]
    # Some metres ahead of the middle of the picture.
    ahead = height / np.tan(np.radians(pitch)) + 6
    truth = ahead * np.array([[np.sin(np.radians(yaw)), np.cos(np.radians(yaw))]])
    x, y = pixels_of_ground(pose, frame, truth)[0]
    half = 8 * abs(np.cos(np.radians(pitch)))
    (placed,), nowhere = place_detections(predictions({"a": [[x - 5, y - half - 8, x + 5, y - half + 8]]}), poses)
    off = frame.to_metres(placed.latitude_deg, placed.longitude_deg) - truth[0]
    # Boxes are rounded to a thousandth of a pixel.
    assert np.linalg.norm(off) < 0.01 * placed.ground_pixel_m
    assert (placed.picture, placed.category, placed.score, nowhere) == ("test/a.jpg", "person", 0.9, 0)
    assert placed.size_m == pytest.approx(16 * placed.ground_pixel_m)


def test_pictures_without_a_pose_are_named_and_flat_rays_counted() -> None:
    images = [a_picture("a", pitch_deg=20.0), a_picture("b", latitude_deg=None, hfov_deg=None)]
    poses = find_poses(images)
    assert poses.lacking == {"test/b.jpg": "latitude_deg, hfov_deg"}
    found = predictions({"a": [[300, 10, 310, 20], [300, 400, 310, 420]], "b": [[0, 0, 9, 9]]})
    placed, nowhere = place_detections(found, poses)
    assert [(p.picture, p.number) for p in placed] == [("test/a.jpg", 1)]
    assert nowhere == 1


def test_given_errors_replace_the_defaults() -> None:
    found = predictions({"a": [[310, 250, 330, 262]]})
    sizes = []
    for errors in (None, PoseErrors(position_m=0.02, height_m=0.1, yaw_deg=0.1, pitch_deg=0.05, roll_deg=0.05)):
        (placed,), _ = place_detections(found, find_poses([a_picture("a")], errors))
        sizes.append(placed.ellipse.major_m)
    assert sizes[0] > 10 * sizes[1]


def test_things_seen_level_touch_the_ground_at_the_lower_edge() -> None:
    pose = find_poses([a_picture("a")]).known["test/a.jpg"]
    boxes = np.array([[10.0, 20.0, 30.0, 60.0]])
    assert isinstance(pose, Pose)
    assert ground_contact(boxes, pose) == pytest.approx(np.array([[20, 40]]))
    assert ground_contact(boxes, replace(pose, pitch_deg=0.0)) == pytest.approx(np.array([[20, 60]]))


def test_maps_hold_detections_and_footprints(tmp_path: Path) -> None:
    images = [a_picture("a"), a_picture("b", longitude_deg=11.3002), a_picture("far", latitude_deg=47.5)]
    images += [a_picture("sky", pitch_deg=-40.0)]
    poses = find_poses(images)
    found = predictions({"a": [[310, 250, 330, 262]], "far": [[310, 250, 330, 262]]})
    placed, _ = place_detections(found, poses)
    files = write_maps(tmp_path, poses, placed)
    assert [f.name for f in files] == ["detections.geojson", "footprints.geojson", "detections.kml", "detections.gpx"]
    points = json.loads(files[0].read_text("utf-8"))["features"]
    assert [p["id"] for p in points] == ["test/a.jpg 0", "test/far.jpg 0"]
    assert points[0]["geometry"]["coordinates"] == pytest.approx([11.3, 46.5], abs=1e-6)
    assert points[0]["properties"]["ellipse"]["major_m"] == pytest.approx(placed[0].ellipse.major_m, abs=0.005)
    areas = json.loads(files[1].read_text("utf-8"))["features"]
    assert [a["properties"]["picture"] for a in areas] == ["test/a.jpg", "test/b.jpg", "test/far.jpg"]
    assert len(areas[0]["geometry"]["coordinates"][0]) == 5


def test_places_far_apart_have_maps_of_their_own() -> None:
    poses = find_poses([a_picture("a"), a_picture("b", longitude_deg=11.3002), a_picture("far", latitude_deg=47.5)])
    placed, _ = place_detections(predictions({"a": [[310, 250, 330, 262]]}), poses)
    near, far = draw_maps(poses, placed)
    assert b"person (1)" in near
    assert b"2 pictures" in near
    assert b"person" not in far
    assert draw_maps(poses, placed)[0] == near


def test_what_has_no_place_is_said() -> None:
    images = [a_picture("a", pitch_deg=20.0), a_picture("b", yaw_deg=None), a_picture("c", yaw_deg=None)]
    found = predictions({"a": [[300, 10, 310, 20], [300, 400, 310, 420]], "b": [[0, 0, 9, 9]]})
    places = place_flight("flight", images, found, PlaceSettings(errors=PoseErrors(height_m=3.0)))
    assert [p.code for p in places.problems] == ["no-pose", "no-place"]
    assert "2 of 3 pictures are not on the map, such as test/b.jpg; they lack: yaw_deg" in str(places.problems[0])
    assert "no place for 1 of 2 detections" in str(places.problems[1])
    facts = places.to_json()
    assert (facts["pictures"], facts["detections"]) == (1, 1)
    assert {"name": "height_m", "value": 3.0, "source": "given", "pictures": 1} in facts["errors"]


@pytest.mark.parametrize("wrong", [{"take_off": (91.0, 0.0)}, {"take_off": (46.5,)}])
def test_wrong_settings_are_refused(wrong: dict[str, tuple[float, ...]]) -> None:
    with pytest.raises(ArgumentError, match="take_off"):
        PlaceSettings(**wrong)
    with pytest.raises(ArgumentError, match="yaw_deg"):
        PoseErrors(yaw_deg=-1.0)
