"""The recipes of videos over a flight of the virtual world: herds and people stay or walk, and keep their size."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from infrablend import api
from infrablend.config.loading import load_recipe
from infrablend.formats.labels import mot
from infrablend.imaging.camera_shift import moved
from infrablend.lab.world import world_flight
from infrablend.lab.world.ground import ground_kelvin
from infrablend.lab.world.world_dataset import WorldRequest, write_world
from infrablend.lab.world.world_flight import begin_flight, flight_frame

SEED, COUNT = 2, 6


class Ground:
    """Renderer of the ground alone."""

    def render(self, plan):
        return ground_kelvin(plan, 1), []


def frames(facts, folder):
    shared = begin_flight(facts[0], SEED, Ground())
    for frame in facts:
        yield flight_frame(shared, frame, folder)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    out = tmp_path_factory.mktemp("flight") / "world"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world_flight, "ACROSS", 2)
        patch.setenv("INFRABLEND_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setenv("INFRABLEND_LOG", str(tmp_path_factory.mktemp("log") / "log.txt"))
        write_world(out, WorldRequest(COUNT, SEED, "flight"), frames)
        yield out


@pytest.mark.parametrize(("recipe", "category"), [("deer-video", "deer"), ("people-video", "Person")])
def test_tracks_of_a_flight_stay_or_walk_and_keep_their_size(recipe: str, category: str, world: Path, tmp_path: Path):
    settings = ["objects.0.count=1", "objects.1.count=1", "objects.2.count=1", "output.formats=[native]"]
    settings += ["placement.where=anywhere", "placement.min_contrast=off", "placement.max_relief_grey=0"]
    execution = api.Execution(renderer="flat", in_process=True)
    report = api.generate(recipe, world, tmp_path / "run", settings=settings, execution=execution)
    assert report.ok
    to_map = [np.array(e["to_map"]) for e in json.loads((world / "world.json").read_text())["frames"]]
    kinds = {o.motion.kind for o in load_recipe(recipe).objects if o.motion is not None}
    tracks: dict[int | str | None, dict[int, np.ndarray]] = {}
    for image in mot.read(tmp_path / "run" / "native").images:
        k = image.capture.frame
        assert k is not None and image.capture.pitch_deg == 90
        for o in image.instances:
            if (o.box_xyxy > 1).all() and (o.box_xyxy[2:] < (639, 511)).all():
                tracks.setdefault(o.track_id, {})[k] = o.box_xyxy
        assert {o.category for o in image.instances} <= {category, "boar"}
    whole = {t: boxes for t, boxes in tracks.items() if len(boxes) == COUNT}
    assert whole and kinds <= {"walk", "graze", "still", "run"}
    for boxes in whole.values():
        middles = np.array([moved((b[:2] + b[2:])[None] / 2, to_map[k])[0] for k, b in boxes.items()])
        steps = np.linalg.norm(np.diff(middles, axis=0), axis=1)
        # At most 4.5 m/s, 0.039 m per px and 25 frames per second, and what limbs move the box.
        assert steps.max() < 4.7 + 3
        spans = np.array([np.linalg.norm(b[2:] - b[:2]) for b in boxes.values()])
        assert np.ptp(spans) < 0.6 * spans.mean()
