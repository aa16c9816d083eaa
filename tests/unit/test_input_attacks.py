"""Labels that nobody can read, models that change beside a run, and small surprises, from the command line."""

from __future__ import annotations

import json
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.samples import SAMPLES

pytestmark = pytest.mark.long

SETTINGS = ("--set", "camera.pitch={fixed_deg: 60}", "--set", "camera.size_px=[64, 48]", "--to", "coco")
DESCRIPTION = """\
name: thing
category: thing
file: thing.gltf
parts: {all: {match: ['*'], delta_t_k: 20, emissivity: 0.9}}
"""


@pytest.fixture(autouse=True)
def own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    render_flat(monkeypatch)
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("INFRABLEND_LOG", str(tmp_path / "log.txt"))


def _cut(text: str) -> str:
    return text[: len(text) // 2]


@pytest.mark.parametrize(
    ("sample", "pattern", "change"),
    [
        ("voc", "*.xml", _cut),
        ("voc", "*.xml", lambda text: ""),
        ("voc:flat", "*.xml", lambda text: '<!DOCTYPE annotation SYSTEM "x.dtd">' + text),
        ("coco", "*.json", _cut),
    ],
    ids=["cut", "empty", "doctype", "coco cut"],
)
def test_labels_that_cannot_be_read_are_not_clean(
    sample: str, pattern: str, change: Callable[[str], str], tmp_path: Path
) -> None:
    """Damaged label files are problems by name, also where none is intact."""
    root = SAMPLES[sample](tmp_path / "data")
    damaged = sorted(root.rglob(pattern))
    for path in damaged:
        path.write_text(change(path.read_text()))
    ended = run("check", root)
    assert ended.exit_code in (1, 2)
    assert damaged[0].name in ended.output.replace("\n", "")


def test_labels_with_an_unknown_suffix_are_not_clean(tmp_path: Path) -> None:
    root = SAMPLES["yolo:detect"](tmp_path / "data")
    for path in sorted(root.rglob("labels/train/*.txt")):
        path.rename(path.with_suffix(".TXT"))
    ended = run("check", root)
    assert ended.exit_code == 1
    assert ".TXT" in ended.output


def write_model(folder: Path, height: float) -> Path:
    """Write a description of a tetrahedron in a glTF file with its points in a file beside it."""
    folder.mkdir(exist_ok=True)
    points = [(0, 0, 0), (1, 0, 0), (0, 0, -1), (0, height, 0)]
    faces = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3]
    data = struct.pack("<12f", *(v for p in points for v in p)) + struct.pack("<12H", *faces)
    (folder / "points.bin").write_bytes(data)
    scene = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": "all"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"uri": "points.bin", "byteLength": 72}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, -1],
             "max": [1, height, 0]},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
    }  # fmt: skip
    (folder / "thing.gltf").write_text(json.dumps(scene))
    (folder / "thing.yaml").write_text(DESCRIPTION)
    return folder / "thing.yaml"


@pytest.mark.blender
def test_a_file_beside_a_model_that_has_changed_is_noticed(tmp_path: Path) -> None:
    """A run is not resumed with another shape, and a new run does not use the old one from the cache."""
    data = SAMPLES["coco"](tmp_path / "data")
    model = write_model(tmp_path / "model", height=1)
    words = (
        "generate",
        "hit-uav-drone",
        "--data",
        data,
        *SETTINGS,
        "--limit",
        "1",
        "--set",
        f"objects=[{{model: {model}}}]",
    )
    done(*words, "--out", tmp_path / "out")
    buffer = model.with_name("points.bin")
    values = bytearray(buffer.read_bytes())
    values[40:44] = struct.pack("<f", 3)
    buffer.write_bytes(values)
    ended = run(*words, "--out", tmp_path / "out", "--resume")
    assert ended.exit_code == 2, ended.output
    assert "different run" in ended.output


def test_doctor_leaves_no_folder_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    run("doctor")
    assert sorted((tmp_path / "temporary").iterdir()) == []


def test_a_number_with_a_leading_zero_is_not_octal(tmp_path: Path) -> None:
    data = SAMPLES["coco"](tmp_path / "data")
    words = ("generate", "hit-uav-drone", "--data", data, *SETTINGS, "--plan", "--json", "--out", tmp_path / "out")
    for settings in (("configurations=010",), ("configurations=10",)):
        assert json.loads(done(*words, "--set", *settings).stdout)["frames"] == 40
