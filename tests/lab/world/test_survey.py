"""Surveys over one scene: what frames state, where things are, and what overlap tells of yaw and ground pixel."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest
from PIL import Image

from infrablend.core.boxes import corners_of_box
from infrablend.core.dataset import Dataset
from infrablend.detection.detections import Detections, Predictions
from infrablend.detection.truth import image_key
from infrablend.errors import ArgumentError, RecipeError
from infrablend.formats.labels import coco
from infrablend.imaging.overlap import Look, Overlap, Place, find_link, fit_overlap, neighbours
from infrablend.lab.world import world_flight, world_survey
from infrablend.lab.world.frame_files import FinishedFrame, Label
from infrablend.lab.world.ground import ground_kelvin
from infrablend.lab.world.scene_plan import WorldPlan
from infrablend.lab.world.world_dataset import WorldRequest, write_world
from infrablend.lab.world.world_frames import FrameFacts, Survey, plan_frames
from infrablend.lab.world.world_survey import begin_survey, find_stations, survey_frame
from infrablend.pipeline.flights.flight_objects import count_flight
from infrablend.pipeline.flights.place_settings import PlaceSettings
from infrablend.pipeline.flights.placed_detections import place_flight
from infrablend.pipeline.plans.sequence_motion import sequence_views
from infrablend.pipeline.studies.flight_overlap import glance_at_overlap

SEED, SIZE = 3, (640, 512)
ACROSS = 3
COUNT = 27


class Peopled:
    """Renderer of the ground with a warm square for each person."""

    def render(self, plan: WorldPlan) -> tuple[np.ndarray, list[Label]]:
        kelvin = ground_kelvin(plan, 1)
        w, h = plan.camera.size_wh
        pixel = plan.camera.distance_m / plan.camera.focal_px
        labels = []
        for person in plan.people:
            x, y = round(w / 2 + person.x_m / pixel), round(h / 2 - person.y_m / pixel)
            kelvin[max(y - 8, 0) : max(y + 8, 0), max(x - 8, 0) : max(x + 8, 0)] += 8
            box = np.array([x - 8, y - 8, x + 8, y + 8], np.float64)
            outline = corners_of_box(box) if 8 < x < w - 8 and 8 < y < h - 8 else None
            labels.append(Label("Person", None, None, 1.0, False, outline_xy=outline))
        return kelvin, labels


def frames(facts: Sequence[FrameFacts], folder: Path) -> Iterator[FinishedFrame]:
    shared = begin_survey(facts[0], SEED, Peopled())
    for frame in facts:
        yield survey_frame(shared, frame, folder)


def made(out: Path, survey: Survey, count: int = COUNT) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world_flight, "ACROSS", ACROSS)
        patch.setattr(world_survey, "ACROSS", ACROSS)
        write_world(out, WorldRequest(count, SEED, "flight", survey), frames)
    return out


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("survey") / "still", Survey(0.7, yaw_error_deg=10))


@pytest.fixture(scope="module")
def walking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("survey") / "walking", Survey(0.7, walking=True))


def truth_of(world: Path) -> list[dict[str, Any]]:
    return [f["survey"] for f in json.loads((world / "world.json").read_text())["frames"]]


def places_of(dataset: Dataset) -> list[Place]:
    found = []
    for c in (i.capture for i in dataset.images):
        east, north, _ = pymap3d.geodetic2enu(c.latitude_deg, c.longitude_deg, 0, 43.0, 15.5, 0)
        found.append(Place(float(east), float(north), c.yaw_deg or 0.0, c.altitude_m or 0.0))
    return found


@pytest.fixture(scope="module")
def overlap(still: Path) -> Overlap:
    dataset = coco.read(still)
    places = places_of(dataset)
    looks = [Look(v) for v in sequence_views(dataset.images)]
    pairs = [*neighbours(places, SIZE, None)][:60]
    links = [link for a, b in pairs if (link := find_link(a, b, looks)) is not None]
    assert len(links) > 50
    found = fit_overlap(places, links, SIZE)
    assert isinstance(found, Overlap)
    return found


def test_frames_state_where_the_camera_was_with_the_errors_of_a_drone(still: Path) -> None:
    dataset, truth = coco.read(still), truth_of(still)
    assert not dataset.problems and len(dataset.images) == COUNT
    off = []
    for image, place, true in zip(dataset.images, places_of(dataset), truth, strict=True):
        c = image.capture
        assert (c.pitch_deg, c.sequence) == (90, f"flight_{SEED:03d}")
        assert c.time_s == pytest.approx(true["time_s"], abs=1e-3)
        off.append((place.east_m - true["east_m"], place.north_m - true["north_m"]))
        assert (place.yaw_deg - true["yaw_deg"] + 180) % 360 - 180 == pytest.approx(10, abs=1.5)
        assert place.height_m == pytest.approx(true["height_m"], abs=0.6)
    assert np.std(off, axis=0).min() > 0.1 and np.abs(off).max() < 2
    headings = {round(t["yaw_deg"] / 90) for t in truth}
    assert headings == {1, -1}  # to and fro


def test_neighbours_overlap_as_asked_and_stay_on_the_map() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world_survey, "ACROSS", ACROSS)
        for seed in range(4):
            stations = find_stations(Survey(0.6), seed, SIZE, 0.04)
            at = np.array([s.middle_xy for s in stations])
            steps = np.abs(np.diff(at, axis=0))
            assert np.median(steps[:, 0]) == pytest.approx(0.4 * 512, abs=15)
            assert steps[:, 1].max() == pytest.approx(0.4 * 640, abs=25)
            for s in stations:
                to_map = world_flight.Pose(s.middle_xy, np.radians(s.yaw_deg), s.zoom, 1, 0).to_map(SIZE)
                corners = corners_of_box(np.array([0.0, 0, *SIZE])) @ to_map[:2, :2].T + to_map[:2, 2]
                assert corners.min() >= 0 and (corners <= np.array(SIZE) * ACROSS).all()


@pytest.mark.parametrize("kind", ["still", "walking"])
def test_boxes_are_around_people_and_places_are_theirs(kind: str, request: pytest.FixtureRequest) -> None:
    world: Path = request.getfixturevalue(kind)
    seen: dict[int | str, list[np.ndarray]] = {}
    for image, true in list(zip(coco.read(world).images, truth_of(world), strict=True))[::2]:
        grey = np.asarray(Image.open(image.path), np.float64)
        for o, place in zip(image.instances, true["objects_m"], strict=True):
            assert o.track_id is not None
            seen.setdefault(o.track_id, []).append(np.array(place))
            x, y = (o.box_xyxy[:2] + o.box_xyxy[2:]) / 2
            if 40 < x < 600 and 40 < y < 472:
                around = np.median(grey[int(y) - 25 : int(y) + 25, int(x) - 25 : int(x) + 25])
                assert grey[int(y) - 2 : int(y) + 3, int(x) - 2 : int(x) + 3].mean() > min(around + 15, 230)
                # Where the picture shows it is where it is, by the true pose.
                a = np.radians(true["yaw_deg"])
                right, up = (x - 320) * true["ground_pixel_m"], (256 - y) * true["ground_pixel_m"]
                east = true["east_m"] + right * np.cos(a) + up * np.sin(a)
                north = true["north_m"] - right * np.sin(a) + up * np.cos(a)
                assert np.hypot(east - place[0], north - place[1]) < 0.1
    ranges = [np.ptp(v, axis=0).max() for v in seen.values() if len(v) > 1]
    assert len(ranges) > 5
    assert max(ranges) < 1e-9 if kind == "still" else min(ranges) > 0.5


def test_overlap_tells_yaw_and_ground_pixel(overlap: Overlap, still: Path) -> None:
    truth = truth_of(still)
    # The bars of the issue: 1.5 degrees, 1.5 %. The stated height is off by up to 0.5 m of 80, 0.6 %.
    assert overlap.yaw_error_deg == pytest.approx(10, abs=0.7)
    assert overlap.yaw_sigma_deg < 0.7 and abs(overlap.yaw_error_deg - 10) < 4 * overlap.yaw_sigma_deg
    assert overlap.ground_pixel_m == pytest.approx(np.median([t["ground_pixel_m"] for t in truth]), rel=0.01)
    assert overlap.hfov_deg(640) == pytest.approx(17.66, rel=0.02)
    # The errors of the drone: 0.25 m from picture to picture.
    assert 0.15 < overlap.residual_m < 0.5


def test_overlap_moves_pictures_to_where_they_were(overlap: Overlap, still: Path) -> None:
    truth, stated = truth_of(still), places_of(coco.read(still))
    true = np.array([complex(t["east_m"], t["north_m"]) for t in truth])

    def spread(at: list[complex]) -> float:
        off = np.array(at) - true
        return float(np.sqrt((np.abs(off - off.mean()) ** 2).mean()))

    assert sorted(overlap.track) == list(range(COUNT))
    assert spread([overlap.track[k] for k in range(COUNT)]) < 0.5 * spread(
        [complex(p.east_m, p.north_m) for p in stated]
    )


def test_a_survey_says_what_it_cannot() -> None:
    with pytest.raises(ArgumentError, match=r"overlap: found 0\.95"):
        Survey(0.95)
    with pytest.raises(ArgumentError, match="flight, which alone has strips"):
        WorldRequest(3, layout="monet", survey=Survey())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world_flight, "ACROSS", 2)
        patch.setattr(world_survey, "ACROSS", 2)
        facts = plan_frames(1000, SEED, "flight", Survey())
        shared = begin_survey(facts[0], SEED, Peopled())
        with pytest.raises(RecipeError, match="at most"):
            survey_frame(shared, facts[-1], Path("unused"))


def true_boxes(dataset: Dataset) -> tuple[Predictions, set[object]]:
    """Return the labels of pictures as detections, and the objects that they are of."""
    names = tuple(c.name for c in dataset.categories)
    found = {}
    for image in dataset.images:
        boxes = np.array([o.box_xyxy for o in image.instances]).reshape(-1, 4)
        classes = np.array([names.index(o.category) for o in image.instances], int)
        found[image_key(image)] = Detections(boxes, np.ones(len(boxes)), classes)
    sizes = dict.fromkeys(found, SIZE)
    return Predictions("detect", names, found, sizes), {o.track_id for i in dataset.images for o in i.instances}


def test_poses_are_corrected_and_things_counted_once(still: Path) -> None:
    dataset, truth = coco.read(still), truth_of(still)
    predictions, tracks = true_boxes(dataset)
    places = place_flight("still", dataset.images, predictions, PlaceSettings())
    (said,) = [p for p in places.problems if p.code == "pose-corrected"]
    assert "degrees too large" in said.found
    for image, true in zip(dataset.images, truth, strict=True):
        pose = places.poses.known[image_key(image)]
        assert (pose.yaw_deg - true["yaw_deg"] + 180) % 360 - 180 == pytest.approx(0, abs=0.7 + 3 * 0.3)
        assert pose.errors["yaw_deg"].source == "overlap of pictures"
        assert pose.hfov_deg == image.capture.hfov_deg  # which it does not contradict
    count = count_flight(places.joined, predictions, dataset.images, places.joining, 1.6)
    assert len(tracks) > 10 and count["expected"] == pytest.approx(len(tracks), rel=0.05)
    assert count["fewest"] <= len(tracks) <= count["most"]
    assert count["per_picture"] == pytest.approx(len(places.placed) / COUNT, abs=1e-3)
    assert sorted(n for o in count["objects"] for n in o["sightings"]) == sorted(
        f"{p.picture} {p.number}" for p in places.placed
    )


def test_inspect_offers_what_the_header_has_wrong(still: Path) -> None:
    dataset = coco.read(still)
    values = glance_at_overlap(dataset.images)
    assert isinstance(values, list)
    found = {v["name"]: v for v in values}
    yaw, pixel, lens = (found[n] for n in ("yaw_error_deg", "ground_pixel_m", "hfov_deg"))
    assert yaw["contradicts"] and yaw["value"] == pytest.approx(10, abs=1.5)
    assert not pixel["contradicts"] and not lens["contradicts"]
    assert pixel["value"] == pytest.approx(80 / 2060, rel=0.02)
    assert lens["low"] < 17.66 < lens["high"] and "to 2 m" in lens["source"]
    wrong = [replace(i, capture=replace(i.capture, hfov_deg=30.0)) for i in dataset.images[:9]]
    values = glance_at_overlap(wrong)
    assert isinstance(values, list)
    assert {v["name"] for v in values if v["contradicts"]} == {"yaw_error_deg", "ground_pixel_m", "hfov_deg"}
    without = [replace(i, capture=replace(i.capture, hfov_deg=None, altitude_m=None)) for i in dataset.images[:9]]
    values = glance_at_overlap(without)
    assert isinstance(values, list)
    assert [(v["name"], v["stated"]) for v in values] == [("yaw_error_deg", 0.0), ("ground_pixel_m", None)]
    tilted = [replace(i, capture=replace(i.capture, pitch_deg=45.0)) for i in dataset.images]
    assert "0 of 27 pictures with a position look straight down" in str(glance_at_overlap(tilted))
    nowhere = [replace(i, capture=replace(i.capture, latitude_deg=None)) for i in dataset.images]
    assert glance_at_overlap(nowhere) is None
