"""Attacks on finished runs from the command line: outputs in the wrong place, edited records, two commands at once."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.samples import SAMPLES


@pytest.fixture(autouse=True)
def flat(monkeypatch: pytest.MonkeyPatch) -> None:
    render_flat(monkeypatch)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return SAMPLES["coco"](tmp_path / "data")


def command(data: Path, out: Path, *more: object) -> list[object]:
    return ["generate", "hit-uav-drone", "--data", data, "--out", out, "--to", "yolo,coco,voc", *more]


@pytest.fixture
def made(data: Path, tmp_path: Path) -> Path:
    done(*command(data, tmp_path / "run"))
    return tmp_path / "run"


def tree(root: Path) -> dict[str, bytes]:
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


# -- outputs in a dataset


def test_merge_writes_neither_into_its_backgrounds_nor_over_them(made: Path, tmp_path: Path) -> None:
    shards = tmp_path / "shards"
    done(*command(made / "coco", shards, "--shard", "1/1"))
    before = tree(made)
    for out in (made, made / "coco", made / "coco" / "merged"):
        for more in ([], ["--overwrite"], ["--data", made / "coco"]):
            ended = run("merge", shards, out, *more)
            assert ended.exit_code == 2, ended.output
            assert "data folder" in ended.output
    assert tree(made) == before
    done("merge", shards, tmp_path / "merged")


def test_pictures_of_a_run_are_not_written_into_datasets(made: Path, data: Path, tmp_path: Path) -> None:
    done("convert", data, tmp_path / "voc", "--to", "voc")
    done(*command(data, tmp_path / "other"))
    frame = next((made / "scenes").rglob("*.json")).relative_to(made / "scenes").with_suffix("").as_posix()
    before = {root: tree(root) for root in (made, data, tmp_path / "voc", tmp_path / "other")}
    for folder in (data, data / "new", made / "images/train", made / "coco", tmp_path / "voc/JPEGImages",
                   tmp_path / "other/images/train"):  # fmt: skip
        for words in (["preview", made], ["preview", made, "--ground"], ["rerender", made, frame, "--overwrite"]):
            ended = run(*words, "--out", folder / "x.png")
            assert ended.exit_code == 2, ended.output
            assert "is inside" in ended.output
    assert {root: tree(root) for root in before} == before
    done("preview", made)
    done("preview", made, "--out", tmp_path / "x.png")


# -- a run as a dataset


@pytest.mark.parametrize("to", ["voc", "yolo", "dota", "huggingface", "native", "hit-uav", "voc,yolo"])
def test_run_is_read_from_its_root_by_the_labels_it_has(data: Path, tmp_path: Path, to: str) -> None:
    out = tmp_path / "run"
    done(*command(data, out)[:-1], to)
    made = json.loads(run("inspect", out / to.split(",")[0], "--json").stdout)
    found = json.loads(done("inspect", out, "--json").stdout)
    assert found["splits"] == made["splits"]
    done("check", out)
    wrong = run("check", out, "--format", "cvat")
    assert wrong.exit_code == 1, wrong.output
    assert "expected labels in cvat" in wrong.output
    assert f"give one of {to.replace(',', ', ')}" in wrong.output


def test_folders_that_hold_no_part_of_a_dataset_are_not_read(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "converted"
    done("convert", data, out, "--to", "voc")
    made = json.loads(done("inspect", out, "--json").stdout)
    shutil.copytree(out / "Annotations", out / "replaced" / "Annotations")
    shutil.copytree(out / "JPEGImages", out / "replaced" / "JPEGImages")
    shutil.copytree(out / "ImageSets", out / "replaced" / "ImageSets")
    found = json.loads(done("inspect", out, "--json").stdout)
    assert (found["splits"], found["problems"]) == (made["splits"], made["problems"])


@pytest.mark.parametrize("depth", [1, 3, 6])
def test_unfinished_run_is_unfinished_at_any_depth(made: Path, depth: int) -> None:
    deep = made.joinpath("images", *[f"part {n}" for n in range(depth)])
    deep.mkdir(parents=True)
    picture = next((made / "images").rglob("*.jpg"))
    shutil.copy(picture, deep / "a.jpg")
    record = json.loads((made / "run.json").read_text())
    (made / "run.json").write_text(json.dumps({**record, "status": "running"}))
    for words in (["inspect", deep], ["check", deep], ["convert", deep, made.parent / "c", "--to", "yolo"]):
        ended = run(*words)
        assert ended.exit_code != 0, ended.output
        assert "unfinished run" in ended.output


# -- values of records


def test_damaged_masks_are_errors_with_a_name(made: Path) -> None:
    for file in sorted((made / "coco").glob("*.json")):
        document = json.loads(file.read_text())
        for annotation in document["annotations"]:
            if isinstance(annotation.get("segmentation"), dict):
                annotation["segmentation"]["counts"] = "1N20c5"
        file.write_text(json.dumps(document))
    ended = run("preview", made, "--out", made.parent / "x.png")
    assert ended.exit_code == 2, ended.output
    assert "run lengths" in ended.output


@pytest.mark.parametrize("value", ["NaN", "-Infinity", "1e999", "9" * 400 + ".5"])
def test_numbers_that_are_not_finite_in_a_record_of_shards_are_refused(data: Path, tmp_path: Path, value: str) -> None:
    shards = tmp_path / "shards"
    for n in (1, 2):
        done(*command(data, shards, "--shard", f"{n}/2"))
    for file in sorted(shards.rglob("run.json")):
        file.write_text(file.read_text().replace('"seed": 0', f'"seed": {value}'))
    ended = run("merge", shards, tmp_path / "merged")
    assert ended.exit_code == 2, ended.output
    assert "shards are not finished" in ended.output
    for n in (1, 2):
        done(*command(data, shards, "--shard", f"{n}/2", "--overwrite"))
    done("merge", shards, tmp_path / "merged")
