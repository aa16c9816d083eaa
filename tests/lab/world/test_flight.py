"""Flights over one scene: the camera's true movement, the labels that go with it, and what all frames share."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from infrablend.core.boxes import corners_of_box
from infrablend.formats.labels import mot
from infrablend.imaging.camera_path import follow_camera
from infrablend.imaging.camera_shift import View, moved
from infrablend.lab.world import world_flight
from infrablend.lab.world.frame_files import MEAN_GREY, FinishedFrame, Label
from infrablend.lab.world.ground import ground_kelvin
from infrablend.lab.world.scene_plan import WorldPlan
from infrablend.lab.world.world_dataset import WorldRequest, write_world
from infrablend.lab.world.world_flight import begin_flight, find_pose, flight_frame
from infrablend.lab.world.world_frames import FrameFacts, plan_frames

SEED, SIZE = 0, (640, 512)


class Ground:
    """Renderer of the ground without what stands on it, but for warm squares, the first half hidden."""

    def render(self, plan: WorldPlan) -> tuple[np.ndarray, list[Label]]:
        kelvin = ground_kelvin(plan, 1)
        labels = [Label("Car", None, None, 0.1, False, "hidden")]
        w, h = plan.camera.size_wh
        for k, (x, y) in enumerate([(x, y) for x in range(30, w, 97) for y in range(30, h, 97)]):
            kelvin[y : y + 14, x : x + 9] += 8
            box = np.array([x, y, x + 9, y + 14], np.float64)
            outline = corners_of_box(box)
            labels.append(Label("Person", box, outline, 0.5 if k == 0 else 1.0, False, outline_xy=outline))
        return kelvin, labels


@pytest.fixture(scope="module", autouse=True)
def narrow() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world_flight, "ACROSS", 2)
        yield


def frames(facts: Sequence[FrameFacts], folder: Path) -> Iterator[FinishedFrame]:
    shared = begin_flight(facts[0], SEED, Ground())
    for frame in facts:
        yield flight_frame(shared, frame, folder)


@pytest.fixture(scope="module")
def world(narrow: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("flight") / "world"
    write_world(out, WorldRequest(40, SEED, "flight"), frames)
    return out


def test_all_of_a_frame_is_read_back(world: Path) -> None:
    dataset = mot.read(world)
    facts = json.loads((world / "world.json").read_text())["frames"]
    assert not dataset.problems and len(dataset.images) == len(facts) == 40
    for k, (image, entry) in enumerate(zip(dataset.images, facts, strict=True)):
        seen = image.capture
        assert (seen.sequence, seen.frame) == ("flight_000", k) and seen.time_s == pytest.approx(k / 25)
        assert seen.pitch_deg == 90 and seen.time_of_day in ("day", "night")
        assert seen.altitude_m == pytest.approx(entry["camera"]["distance_m"], abs=1e-3)
        assert seen.hfov_deg == pytest.approx(2 * np.degrees(np.arctan(320 / 2060)), abs=1e-3)
        assert [o.track_id for o in image.instances] == [o["track_id"] for o in entry["objects"]] != []
        assert 1 not in {o.track_id for o in image.instances}  # hidden


def test_boxes_are_around_what_they_name_in_every_frame(world: Path) -> None:
    dataset = mot.read(world)
    sizes: dict[int | str | None, list[np.ndarray]] = {}
    for image in dataset.images[::13]:
        grey = np.asarray(Image.open(image.path), np.float64)
        for o in image.instances:
            x0, y0, x1, y1 = o.box_xyxy
            if x0 < 15 or y0 < 15 or x1 > 625 or y1 > 497:
                continue
            x, y = int((x0 + x1) / 2), int((y0 + y1) / 2)
            around = np.median(grey[y - 14 : y + 15, x - 14 : x + 15])
            assert grey[y - 1 : y + 2, x - 1 : x + 2].mean() > around + 20
            sizes.setdefault(o.track_id, []).append(o.box_xyxy[2:] - o.box_xyxy[:2])
    assert len(sizes) > 20 and all(np.ptp(s, axis=0).max() < 3 for s in sizes.values())
    cut = [o for i in dataset.images for o in i.instances if o.box_xyxy[0] == 0]
    assert cut and all(o.visibility is not None and 0.25 <= o.visibility <= 1 for o in cut)


def test_the_camera_is_followed_along_its_true_way(world: Path) -> None:
    images = mot.read(world).images
    blocked = np.zeros(SIZE[::-1], np.bool_)
    moments = follow_camera(View(np.array(Image.open(i.path)), blocked) for i in images)
    assert [m.state for m in moments] == ["first"] + ["followed"] * 39
    entries = json.loads((world / "world.json").read_text())["frames"]
    to_map = [np.array(e["to_map"]) for e in entries]
    corners = corners_of_box(np.array([0.0, 0, *SIZE]))
    steps = []
    for moment, matrix in zip(moments, to_map, strict=True):
        true = moved(corners, np.linalg.inv(to_map[0]) @ matrix)
        assert np.abs(moved(corners, moment.to_first) - true).max() < 0.3
    for before, after in pairwise(to_map):
        steps.append(np.abs(moved(corners, np.linalg.inv(before) @ after) - corners).max())
    assert 0.3 < np.median(steps) < 12
    for moment, entry in zip(moments, entries, strict=True):  # levels at the mean one
        drift = entry["offset_grey"] - entries[0]["offset_grey"]
        assert moment.gain * MEAN_GREY + moment.offset - MEAN_GREY == pytest.approx(drift, abs=1.0)


class Even:
    """Renderer of an even ground."""

    def render(self, plan: WorldPlan) -> tuple[np.ndarray, list[Label]]:
        w, h = plan.camera.size_wh
        return np.full((h, w), 285.0, np.float32), []


def test_the_grain_is_new_and_the_pattern_stays(tmp_path: Path) -> None:
    facts = plan_frames(16, SEED, "flight")
    shared = begin_flight(facts[0], SEED, Even())
    made = [flight_frame(shared, f, tmp_path).image.path for f in facts]
    again = flight_frame(shared, facts[1], tmp_path / "again").image.path
    assert made[0].read_bytes() != made[1].read_bytes() == again.read_bytes()
    greys = np.stack([np.asarray(Image.open(p), np.float32) for p in made])

    def alike(one: np.ndarray, other: np.ndarray) -> float:
        fine = [(g - cv2.GaussianBlur(g, (0, 0), 4)).ravel() for g in (one, other)]
        return float(np.corrcoef(*fine)[0, 1])

    assert alike(greys[0], greys[1]) < 0.15
    assert alike(greys.mean(axis=0), shared.pattern) > 0.3
    assert greys[:, 200:300, 270:370].mean() > greys[:, :20, :20].mean() + 1  # vignette


def test_a_frame_does_not_depend_on_how_many_follow_and_stays_on_the_map() -> None:
    assert plan_frames(5, 3, "flight")[:2] == plan_frames(2, 3, "flight")
    corners = corners_of_box(np.array([0.0, 0, *SIZE]))
    for seed in range(4):
        at = [moved(corners, find_pose(seed, k, SIZE).to_map(SIZE)) for k in range(0, 4000, 40)]
        assert np.min(at) >= 0 and (np.array(at) <= np.array(SIZE) * world_flight.ACROSS).all()
