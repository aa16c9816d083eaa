"""Attacks on output folders from the command line: kills, edited and foreign files, removed files, records that lie."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
from pathlib import Path
from typing import cast

import pytest
from click.testing import Result

from infrablend.core.ledger import Ledger
from infrablend.core.run_record import RunRecord
from infrablend.core.workspace import Workspace, partial_of
from tests.clips import write_detections
from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.killing import run_until_killed
from tests.run_files import edit_ledger, frame_ids, hashes, records
from tests.samples import SAMPLES

pytestmark = pytest.mark.long


def killed(renames: int, *words: object) -> None:
    """Run a command that dies after this many renames."""
    run_until_killed(renames, lambda: run(*words))


def tree(root: Path) -> dict[str, bytes]:
    """Return all files of a conversion but its record."""
    names = [p.relative_to(root).as_posix() for p in sorted(root.rglob("*")) if p.is_file()]
    return {name: (root / name).read_bytes() for name in names if name != "convert.json"}


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return SAMPLES["coco"](tmp_path / "data")


@pytest.fixture
def converted(data: Path, tmp_path: Path) -> Path:
    done("convert", data, tmp_path / "voc", "--to", "voc")
    return tmp_path / "voc"


# -- unfinished output does not pass for finished


def said_command(said: str) -> list[str]:
    """Return the words of the command that a message says to repeat."""
    return shlex.split(said.rpartition("infrablend ")[2])


def test_an_unfinished_run_names_the_whole_command(words: list[object], tmp_path: Path) -> None:
    """The command in the message finishes the folder: nothing that the user gave is left out."""
    killed(8, *words, "--limit", "2", "--seed", "3")
    out = tmp_path / "run"
    for reader in (
        ["check", out],
        ["report", out],
        ["preview", out],
        ["exclude", out, "a"],
        ["train", out, "--out", tmp_path / "t"],
    ):
        ended = run(*reader)
        assert ended.exit_code == 2 and "unfinished run" in " ".join(ended.stderr.split()), ended.output
    ended = run("check", out)
    assert "--set 'camera.pitch={fixed_deg: 60}' --data" in ended.stderr, ended.output
    assert run(*said_command(ended.stderr)).exit_code == 0
    done("check", out)
    made = json.loads((out / "run.json").read_text())
    assert made["request"]["selection"] == {"limit": 2} and made["seed"] == 3


@pytest.mark.parametrize("renames", [0, 1, 5])
def test_killed_conversion_is_finished_with_overwrite(renames: int, data: Path, converted: Path) -> None:
    out = data.parent / "out"
    killed(renames, "convert", data, out, "--to", "voc")
    done("convert", data, out, "--to", "voc", "--overwrite")
    assert tree(out) == tree(converted)


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


@pytest.mark.parametrize("name", ["images/test/mine.jpg", "yolo/labels/mine.txt", "review.json", "notes/a.txt"])
def test_a_run_with_files_of_others_is_resumed_and_not_overwritten(words: list[object], made: Path, name: str) -> None:
    mine = made / name
    mine.parent.mkdir(exist_ok=True)
    mine.write_text("mine")
    ended = run(*words, "--overwrite")
    assert ended.exit_code == 2 and "nothing was touched" in " ".join(ended.stderr.split()), ended.output
    assert mine.read_text() == "mine"
    done(*words, "--resume")
    assert mine.read_text() == "mine"
    if name.startswith(("images", "yolo")):
        assert f"{name}: not written by this run" in " ".join(run("check", made).output.split())


def test_folder_with_a_foreign_run_file_is_left_alone(words: list[object], tmp_path: Path) -> None:
    out = tmp_path / "run"
    (out / "images").mkdir(parents=True)
    (out / "images" / "mine.jpg").write_text("mine")
    (out / "run.json").write_text('{"recipe": "soup"}')
    for option in ("--overwrite", "--resume"):
        assert run(*words, option).exit_code == 2
        assert (out / "images" / "mine.jpg").read_text() == "mine"


def test_resume_writes_edited_label_files_again(words: list[object], made: Path) -> None:
    before = hashes(made)
    label = next(p for p in sorted((made / "yolo").rglob("*_c0.txt")) if p.stat().st_size)
    label.write_text("0 0.5 0.5 0.1 0.1\n")
    done(*words, "--resume")
    assert hashes(made) == before


@pytest.mark.parametrize("damage", [b"", b"no database", None])
def test_a_damaged_ledger_is_named_and_the_run_made_again(
    words: list[object], made: Path, damage: bytes | None
) -> None:
    before, file = hashes(made), made / "run.sqlite"
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2] if damage is None else damage)
    for call in (
        ["report", made],
        ["exclude", made, "a"],
        ["show", made, "a"],
        ["preview", made],
        words + ["--resume"],
    ):
        ended = run(*call)
        assert ended.exit_code in (2, 3) and "run.sqlite" in " ".join(ended.stderr.split()), ended.output
        assert "Traceback" not in ended.output
    done(*words, "--overwrite")
    assert hashes(made) == before


@pytest.mark.parametrize("picture_gone", [False, True])
def test_frames_of_a_background_that_broke_are_removed(
    picture_gone: bool, words: list[object], made: Path, data: Path, tmp_path: Path
) -> None:
    file = data / str(records(made)[0].background["path"])
    file.write_bytes(file.read_bytes()[:400])
    if picture_gone:
        sorted((made / "images").rglob("*_c*.*"))[-1].unlink()
    assert run(*words, "--resume").exit_code == 1
    words[words.index("--out") + 1] = tmp_path / "fresh"
    assert run(*words).exit_code == 1
    assert {k: v for k, v in hashes(made).items() if k != "run.sqlite"} == {
        k: v for k, v in hashes(tmp_path / "fresh").items() if k != "run.sqlite"
    }
    assert frame_ids(made) == frame_ids(tmp_path / "fresh")


# While the workspace is prepared, frames are made, and labels are written.
@pytest.mark.parametrize("renames", [0, 1, 4, 9, 12, 20])
def test_killed_run_is_resumed_or_overwritten(renames: int, words: list[object], made: Path, tmp_path: Path) -> None:
    for option in ("--resume", "--overwrite"):
        out = words[words.index("--out") + 1] = tmp_path / option
        killed(renames, *words)
        assert not Path(str(out)).exists()
        done(*words, option)
        assert hashes(Path(str(out))) == hashes(made)
        assert not partial_of(Path(str(out))).exists()


def test_a_run_that_is_killed_when_it_gets_its_name_is_complete(
    words: list[object], made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = words[words.index("--out") + 1] = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(Workspace, "_publish", lambda self: os._exit(137))
        killed(10**6, *words)
    before = {p.name: p.stat().st_mtime_ns for p in (partial_of(out) / "images").rglob("*.jpg")}
    done(*words, "--resume")
    assert hashes(out) == hashes(made)
    assert {p.name: p.stat().st_mtime_ns for p in (out / "images").rglob("*.jpg")} == before


def test_rerender_does_not_overwrite_another_file(made: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.png"
    mine.write_text("mine")
    frame = frame_ids(made)[0]
    ended = run("rerender", made, frame, "--out", mine)
    assert ended.exit_code == 2 and "nothing was touched" in ended.stderr, ended.output
    assert mine.read_text() == "mine"
    assert run("preview", made, "--out", mine).exit_code == 2 and mine.read_text() == "mine"
    done("rerender", made, frame, "--out", tmp_path / "new.png")
    done("rerender", made, frame, "--out", tmp_path / "new.png")


# -- found by scripts/attack.py


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


@pytest.mark.parametrize("text", ["[1]", '{"inserted": [[]], "frame_id": "a", "image": "b"}'])
def test_damaged_records_are_errors_with_a_name(text: str, made: Path) -> None:
    edit_ledger(made, "UPDATE records SET record = ?", text)
    frame = frame_ids(made)[0]
    for words in (["preview", made], ["preview", made, "--ground"], ["rerender", made, frame], ["report", made]):
        ended = run(*words)
        assert ended.exit_code == 2 and "run.sqlite: the record of" in " ".join(ended.output.split()), ended.output


@pytest.mark.parametrize(
    "values", [{"data": None}, {"data": "x"}, {"request": 5}, {"request": {"selection": []}}], ids=str
)
def test_fields_of_a_run_record_of_another_type_are_named(
    words: list[object], made: Path, values: dict[str, object]
) -> None:
    with Ledger.open(made, write=True) as ledger:
        ledger.write_run(cast(RunRecord, {**ledger.read_run(), **values}))
    frame = frame_ids(made)[0]
    for reader in (["exclude", made, frame], ["rerender", made, frame]):
        ended = run(*reader)
        assert ended.exit_code in (1, 2, 3) and "Traceback" not in ended.output, ended.output
        assert "run.json: cannot be read" in ended.output and "--overwrite" in ended.output
    assert run("preview", made).exit_code in (0, 2)
    assert run("preview", made, "--ground").exit_code == 2
    assert run("check", made).exit_code in (0, 1, 2)
    done(*words, "--overwrite")
    done("check", made)


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


def test_preview_of_a_box_without_an_end_is_an_error_with_a_name(words: list[object], tmp_path: Path) -> None:
    done(*words, "--set", "output.formats=[coco]")
    made, sheet = tmp_path / "run", tmp_path / "sheet.png"
    for path in (made / "coco").rglob("*.json"):
        path.write_text(re.sub(r'("bbox": *\[)[^,]*', r"\1Infinity", path.read_text()))
    ended = run("preview", made, "--out", sheet)
    assert ended.exit_code == 2 and "finite" in ended.output, ended.output


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


def test_frame_that_is_a_link_out_of_the_run_is_refused_and_made_again(
    words: list[object], made: Path, tmp_path: Path
) -> None:
    image = sorted(p for p in (made / "images").rglob("*.jpg"))[0]
    content = image.read_bytes()
    link_out(image, tmp_path / "secret.png")
    assert_refused(run("preview", made, "--out", tmp_path / "sheet.png"), image.name)
    done(*words, "--resume")
    assert not image.is_symlink() and image.read_bytes() == content


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
    done("exclude", finished_run, frame_ids(finished_run)[0])
    assert _errors(finished_run) == {}
    sorted((finished_run / "images").rglob("*_c*.*"))[0].unlink()
    assert "missing, damaged or failed" in done(*in_formats, "--resume").output
    assert _errors(finished_run) == {}
    done("include", finished_run, "--all")
    assert _errors(finished_run) == {}
