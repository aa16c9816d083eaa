"""The samples are what they say: one or more of every format, found, read without an error, the same each time."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.samples import SAMPLES

from infrablend.formats import detection


def test_every_format_has_a_sample() -> None:
    assert {name.partition(":")[0] for name in SAMPLES} == {f.name for f in detection.FORMATS}


@pytest.mark.parametrize("name", sorted(SAMPLES))
def test_a_sample_is_found_and_read_without_an_error(name: str, tmp_path: Path) -> None:
    root = SAMPLES[name](tmp_path / "data")
    assert detection.detect(root).format == name.partition(":")[0]
    dataset = detection.read(root)
    assert [str(p) for p in dataset.problems if p.severity == "error"] == []
    counts = [len(i.instances) for i in dataset.images]
    assert max(counts) >= (0 if name in ("birdsai:frames", "folder:plain") else 1 if name == "yolo:seg" else 2), counts
    assert min(counts) == 0, counts
    files = {p.relative_to(root): p.read_bytes() for p in root.rglob("*") if p.is_file()}
    assert len(files) <= 40
    again = SAMPLES[name](tmp_path / "again")
    assert {p.relative_to(again): p.read_bytes() for p in again.rglob("*") if p.is_file()} == files
