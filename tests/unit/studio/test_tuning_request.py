"""What the studio tunes: what the user gave, or recipe, seed and backgrounds of the opened run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from infrablend import api
from infrablend.config.loading import load_recipe
from infrablend.errors import DatasetError
from infrablend.formats.read_write import Reading
from infrablend.pipeline.plans.run_request import Execution
from infrablend.studio.opened_run import OpenedRun
from infrablend.studio.studio_request import StudioRequest
from infrablend.studio.tuning import FIRST_RECIPE, Tuning, tuning_request

FLAT = Execution(renderer="flat", in_process=True)
SETTINGS = {"camera.distance_m": [3, 4]}


@pytest.fixture
def data(write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> Path:
    return write_tiny_hit_uav(tmp_path / "data")


@pytest.fixture
def run(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> OpenedRun:
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path / "cache"))
    api.generate(
        "hit-uav-drone", data, tmp_path / "run", seed=7, limit=2, settings=SETTINGS, execution=FLAT,
        reading=Reading(splits=("test",)),
    )  # fmt: skip
    return OpenedRun(tmp_path / "run")


def test_a_run_alone_is_tuned_with_its_own_recipe_and_gives_its_own_frames(run: OpenedRun) -> None:
    request = tuning_request(StudioRequest(run=run.layout.root, execution=FLAT), run)
    assert (request.seed, request.reading.splits, request.execution.renderer) == (7, ["test"], "flat")
    assert load_recipe(request.recipe).camera.distance_m == (3, 4)
    tuning = Tuning(request)
    try:
        background = tuning.backgrounds[0]
        tuned = tuning.compose(tuning.recipe, {}, background).trial.frame.record.image_sha256
    finally:
        tuning.close()
    assert tuned in {row.digest for row in run.rows if row.background == background.id}


def test_what_the_user_gives_comes_first(run: OpenedRun, data: Path) -> None:
    given = tuning_request(StudioRequest("hit-uav-person", data, run.layout.root, seed=3), run)
    assert (given.recipe, given.data, given.seed) == ("hit-uav-person", data, 3)
    assert tuning_request(StudioRequest(None, data), None).recipe == FIRST_RECIPE
    moved = data.rename(data.with_name("moved"))
    assert tuning_request(StudioRequest(None, moved, run.layout.root), run).data == moved


def test_missing_backgrounds_are_named_with_what_to_do(run: OpenedRun, data: Path) -> None:
    data.rename(data.with_name("moved"))
    with pytest.raises(DatasetError, match=r"no such folder; expected the backgrounds of this run.*--data DIR"):
        tuning_request(StudioRequest(run=run.layout.root), run)
