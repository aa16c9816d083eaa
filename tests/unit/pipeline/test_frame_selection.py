"""Frames chosen by id, sample or number: the same bytes as in the full run, and unknown ids with similar ones."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from infrablend import api
from infrablend.core.dataset import ImageRecord
from infrablend.errors import ArgumentError, OtherSettingsError
from infrablend.pipeline.plans.selection import FrameSelection
from tests.command_line import run
from tests.run_files import ledger_rows

FLAT = api.Execution(renderer="flat", in_process=True)
RECIPE = "hit-uav-drone-physical"


@pytest.fixture
def data(write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> Path:
    return write_tiny_hit_uav(tmp_path / "hit-uav")


def files(run: Path, folder: str) -> dict[str, bytes]:
    return {p.relative_to(run).as_posix(): p.read_bytes() for p in sorted((run / folder).rglob("*")) if p.is_file()}


def test_chosen_frames_have_the_bytes_of_the_full_run(data: Path, tmp_path: Path) -> None:
    api.generate(RECIPE, data, tmp_path / "full", execution=FLAT)
    chosen = ["train/0_60_30_0_00001_c1", "0_130_90_0_00004"]
    report = api.generate(RECIPE, data, tmp_path / "part", selection=FrameSelection(frames=chosen), execution=FLAT)
    assert report.counts["frames_planned"] == report.counts["frames"] == 3
    full, part = files(tmp_path / "full", "images"), files(tmp_path / "part", "images")
    stems = {"train/0_60_30_0_00001_c1", "test/0_130_90_0_00004_c0", "test/0_130_90_0_00004_c1"}
    pictures = {name: content for name, content in part.items() if name.endswith(".jpg")}
    assert {name.removeprefix("images/").removesuffix(".jpg") for name in pictures} == stems
    assert pictures.items() <= full.items()
    full_rows, part_rows = (ledger_rows(tmp_path / name / "run.sqlite") for name in ("full", "part"))
    assert len(part_rows) == 6 and set(part_rows) <= set(full_rows)


def test_a_run_of_chosen_frames_is_resumed_only_with_the_same_frames(data: Path, tmp_path: Path) -> None:
    def generate(frames: list[str], **options: Any) -> api.RunReport:
        return api.generate(
            RECIPE, data, tmp_path / "run", selection=FrameSelection(frames=frames), execution=FLAT, **options
        )

    generate(["test/0_130_90_0_00004_c0"])
    assert generate(["test/0_130_90_0_00004_c0"], existing="resume").ok
    with pytest.raises(OtherSettingsError, match="frames was"):
        generate(["test/0_130_90_0_00004_c1"], existing="resume")


def images(count: int) -> list[ImageRecord]:
    return [ImageRecord(f"{k}", Path(f"{k}.png"), "train", None, ()) for k in range(count)]


@pytest.mark.parametrize(("count", "size"), [(783, 120), (783, 700), (290, 200), (10, 9)])
def test_no_background_is_drawn_twice(count: int, size: int) -> None:
    pictures = images(count)
    for seed in range(20):
        drawn = [int(i.id) for i in FrameSelection(sample=size).backgrounds(pictures, seed)]
        assert len(drawn) == size and drawn == sorted(set(drawn))


def test_a_sample_is_spread_over_the_dataset_and_drawn_with_the_seed() -> None:
    pictures = images(100)
    for seed in (0, 1):
        drawn = [int(i.id) for i in FrameSelection(sample=10).backgrounds(pictures, seed)]
        assert [n // 10 for n in drawn] == list(range(10))
        assert drawn == [int(i.id) for i in FrameSelection(sample=10).backgrounds(pictures, seed)]
    assert FrameSelection(sample=10).backgrounds(pictures, 0) != FrameSelection(sample=10).backgrounds(pictures, 1)
    assert list(FrameSelection(sample=200).backgrounds(pictures, 0)) == pictures


@pytest.mark.parametrize("originals", [False, True])
@pytest.mark.parametrize(("count", "size"), [(7, 1), (7, 3), (7, 7), (7, 8), (7, 15), (7, 40), (1, 5)])
def test_a_number_of_pictures_is_exact_and_spread_over_the_backgrounds(count: int, size: int, originals: bool) -> None:
    pictures = images(count)
    chosen = FrameSelection(pictures=size).share_out(pictures, originals, 0)
    assert chosen == FrameSelection(pictures=size).share_out(pictures, originals, 0)
    per_background = Counter(image for image, _ in chosen)
    assert len(chosen) == size and max(per_background.values()) - min(per_background.values()) <= 1
    assert len(per_background) == min(count, max(1, size // 2) if originals else size)
    for image, n in per_background.items():
        configurations = sorted(k for i, k in chosen if i == image and k is not None)
        assert configurations == list(range(n - (originals and n > 1)))


def test_more_pictures_than_configurations_allow_are_refused() -> None:
    with pytest.raises(ArgumentError, match="found 2001, expected at most 1000 for each of 2 usable"):
        FrameSelection(pictures=2001).share_out(images(2), False, 0)
    assert len(FrameSelection(pictures=2002).share_out(images(2), True, 0)) == 2002


@pytest.mark.parametrize("size", [3, 7])
def test_a_number_of_pictures_has_the_bytes_of_a_full_run(data: Path, tmp_path: Path, size: int) -> None:
    full = api.generate(RECIPE, data, tmp_path / "full", settings=["configurations=2"], execution=FLAT)
    chosen = FrameSelection(pictures=size)
    report = api.generate(RECIPE, data, tmp_path / "run", selection=chosen, execution=FLAT)
    assert full.ok and report.ok and report.counts["frames"] == size
    made = {n: b for n, b in files(tmp_path / "run", "images").items() if n.endswith(".jpg")}
    assert len(made) == size and made.items() <= files(tmp_path / "full", "images").items()
    with pytest.raises(OtherSettingsError, match=f"pictures was {size}, is {size + 1}"):
        more = FrameSelection(pictures=size + 1)
        api.generate(RECIPE, data, tmp_path / "run", selection=more, execution=FLAT, existing="resume")
    frame = max(n.removeprefix("images/").removesuffix(".jpg") for n in made)
    assert api.rerender(tmp_path / "run", frame, tmp_path / "again.jpg").read_bytes() == made[f"images/{frame}.jpg"]


def test_shards_have_the_number_of_pictures_together(data: Path, tmp_path: Path) -> None:
    request = api.RunRequest(RECIPE, data, tmp_path / "parts", FrameSelection(pictures=5), execution=FLAT)
    for number in (1, 2):
        api.generate_shard(replace(request, shard=api.ShardRequest(number, 2)))
    api.merge([tmp_path / "parts"], tmp_path / "merged")
    api.generate(RECIPE, data, tmp_path / "whole", selection=FrameSelection(pictures=5), execution=FLAT)
    assert files(tmp_path / "merged", "images") == files(tmp_path / "whole", "images")


def test_a_number_of_pictures_is_chosen_from_usable_backgrounds(data: Path, tmp_path: Path) -> None:
    for form in "normal_json", "rotate_json":
        (data / form / "train" / "0_60_30_0_00001.jpg").unlink()
    report = api.generate(RECIPE, data, tmp_path / "run", selection=FrameSelection(pictures=4), execution=FLAT)
    assert report.counts["frames"] == 4 and report.ok
    assert any(p.code == "image-missing" for p in report.problems)


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"limit": 1, "sample": 1}, "limit and sample exclude each other"),
        ({"limit": 1, "pictures": 1}, "limit and pictures exclude each other"),
        ({"frames": ["a"], "pictures": 1}, "frames and pictures exclude each other"),
        ({"pictures": 0}, "pictures"),
        ({"frames": []}, "an empty list"),
        ({"frames": "a,b"}, "expected a list of names"),
        ({"sample": 0}, "sample"),
    ],
)
def test_wrong_choices_are_refused(choice: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        FrameSelection(**choice)


def test_unknown_frames_are_named_with_similar_ones(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    with pytest.raises(ArgumentError, match="1 of 2 frames do not exist") as caught:
        unknown = FrameSelection(frames=["test/0_130_90_0_00004", "tst/0_130_90_0_00004_c0"])
        api.generate(RECIPE, data, out, selection=unknown, execution=FLAT)
    (problem,) = caught.value.problems
    assert "test/0_130_90_0_00004_c0" in problem.expected
    assert not out.exists()


def test_the_command_line_plans_chosen_frames(data: Path, tmp_path: Path) -> None:
    words = ("generate", RECIPE, "--data", data, "--out", tmp_path / "run", "--plan", "--json")
    by_id = ("--frames", "test/0_130_90_0_00004_c1,0_60_30_0_00001")
    for chosen, count in (by_id, 3), (("--sample", 2), 4), (("--pictures", 9), 9):
        assert json.loads(run(*words, *chosen).stdout)["frames"] == count
    for other in "--sample", "--limit":
        refused = run(*words, other, 2, "--pictures", 1)
        assert refused.exit_code == 2 and f"{other[2:]} and pictures exclude each other" in refused.output
