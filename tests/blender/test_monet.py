"""MONET-deer as in the paper, on a virtual dataset in MONET's layout."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from tests.coarse_world import coarse_worlds

pytestmark = [pytest.mark.blender, pytest.mark.slow, pytest.mark.long]

FRAMES = 7
SETTINGS = {"render.samples": 16, "placement.size_px": [40, 300]}


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> Path:
    """Seven frames, two of them of sequences without telemetry, one that has lost it."""
    with coarse_worlds():
        return api.make_world(tmp_path_factory.mktemp("monet") / "world", FRAMES, 3, layout="monet", workers=2)


@pytest.fixture(scope="module")
def run(world, tmp_path_factory) -> tuple[api.RunReport, Path]:
    out = tmp_path_factory.mktemp("runs") / "deer"
    return api.generate("monet-deer", world, out, execution=api.Execution(workers=2), settings=SETTINGS), out


def test_world_has_monets_layout(world):
    pictures = sorted(p.relative_to(world).as_posix() for p in world.rglob("*.png"))
    assert len(pictures) == FRAMES and pictures[0] == "test/dirtroad_03/lwir/image00000.png"
    for name in pictures:
        with Image.open(world / name) as picture:
            assert (picture.size, picture.mode, picture.format) == ((800, 600), "L", "PNG")
            assert 8 < np.asarray(picture, np.float64).std() < 70
    dataset = api.read_dataset(world)
    assert dataset.format == "monet" and [p for p in dataset.problems if p.severity == "error"] == []
    assert set(dataset.notes["excluded"]) == {"train/dirtroad_01", "train/runway_01"}
    assert dataset.notes["frames_without_pitch"] == {"train/runway_04": 1}
    assert {c.name for c in dataset.categories} == {"person", "vehicle"}
    facts = {(f["split"], f["name"]): f for f in json.loads((world / "world.json").read_text())["frames"]}
    for image in dataset.images:
        # With the sign reversed, the pitch in the JSON is that of the camera.
        pitch = np.degrees(facts[image.split, image.name]["camera"]["pitch_rad"])
        assert image.capture.pitch_deg is None or image.capture.pitch_deg == pytest.approx(pitch)
        objects = facts[image.split, image.name]["objects"]
        assert len(image.instances) == sum(not o["dropped"] for o in objects)


def test_deer_are_put_into_every_usable_frame(world, run):
    report, out = run
    # The one frame without pitch in a good sequence is left out and counted; sequences without any are no loss.
    assert report.counts["skipped_backgrounds"] == 1 and report.counts["failed_frames"] == 0
    assert report.counts["labels_inserted"] == {"deer": 4} and report.counts["images"] == 4
    backgrounds = {i.id: i for i in api.read_dataset(world).images}
    again = api.read_dataset(out / "native")
    assert again.format == "monet" and [p for p in again.problems if p.severity == "error"] == []
    assert [c.name for c in again.categories] == ["person", "vehicle", "deer"]
    for image in again.images:
        source = backgrounds[image.id.removesuffix("_c0")]
        assert (image.split, image.capture.sequence, image.size_wh) == (
            source.split,
            source.capture.sequence,
            (800, 600),
        )
        assert (image.capture.pitch_deg, image.capture.altitude_m, image.capture.captured) == (
            source.capture.pitch_deg, source.capture.altitude_m, source.capture.captured,
        )  # fmt: skip
        assert image.extra["fields"] == source.extra["fields"]
        (deer,) = (o for o in image.instances if o.category == "deer")
        assert deer.inserted and deer.mask is not None and deer.corners_xy is not None
        before, after = (np.asarray(Image.open(p)) for p in (source.path, image.path))
        mask = deer.mask.to_array()
        assert (before != after)[mask].mean() > 0.9
        kept = [o.box_xyxy.tolist() for o in image.instances if o is not deer]
        assert all(box in [o.box_xyxy.tolist() for o in source.instances] for box in kept)
