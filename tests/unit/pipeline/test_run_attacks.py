"""Attacks on finished runs from the command line: outputs in the wrong place, edited records, two commands at once."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from infrablend.core.finished import markers_of, require_unchanged
from infrablend.core.manifest import Manifest
from infrablend.errors import DatasetError
from infrablend.formats import writing
from infrablend.pipeline import choose
from infrablend.pipeline import run as run_module
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


# -- choices of frames


def test_a_choice_of_frames_renders_none_again(data: Path, made: Path) -> None:
    ids = [p.relative_to(made / "scenes").with_suffix("").as_posix() for p in sorted((made / "scenes").rglob("*.json"))]
    before = tree(made)
    record = json.loads((made / "scenes" / f"{ids[0]}.json").read_text())
    background = next(p for p in data.rglob("*.jpg") if p.stem == Path(record["background"]["path"]).stem)
    whole = background.read_bytes()
    for broken in (whole + b"x", whole[:300]):
        background.write_bytes(broken)
        ended = run("exclude", made, ids[-1])
        assert ended.exit_code == 2, ended.output
        assert "nothing was changed" in ended.output
        after = tree(made)
        assert {n: after[n] for n in before if not n.startswith("log/")} == {
            n: c for n, c in before.items() if not n.startswith("log/")
        }
    background.write_bytes(whole)
    done("exclude", made, ids[0])


def test_a_frame_counts_more_than_a_background_of_its_name(data: Path, tmp_path: Path) -> None:
    made = tmp_path / "originals"
    done(*command(data, made, "--set", "output.originals=true"))
    again = tmp_path / "again"
    done(*command(made / "coco", again, "--set", "output.originals=true"))
    ids = [p.relative_to(again / "scenes").with_suffix("").as_posix() for p in (again / "scenes").rglob("*.json")]
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
    ids = [p.relative_to(made / "scenes").with_suffix("").as_posix() for p in sorted((made / "scenes").rglob("*.json"))]
    done("exclude", made, ids[0])
    mine = made / "excluded" / "scenes" / "mybackup" / f"{Path(ids[1]).name}.json"
    mine.parent.mkdir()
    shutil.copy(made / "scenes" / f"{ids[1]}.json", mine)
    report = json.loads(done("exclude", made, "--purge", "--json").stdout)
    assert report["purged_files"] == 2 and mine.is_file()


def test_a_choice_that_was_removed_or_put_back_is_noticed(made: Path) -> None:
    ids = [p.relative_to(made / "scenes").with_suffix("").as_posix() for p in sorted((made / "scenes").rglob("*.json"))]
    done("exclude", made, ids[0])
    first = (made / "excluded.json").read_bytes()
    (made / "excluded.json").unlink()
    assert run("check", made).exit_code == 1
    ended = run("exclude", made, ids[1])
    assert ended.exit_code == 2 and "is missing" in ended.output, ended.output
    (made / "excluded.json").write_bytes(first)
    done("exclude", made, ids[1])
    (made / "excluded.json").write_bytes(first)
    assert run("check", made).exit_code == 1


# -- what is missing


@pytest.mark.parametrize("gone", ["scenes", "log/files.jsonl"])
def test_missing_records_and_lists_are_found(made: Path, gone: str) -> None:
    path = made / gone
    path = next(path.rglob("*.json")) if path.is_dir() else path
    path.unlink()
    ended = run("check", made)
    assert ended.exit_code == 1, ended.output
    assert "run.json counts" in ended.output or "lists 0 files" in ended.output


def test_labels_are_not_left_out_without_the_list_of_their_files(made: Path) -> None:
    ids = [p.relative_to(made / "scenes").with_suffix("").as_posix() for p in sorted((made / "scenes").rglob("*.json"))]
    (made / "log/files.jsonl").unlink()
    ended = run("exclude", made, ids[0])
    assert ended.exit_code == 2 and "--resume" in ended.output, ended.output


@pytest.mark.parametrize("name", ["yolo", "yolo/labels", "images"])
def test_linked_folders_of_a_run_are_refused(made: Path, tmp_path: Path, name: str) -> None:
    ids = [p.relative_to(made / "scenes").with_suffix("").as_posix() for p in sorted((made / "scenes").rglob("*.json"))]
    (made / name).rename(tmp_path / "elsewhere")
    (made / name).symlink_to(tmp_path / "elsewhere")
    before = tree(tmp_path / "elsewhere")
    ended = run("exclude", made, ids[0])
    assert ended.exit_code == 2 and "are links" in ended.output, ended.output
    assert tree(tmp_path / "elsewhere") == before


# -- folders that change meanwhile


def test_a_killed_overwrite_leaves_an_unfinished_folder(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for words in (
        ["convert", data, tmp_path / "c", "--to", "voc"],
        ["split", data, tmp_path / "s", "--to", "yolo", "--by", "gap"],
    ):
        out = Path(str(words[2]))
        done(*words)
        whole = tree(out)

        def stop(self: Manifest, keep: object = ()) -> list[str]:
            next(self.root / n for n in self.paths if "/" in n).unlink()
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(Manifest, "remove_own", stop)
            run(*words, "--overwrite")
        ended = run("convert", out, tmp_path / "d", "--to", "coco")
        assert ended.exit_code == 2 and "unfinished" in ended.output, ended.output
        done(*words, "--overwrite")
        assert tree(out).keys() == whole.keys()


def test_a_source_that_is_written_again_with_the_same_bytes_is_noticed(data: Path, tmp_path: Path) -> None:
    source = tmp_path / "c"
    done("convert", data, source, "--to", "yolo")
    markers = markers_of(source)
    require_unchanged(source, markers)
    done("convert", data, source, "--to", "yolo", "--overwrite")
    with pytest.raises(DatasetError, match="written again while it was read"):
        require_unchanged(source, markers)


def test_a_run_notices_backgrounds_that_are_written_again(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = run_module._make_frames

    def rewriting(*arguments: object) -> None:
        frames(*arguments)  # type: ignore[arg-type]
        (made / "run.json").write_bytes((made / "run.json").read_bytes())

    monkeypatch.setattr(run_module, "_make_frames", rewriting)
    ended = run(*command(made / "coco", tmp_path / "second"))
    assert ended.exit_code == 2 and "written again while it was read" in ended.output, ended.output
    assert json.loads((tmp_path / "second/run.json").read_text())["status"] != "complete"


def test_a_folder_that_is_made_again_meanwhile_is_left_alone(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "other"
    done(*command(data, other, "--seed", 1))
    frames = run_module._make_frames

    def swapping(*arguments: object) -> None:
        (tmp_path / "run").rename(tmp_path / "moved")
        other.rename(tmp_path / "run")
        frames(*arguments)  # type: ignore[arg-type]

    before = tree(other)
    monkeypatch.setattr(run_module, "_make_frames", swapping)
    ended = run(*command(data, tmp_path / "run"))
    assert ended.exit_code in (2, 3) and "made again" in ended.output, ended.output
    after = tree(tmp_path / "run")
    assert after["run.json"] == before["run.json"]


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


def test_frames_of_another_run_are_noticed(data: Path, made: Path, tmp_path: Path) -> None:
    before = tree(made)
    done(*command(data, tmp_path / "other", "--seed", 1))
    ids = [p.relative_to(made / "scenes").with_suffix("").as_posix() for p in sorted((made / "scenes").rglob("*.json"))]
    for name in (f"scenes/{ids[0]}.json", f"images/{ids[0]}.jpg"):
        (made / name).unlink()
        shutil.copy(tmp_path / "other" / name, made / name)
    ended = run("check", made)
    assert ended.exit_code == 1 and "a frame of another run" in ended.output, ended.output
    done(*command(data, made, "--resume"))
    after = tree(made)
    assert {n: after[n] for n in before if n.startswith(("scenes/", "images/", "coco/", "yolo/"))} == {
        n: c for n, c in before.items() if n.startswith(("scenes/", "images/", "coco/", "yolo/"))
    }


def test_frames_of_another_run_are_not_merged(data: Path, tmp_path: Path) -> None:
    for seed, out in ((0, tmp_path / "a"), (1, tmp_path / "b")):
        for n in (1, 2):
            done(*command(data, out, "--shard", f"{n}/2", "--seed", seed))
    record = next((tmp_path / "a").rglob("scenes/*/*.json"))
    name = record.relative_to(tmp_path / "a")
    picture = Path(str(name).replace("scenes", "images")).with_suffix(".jpg")
    for part in (name, picture):
        (tmp_path / "a" / part).unlink()
        shutil.copy(tmp_path / "b" / part, tmp_path / "a" / part)
    ended = run("merge", tmp_path / "a", tmp_path / "merged")
    assert ended.exit_code == 2 and "missing or damaged" in ended.output, ended.output


@pytest.mark.parametrize("what", ["links", "folders"])
def test_what_is_in_both_places_of_an_excluded_picture_is_kept(made: Path, tmp_path: Path, what: str) -> None:
    ids = [p.relative_to(made / "scenes").with_suffix("").as_posix() for p in sorted((made / "scenes").rglob("*.json"))]
    done("exclude", made, ids[0])
    for number, place in enumerate((made / f"images/{ids[0]}.jpg", made / f"excluded/images/{ids[0]}.jpg")):
        place.unlink(missing_ok=True)
        mine = tmp_path / f"mine{number}"
        mine.mkdir() if what == "folders" else mine.write_text("mine")
        if what == "folders":
            place.mkdir(parents=True)
            (place / "note").write_text(f"mine {number}")
        else:
            place.parent.mkdir(parents=True, exist_ok=True)
            place.symlink_to(mine)
    ended = run("exclude", made, ids[1])
    assert ended.exit_code in (0, 1, 2, 3), ended.output
    kept = [p for p in made.rglob("*") if (p.is_symlink() if what == "links" else p.name == "note")]
    assert len(kept) == 2, (ended.output, sorted(made.rglob("*.jpg*")))


@pytest.mark.parametrize("place", ["images", "voc/Annotations", "yolo/labels"])
def test_a_folder_removed_while_files_are_written_can_be_used_again(data, tmp_path, monkeypatch, place):
    out, mkdir = tmp_path / "out", Path.mkdir
    words = command(data, out)
    removed = []

    def remove(path: Path, *rest: object, **options: object) -> None:
        if not removed and out / place in (path, *path.parents) and not path.exists():
            removed.append(path)
            shutil.rmtree(out)
        mkdir(path, *rest, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "mkdir", remove)
        ended = run(*words)
    assert removed and ended.exit_code in (2, 3), ended.output
    again = run(*words)
    if again.exit_code:
        done(*words, "--resume")
    done("check", out)
    done(*command(data, tmp_path / "whole"))
    found, whole = (
        {n: data for n, data in tree(root).items() if "/" in n and not n.startswith("log/")}
        for root in (out, tmp_path / "whole")
    )
    assert found == whole
