"""Datasets in JSON files that are read record by record are those of files that are parsed as a whole."""

from __future__ import annotations

import json
import random
import shutil
import tracemalloc
from pathlib import Path
from typing import Any

import pytest
from tests.fuzzing import mutate
from tests.samples import SAMPLES, picture

from infrablend.core import json_records
from infrablend.errors import DatasetError, Problem
from infrablend.formats import annotation_files, dataset_folder
from infrablend.formats.annotation_files import read_lines
from infrablend.formats.labels import label_studio
from infrablend.formats.picture_facts import read_table
from infrablend.formats.unread import unread_files

pytestmark = pytest.mark.long

WITH_JSON = [
    name
    for name in sorted(SAMPLES)
    if name.partition(":")[0] in ("coco", "hit-uav", "monet", "label-studio", "anti-uav", "bambi", "masks", "folder")
]


@pytest.fixture
def streaming(monkeypatch):
    """Return a function that has JSON files of any size be read record by record from then on."""

    def start(short: int = 60) -> None:  # lists of fewer characters are parsed as a whole
        monkeypatch.setattr(annotation_files, "WHOLE_JSON", 0)
        monkeypatch.setattr(json_records, "_SHORT", short)
        monkeypatch.setattr(json_records, "_CHUNK", 50)

    return start


def read(root: Path) -> tuple[Any, ...]:
    """Return everything that a reader says about a folder."""
    try:
        dataset = dataset_folder.read(root)
    except DatasetError as error:
        return (sorted((p.where, p.code) for p in error.problems),)
    unread = unread_files(dataset)
    problems = sorted((p.where, p.code, p.severity) for p in (*dataset.problems, *unread))
    return repr(dataset.images), repr(dataset.categories), repr(dataset.notes), repr(dataset.extra), problems


@pytest.mark.parametrize("name", WITH_JSON)
def test_records_are_the_same(tmp_path, streaming, name):
    root = SAMPLES[name](tmp_path / "data")
    whole = read(root)
    assert len(whole) > 1
    streaming()
    assert read(root) == whole


@pytest.mark.parametrize("name", ["coco", "hit-uav:json", "label-studio", "monet"])
def test_damaged_files_give_the_same_problems(tmp_path, streaming, name):
    intact = SAMPLES[name](tmp_path / "intact")
    (tmp_path / "outside").mkdir()
    for seed in range(40):
        choose = random.Random(seed)
        root = tmp_path / str(seed)
        shutil.copytree(intact, root)
        mutate(root, tmp_path / "outside", choose)
    whole = [read(tmp_path / str(seed)) for seed in range(40)]
    assert len({repr(w) for w in whole}) > 10
    streaming(300)
    for seed in range(40):
        assert read(tmp_path / str(seed)) == whole[seed], seed


@pytest.mark.parametrize("as_list", [True, False])
def test_a_table_of_the_camera_is_the_same(tmp_path, streaming, as_list):
    rows = [{"file": f"{n}.png", "pitch_deg": n, "roll_deg": 0.5} for n in range(20)]
    path = tmp_path / "metadata.json"
    path.write_text(json.dumps(rows if as_list else {r["file"]: r for r in rows}))
    whole = repr(read_table(path))
    assert "19.png" in whole
    streaming()
    assert repr(read_table(path)) == whole


def test_text_that_readers_do_not_keep_takes_no_memory(tmp_path, streaming):
    (tmp_path / "images" / "train").mkdir(parents=True)
    tasks = []
    for n in range(60):
        picture(tmp_path / "images" / "train" / f"{n}.png", n)
        result = [{"type": "textarea", "value": {"text": "x" * 20_000}}]
        tasks.append({"data": {"image": f"images/train/{n}.png"}, "annotations": [{"result": result}]})
    path = tmp_path / "train.json"
    path.write_text(json.dumps(tasks))
    streaming()
    json_records._CHUNK = 10_000  # the fixture restores it
    label_studio.read(tmp_path)
    tracemalloc.start()
    images = label_studio.read(tmp_path).images
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(images) == 60
    assert peak < path.stat().st_size / 3


def test_lines_are_read_one_at_a_time(tmp_path, monkeypatch):
    monkeypatch.setattr(annotation_files, "MAX_RECORD", 100)
    path = tmp_path / "metadata.jsonl"
    path.write_bytes(b'\xef\xbb\xbf{"a": 1}\r\n\n{"b": "' + b"x" * 500 + b'"}\n"\xff"\n{"c": "a\xe2\x80\xa8b"}')
    problems: list[Problem] = []
    lines = list(read_lines(path, "m", "a line", problems))
    assert lines == [(1, '{"a": 1}'), (5, '{"c": "a\u2028b"}')]
    assert [(p.where, p.code) for p in problems] == [
        ("m: line 3", "annotation-too-large"),
        ("m: line 4", "annotation-not-json"),
    ]
    for broken in (tmp_path, tmp_path / "missing"):
        assert list(read_lines(broken, "m", "a line", problems)) == []
        assert problems[-1].code == "annotation-unreadable"
