"""Runs that the studio has made in a process of its own."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from infrablend.core.run_folder import RunFolder
from infrablend.errors import ArgumentError
from infrablend.pipeline.compose.trial import TrialRequest
from infrablend.pipeline.plans.run_request import Execution
from infrablend.studio.tuning import Generation, Tuning

RECIPE = "hit-uav-drone"


def wait_for(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.slow
def test_a_run_is_made_stopped_and_resumed(write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> None:
    data, out = write_tiny_hit_uav(tmp_path / "data"), tmp_path / "runs/a"
    tuning = Tuning(TrialRequest(RECIPE, data, execution=Execution(renderer="flat", in_process=True)))
    tuned = tuning.compose(RECIPE, {"configurations": 200}, tuning.backgrounds[0])
    recipe, _ = tuning.save(tuned.recipe, tmp_path / "a.yaml", tuned.trial.frame.id)
    made = tuning.generate(recipe, out, limit=1, resume=False)
    assert made.command.startswith(f"infrablend generate {recipe} --data {data} --seed 0 --out {out}")
    with pytest.raises(ArgumentError, match="is being made"):
        tuning.generate(recipe, out, limit=1, resume=False)
    wait_for(lambda: made.total == 200)
    made.stop()
    wait_for(lambda: not made.is_running)
    assert made.state.startswith("Stopped. ") and not made.is_complete and not out.exists()
    again = tuning.generate(recipe, out, limit=1, resume=True)
    wait_for(lambda: not again.is_running)
    assert again.is_complete, again.lines
    assert again.done == again.total == 200
    assert f"infrablend studio --run {out}" in again.state
    assert len(list(RunFolder(out).records())) == 200
    tuning.close()


def test_a_run_may_be_stopped_before_it_begins(tmp_path: Path) -> None:
    made = Generation(["generate", "no-recipe", "--data", str(tmp_path), "--out", "out"], tmp_path / "out")
    made.stop()
    wait_for(lambda: not made.is_running)
    assert made.state == "Stopped before it began." and not made.lines


@pytest.mark.slow
def test_an_error_is_shown_as_the_command_words_it(tmp_path: Path) -> None:
    made = Generation(
        ["generate", "no-recipe", "--data", str(tmp_path), "--out", str(tmp_path / "out")], tmp_path / "out"
    )
    wait_for(lambda: not made.is_running)
    assert "exit code" in made.state and any("no-recipe" in line for line in made.lines)
    made.close()
