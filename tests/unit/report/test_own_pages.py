"""Pages of results, and profiles, replace pages of InfraBlend only."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from infrablend.core.files import write_text
from infrablend.errors import OutputError
from infrablend.lab.pages.write_results import index_text, require_own_pages, write_page
from infrablend.pipeline.studies.profile import _require_own_profile
from tests.command_line import run
from tests.samples import SAMPLES

RESULTS = Path(__file__).parents[3] / "docs" / "results"


def test_own_pages_are_replaced(tmp_path: Path) -> None:
    require_own_pages(RESULTS, "transfer-car", "small")
    require_own_pages(tmp_path, "transfer-car", "small")
    write_text(tmp_path / "index.md", index_text(tmp_path))
    for name in ("transfer-car.json", "transfer-car.md"):
        shutil.copy(RESULTS / name, tmp_path / name)
    require_own_pages(tmp_path, "transfer-car", "small")


@pytest.mark.parametrize(
    "name", ["index.md", "transfer-car.md", "transfer-car.json", "transfer-car_pr.svg", "transfer-car-unfinished.md"]
)
@pytest.mark.parametrize("kind", ["file", "link"])
def test_other_files_in_their_place_are_named(tmp_path: Path, name: str, kind: str) -> None:
    mine = tmp_path / "mine"
    mine.write_text(json.dumps({"mine": 1}))
    out = tmp_path / "out"
    out.mkdir()
    (out / name).symlink_to(mine) if kind == "link" else shutil.copy(mine, out / name)
    with pytest.raises(OutputError, match="not written by InfraBlend") as caught:
        require_own_pages(out, "transfer-car", "small")
    assert [Path(p.where).name for p in caught.value.problems] == [name]


def test_note_beside_the_record_of_an_experiment_is_named(tmp_path: Path) -> None:
    shutil.copy(RESULTS / "transfer-car.json", tmp_path / "transfer-car.json")
    (tmp_path / "transfer-car.md").write_text("my notes on the cars")
    with pytest.raises(OutputError, match="not written by InfraBlend"):
        require_own_pages(tmp_path, "transfer-car", "small")


def test_only_charts_of_the_page_are_deleted(tmp_path: Path) -> None:
    facts = json.loads((RESULTS / "datasets.json").read_text("utf-8"))
    for name in ("datasets_pr.svg", "datasets_mine.svg"):
        (tmp_path / name).write_text("chart")
    write_page(facts, tmp_path)
    assert (tmp_path / "datasets_mine.svg").read_text() == "chart" and not (tmp_path / "datasets_pr.svg").exists()


def test_committed_pages_can_be_written_again() -> None:
    for path in sorted(RESULTS.glob("*.json")):
        facts = json.loads(path.read_text("utf-8"))
        if "experiment" in facts:
            require_own_pages(RESULTS, facts["experiment"], facts["scale"])


def test_an_experiment_stops_before_its_first_stage(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "results/index.md").write_text("mine")
    data = SAMPLES["hit-uav:json"](tmp_path / "data")
    words = ("--data", data, "--work", tmp_path / "work", "--results", tmp_path / "results", "--scale", "smoke")
    ended = run("experiment", "hit-uav-drone", *words)
    assert ended.exit_code == 2 and "--results" in ended.output, ended.output
    assert (tmp_path / "results/index.md").read_text() == "mine" and not (tmp_path / "work").exists()


def test_profiles_of_others_are_not_replaced(tmp_path: Path) -> None:
    _require_own_profile(tmp_path)
    for name in ("profile.json", "profile.png"):
        (tmp_path / name).write_text("{}")
        with pytest.raises(OutputError, match="not written by InfraBlend"):
            _require_own_profile(tmp_path)
        (tmp_path / name).unlink()
