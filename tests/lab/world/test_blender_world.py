"""The virtual world rendered by Blender and without it: pixels, labels and files agree and repeat."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend.core.rng import stream
from infrablend.core.surface_kinds import SURFACES
from infrablend.core.tasks import Task
from infrablend.errors import OutputError
from infrablend.formats.labels import mot
from infrablend.formats.published import hit_uav
from infrablend.lab.world.buildings import Building
from infrablend.lab.world.fixtures import Tree
from infrablend.lab.world.frame_files import FinishedFrame, sample_world
from infrablend.lab.world.ground import ground_kelvin
from infrablend.lab.world.ground_cover import Road
from infrablend.lab.world.people import Person
from infrablend.lab.world.world_dataset import FrameSource, WorldRequest, write_world
from infrablend.lab.world.world_frames import FrameFacts
from tests.coarse_world import coarse_worlds

ENGINES = [pytest.param("blender", marks=pytest.mark.blender), "lattice"]


def in_this_process(request: WorldRequest) -> FrameSource:
    from infrablend.lab.world.blender_world import WorldWorker

    def rendered(frames: Sequence[FrameFacts], folder: Path) -> Iterator[FinishedFrame]:
        worker = WorldWorker(request.seed, folder, request.engine)
        try:
            for frame in frames:
                yield worker(Task(frame.name, frame))
        finally:
            worker.close()

    return rendered


def render(out: Path, request: WorldRequest, progress: Callable[[int, int], None] | None = None) -> None:
    with coarse_worlds():
        write_world(out, request, in_this_process(request), progress)


@pytest.fixture(scope="module")
def bare():
    """A night scene with nothing on the ground."""
    plan = sample_world(stream(0, "bare"), 60, 60, "night", "park")
    return replace(plan, roads=(), patches=(), vehicles=(), people=(), cycles=(), trees=(), buildings=(), furniture=())


def someone(x: float, y: float) -> Person:
    return Person(x, y, 0.5, 1.75, 1.1, "walk", 0.6, 0.2, 303.0, 300.0, 299.0, 299.0, 0.0)


@pytest.mark.parametrize("engine", ENGINES)
def test_pixels_and_boxes_agree_and_walls_hide(bare, engine):
    from infrablend.lab.world.blender_world import WorldRenderer

    with closing(WorldRenderer(engine)) as renderer:
        empty, labels = renderer.render(bare)
        assert not labels
        # The plane shows exactly the temperatures computed for it.
        expected = ground_kelvin(bare, 2).reshape(512, 2, 640, 2).mean(axis=(1, 3))
        assert np.abs(empty - expected).max() < 0.01

        wall = Building(4.0, -1.5, 0.0, 6.0, 1.0, 6.0, "flat", 270.0, 275.0, 275.0, 0.0, 0.0, 1)
        scene = replace(bare, people=(someone(-4.0, 0.0), someone(4.0, 0.5)), buildings=(wall,))
        kelvin, labels = renderer.render(scene)
        again, _ = renderer.render(scene)
    assert np.array_equal(kelvin, again)
    seen, hidden = labels
    assert hidden.dropped == "hidden" and hidden.visibility < 0.1
    assert seen.visibility > 0.9 and seen.box_xyxy is not None
    warm = kelvin > empty.max() + 3
    rows, columns = np.nonzero(warm)
    pixels = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
    assert np.abs(seen.box_xyxy - pixels).max() <= 1.0


@pytest.mark.parametrize("engine", ENGINES)
def test_the_pass_of_surfaces_shows_what_stands_where(bare, engine):
    from infrablend.lab.world.blender_world import WorldRenderer

    tree = Tree("crown", 0, -6.0, 4.0, 0.0, 7.0, 3.0, 280.0, 0.0)
    lane = Road(0.0, -5.0, 0.0, 0.0, 3.0, 0.0, 2, "asphalt", False)
    wall = Building(5.0, 3.0, 0.0, 6.0, 4.0, 4.0, "flat", 270.0, 275.0, 275.0, 0.0, 0.0, 1)
    scene = replace(bare, people=(someone(0.0, 0.0),), trees=(tree,), roads=(lane,), buildings=(wall,))
    with closing(WorldRenderer(engine)) as renderer:
        kelvin, kinds = renderer.render_surfaces(scene)
        same, labels = renderer.render(scene)
    assert np.array_equal(kelvin, same) and kinds.shape == kelvin.shape
    assert {SURFACES[k] for k in np.unique(kinds)} == {"grass", "object", "tree", "road", "structure"}
    (person,) = labels
    rows, columns = np.nonzero(kinds == SURFACES.index("object"))
    pixels = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
    assert np.abs(person.box_xyxy - pixels).max() <= 1.5

    def kind_at(x: float, y: float, z: float = 0.0) -> str:
        (xy,), _ = scene.camera.project(np.array([[x, y, z]]))
        return SURFACES[kinds[int(xy[1]), int(xy[0])]]

    assert kind_at(0.0, -5.0) == "road" and kind_at(0.0, 4.5) == "grass" and kind_at(5.0, 3.0, 4.0) == "structure"


@pytest.mark.parametrize("engine", ENGINES)
def test_dataset_reads_back_and_repeats(tmp_path, engine):
    done: list[tuple[int, int]] = []
    request = WorldRequest(2, 3, engine=engine)
    render(tmp_path / "a", request, progress=lambda a, b: done.append((a, b)))
    render(tmp_path / "b", request)
    assert done == [(1, 2), (2, 2)]

    def hashes(name: str) -> dict[str, str]:
        root = tmp_path / name
        files = sorted(p for p in root.rglob("*") if p.is_file())
        return {str(p.relative_to(root)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}

    assert hashes("a") == hashes("b")
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["normal_json", "rotate_json", "world.json"]
    dataset = hit_uav.read(tmp_path / "a")
    assert not [p for p in dataset.problems if p.severity == "error"]
    assert len(dataset.images) == 2
    facts = json.loads((tmp_path / "a" / "world.json").read_text())
    labelled = [o for entry in facts["frames"] for o in entry["objects"] if not o["dropped"]]
    assert sum(len(i.instances) for i in dataset.images) == len(labelled) > 0
    for image, entry in zip(dataset.images, sorted(facts["frames"], key=lambda f: f["name"]), strict=True):
        with Image.open(image.path) as picture:
            assert picture.mode == "L" and picture.size == (640, 512) and picture.format == "JPEG"
            grey = np.asarray(picture, np.float64)
        assert image.path.name == entry["name"] and image.capture.pitch_deg is not None
        assert 90 < grey.mean() < 168 and 8 < grey.std() < 70
        for instance in image.instances:
            x0, y0, x1, y1 = instance.box_xyxy
            assert 0 <= x0 < x1 <= 640 and 0 <= y0 < y1 <= 512
            assert instance.corners_xy is not None
    with pytest.raises(OutputError, match="not"):
        render(tmp_path / "a", WorldRequest(1, engine=engine))


@pytest.mark.blender
def test_both_engines_show_the_same_scenes(tmp_path):
    """Blender's rays fall anywhere in a pixel, the lattice's in its middle, and pass no light on: edges differ."""
    from infrablend.lab.world.blender_world import WorldRenderer

    plan = sample_world(stream(1, "engines"), 60, 60, "day", "parking")
    with closing(WorldRenderer()) as first, closing(WorldRenderer("lattice")) as second:
        traced, drawn = first.render(plan), second.render(plan)
    difference = drawn[0] - traced[0]
    on_things = np.abs(difference) > 0.01  # the ground is the same
    assert 0.2 < np.mean(on_things) < 0.5
    assert abs(np.mean(difference[on_things])) < 0.2 and np.mean(np.abs(difference) > 2) < 0.05
    assert len(traced[1]) == len(drawn[1]) > 3
    for one, other in zip(traced[1], drawn[1], strict=True):
        assert (one.category, one.dropped) == (other.category, other.dropped)
        assert abs(one.visibility - other.visibility) < 0.05
        if one.box_xyxy is not None:
            assert np.abs(one.box_xyxy - other.box_xyxy).max() <= 1.0


@pytest.mark.blender
def test_a_flight_renders_its_scene_once_and_tracks_what_stands_in_it(tmp_path, monkeypatch):
    from infrablend.lab.world.blender_world import WorldRenderer

    asked: list[str] = []
    render_map = WorldRenderer.render
    monkeypatch.setattr("infrablend.lab.world.world_flight.ACROSS", 2)

    def counted(self, plan):
        asked.append(plan.kind)
        return render_map(self, plan)

    monkeypatch.setattr(WorldRenderer, "render", counted)
    render(tmp_path / "out", WorldRequest(3, 1, "flight"))
    assert len(asked) == 1
    images = mot.read(tmp_path / "out").images
    assert [i.capture.frame for i in images] == [0, 1, 2]
    ids = [{o.track_id for o in i.instances} for i in images]
    assert ids[0] and ids[0] == ids[1] == ids[2]
    looks: dict[int | str | None, list[np.ndarray]] = {}
    for image in images:
        with Image.open(image.path) as picture:
            for o in image.instances:
                looks.setdefault(o.track_id, []).append(
                    np.asarray(picture.crop(tuple(o.box_xyxy)).resize((16, 16)), float)
                )
    for first, second, third in looks.values():
        assert np.ptp(first) > 30
        assert min(np.corrcoef(first.ravel(), other.ravel())[0, 1] for other in (second, third)) > 0.8


@pytest.mark.parametrize("engine", ENGINES)
def test_stopped_command_leaves_nothing(tmp_path, engine):
    def stop(done: int, count: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render(tmp_path / "out", WorldRequest(2, engine=engine), progress=stop)
    assert not (tmp_path / "out").exists()
