"""Tests of training on 16-bit pictures: they go through the automatic gain control, in training and in evaluation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend.config.agc import DEFAULT_AGC, PlateauAgc, parse_agc
from infrablend.detection.scale import training_agc
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.lab.training.train_request import TrainRequest
from infrablend.lab.training.training_data import has_deep_pictures, select_training_data, write_training_data


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    for split in ("train", "val"):
        for kind in ("images", "labels"):
            (tmp_path / "data" / kind / split).mkdir(parents=True)
        for k in range(2):
            counts = np.asarray(np.rint(29_000 + rng.normal(0, 60, (240, 320))), np.uint16)
            counts[100:110, 100:108] = 30_500
            Image.fromarray(counts).save(tmp_path / "data" / "images" / split / f"{split}{k}.tiff")
            row = "0 0.325 0.4375 0.025 0.04167\n"
            (tmp_path / "data" / "labels" / split / f"{split}{k}.txt").write_text(row)
    (tmp_path / "data" / "data.yaml").write_text("train: images/train\nval: images/val\nnames: {0: deer}\n")
    return tmp_path / "data"


@pytest.mark.parametrize("tile", [0, 160])
def test_the_trainer_gets_8_bit_pictures_by_the_agc(flight: Path, tmp_path: Path, tile: int) -> None:
    agc = PlateauAgc(mode="plateau", max_gain=1.0)
    request = TrainRequest(preset="smoke", settings={"tile": tile}, agc=agc)
    wanted, _ = select_training_data(dataset_folder.read(flight), request)
    assert has_deep_pictures(wanted)
    counts = write_training_data(wanted, tmp_path / "out", request)
    assert counts["labels"] == 2
    assert counts.get("picture_px") == (320 if tile else None)  # the size that other programs show pictures at
    files = sorted((tmp_path / "out" / "data" / "images" / "train").iterdir())
    pictures = [np.array(Image.open(p)) for p in files]
    assert {p.dtype for p in pictures} == {np.dtype(np.uint8)}
    if not tile:
        whole = np.array(Image.open(flight / "images" / "train" / "train0.tiff")).astype(np.uint16)
        assert (pictures[0] == agc.apply(whole)).all()
    assert not (tmp_path / "out" / "8bit").exists()  # a working folder


def test_a_fixed_agc_needs_a_scale_and_depths_are_not_mixed(flight: Path) -> None:
    fixed = TrainRequest(preset="smoke", agc=parse_agc("{mode: fixed, low_c: 0, high_c: 40}"))
    with pytest.raises(DatasetError) as caught:
        select_training_data(dataset_folder.read(flight), fixed)
    assert {p.code for p in caught.value.problems} == {"no-temperature-scale"}
    Image.fromarray(np.zeros((240, 320), np.uint8)).save(flight / "images" / "train" / "train0.tiff")
    with pytest.raises(DatasetError, match="8-bit pictures, as the others have"):
        select_training_data(dataset_folder.read(flight), TrainRequest(preset="smoke"))


def test_a_detector_keeps_the_agc_of_its_training(tmp_path: Path) -> None:
    weights, agc = tmp_path / "weights.pt", PlateauAgc(mode="plateau", max_gain=1.0)
    assert training_agc(weights, {"infrablend": {"tile": 320, "agc": agc.model_dump()}}) == agc
    assert training_agc(weights, {"infrablend": {"tile": 320}}) is None
    (tmp_path / "train.json").write_text(json.dumps({"agc": DEFAULT_AGC.model_dump()}))
    assert training_agc(weights, {}) == DEFAULT_AGC
    assert training_agc(tmp_path / "best.pt", {}) is None


def test_pictures_of_floats_are_refused_before_the_training(flight: Path) -> None:
    for picture in sorted((flight / "images").rglob("*.tiff")):
        Image.fromarray(np.full((240, 320), 290.5, np.float32)).save(picture)
    with pytest.raises(DatasetError) as caught:
        select_training_data(dataset_folder.read(flight), TrainRequest(preset="smoke"))
    assert {(p.where, p.code, p.found) for p in caught.value.problems} == {
        (f"{split}{k}", "image-depth", "mode F") for split in ("train", "val") for k in range(2)
    }
