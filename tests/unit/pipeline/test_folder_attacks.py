"""Attacks on output folders from the command line: kills, edited and foreign files, removed files, records that lie."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

from infrablend.core.files import part_path
from tests.clips import write_detections
from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.killing import run_until_killed
from tests.run_files import without_times
from tests.samples import SAMPLES


def killed(renames: int, *words: object) -> None:
    """Run a command that dies after this many renames."""
    run_until_killed(renames, lambda: run(*words))


def set_status(record: Path, status: str) -> None:
    record.write_text(json.dumps(json.loads(record.read_text()) | {"status": status}))


def tree(root: Path) -> dict[str, bytes]:
    """Return all files but records and logs."""
    names = [p.relative_to(root).as_posix() for p in sorted(root.rglob("*")) if p.is_file()]
    found = {name: without_times(name, (root / name).read_bytes()) for name in names}
    return {k: v for k, v in found.items() if not k.startswith("log/") and k not in ("convert.json", "run.json")}


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return SAMPLES["coco"](tmp_path / "data")


@pytest.fixture
def converted(data: Path, tmp_path: Path) -> Path:
    done("convert", data, tmp_path / "voc", "--to", "voc")
    return tmp_path / "voc"


# -- unfinished output does not pass for finished


READERS: dict[str, Callable[[Path, Path], list[object]]] = {
    "check": lambda folder, out: ["check", folder],
    "inspect": lambda folder, out: ["inspect", folder],
    "convert": lambda folder, out: ["convert", folder, out, "--to", "yolo"],
    "split": lambda folder, out: ["split", folder, out, "--by", "gap"],
    "train": lambda folder, out: ["train", folder, "--out", out, "--plan", "--preset", "smoke"],
    "generate": lambda folder, out: ["generate", "hit-uav-drone", "--data", folder, "--out", out],
}


@pytest.mark.parametrize("reader", READERS)
def test_unfinished_conversion_is_an_error_that_names_the_command(reader: str, converted: Path, tmp_path: Path) -> None:
    set_status(converted / "convert.json", "running")
    sorted((converted / "Annotations").glob("*.xml"))[0].unlink()
    ended = run(*READERS[reader](converted, tmp_path / "out"))
    assert ended.exit_code == 2, ended.output
    said = " ".join(ended.stderr.split())
    assert "unfinished conversion" in said and f"infrablend convert {tmp_path}/data {converted} --to voc" in said
    assert not (tmp_path / "out").exists()


def test_killed_split_is_unfinished_and_is_finished_with_overwrite(data: Path, tmp_path: Path) -> None:
    out, fresh = tmp_path / "out", tmp_path / "fresh"
    words = ["--by", "gap", "--gap", "1", "--shares", "0.5,0.25,0.25", "--to", "voc"]
    killed(6, "split", data, out, *words)
    assert any(out.rglob("*.xml"))
    ended = run("check", out)
    assert ended.exit_code == 2 and "infrablend split" in ended.stderr and "--overwrite" in ended.stderr
    assert run("split", data, out, *words).exit_code == 2
    done("split", data, out, *words, "--overwrite")
    done("split", data, fresh, *words)
    assert tree(out) == tree(fresh)
    assert run("check", out).exit_code != 2


def said_command(said: str) -> list[str]:
    """Return the words of the command that a message says to repeat."""
    return shlex.split(said.rpartition("infrablend ")[2])


def test_unfinished_folders_name_the_whole_command(data: Path, words: list[object], tmp_path: Path) -> None:
    """The command in the message finishes the folder: nothing that the user gave is left out."""
    run_until_killed(8, lambda: run(*words, "--limit", "2", "--seed", "3"))
    out, dst = tmp_path / "the parts", tmp_path / "a copy"
    killed(6, "split", data, out, "--by", "gap", "--gap", "1", "--shares", "0.5,0.25,0.25", "--to", "voc")
    killed(2, "convert", data, dst, "--to", "voc", "--rename", "Person=human")
    for folder, given in (
        (tmp_path / "run", "--set 'camera.pitch={fixed_deg: 60}' --data"),
        (out, "--shares 0.5,0.25,0.25"),
        (dst, "--rename Person=human"),
    ):
        ended = run("check", folder)
        assert ended.exit_code == 2 and given in ended.stderr, ended.output
        assert run(*said_command(ended.stderr)).exit_code == 0
        assert run("check", folder).exit_code != 2
    made = json.loads((tmp_path / "run" / "run.json").read_text())
    assert made["request"]["selection"] == {"limit": 2} and made["seed"] == 3


def test_unfinished_run_without_a_command_names_what_its_record_holds(made: Path, data: Path) -> None:
    set_status(made / "run.json", "interrupted")
    command = f"infrablend generate RECIPE --data {data} --out {made} --seed 0 --resume"
    assert command in run("check", made / "yolo").stderr
    assert command in run("exclude", made, "a").stderr
    set_status(made / "run.json", "excluding")
    assert f"infrablend exclude {made}" in run("check", made / "yolo").stderr


def test_split_does_not_write_to_a_folder_in_use(data: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    handle = os.open(tmp_path / "out", os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        ended = run("split", data, tmp_path / "out", "--by", "gap", "--gap", "1")
    finally:
        os.close(handle)
    assert ended.exit_code == 2 and "another process is writing" in ended.stderr
    assert not any((tmp_path / "out").iterdir())


# -- a killed conversion can be repeated; foreign and changed files survive


@pytest.mark.parametrize("renames", [0, 1, 5])
def test_killed_conversion_is_finished_with_overwrite(renames: int, data: Path, converted: Path) -> None:
    out = data.parent / "out"
    killed(renames, "convert", data, out, "--to", "voc")
    done("convert", data, out, "--to", "voc", "--overwrite")
    assert tree(out) == tree(converted)


def test_overwritten_conversion_keeps_what_it_did_not_write(data: Path, converted: Path) -> None:
    notes = converted / "Annotations" / "notes.txt"
    notes.write_text("mine")
    edited = sorted((converted / "Annotations").glob("*.xml"))[0]
    edited.write_text("<mine/>")
    ended = done("convert", data, converted, "--to", "voc", "--overwrite")
    assert notes.read_text() == "mine" and "Annotations/notes.txt" in ended.stderr
    aside = converted / "replaced" / "Annotations" / edited.name
    assert aside.read_text() == "<mine/>" and f"replaced/Annotations/{edited.name}" in ended.stderr
    assert edited.read_text() != "<mine/>"


def test_record_with_foreign_paths_deletes_nothing(data: Path, tmp_path: Path, converted: Path) -> None:
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    record = json.loads((converted / "convert.json").read_text())
    digest = hashlib.sha256(b"mine").hexdigest()
    for where in ("../mine.txt", str(mine)):
        written = {**record.get("written", {}), where: [4, digest]}
        (converted / "convert.json").write_text(json.dumps({**record, "written": written, "entries": [where]}))
        run("convert", data, converted, "--to", "voc", "--overwrite")
        assert mine.read_text() == "mine"


# -- runs


GENERATE = ("generate", "hit-uav-drone", "--set", "output.formats=[yolo]", "--set", "camera.pitch={fixed_deg: 60}")


@pytest.fixture
def flat(monkeypatch: pytest.MonkeyPatch) -> None:
    """Render with the flat renderer, which the command line does not offer."""
    render_flat(monkeypatch)


@pytest.fixture
def words(flat: None, data: Path, tmp_path: Path) -> list[object]:
    return [*GENERATE, "--data", data, "--out", tmp_path / "run"]


@pytest.fixture
def made(words: list[object], tmp_path: Path) -> Path:
    done(*words)
    return tmp_path / "run"


def record_of(made: Path) -> Path:
    """Return the record of a frame whose background has labels."""
    return next(p for p in sorted((made / "scenes").rglob("*.json")) if len(json.loads(p.read_text())["kept"]) > 1)


def test_unfinished_run_is_an_error_wherever_it_is_read(made: Path, tmp_path: Path) -> None:
    set_status(made / "run.json", "running")
    for folder in (made / "yolo", made / "images"):
        ended = run("check", folder)
        assert ended.exit_code == 2 and "--resume" in ended.stderr, ended.output
    ended = run("realism", made, "--against", tmp_path / "data", "--out", tmp_path / "report")
    assert ended.exit_code == 2 and "unfinished run" in ended.stderr, ended.output


def test_overwritten_run_keeps_what_it_did_not_write(words: list[object], made: Path) -> None:
    picture = sorted((made / "images").rglob("*_c*.*"))[0]
    mine = [picture.with_name("mine.jpg"), made / "yolo" / "labels" / "mine.txt", made / "scenes" / ".a.part.txt"]
    for path in mine:
        path.write_text("mine")
    ended = done(*words, "--overwrite")
    for path in mine:
        assert path.read_text() == "mine"
        assert path.relative_to(made).as_posix() in ended.stderr


def test_folder_with_a_foreign_run_file_is_left_alone(words: list[object], tmp_path: Path) -> None:
    out = tmp_path / "run"
    (out / "images").mkdir(parents=True)
    (out / "images" / "mine.jpg").write_text("mine")
    (out / "run.json").write_text('{"recipe": "soup"}')
    for option in ("--overwrite", "--resume"):
        assert run(*words, option).exit_code == 2
        assert (out / "images" / "mine.jpg").read_text() == "mine"


def test_resume_deletes_no_foreign_part_files(words: list[object], made: Path) -> None:
    mine = made / "images" / ".notes.part1.txt"
    mine.write_text("mine")
    done(*words, "--resume")
    assert mine.read_text() == "mine"


EDITS: dict[str, Callable[[dict], object]] = {  # type: ignore[type-arg]
    "moved box": lambda r: r["inserted"][0]["box_xyxy"].__setitem__(0, 1.0),
    "no inserts": lambda r: r.update(inserted=[]),
    "negative index": lambda r: r.update(kept=[-1]),
    "index too high": lambda r: r.update(kept=[999]),
    "not an object": lambda r: None,
}


@pytest.mark.parametrize("edit", EDITS)
def test_edited_record_is_reported_and_kept_aside(edit: str, words: list[object], made: Path) -> None:
    before = tree(made)
    path = record_of(made)
    record = json.loads(path.read_text())
    EDITS[edit](record)
    text = json.dumps([] if edit == "not an object" else record)
    path.write_text(text)
    ended = done(*words, "--resume")
    assert tree(made) == before
    name = path.relative_to(made).as_posix()
    assert name in ended.stderr and (made / "log" / "replaced" / name).read_text() == text


def test_edited_label_file_is_reported_and_kept_aside(words: list[object], made: Path) -> None:
    before = tree(made)
    label = next(p for p in sorted((made / "yolo").rglob("*_c0.txt")) if p.stat().st_size)
    label.write_text("0 0.5 0.5 0.1 0.1\n")
    (label.parent / "stray.txt").write_text("")
    ended = done(*words, "--resume")
    name = label.relative_to(made).as_posix()
    assert name in ended.stderr and "stray.txt" in ended.stderr
    assert (made / "log" / "replaced" / name).read_text() == "0 0.5 0.5 0.1 0.1\n"
    (label.parent / "stray.txt").unlink()
    assert tree(made) == before


@pytest.mark.parametrize("picture_gone", [False, True])
def test_frames_of_a_background_that_broke_are_removed(
    picture_gone: bool, words: list[object], made: Path, data: Path, tmp_path: Path
) -> None:
    set_status(made / "run.json", "interrupted")
    background = json.loads(record_of(made).read_text())["background"]["path"]
    file = next(p for p in data.rglob("*.*") if p.as_posix().endswith(background))
    file.write_bytes(file.read_bytes()[:400])
    if picture_gone:
        sorted((made / "images").rglob("*_c*.*"))[-1].unlink()
    assert run(*words, "--resume").exit_code == 1
    words[words.index("--out") + 1] = tmp_path / "fresh"
    assert run(*words).exit_code == 1
    assert tree(made) == tree(tmp_path / "fresh")


@pytest.mark.parametrize("folder", ["scenes", "images"])
def test_frames_removed_while_the_run_goes_on_are_not_counted(
    folder: str, words: list[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, real, count = tmp_path / "run", Path.replace, [0]

    def replace(path: Path, target: Path) -> Path:
        count[0] += 1
        if count[0] == 9:
            shutil.rmtree(out / folder)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
        return real(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", replace)
        ended = run(*words)
    counts = json.loads((out / "run.json").read_text())["counts"]
    frames = [p for p in (out / "images").rglob("*_c*.*") if p.is_file() and p.stat().st_size]
    assert ended.exit_code == 1, ended.output
    assert counts["frames"] < counts["frames_planned"] and counts["failed_frames"]
    assert counts["frames"] == counts["images"] <= len(frames)
    done(*words, "--resume")
    words[words.index("--out") + 1] = tmp_path / "fresh"
    done(*words)
    assert tree(out) == tree(tmp_path / "fresh")


def test_log_without_a_record_is_no_dead_end(words: list[object], tmp_path: Path) -> None:
    for option in ("--resume", "--overwrite"):
        shutil.rmtree(tmp_path / "run", ignore_errors=True)
        (tmp_path / "run" / "log").mkdir(parents=True)
        (tmp_path / "run" / "log" / "run.log").write_text("started")
        part_path(tmp_path / "run" / "run.json").write_text("{")
        done(*words, option)


def test_write_failure_is_exit_code_3(words: list[object], made: Path) -> None:
    record = record_of(made)
    shutil.rmtree(record.parent)
    record.parent.write_text("a file where a folder should be")
    (made / "log" / "replaced").write_text("so that nothing can be moved aside")
    ended = run(*words, "--resume")
    assert ended.exit_code == 3, ended.output


@pytest.mark.parametrize("renames", [1, 9, 30])
def test_killed_run_is_resumed_or_overwritten(renames: int, words: list[object], made: Path, tmp_path: Path) -> None:
    for option in ("--resume", "--overwrite"):
        out = words[words.index("--out") + 1] = tmp_path / option
        killed(renames, *words)
        ended = done(*words, option)
        assert tree(Path(str(out))) == tree(made)
        assert "not written by" not in ended.stderr


def test_rerender_does_not_overwrite_another_file(made: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.png"
    mine.write_text("mine")
    frame = record_of(made).relative_to(made / "scenes").with_suffix("").as_posix()
    ended = run("rerender", made, frame, "--out", mine)
    assert ended.exit_code == 2 and "nothing was touched" in ended.stderr, ended.output
    assert mine.read_text() == "mine"
    assert run("preview", made, "--out", mine).exit_code == 2 and mine.read_text() == "mine"
    done("rerender", made, frame, "--out", tmp_path / "new.png")
    done("rerender", made, frame, "--out", tmp_path / "new.png")


# -- found by scripts/attack.py


def test_evaluation_killed_at_its_record_is_repeated_with_overwrite(tmp_path: Path) -> None:
    write_detections(tmp_path)
    words = ["evaluate", tmp_path / "in" / "predictions.json", tmp_path / "in" / "data", "--bootstrap", "0"]
    done(*words, "--out", tmp_path / "fresh")
    made = tmp_path / "out"
    shutil.copytree(tmp_path / "fresh", made)
    (made / "evaluation.json").rename(part_path(made / "evaluation.json"))
    ended = run(*words, "--out", made)
    assert ended.exit_code == 2 and "--overwrite" in ended.stderr, ended.output
    done(*words, "--out", made, "--overwrite")
    assert tree(made) == tree(tmp_path / "fresh")


def test_weights_of_an_unfinished_training_are_refused(tmp_path: Path) -> None:
    write_detections(tmp_path)
    training = tmp_path / "training"
    training.mkdir()
    (training / "weights.pt").write_bytes(b"")
    (training / "train.json").write_text(json.dumps({"infrablend": "1", "status": "running"}))
    for weights in (training, training / "weights.pt"):
        ended = run("evaluate", weights, tmp_path / "in" / "data", "--out", tmp_path / "out")
        assert ended.exit_code == 2 and "unfinished training" in ended.stderr and "--resume" in ended.stderr
    record = {"infrablend": "1", "status": "running"}
    command = {"words": ["train", "data", "--out", str(training), "--preset", "x"], "folder": str(tmp_path)}
    (training / "train.json").write_text(json.dumps({**record, "command": command}))
    ended = run("evaluate", training, tmp_path / "in" / "data", "--out", tmp_path / "out")
    assert f"infrablend train data --out {training} --preset x --resume" in ended.stderr


def test_report_removed_while_it_is_written_is_an_error_and_can_be_repeated(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, real = tmp_path / "report", Path.replace

    def replace(path: Path, target: Path) -> Path:
        if target.name == "inspect.png":
            (out / "inspect.json").unlink()
        return real(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", replace)
        ended = run("inspect", data, "--out", out)
    assert ended.exit_code == 2 and "inspect.json" in ended.stderr and "repeat the command" in ended.stderr.lower()
    done("inspect", data, "--out", out)
    (out / "inspect.json").unlink()
    (out / "inspect.png").write_bytes(b"mine")
    assert run("inspect", data, "--out", out).exit_code == 2 and (out / "inspect.png").read_bytes() == b"mine"


@pytest.mark.parametrize("name", ["README.md", "SOURCE.json"])
def test_conversion_killed_while_it_writes_beside_its_record_is_repeated(
    name: str, data: Path, converted: Path
) -> None:
    before = tree(converted)
    set_status(converted / "convert.json", "running")
    part_path(converted / name).write_text("half")
    (converted / ".files.jsonl").write_text(json.dumps({"path": name}) + "\n")
    done("convert", data, converted, "--to", "voc", "--overwrite")
    assert tree(converted) == before


def test_conversion_whose_files_are_removed_meanwhile_is_not_finished(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, real = tmp_path / "voc", Path.replace

    def replace(path: Path, target: Path) -> Path:
        if target.name == "README.md":
            shutil.rmtree(out / "JPEGImages")
        return real(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", replace)
        ended = run("convert", data, out, "--to", "voc")
    assert ended.exit_code == 2 and "was removed" in ended.stderr and "--overwrite" in ended.stderr, ended.output
    assert run("check", out).exit_code == 2
    done("convert", data, out, "--to", "voc", "--overwrite")
    assert run("check", out).exit_code == 0


def test_picture_that_is_a_link_to_itself_is_missing(tmp_path: Path) -> None:
    data = SAMPLES["hit-uav:json"](tmp_path / "data")
    picture = sorted(data.rglob("*.jpg"))[0]
    picture.unlink()
    picture.symlink_to(picture)
    ended = run("convert", data, tmp_path / "out", "--to", "coco")
    assert "image-missing" in ended.stdout + ended.stderr or "leads to no file" in ended.stdout + ended.stderr
    assert json.loads((tmp_path / "out" / "convert.json").read_text())["counts"]["images"] == 3


@pytest.mark.parametrize("command", [["check"], ["inspect", "--decode"], ["convert", "--to", "voc"]])
def test_picture_that_is_a_pipe_is_missing(command: list[str], tmp_path: Path) -> None:
    data = SAMPLES["coco:plain"](tmp_path / "data")
    (data / "a1.png").unlink()
    os.mkfifo(data / "a1.png")
    to = [tmp_path / "out"] if command[0] == "convert" else []
    ended = run(command[0], data, *to, *command[1:])
    assert "pipe" in ended.stdout + ended.stderr, ended.output


def test_links_in_a_circle_are_an_error_with_a_name(data: Path, tmp_path: Path) -> None:
    circle = tmp_path / "circle.csv"
    circle.symlink_to(circle)
    for words in (
        ["inspect", data, "--metadata", circle],
        ["check", circle],
        ["convert", data, circle, "--to", "voc"],
        [*GENERATE[:2], "--data", circle, "--out", tmp_path / "out"],
        [*GENERATE[:2], "--data", data, "--out", circle],
        ["generate", circle, "--data", data, "--out", tmp_path / "out"],
        ["evaluate", circle, data, "--out", tmp_path / "out"],
    ):
        ended = run(*words)
        assert ended.exit_code in (2, 3), (words, ended.output)


def test_pipe_in_place_of_a_log_does_not_stop_a_run_for_ever(words: list[object], made: Path) -> None:
    (made / "log" / "workers.log").unlink(missing_ok=True)
    os.mkfifo(made / "log" / "workers.log")
    ended = run(*words, "--resume")
    assert ended.exit_code == 2 and "workers.log" in ended.stderr, ended.output


@pytest.mark.parametrize("text", ["[" * 100_000, "[1]", '{"inserted": [[]], "frame_id": "a", "image": "b"}'])
def test_preview_of_a_damaged_record_is_an_error_with_a_name(text: str, made: Path) -> None:
    for path in (made / "scenes").rglob("*.json"):
        path.write_text(text)
    for path in (made / "coco").rglob("*.json"):
        path.write_text(text)
    for options in ([], ["--ground"]):
        assert run("preview", made, *options).exit_code == 2


def test_numbers_that_are_too_large_are_errors_with_a_name(tmp_path: Path) -> None:
    write_detections(tmp_path)
    data = tmp_path / "in" / "data"
    predictions = tmp_path / "in" / "predictions.json"
    top = json.loads(predictions.read_text())
    top["annotations"][0]["bbox"][0] = 10**400
    predictions.write_text(json.dumps(top))
    assert run("evaluate", predictions, data, "--out", tmp_path / "out").exit_code == 2
    table = tmp_path / "table.json"
    names = [p.name for p in sorted(data.rglob("*.png"))]
    table.write_text(json.dumps([{"file": n, "pitch_deg": 10**400} for n in names]))
    ended = run("inspect", data, "--metadata", table)
    assert ended.exit_code in (0, 2) and "pitch_deg" in ended.stdout + ended.stderr, ended.output


def test_overwritten_evaluation_keeps_what_it_did_not_write(tmp_path: Path) -> None:
    write_detections(tmp_path)
    out = tmp_path / "out"
    words = ["evaluate", tmp_path / "in" / "predictions.json", tmp_path / "in" / "data", "--out", out]
    done(*words, "--bootstrap", "0")
    whole = tree(out)
    (out / "evaluation.html").write_text("edited page")
    (out / "evaluation.json").write_text("edited record")
    (out / "plots" / "mine.png").write_text("mine")
    (out / "plots" / sorted((out / "plots").iterdir())[0].name).write_text("edited plot")
    ended = done(*words, "--bootstrap", "0", "--overwrite")
    kept = {p.relative_to(out).as_posix(): p.read_text() for p in (out / "replaced").rglob("*") if p.is_file()}
    assert sorted(kept.values()) == ["edited page", "edited plot", "edited record"]
    assert {k: v for k, v in tree(out).items() if k in whole and k != ".files.jsonl"} == {
        k: v for k, v in whole.items() if k != ".files.jsonl"
    }
    assert (out / "plots" / "mine.png").read_text() == "mine"
    for name in (*kept, "plots/mine.png"):
        assert name in ended.output.replace("\n", ""), name
    done(*words, "--bootstrap", "0", "--overwrite")  # what was moved aside stays
    assert (out / "replaced" / "evaluation.html").read_text() == "edited page"


def test_overwritten_evaluation_deletes_no_folder_with_a_temporary_name(tmp_path: Path) -> None:
    write_detections(tmp_path)
    out = tmp_path / "out"
    words = ["evaluate", tmp_path / "in" / "predictions.json", tmp_path / "in" / "data", "--out", out]
    done(*words, "--bootstrap", "0")
    usual = part_path(out / "evaluation.json").name
    for name in (".plots.part", usual):
        (out / name).mkdir()
        (out / name / "mine").write_text("mine")
        ended = run(*words, "--bootstrap", "0", "--overwrite")
        assert name == usual or (ended.exit_code == 2 and name in ended.output), ended.output
        assert (out / name / "mine").read_text() == "mine"
        (out / name).rename(tmp_path / name)


@pytest.mark.parametrize("instead", ["endless", "pipe"])
def test_record_that_is_no_regular_file_is_made_again(instead: str, words: list[object], made: Path) -> None:
    record = record_of(made)
    content = record.read_bytes()
    record.unlink()
    if instead == "pipe":
        os.mkfifo(record)
    else:
        record.symlink_to("/dev/zero")
    assert run("preview", made, "--out", made.parent / "sheet.png").exit_code in (0, 2)
    ended = run(*words, "--resume")
    assert ended.exit_code == 0, ended.output
    assert not record.is_symlink() and record.is_file()
    assert record.read_bytes() == content


def test_preview_of_a_box_without_an_end_is_an_error_with_a_name(words: list[object], tmp_path: Path) -> None:
    done(*words, "--set", "output.formats=[coco]")
    for name in ("coco", "scenes"):
        for path in (tmp_path / "run" / name).rglob("*.json"):
            path.write_text(re.sub(r'("(?:bbox|box_xyxy)": *\[)[^,]*', r"\1Infinity", path.read_text()))
        ended = run("preview", tmp_path / "run", "--out", tmp_path / "sheet.png")
        assert ended.exit_code == 2, ended.output
        assert "finite" in ended.output
        shutil.rmtree(tmp_path / "run" / "coco", ignore_errors=True)


def test_preview_follows_no_label_file_out_of_the_run(words: list[object], tmp_path: Path) -> None:
    done(*words, "--set", "output.formats=[coco]")
    labels = next((tmp_path / "run" / "coco").rglob("train.json"))
    outside = tmp_path / "outside.json"
    shutil.move(labels, outside)
    labels.symlink_to(outside)
    ended = run("preview", tmp_path / "run", "--out", tmp_path / "sheet.png")
    assert ended.exit_code == 2, ended.output
    assert "a link out of its folder" in " ".join(ended.stderr.split())


# -- links out of the folder that owns the file


def link_out(file: Path, outside: Path) -> None:
    """Move a file to `outside`, and put a link in its place."""
    shutil.move(file, outside)
    file.symlink_to(outside)


def assert_refused(ended: Result, name: str, code: int = 2) -> None:
    """Check for the four parts of the message: where, what was found, what was expected and what to do."""
    text = " ".join(ended.output.split())
    assert ended.exit_code == code, ended.output
    assert name in text and "a link out of its folder" in text and "a file inside it" in text, text
    assert "copy the file" in text.lower(), text


def test_scene_record_that_is_a_link_out_of_the_run_is_refused_and_made_again(
    words: list[object], made: Path, tmp_path: Path
) -> None:
    record = record_of(made)
    content = record.read_bytes()
    link_out(record, tmp_path / "secret.json")
    shutil.rmtree(made / "coco", ignore_errors=True)
    assert_refused(run("preview", made, "--out", tmp_path / "sheet.png"), record.name)
    frame = record.relative_to(made / "scenes").with_suffix("").as_posix()
    assert_refused(run("rerender", made, frame, "--out", tmp_path / "frame.png"), record.name)
    done(*words, "--resume")
    assert not record.is_symlink() and record.read_bytes() == content
    assert (tmp_path / "secret.json").read_bytes() == content


def test_frame_that_is_a_link_out_of_the_run_is_refused_and_made_again(
    words: list[object], made: Path, tmp_path: Path
) -> None:
    image = sorted(p for p in (made / "images").rglob("*") if p.is_file())[0]
    content = image.read_bytes()
    link_out(image, tmp_path / "secret.png")
    assert_refused(run("preview", made, "--out", tmp_path / "sheet.png"), image.name)
    done(*words, "--resume")
    assert not image.is_symlink() and image.read_bytes() == content


def test_frame_that_is_a_link_within_the_run_is_read(made: Path, tmp_path: Path) -> None:
    image = sorted(p for p in (made / "images").rglob("*") if p.is_file())[0]
    link_out(image, made / "elsewhere.png")
    done("preview", made, "--out", tmp_path / "sheet.png")


@pytest.mark.parametrize("name", ["run.json", "log/files.jsonl"])
def test_record_of_a_run_that_is_a_link_out_of_it_is_refused(
    name: str, words: list[object], made: Path, tmp_path: Path
) -> None:
    link_out(made / name, tmp_path / "secret")
    content = (tmp_path / "secret").read_bytes()
    ended = run(*words, "--resume")
    assert ended.exit_code == 2 and name in ended.stderr.replace("\n", ""), ended.output
    if name == "run.json":
        assert_refused(run("check", made / "yolo"), name, 1)
    assert (tmp_path / "secret").read_bytes() == content


def test_record_of_a_conversion_that_is_a_link_out_of_it_is_refused(converted: Path, tmp_path: Path) -> None:
    link_out(converted / "convert.json", tmp_path / "secret.json")
    assert_refused(run("check", converted), "convert.json", 1)
    assert_refused(run("inspect", converted), "convert.json")


def test_manifest_of_a_conversion_that_is_a_link_is_not_written_through(
    data: Path, converted: Path, tmp_path: Path
) -> None:
    (tmp_path / "secret").write_text("mine")
    (converted / ".files.jsonl").symlink_to(tmp_path / "secret")
    assert run("convert", data, converted, "--to", "voc", "--overwrite").exit_code in (0, 2)
    assert (tmp_path / "secret").read_text() == "mine"


def test_run_of_backgrounds_that_are_links_is_finished_and_resumed(words: list[object], data: Path) -> None:
    (data / "store").mkdir()
    for number, picture in enumerate(sorted(data.rglob("*.png"))):
        link_out(picture, data / "store" / f"{number}.png")
    done(*words)
    done(*words, "--resume")


# -- finished output that is edited


@pytest.fixture
def in_formats(words: list[object]) -> list[object]:
    return [*words, "--to", "coco,yolo,voc"]


@pytest.fixture
def finished_run(in_formats: list[object], tmp_path: Path) -> Path:
    done(*in_formats)
    return tmp_path / "run"


def _errors(root: Path) -> dict[str, list[str]]:
    found = json.loads(run("check", root, "--json").stdout)
    errors = [p for p in found["problems"] if p["severity"] == "error"]
    return {code: sorted(p["where"] for p in errors if p["code"] == code) for code in {p["code"] for p in errors}}


def test_check_finds_what_was_changed_in_a_run(finished_run: Path) -> None:
    assert _errors(finished_run) == {}
    pictures = sorted((finished_run / "images").rglob("*_c*.*"))
    label = sorted((finished_run / "yolo" / "labels").rglob("*.txt"))[0]
    label.write_text("".join(label.read_text().splitlines(keepends=True)[1:]))
    edited = (finished_run / "coco" / "train.json").read_text().replace('"drone"', '"Drone!"')
    (finished_run / "coco" / "train.json").write_text(edited)
    swapped = pictures[0].read_bytes()
    pictures[1].unlink()  # it is linked into the folders of the other formats
    pictures[1].write_bytes(swapped)
    sorted((finished_run / "voc" / "Annotations").glob("*.xml"))[0].unlink()
    names = [p.relative_to(finished_run).as_posix() for p in (label, pictures[1])]
    errors = _errors(finished_run)
    assert errors["file-changed"] == sorted(["coco/train.json", *names])
    assert len(errors["file-gone"]) == 1 and errors["file-gone"][0].startswith("voc/Annotations/")


def test_check_of_a_run_is_clean_after_exclusions_and_a_resume(finished_run: Path, in_formats: list[object]) -> None:
    scenes = finished_run / "scenes"
    first = sorted(p.relative_to(scenes).with_suffix("").as_posix() for p in scenes.rglob("*.json"))[0]
    done("exclude", finished_run, first)
    assert _errors(finished_run) == {}
    sorted((finished_run / "images").rglob("*_c*.*"))[0].unlink()
    assert "removed since the run" in run("report", finished_run).output
    assert "missing, damaged or failed" in done(*in_formats, "--resume").output
    assert _errors(finished_run) == {}
    done("include", finished_run, "--all")
    assert _errors(finished_run) == {}


def test_edits_of_a_conversion_are_warnings(converted: Path) -> None:
    label = sorted((converted / "Annotations").glob("*.xml"))[0]
    label.write_text(label.read_text() + "\n")
    ended = done("check", converted)
    assert "file-changed" in ended.output and label.name in ended.output
    label.unlink()
    assert "file-gone" in _errors(converted)
