"""Attacks on finished runs from the command line: outputs in the wrong place, edited records, two commands at once."""

from __future__ import annotations

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
