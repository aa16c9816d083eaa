"""Attacks on finished runs from the command line: outputs in the wrong place, edited records, two commands at once."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from infrablend.formats import writing
from infrablend.pipeline import choose
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


@pytest.mark.parametrize(
    "change",
    [
        lambda r: r.update(levels=[0, 100]),
        lambda r: r["machine"].update(renderer="blender"),
        lambda r: r["recipe"].update(seed=5),
        lambda r: r.setdefault("request", {}).update(selection={"limit": 1}),
    ],
)
def test_edited_record_of_a_run_is_refused_and_found_by_check(made: Path, data: Path, change) -> None:
    record = json.loads((made / "run.json").read_text())
    change(record)
    (made / "run.json").write_text(json.dumps(record))
    frame = next((made / "scenes").rglob("*.json")).relative_to(made / "scenes").with_suffix("").as_posix()
    for words in (
        command(data, made, "--resume"),
        ["exclude", made, frame],
        ["report", made],
        ["rerender", made, frame],
    ):
        ended = run(*words)
        assert ended.exit_code == 2, ended.output
        assert "changed after InfraBlend wrote it" in ended.output
    assert "file-changed" in run("check", made).output
    done(*command(data, made, "--overwrite"))
    assert (made / "log/replaced/run.json").is_file()
    done("check", made)


# -- choices of frames


def frames_of(run_folder: Path) -> list[str]:
    scenes = run_folder / "scenes"
    return sorted(p.relative_to(scenes).with_suffix("").as_posix() for p in scenes.rglob("*.json"))


def test_two_choices_at_once_are_both_kept(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second, *_ = frames_of(made)
    real, others = choose.run_plan, []

    def meanwhile(*words: object, **more: object) -> object:
        if not others:
            others.append(second)
            done("exclude", made, second)
        return real(*words, **more)

    monkeypatch.setattr(choose, "run_plan", meanwhile)
    done("exclude", made, first)
    assert set(json.loads((made / "excluded.json").read_text())["frames"]) == {first, second}
    assert not {first, second} & {*frames_of(made)}


def test_edited_choice_deletes_nothing(made: Path, data: Path) -> None:
    first, second, *_ = frames_of(made)
    done("exclude", made, first)
    chosen = json.loads((made / "excluded.json").read_text())
    (made / "excluded.json").write_text(json.dumps({**chosen, "frames": {second: "by hand"}}))
    before = tree(made / "excluded") | tree(made / "images")
    for words in (["exclude", made, "--purge"], ["include", made, first], command(data, made, "--resume")):
        ended = run(*words)
        assert ended.exit_code == 2, ended.output
        assert "excluded.json" in ended.output and "edited" in ended.output
    assert tree(made / "excluded") | tree(made / "images") == before
    done(*command(data, made, "--overwrite"))
    assert (made / "log/replaced/excluded.json").is_file()
    assert first in frames_of(made)


def test_review_of_an_overwritten_run_is_kept_aside(made: Path, data: Path) -> None:
    first = frames_of(made)[0]
    (made / "review.json").write_text(json.dumps({"frames": {first: {"verdict": "reject"}}}))
    done(*command(data, made, "--overwrite", "--seed", 3))
    assert not (made / "review.json").exists()
    assert (made / "log/replaced/review.json").is_file()
    assert run("exclude", made, "--review").exit_code == 2
    assert first in frames_of(made)


@pytest.mark.parametrize("words", [["convert", "--to", "yolo"], ["split", "--by", "gap", "--gap", 1, "--to", "coco"]])
def test_dataset_that_is_written_again_meanwhile_is_an_error(
    made: Path, data: Path, tmp_path: Path, words: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    real, done_before = writing.write, []

    def meanwhile(*given: object, **more: object) -> object:
        if not done_before:
            done_before.append(True)
            done(*command(data, made, "--overwrite", "--seed", 3))
        return real(*given, **more)

    monkeypatch.setattr(writing, "write", meanwhile)
    ended = run(words[0], made, tmp_path / "out", *words[1:])
    assert ended.exit_code == 2, ended.output
    assert "was written again while it was read" in ended.output
    assert "unfinished" in run("check", tmp_path / "out").output
    done(words[0], made, tmp_path / "out", *words[1:], "--overwrite")
