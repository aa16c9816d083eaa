"""The examples run unchanged."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.config.loading import load_recipe

EXAMPLES = Path(__file__).parents[2] / "examples"
RECIPES = ["two_classes.yaml", "existing_class.yaml"]


@pytest.fixture
def backgrounds(tmp_path) -> Path:
    folder = tmp_path / "data"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for n in range(6):
        Image.fromarray(rng.integers(90, 160, (256, 320), dtype=np.uint8)).save(folder / f"1_80_60_0_0000{n}.png")
    return folder


def test_every_example_is_listed():
    listed = (EXAMPLES / "README.md").read_text()
    for path in EXAMPLES.rglob("*.*"):
        if path.suffix in {".yaml", ".py"}:
            assert f"`{path.relative_to(EXAMPLES).as_posix()}`" in listed


@pytest.mark.parametrize("name", RECIPES)
def test_recipes_run_and_their_labels_can_be_read(name, backgrounds, tmp_path):
    report = api.generate(
        EXAMPLES / name, backgrounds, tmp_path / "run", execution=api.Execution(renderer="flat", in_process=True)
    )
    assert report.ok
    assert report.counts["objects_inserted"] > 0
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / "read_labels.py"), str(tmp_path / "run")],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    assert len(done.stdout.splitlines()) == report.counts["objects_inserted"]


def run_example(name: str, *arguments: str) -> str:
    command = [sys.executable, str(EXAMPLES / name), *arguments, "--renderer", "flat"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def test_own_sampler_backgrounds_and_look():
    lines = run_example("own_code/use_them.py").splitlines()
    assert [line.split()[0] for line in lines] == [f"train/gradient_{k}_c0" for k in range(6)]
    assert all(line.count("[") == 2 for line in lines)  # one object each


def test_training_on_frames_in_memory(backgrounds):
    pytest.importorskip("torch")
    lines = run_example("train_while_composing.py", str(backgrounds), "--epochs", "2").splitlines()
    assert [line.partition(",")[0] for line in lines] == ["epoch 0: 12 frames", "epoch 1: 12 frames"]
    losses = [float(line.split("loss ")[1].split(",")[0]) for line in lines]
    assert losses[1] < losses[0]


@pytest.mark.blender
def test_own_model(backgrounds, tmp_path, monkeypatch):
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path / "cache"))
    recipe = EXAMPLES / "own_model" / "lanterns.yaml"
    assert load_recipe(recipe).objects[0].model.endswith("lantern.yaml")
    report = api.generate(recipe, backgrounds, tmp_path / "run", limit=2, execution=api.Execution(workers=1))
    assert report.counts["labels_inserted"] == {"lantern": 4}
