"""Writing in little memory: stored images give the bytes of images in memory, and memory does not grow with them."""

from __future__ import annotations

import itertools
import json
import tracemalloc
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.contract.test_formats import CATEGORIES, golden_images
from tests.samples import picture

from infrablend.core import spool
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, ImageRecord, Instance
from infrablend.core.format_table import WRITERS
from infrablend.core.json_records import COMPACT, SPACED, Streamed, json_chunks
from infrablend.core.spool import Spool, store_images
from infrablend.formats import writing


def varied_images(folder: Path) -> list[ImageRecord]:
    """Pictures of all splits, with and without labels, pitch, sequence, date and folder in the name."""
    images = []
    for image in golden_images(folder):
        for k in range(4):
            images.append(
                replace(
                    image,
                    id=f"{image.id}-{k}",
                    file_name=f"sub/{image.id}-{k}.png" if k == 3 else f"{image.id}-{k}.png",
                    split=("train", "val", "test", "train")[k],
                    capture=replace(
                        image.capture,
                        sequence=f"s{k}" if k else None,
                        captured="2020-01-01" if k == 2 else None,
                        pitch_deg=None if k == 1 else image.capture.pitch_deg,
                    ),
                    instances=() if k == 2 else image.instances,
                )
            )
    return images


@pytest.mark.parametrize("name", [w.name for w in WRITERS])
def test_stored_images_give_the_same_bytes(tmp_path, monkeypatch, name):
    images = varied_images(tmp_path / "in")
    written = writing.write(name, tmp_path / "memory", images, CATEGORIES)
    monkeypatch.setattr(spool, "IN_MEMORY", 2)
    again = writing.write(name, tmp_path / "disk", store_images(reversed(images), tmp_path), CATEGORIES)
    assert contents(tmp_path / "disk") == contents(tmp_path / "memory")
    assert (again.losses, again.problems) == (written.losses, written.problems)


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def made_up_images(folder: Path, count: int) -> Iterator[ImageRecord]:
    path = picture(folder / "picture.png", 0, (64, 64))
    for n in range(count):
        box = np.array([1.0, 2.0, 30.0 + n % 7, 40.0])
        objects = tuple(Instance("drone", box + k, inserted=True) for k in range(15))
        name = f"{n:06d}"
        yield ImageRecord(
            name, path, "train", (64, 64), objects, capture=Capture(pitch_deg=30.0), file_name=f"{name}.png"
        )


@pytest.mark.parametrize("name", [w.name for w in WRITERS])
def test_memory_does_not_grow_with_the_number_of_images(tmp_path, monkeypatch, name):
    monkeypatch.setattr(spool, "IN_MEMORY", 10)
    peaks: dict[int, int] = {}
    # Late imports and other threads of the process count as well, so the smaller of two peaks is taken.
    for count, turn in itertools.product((50, 250), range(2)):
        images = store_images(made_up_images(tmp_path, count), tmp_path)
        tracemalloc.start()
        settings = writing.WriteSettings(pictures=False)
        writing.write(name, tmp_path / f"{count}-{turn}", images, (Category(1, "drone"),), settings=settings)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        peaks[count] = min(peak, peaks.get(count, peak))
    # A picture with 15 objects takes 9 kB in memory; some hundred bytes of names and numbers remain, and the paths
    # of its label file and of the picture, which writers return. Anti-UAV has a label file for each of the 15 objects.
    assert (peaks[250] - peaks[50]) / 200 < 2000 * (15 if name == "anti-uav" else 1)


@pytest.mark.parametrize("separators", [COMPACT, SPACED])
@pytest.mark.parametrize("sort_keys", [True, False])
def test_pieces_are_the_text_of_the_whole(separators, sort_keys):
    value = {"b": [{"z": 1.5, "a": "ä"}, [], None], "a": [], "c": {"y": 1, "x": [True]}, "ü": "d"}
    streamed = {**value, "b": Streamed(iter(value["b"])), "a": Streamed(iter(()))}
    expected = json.dumps(value, separators=separators, sort_keys=sort_keys)
    found = json_chunks(streamed, Counter(), separators=separators, sort_keys=sort_keys)
    assert "".join(found) == expected
    assert "".join(json_chunks(Streamed([1, "b"]), None)) == '[1,"b"]'


def test_numbers_that_are_not_finite():
    losses: Counter[str] = Counter()
    assert "".join(json_chunks({"a": Streamed([float("nan"), 1.0])}, losses)) == '{"a":[null,1.0]}'
    assert losses == {"not_finite_dropped": 1}
    with pytest.raises(ValueError, match="JSON compliant"):
        "".join(json_chunks(Streamed([float("nan")]), None))


def test_a_spool_is_a_sequence_and_leaves_nothing_behind(tmp_path):
    items: Spool[tuple[int, str]] = Spool(tmp_path, in_memory=2)
    for n in range(5):
        items.append((n, "x" * n))
    assert list(tmp_path.iterdir()) == []
    assert (len(items), items[1], items[4], items[-1]) == (5, (1, "x"), (4, "xxxx"), (4, "xxxx"))
    assert [n for n, _ in items] == [0, 1, 2, 3, 4]
    assert [n for n, _ in items[1:4]] == [1, 2, 3]
    with pytest.raises(IndexError):
        items[5]
