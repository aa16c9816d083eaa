"""Records with values that InfraBlend never writes end in an error that names them, never in a traceback."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result


from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.samples import SAMPLES

FORMATS = "yolo,coco"


@pytest.fixture(autouse=True)
def flat(monkeypatch: pytest.MonkeyPatch) -> None:
    render_flat(monkeypatch)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return SAMPLES["coco"](tmp_path / "data")


@pytest.fixture
def made(data: Path, tmp_path: Path) -> Path:
    done(*generate(data, tmp_path / "run"))
    return tmp_path / "run"


def generate(data: Path, out: Path, *more: object) -> list[object]:
    return ["generate", "hit-uav-drone", "--data", data, "--out", out, "--to", FORMATS, *more]


def named(ended: Result, *words: str) -> None:
    """Check that a command ended in an error with a name."""
    assert ended.exit_code in (1, 2, 3), ended.output
    assert "Traceback" not in ended.output
    for word in words:
        assert word in ended.output


def change(file: Path, edit: Callable[[dict[str, Any]], None]) -> None:
    record = json.loads(file.read_text())
    edit(record)
    file.write_text(json.dumps(record))


# -- manifests

DIGEST = "0" * 64
NEVER_WRITTEN = {
    "half of a pair": {"path": "yolo/\ud800x.txt", "size": 1, "sha256": DIGEST},
    "half of a pair, begun": {"path": "yolo/\ud800x.txt"},
    "long name": {"path": f"yolo/{'x' * 300}", "size": 1, "sha256": DIGEST},
    "long path": {"path": "yolo/" + "x/" * 2500 + "x", "size": 1, "sha256": DIGEST},
    "endless": {"path": "yolo/x.txt", "size": 1e999, "sha256": DIGEST},
    "below zero": {"path": "yolo/x.txt", "size": -1, "sha256": DIGEST},
    "no digest": {"path": "yolo/x.txt", "size": 1, "sha256": 5},
}


@pytest.mark.parametrize("entry", NEVER_WRITTEN.values(), ids=NEVER_WRITTEN)
def test_entries_of_a_run_that_are_never_written_are_left_out(made: Path, data: Path, entry: dict[str, Any]) -> None:
    manifest = made / "log" / "files.jsonl"
    lines, listed = manifest.read_text().splitlines(), json.loads((made / "run.json").read_text())["files"]
    label = next(n for n, line in enumerate(lines) if '"yolo/' in line and "sha256" in line)
    line = json.dumps(entry).replace("Infinity", "1e400")
    manifest.write_text("\n".join([*lines[:label], line, *lines[label + 1 :], ""]))
    named(run("check", made), "log/files.jsonl", f"lists {listed - 1} files")
    frame = next((made / "scenes").rglob("*.json")).relative_to(made / "scenes").with_suffix("").as_posix()
    for words in (["exclude", made, frame], ["include", made, frame], generate(data, made, "--resume")):
        done(*words)
    done("check", made)
    manifest.write_text(manifest.read_text() + line + "\n")
    done(*generate(data, made, "--overwrite"))
    done("check", made)


@pytest.mark.parametrize("name", ["\ud800.txt", "x" * 300, "x/" * 2500 + "x"])
def test_names_in_the_record_of_a_conversion_that_are_never_written_are_left_out(
    data: Path, tmp_path: Path, name: str
) -> None:
    out = tmp_path / "out"
    done("convert", data, out, "--to", "yolo")
    change(out / "convert.json", lambda r: r["written"].update({name: [1, DIGEST]}))
    done("check", out)
    change(out / "convert.json", lambda r: r["written"].update({name: [float("1e300"), DIGEST]}))
    done("convert", data, out, "--to", "yolo", "--overwrite")
    assert name not in json.loads((out / "convert.json").read_text())["written"]


# -- the record of a run

DAMAGES: dict[str, dict[str, Any]] = {
    "data": {"data": None},
    "data, text": {"data": "x"},
    "data.root": {"data": {"root": "\ud800"}},
    "data.root, long": {"data": {"root": f"/{'x' * 300}"}},
    "request": {"request": 5},
    "request.selection": {"request": {"selection": []}},
    "request.reading.options": {"request": {"reading": {"options": {"a": 5}}}},
    "machine": {"machine": []},
    "key": {"key": None},
    "counts.labels": {"counts": {"labels": {"Car": "2"}}},
    "timing.seconds": {"timing": {"seconds": "long"}},
    "problems.0": {"problems": [5]},
    "formats.0": {"formats": [None]},
    "packages": {"packages": ""},
}


@pytest.mark.parametrize(("name", "values"), DAMAGES.items(), ids=DAMAGES)
def test_fields_of_a_run_record_of_another_type_are_named(
    made: Path, data: Path, name: str, values: dict[str, Any]
) -> None:
    def edit(record: dict[str, Any]) -> None:
        record.update(values)
        del record["sha256"]  # as in records of earlier versions

    change(made / "run.json", edit)
    frame = next((made / "scenes").rglob("*.json")).relative_to(made / "scenes").with_suffix("").as_posix()
    for words in (
        ["report", made],
        ["exclude", made, frame],
        ["rerender", made, frame],
        generate(data, made, "--resume"),
    ):
        named(run(*words), "run.json: damaged (" + name.partition(",")[0], "--overwrite")
    assert run("preview", made).exit_code in (0, 2)
    assert run("preview", made, "--ground").exit_code == 2
    assert run("check", made).exit_code in (0, 1, 2)
    done(*generate(data, made, "--overwrite"))
    done("check", made)


def test_a_run_record_of_a_newer_version_is_named_as_such(made: Path) -> None:
    def edit(record: dict[str, Any]) -> None:
        record["infrablend"] = "9.1.0"
        record["recipe"]["matching"]["from_the_future"] = 1
        del record["sha256"]

    change(made / "run.json", edit)
    frame = next((made / "scenes").rglob("*.json")).relative_to(made / "scenes").with_suffix("").as_posix()
    named(run("rerender", made, frame), "run.json: written by InfraBlend '9.1.0', or damaged", "from_the_future")


# -- records of frames


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("image", {"image": "test/\ud800.jpg"}),
        ("background.altitude_m", {"background": {"altitude_m": {"a": 1}}}),
        ("inserted.0.category", {"inserted": [{"category": ["Car"]}]}),
        ("removed.0", {"removed": [5]}),
    ],
)
def test_fields_of_a_frame_record_of_another_type_are_named(
    made: Path, data: Path, name: str, values: dict[str, Any]
) -> None:
    file = next((made / "scenes").rglob("*.json"))

    def edit(record: dict[str, Any]) -> None:
        record.update(values)
        del record["record_sha256"], record["run"]  # as in records of earlier versions

    change(file, edit)
    named(run("report", made), file.name, name)
    named(run("check", made), file.name, name)
    done(*generate(data, made, "--resume"))
    done("check", made)


def test_a_frame_record_without_its_digest_is_made_again(made: Path, data: Path) -> None:
    file = next((made / "scenes").rglob("*.json"))
    before = file.read_bytes()
    file.write_text(file.read_text().replace('"record_sha256"', '"record_sha257"'))
    named(run("check", made), file.name, "it has no record_sha256")
    done(*generate(data, made, "--resume"))
    assert file.read_bytes() == before
