"""Objects of a survey with 70 % overlap, true boxes as detections: how far their number is from the true one."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from infrablend.core.boxes import corners_of_box
from infrablend.lab.world import world_flight
from infrablend.lab.world.frame_files import Label
from infrablend.lab.world.scene_plan import WorldPlan
from infrablend.lab.world.world_frames import Survey, plan_frames
from infrablend.lab.world.world_survey import begin_survey, survey_frame
from infrablend.pipeline.flights.same_object import FlightCount, PlacedSighting, count_objects

SEEDS = range(4)
SIZE = (640, 512)
# Positions of pictures after they were joined by overlap, and of the middle of a box.
PLACE_M, BOX_M, CUT_M = 0.15, 0.05, 0.3


class Outlines:
    """Renderer of outlines of people on nothing."""

    def render(self, plan: WorldPlan) -> tuple[np.ndarray, list[Label]]:
        w, h = plan.camera.size_wh
        pixel = plan.camera.distance_m / plan.camera.focal_px
        labels = []
        for person in plan.people:
            x, y = w / 2 + person.x_m / pixel, h / 2 - person.y_m / pixel
            box = corners_of_box(np.array([x - 8, y - 8, x + 8, y + 8]))
            inside = 8 < x < w - 8 and 8 < y < h - 8
            labels.append(Label("Person", None, None, 1.0, False, outline_xy=box if inside else None))
        kelvin = np.full((h, w), 285.0, np.float32)
        kelvin[::2] += 1
        return kelvin, labels


def counted(seed: int, walking: bool, folder: Path) -> tuple[int, FlightCount]:
    """Return how many people the pictures show, and how many are counted."""
    frames = plan_frames(84, seed, "flight", Survey(0.7, walking=walking))
    shared = begin_survey(frames[0], seed, Outlines())
    rng = np.random.default_rng(seed)
    sightings, tracks, area = [], set(), 0.0
    for frame in frames:
        finished = survey_frame(shared, frame, folder)
        true: dict[str, float] = finished.facts["survey"]  # type: ignore[assignment]
        pixel, yaw = true["ground_pixel_m"], math.radians(true["yaw_deg"])
        area += pixel**2 * SIZE[0] * SIZE[1]
        at = complex(true["east_m"], true["north_m"]) + PLACE_M * complex(*rng.standard_normal(2))
        for one in finished.image.instances:
            right, down = (one.box_xyxy[:2] + one.box_xyxy[2:] - SIZE) / 2
            place = at + pixel * complex(right, -down) * np.exp(-1j * yaw)
            own = PLACE_M**2 + BOX_M**2 + (CUT_M**2 if one.truncated else 0)
            size = float((one.box_xyxy[2:] - one.box_xyxy[:2]).max()) * pixel
            xy = np.array([place.real, place.imag])
            sightings.append(PlacedSighting(frame.name, true["time_s"], xy, own * np.eye(2), size, one.category))
            tracks.add(one.track_id)
    return len(tracks), count_objects(sightings, area)


@pytest.fixture(autouse=True)
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world_flight, "_picture", lambda *_: np.zeros((2, 2), np.uint8))


@pytest.mark.parametrize(("walking", "bar"), [(False, 0.05), (True, 0.15)])
def test_objects_are_counted_once(walking: bool, bar: float, tmp_path: Path) -> None:
    found = [counted(seed, walking, tmp_path / str(seed)) for seed in SEEDS]
    errors = [abs(count.expected / true - 1) for true, count in found]
    assert float(np.mean(errors)) <= bar
    assert all(count.fewest <= true <= count.most for true, count in found)
    told = [o.moves for _, count in found for o in count.objects if o.moves is not None]
    assert np.mean([moves is walking for moves in told]) > 0.9
    if not walking:
        assert all(abs(len(count.objects) / true - 1) <= bar for true, count in found)
