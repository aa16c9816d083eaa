"""Check of packed shards in parts: the report of the whole dataset, with one part on disk and in memory."""

import gc
import os
import shutil
import weakref
from dataclasses import replace
from pathlib import Path

import pytest

from infrablend.formats import dataset_folder
from infrablend.formats.labels import shards
from infrablend.formats.pictures import derived
from infrablend.formats.read_write import Reading
from infrablend.pipeline.studies.examine import changes_since_written, check_folder
from infrablend.report.checking import check_dataset
from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.unit.pipeline.test_run import dataset
from tests.unit.pipeline.test_shard_layout import PACKED
from tests.unit.pipeline.test_shards import command

pytest.importorskip("pyarrow.parquet")

__all__ = ["dataset"]


@pytest.fixture
def packed(dataset, tmp_path, monkeypatch):
    """Run in four packed shards in which one picture occurs in two splits, and one twice in a split."""
    render_flat(monkeypatch)
    source = dataset / "normal_json"
    pictures = sorted((source / "train").glob("*.jpg")), sorted((source / "val").glob("*.jpg"))
    shutil.copy(pictures[0][0], pictures[1][0])
    shutil.copy(pictures[0][0], pictures[0][1])
    done(*command(dataset, tmp_path / "out", *PACKED, "--shard-size", 3))
    return tmp_path / "out"


@pytest.mark.parametrize("decode", [True, False])
@pytest.mark.parametrize("most", [1, 5, 2000])
def test_parts_give_the_report_of_the_whole(packed, monkeypatch, most, decode):
    whole = check_dataset(dataset_folder.read(packed), decode=decode)
    assert {"image-leak", "image-repeated"} & {p.code for p in whole.problems}
    monkeypatch.setattr(dataset_folder, "PART_FRAMES", most)
    seen = []
    report = check_folder(packed, decode=decode, on_progress=seen.append)
    assert replace(report, problems=()) == replace(whole, problems=())
    assert report.problems == whole.problems
    assert changes_since_written(packed) == []
    assert (seen[-1].done, seen[-1].total) == (report.images, report.images)


def test_damaged_labels_and_wanted_splits(packed, monkeypatch):
    monkeypatch.setattr(dataset_folder, "PART_FRAMES", 2)
    train = check_folder(packed, reading=Reading(splits=["train"]))
    assert train.images == sum(i.split == "train" for i in dataset_folder.read(packed).images)
    read = shards.image_of

    def damaged(label, folder):
        if label["frame_id"].startswith("val/"):
            raise ValueError("no box")
        return read(label, folder)

    monkeypatch.setattr(shards, "image_of", damaged)
    report = check_folder(packed)
    assert report.by_code()["annotation-layout"] == sum(i.startswith("val/") for i in frame_ids(packed))
    monkeypatch.setattr(shards, "image_of", lambda label, folder: damaged({"frame_id": "val/"}, folder))
    none = check_folder(packed)
    assert not none.ok() and none.images == 0


def frame_ids(root: Path) -> list[str]:
    import pyarrow.parquet as pq

    return [i for p in sorted(root.glob("*.parquet")) for i in pq.read_table(p)["frame_id"].to_pylist()]


def test_nothing_is_left_in_cache_or_scratch(packed, tmp_path, monkeypatch):
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr(derived, "cache_folder", lambda: tmp_path / "cache")
    assert run("check", packed).exit_code in (0, 1)
    assert not (tmp_path / "cache").exists()
    assert [n for _, _, names in os.walk(temporary) for n in names] == []


def test_labels_of_earlier_parts_are_freed(packed, monkeypatch):
    monkeypatch.setattr(dataset_folder, "PART_FRAMES", 2)
    parts, make = [], shards._Frames.dataset

    def watched(self, found):
        gc.collect()
        # The last part is still in the hands of the caller.
        assert all(label() is None for part in parts[:-1] for label in part)
        parts.append([weakref.ref(i) for image in found for i in image.instances])
        return make(self, found)

    monkeypatch.setattr(shards._Frames, "dataset", watched)
    assert check_folder(packed).images == 12
    assert len(parts) == 6
    assert sum(map(len, parts)) > 12
