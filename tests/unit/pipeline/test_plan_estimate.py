"""What `generate --plan` estimates (core-hours, cost, the time of each shard), and the pace of a run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from infrablend.core.tasks import TaskResult
from infrablend.pipeline.runs import generate
from infrablend.pipeline.runs.forecast import (
    CYCLES_OBJECT_CPU_S,
    CYCLES_SAMPLE_CPU_S,
    OBJECT_CPU_S,
    OTHER_OBJECT_CPU_S,
)
from infrablend.pipeline.runs.run import Pace
from tests.command_line import run
from tests.samples import SAMPLES

RECIPE = "hit-uav-drone"


@pytest.fixture(autouse=True)
def without_forecast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Place no objects: these tests ask for very many."""
    monkeypatch.setattr(generate, "forecast_objects", lambda plan: ({}, []))


def planned(data: Path, *options: object) -> dict[str, object]:
    done = run(
        "generate", RECIPE, "--data", data, "--out", data.parent / "out", "--workers", 2, "--plan", "--json", *options
    )
    assert done.exit_code == 0, done.output
    assert not (data.parent / "out").exists()
    result: dict[str, object] = json.loads(done.stdout)
    return result


def test_cost_is_core_hours_times_the_price(tmp_path: Path) -> None:
    data = SAMPLES["hit-uav:json"](tmp_path / "data")
    whole, paid = planned(data), planned(data, "--price", 1000)
    assert "cost" not in whole and paid["core_hours"] == whole["core_hours"]
    assert paid["cost"] == pytest.approx(1000 * float(str(whole["core_hours"])), abs=0.51)  # hours have three digits
    refused = run("generate", RECIPE, "--data", data, "--out", tmp_path / "out", "--price", 1)
    assert refused.exit_code == 2 and "--plan" in refused.output


def test_shards_are_planned_one_by_one(tmp_path: Path) -> None:
    data = SAMPLES["hit-uav:json"](tmp_path / "data")
    whole = planned(data)
    frames = int(str(whole["frames"]))
    parts = planned(data, "--shard", "1/3")
    assert parts["frames"] == frames and parts["shards"] == 3 and parts["frames_per_shard"] == -(-frames // 3)
    assert parts["about_s"] is None and int(str(parts["about_per_shard_s"])) <= int(str(whole["about_s"]))
    assert float(str(parts["core_hours"])) > float(str(whole["core_hours"]))  # every shard starts its own workers
    assert planned(data, "--shard", "1", "--shard-size", 2)["shards"] == -(-frames // 2)


def test_records_of_more_objects_take_more_space(tmp_path: Path) -> None:
    data = SAMPLES["hit-uav:json"](tmp_path / "data")
    one, five, drawn = (
        int(str(planned(data, "--set", f"objects.0.count={count}")["disk_bytes"]))
        for count in (1, 5, "{values: [0, 5], weights: [1, 4]}")
    )
    frames = int(str(planned(data)["frames"]))
    assert five - one == pytest.approx(4 * 10_000 * frames, abs=2)
    assert drawn - one == pytest.approx(3 * 10_000 * frames, abs=2)


def test_more_objects_take_more_time(tmp_path: Path) -> None:
    data = SAMPLES["hit-uav:json"](tmp_path / "data")
    one, many = (float(str(planned(data, "--set", f"objects.0.count={count}")["core_hours"])) for count in (1, 61))
    frames = int(str(planned(data)["frames"]))
    more = 60 * OTHER_OBJECT_CPU_S * frames
    assert (many - one) * 3600 == pytest.approx(more, abs=4)  # hours have three digits


def test_objects_take_the_time_of_their_model_and_samples(tmp_path: Path) -> None:
    data = SAMPLES["hit-uav:json"](tmp_path / "data")
    many = ("--set", "objects.0.count=61", "--set", "render.samples=64", "--set", "labels.similar_names=keep")
    drones, cars, finer = (
        float(str(planned(data, *many, *more)["core_hours"])) * 3600
        for more in ((), ("--set", "objects.0.model=car"), ("--set", "render.samples=640"))
    )
    frames = int(str(planned(data)["frames"]))
    assert cars - drones == pytest.approx(61 * (OBJECT_CPU_S["car"] - OTHER_OBJECT_CPU_S) * frames, abs=4)
    assert finer - drones == pytest.approx(61 * 576 * CYCLES_SAMPLE_CPU_S * frames, abs=4)
    flat = float(str(planned(data, "--set", "objects.0.count=61")["core_hours"])) * 3600
    assert drones - flat > 61 * (CYCLES_OBJECT_CPU_S + 64 * CYCLES_SAMPLE_CPU_S) * frames - 4


def test_unchanged_pictures_have_no_records_of_inserts(tmp_path: Path) -> None:
    """Every second of many frames is an original: a sample of every second one had no inserts."""
    data = SAMPLES["hit-uav:json"](tmp_path / "data")
    settings = ("--set", "configurations=1", "--set", "objects.0.count=5")
    with_originals, without = (
        planned(data, *settings, "--set", f"output.originals={yes}") for yes in ("true", "false")
    )
    originals = int(str(with_originals["frames"])) - int(str(without["frames"]))
    more = int(str(with_originals["disk_bytes"])) - int(str(without["disk_bytes"]))
    size = sum(p.stat().st_size for p in data.rglob("*.jpg")) / len([*data.rglob("*.jpg")])
    assert originals > 0 and more == pytest.approx((6_000 + size) * originals, rel=0.05)


def test_the_first_frame_of_a_worker_counts_only_until_another_is_done() -> None:
    pace = Pace(workers=2)
    assert pace.frames_per_s() == 0
    pace.add(TaskResult("a", seconds=2.0, worker=0))
    assert pace.frames_per_s() == pytest.approx(1.0)
    pace.add(TaskResult("b", seconds=4.0, worker=1))
    assert pace.frames_per_s() == pytest.approx(2 / 3)
    pace.add(TaskResult("c", seconds=0.2, worker=0))
    assert pace.frames_per_s() == pytest.approx(10)
