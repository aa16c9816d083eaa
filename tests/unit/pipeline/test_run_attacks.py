"""Attacks on finished runs from the command line: outputs in the wrong place, damaged labels, two commands at once."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from infrablend.pipeline.runs import choose
from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.run_files import excluded, frame_ids, records
from tests.samples import SAMPLES

pytestmark = pytest.mark.long


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
    frame = frame_ids(made)[0]
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


# -- choices of frames


def test_two_choices_at_once_are_both_kept(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, *_ = frame_ids(made)
    real, others = choose.run_plan, []

    def meanwhile(*words: object, **more: object) -> object:
        if not others:
            others.append(second)
            done("exclude", made, second)
        return real(*words, **more)

    monkeypatch.setattr(choose, "run_plan", meanwhile)
    done("exclude", made, first)
    assert excluded(made).keys() == {first, second}
    assert not {first, second} & {*frame_ids(made)}


def test_a_choice_of_frames_renders_none_again(data: Path, made: Path) -> None:
    ids = frame_ids(made)
    before = tree(made)
    background = data / str(records(made)[0].background["path"])
    whole = background.read_bytes()
    for broken in (whole + b"x", whole[:300]):
        background.write_bytes(broken)
        ended = run("exclude", made, ids[-1])
        assert ended.exit_code == 2, ended.output
        assert "nothing was changed" in ended.output
        assert tree(made) == before
    background.write_bytes(whole)
    done("exclude", made, ids[0])


def test_a_frame_counts_more_than_a_background_of_its_name(data: Path, tmp_path: Path) -> None:
    made = tmp_path / "originals"
    done(*command(data, made, "--set", "output.originals=true"))
    again = tmp_path / "again"
    done(*command(made / "coco", again, "--set", "output.originals=true"))
    ids = frame_ids(again)
    both = sorted(i for i in ids if f"{i}_c0" in ids and i.endswith("_c0"))
    assert both, ids
    chosen = both[0]
    verdicts = {chosen: {"verdict": "reject"}, f"{chosen}_c0": {"verdict": "accept"}}
    (again / "review.json").write_text(json.dumps({"frames": verdicts}))
    report = json.loads(done("exclude", again, "--review", "--json").stdout)
    assert list(report["excluded"]) == [chosen]
    (again / "review.json").write_text(
        json.dumps({"frames": {chosen.rpartition("_c")[0] + "-x": {"verdict": "reject"}}})
    )
    assert run("exclude", again, "--review").exit_code == 2


def test_purging_leaves_copies_that_somebody_made(made: Path) -> None:
    ids = frame_ids(made)
    done("exclude", made, ids[0])
    mine = made / "excluded" / "test" / "mybackup" / "a.jpg"
    mine.parent.mkdir(parents=True)
    shutil.copy(next((made / "images").rglob("*.jpg")), mine)
    report = json.loads(done("exclude", made, "--purge", "--json").stdout)
    assert report["purged_files"] == 1 and mine.is_file()


def test_shards_with_other_grey_levels_are_not_merged(data: Path, tmp_path: Path) -> None:
    shards = tmp_path / "shards"
    for n in (1, 2):
        words = command(data, shards, "--shard", f"{n}/2")
        words[1] = "hit-uav-drone-physical"
        assert run(*words).exit_code in (0, 1)
        record = json.loads((shards / "shards.json").read_text())
        assert record["levels"]
        (shards / "shards.json").write_text(json.dumps({**record, "levels": [41.0, 167.0]}))
    ended = run("merge", shards, tmp_path / "merged")
    assert ended.exit_code == 2 and "grey levels" in ended.output, ended.output
