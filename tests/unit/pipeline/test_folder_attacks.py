"""Attacks on output folders from the command line: kills, edited and foreign files, removed files, records that lie."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from infrablend.cli.app import build_app
from tests.samples import SAMPLES


def run(*words: object) -> Result:
    return CliRunner().invoke(build_app(), ["-q", *(str(w) for w in words)])


def done(*words: object) -> Result:
    ended = run(*words)
    assert ended.exit_code == 0, ended.output
    return ended


def killed(renames: int, *words: object) -> None:
    """Run a command in a process that dies, without any clean-up, just before it gives a file its name."""
    child = os.fork()
    if not child:
        left = [renames]
        real = Path.replace

        def replace(path: Path, target: Path) -> Path:
            left[0] -= 1
            if left[0] < 0:
                os._exit(137)
            return real(path, target)

        Path.replace = replace  # type: ignore[assignment,method-assign]
        try:
            run(*words)
        finally:
            os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 137, "ended before it was killed"


def set_status(record: Path, status: str) -> None:
    record.write_text(json.dumps(json.loads(record.read_text()) | {"status": status}))


def tree(root: Path) -> dict[str, bytes]:
    """Return all files but records and logs."""
    found = {p.relative_to(root).as_posix(): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}
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


@pytest.mark.parametrize("renames", [0, 1, 2, 5, 9])
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
