"""Frames excluded from a finished run: labels and counts follow, nothing is lost, and kills leave nothing half done."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from infrablend import api
from infrablend.core.workspace import partial_of
from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.killing import run_until_killed
from tests.run_files import excluded, frame_ids, hashes
from tests.samples import SAMPLES

FRAME = "train/0_60_30_0_00001_c0"


def refused(*words: object) -> str:
    ended = run(*words)
    assert ended.exit_code == 2, ended.output
    return ended.output


@pytest.fixture(autouse=True)
def flat(monkeypatch: pytest.MonkeyPatch) -> None:
    render_flat(monkeypatch)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return SAMPLES["coco"](tmp_path / "data")


@pytest.fixture
def words(data: Path, tmp_path: Path) -> list[object]:
    recipe = tmp_path / "recipe.yaml"
    text = api.show_recipe("hit-uav-drone").replace("configurations: 2", "configurations: 1")
    recipe.write_text(text)
    sets = ["--set", "camera.pitch={fixed_deg: 60}", "--set", "camera.size_px=[64, 48]", "--to", "yolo,coco,voc"]
    return ["generate", recipe, "--data", data, "--out", tmp_path / "run", *sets]


@pytest.fixture
def made(words: list[object], tmp_path: Path) -> Path:
    done(*words)
    return tmp_path / "run"


def record(run_folder: Path) -> dict:  # type: ignore[type-arg]
    found: dict = json.loads((run_folder / "run.json").read_text())  # type: ignore[type-arg]
    return found


def test_a_label_that_is_dropped_is_no_failure(words: list[object], data: Path, tmp_path: Path) -> None:
    file = next(p for p in sorted(data.rglob("*.json")) if "annotations" in json.loads(p.read_text()))
    annotated = json.loads(file.read_text())
    annotated["annotations"].append({**annotated["annotations"][0], "id": 999, "bbox": [900, 900, 9, 9]})
    annotated["annotations"][-1].pop("segmentation", None)
    file.write_text(json.dumps(annotated))
    done(*words)
    run_folder = tmp_path / "run"
    assert record(run_folder)["counts"]["dataset_errors"] == {"box-outside": 1}
    frame = frame_ids(run_folder)[0]
    done("exclude", run_folder, frame)
    done("include", run_folder, frame)


@pytest.mark.parametrize("place", ["images", "yolo/labels"])
def test_files_added_to_folders_that_are_written_again_are_not_lost(
    made: Path, words: list[object], place: str
) -> None:
    mine = made / place / "mine.txt"
    mine.write_text("mine")
    frame = frame_ids(made)[0]
    assert f"{place}/mine.txt" in refused("exclude", made, frame)
    assert mine.read_text() == "mine" and not excluded(made)
    done(*words, "--resume")  # nothing is written again
    next((made / "yolo" / "labels").rglob("*_c0.txt")).unlink()
    assert f"{place}/mine.txt" in refused(*words, "--resume")
    mine.rename(made.parent / "mine.txt")
    done("exclude", made, frame)
    done("check", made)


def test_labels_counts_card_and_check_follow(made: Path, tmp_path: Path) -> None:
    every = frame_ids(made)
    left_out = every[0]
    done("exclude", made, left_out, "--reason", "too bright")
    assert frame_ids(made) == every[1:]
    assert excluded(made) == {left_out: "too bright"}
    counts = record(made)["counts"]
    assert (counts["frames_planned"], counts["frames"], counts["frames_excluded"]) == (len(every), len(every) - 1, 1)
    stem = left_out.rpartition("/")[2]
    inside = [p for p in made.rglob(f"{stem}.*") if p.relative_to(made).parts[0] != "excluded"]
    assert inside == []
    assert stem not in "".join(p.read_text() for p in (made / "coco").glob("*.json"))
    assert [p.name for p in (made / "excluded").rglob("*.*")] == [f"{stem}.jpg"]
    done("check", made)
    done("convert", made, tmp_path / "voc", "--to", "voc")
    assert not list((tmp_path / "voc").rglob(f"{stem}.*"))
    assert f"{len(every) - 1}" in (made / "README.md").read_text()


def test_included_frames_give_the_run_back_byte_by_byte(made: Path) -> None:
    before = hashes(made)
    every = frame_ids(made)
    done("exclude", made, *every[:2])
    done("include", made, every[0])
    assert frame_ids(made) == [every[0], *every[2:]]
    done("include", made, "--all")
    assert hashes(made) == before


@pytest.mark.parametrize("option", ["--resume", "--overwrite"])
def test_a_resumed_run_keeps_the_choice_and_a_new_one_forgets_it(option: str, made: Path, words: list[object]) -> None:
    whole = hashes(made)
    done("exclude", made, frame_ids(made)[0])
    expected = hashes(made) if option == "--resume" else whole
    done(*words, option)
    assert hashes(made) == expected


def test_purged_files_are_deleted_and_rendered_again(made: Path, words: list[object]) -> None:
    before, left_out = hashes(made), frame_ids(made)[1]
    done("exclude", made, left_out, "--purge")
    assert not (made / "excluded").exists()
    done(*words, "--resume")
    assert left_out not in frame_ids(made)
    done("include", made, left_out)
    assert hashes(made) == before


def test_a_review_excludes_and_includes(made: Path) -> None:
    every = frame_ids(made)
    done("exclude", made, every[2])
    verdicts = {every[0]: {"verdict": "reject", "reason": "blurred"}, every[2]: {"verdict": "accept"}}
    (made / "review.json").write_text(json.dumps({"frames": verdicts}))
    done("exclude", made, "--review")
    assert excluded(made) == {every[0]: "blurred"}
    ended = refused("generate", "hit-uav-drone", "--data", made.parent / "data", "--out", made, "--overwrite")
    assert "not part of the run (review.json)" in " ".join(ended.split())
    done("check", made)
    (made / "review.json").write_text('{"frames": {"a": {"verdict": "maybe"}}}')
    assert "cannot be read as a review" in refused("exclude", made, "--review")
    (made / "review.json").unlink()
    (made.parent / "review.json").write_text(json.dumps({"frames": verdicts}))
    (made / "review.json").symlink_to(made.parent / "review.json")
    assert "a link out of its folder" in " ".join(refused("exclude", made, "--review").split())


# Before and after the folder is reopened, while files move and labels are written, and at its end.
@pytest.mark.parametrize("finish", ["exclude", "resume"])
@pytest.mark.parametrize("renames", [0, 1, 2, 3, 5, 8, 12, 16])
def test_a_killed_exclusion_is_finished(
    renames: int, finish: str, made: Path, words: list[object], tmp_path: Path
) -> None:
    left_out = frame_ids(made)[0]
    shutil.copytree(made, tmp_path / "whole")
    done("exclude", tmp_path / "whole", left_out)
    run_until_killed(renames, lambda: run("exclude", made, left_out))
    if renames > 1:
        assert f"infrablend exclude {made}" in " ".join(refused("check", made).split())
    if finish == "resume":
        done(*words, "--resume")
    done("exclude", made, left_out)  # the kill may have come before the choice was stored
    assert hashes(made) == hashes(tmp_path / "whole")
    assert not partial_of(made).exists()


def test_an_exclusion_killed_right_after_it_took_the_name_away_is_finished(made: Path) -> None:
    left_out = frame_ids(made)[0]
    made.rename(partial_of(made))
    done("exclude", made, left_out)
    assert left_out not in frame_ids(made) and not partial_of(made).exists()


def test_wrong_requests_change_nothing(made: Path, data: Path, tmp_path: Path) -> None:
    before = hashes(made)
    left_out = frame_ids(made)[0]
    assert left_out in refused("exclude", made, left_out[:-1] + "7")
    assert "all frames of the run would be excluded" in refused("exclude", made, *frame_ids(made))
    assert "give either ids of frames or --all" in refused("include", made)
    refused("exclude", tmp_path, left_out)
    shutil.move(data, tmp_path / "moved")
    refused("exclude", made, left_out)
    assert hashes(made) == before
    done("exclude", made, left_out, "--data", tmp_path / "moved")


def test_an_unfinished_run_is_refused(words: list[object], tmp_path: Path) -> None:
    run_until_killed(8, lambda: run(*words))
    ended = " ".join(refused("exclude", tmp_path / "run", FRAME).split())
    assert "an unfinished run; expected a finished one" in ended and "--resume" in ended


def test_the_recorded_request_is_read_again(made: Path, words: list[object], tmp_path: Path) -> None:
    """A run with a limit, one split and options of the reader."""
    out = tmp_path / "part"
    part = [*words]
    part[part.index("--out") + 1] = out
    done(*part, "--split", "train,val", "--limit", "2", "--format", "coco")
    assert record(out)["request"] == {
        "reading": {"splits": ["train", "val"], "format": "coco"},
        "selection": {"limit": 2},
    }
    done("exclude", out, frame_ids(out)[0])
    assert len(frame_ids(out)) == 1
