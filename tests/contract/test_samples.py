"""Every format has a sample, which is detected, read without errors, and the same each time."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from tests.samples import SAMPLES

from infrablend import api
from infrablend.core.format_table import FORMATS, WRITERS, Writer
from infrablend.formats import dataset_folder, writing
from infrablend.formats.pictures.listing import read_size


def test_every_format_has_a_sample() -> None:
    assert {name.partition(":")[0] for name in SAMPLES} == {f.name for f in FORMATS}


@pytest.mark.parametrize("name", sorted(SAMPLES))
def test_a_sample_is_found_and_read_without_an_error(name: str, tmp_path: Path) -> None:
    root = SAMPLES[name](tmp_path / "data")
    found = dataset_folder.detect(root)
    assert found.format == name.partition(":")[0]
    assert list(found.reasons) == [f.name for f in FORMATS] and all(found.reasons.values())
    dataset = dataset_folder.read(root)
    assert [str(p) for p in dataset.problems if p.severity == "error"] == []
    counts = [len(i.instances) for i in dataset.images]
    most = {"birdsai:frames": 0, "folder:plain": 0, "yolo:seg": 1, "anti-uav": 1, "halmstad": 1, "videos": 0}
    assert max(counts) >= most.get(name, 2), counts
    assert min(counts) == 0, counts
    files = {p.relative_to(root): p.read_bytes() for p in root.rglob("*") if p.is_file()}
    assert len(files) <= 40
    again = SAMPLES[name](tmp_path / "again")
    assert {p.relative_to(again): p.read_bytes() for p in again.rglob("*") if p.is_file()} == files


@pytest.mark.parametrize("writer", WRITERS, ids=lambda w: w.name)
def test_no_format_takes_what_another_one_wrote(writer: Writer, tmp_path: Path) -> None:
    """Names, folders and telemetry of one format, written as another: it is the other one's."""
    taken = {}
    for name in sorted(SAMPLES):
        source = dataset_folder.read(SAMPLES[name](tmp_path / name))
        images = [i if i.size_wh else replace(i, size_wh=read_size(i.path, i.id)[0]) for i in source.images]
        if not source.categories or (
            writer.name == "monet" and not any(i.capture.pitch_deg is not None for i in images)
        ):
            continue  # MONET is recognised by its telemetry
        out = tmp_path / f"{name}-out"
        writing.write(writer.name, out, images, source.categories)
        found = dataset_folder.detect(out).format
        if found != writer.reader:
            taken[name] = found
    assert taken == {}


@pytest.mark.parametrize("name", ["birdsai", "voc:flat", "wisard", "wit-uas"])
def test_a_run_on_it_keeps_its_labels(name: str, tmp_path: Path) -> None:
    root = SAMPLES[name](tmp_path / "data")
    settings = [
        "camera.pitch={fixed_deg: 40}",
        "output.formats=[coco, birdsai, native]",
        "labels.dont_care=keep",
        "configurations=1",
    ]
    api.generate(
        "hit-uav-drone",
        root,
        tmp_path / "run",
        execution=api.Execution(renderer="flat", in_process=True),
        settings=settings,
    )
    before = Counter(o.category for i in dataset_folder.read(root).images for o in i.instances)
    removed = json.loads((tmp_path / "run" / "run.json").read_text())["counts"]["labels_removed"]
    for written in ("coco", "birdsai"):
        again = dataset_folder.read(tmp_path / "run" / written)
        assert {c.name for c in again.categories if c.ignore} <= {"Logo"}
        assert name != "wisard" or again.category("Logo").ignore
        after = Counter(o.category for i in again.images for o in i.instances)
        assert after.pop("drone") >= 1
        assert after <= before
        assert after.total() + sum(removed.values()) == before.total(), written
