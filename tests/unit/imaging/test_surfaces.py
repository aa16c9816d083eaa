"""Surfaces of pictures that the shipped model finds, what overrides it, and the command that writes maps of places."""

import json

import cv2
import numpy as np
import pytest
from PIL import Image

from infrablend.core.surface_kinds import SURFACES
from infrablend.imaging.surfaces import DRIVE, STAND, find_surfaces, model_version
from tests.command_line import done, said
from tests.unit.pipeline.test_run import dataset

__all__ = ["dataset"]


def road_by_night(turn: bool = False) -> np.ndarray:
    """Return a picture of a warm road with a line in its middle between rough, cold lawns."""
    rng = np.random.default_rng(0)
    grey = 90 + cv2.GaussianBlur(rng.standard_normal((512, 640)).astype(np.float32), (0, 0), 4) * 60
    grey[:, 220:420] = 165 + cv2.GaussianBlur(rng.standard_normal((512, 200)).astype(np.float32), (0, 0), 9) * 20
    grey[:, 318:322] = 150
    grey += rng.standard_normal(grey.shape) * 2
    picture = np.clip(cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 1), 0, 255).astype(np.uint8)
    return np.ascontiguousarray(picture.T) if turn else picture


@pytest.mark.parametrize("turn", [False, True])
def test_a_warm_even_strip_is_where_cars_drive(turn):
    found = find_surfaces(road_by_night(turn))
    drive, stand = found.share(DRIVE), found.share(STAND)
    assert drive.shape == ((640, 512) if turn else (512, 640)) and 0 <= drive.min() <= drive.max() <= 1
    across = (drive.T if turn else drive).mean(axis=0)
    assert across[250:390].mean() > 3 * across[:180].mean()
    assert stand.mean() > 0.5


def test_the_same_picture_gives_the_same_bytes_and_depth_does_not_matter():
    picture = road_by_night()
    first, again = find_surfaces(picture), find_surfaces(picture.copy())
    assert np.array_equal(first.shares, again.shares)
    low, high = np.percentile(picture, (0.5, 99.5))
    spread = np.clip((picture - low) / (high - low), 0, 1)
    deep = find_surfaces((20_000 + 3000 * spread).astype(np.uint16))
    assert (deep.kinds() == first.kinds()).mean() > 0.8


def test_labels_sky_and_margins_override_the_model():
    picture = road_by_night()
    picture[:, :64] = 0
    sky = np.zeros(picture.shape, np.bool_)
    sky[:100] = True
    found = find_surfaces(picture, np.array([[300.0, 300, 360, 340]]), sky)
    kinds = found.kinds()
    names = np.array(SURFACES)[kinds]
    assert set(names[:96, 80:].ravel()) == {"sky"} and set(names[304:336, 304:356].ravel()) == {"object"}
    assert set(names[:, :56].ravel()) == {"margin"}
    for kinds_ in (STAND, DRIVE):
        share = found.share(kinds_)
        assert not share[:92, 80:].any() and not share[308:332, 308:352].any() and not share[:, :52].any()


@pytest.mark.parametrize("size_wh", [(64, 48), (160, 120), (1280, 1024), (800, 200), (1024, 1024)])
def test_any_size_has_a_map(size_wh):
    grey = np.random.default_rng(1).integers(0, 255, (size_wh[1], size_wh[0])).astype(np.uint8)
    found = find_surfaces(grey)
    assert found.share(STAND).shape == grey.shape == found.kinds().shape
    assert np.isfinite(found.share(STAND)).all()
    even = find_surfaces(np.full_like(grey, 7))
    assert np.isfinite(even.share(DRIVE)).all()


def test_the_command_writes_maps_of_the_pictures_size_and_a_sheet(dataset, tmp_path):
    done("places", "map", dataset, "--out", tmp_path / "maps")
    record = json.loads((tmp_path / "maps" / "places.json").read_text())
    maps = sorted(p.relative_to(tmp_path / "maps").as_posix() for p in (tmp_path / "maps").rglob("*.png"))
    assert record["maps"] == 4 and record["model"] == model_version() and len(maps) == 9
    assert "places.png" in maps and "test/0_130_70_0_00004.stand.png" in maps
    with Image.open(tmp_path / "maps" / "test/0_130_70_0_00004.drive.png") as picture:
        assert picture.mode == "L" and picture.size == (640, 512)
    assert sum(record["surfaces"].values()) == pytest.approx(1, abs=0.01)
    again = said("places", "map", dataset, "--out", tmp_path / "maps", code=2)
    assert "--overwrite" in again


def test_a_damaged_picture_is_named_and_the_others_have_maps(dataset, tmp_path):
    broken = next(dataset.rglob("0_130_70_0_00004.jpg"))
    broken.write_bytes(broken.read_bytes()[:2000])
    text = said("places", "map", dataset, "--out", tmp_path / "maps", code=1)
    assert broken.name in text
    assert json.loads((tmp_path / "maps" / "places.json").read_text())["maps"] == 3
