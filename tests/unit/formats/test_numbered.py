"""Plain folders of numbered pictures: which of them are sequences."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from infrablend.formats import dataset_folder
from infrablend.formats.image_groups import leakage
from tests.samples import picture


def places(root: Path, names: Sequence[str]) -> list[tuple[str | None, int | None]]:
    """Return sequence and frame number of pictures of these names, in the order of their ids."""
    for k, name in enumerate(names):
        picture(root / name, k)
    return [(i.capture.sequence, i.capture.frame) for i in dataset_folder.read(root).images]


@pytest.mark.parametrize(
    ("names", "sequence"),
    [
        ([f"frame_{k:06d}.png" for k in (5, 6, 7, 9)], "frame"),
        ([f"{k:06d}.png" for k in (5, 6, 7, 9)], "frames"),
        ([f"night/clip 2/{k}.png" for k in (5, 6, 7, 9)], "night/clip 2"),
        ([f"images/train/a/f{k}.png" for k in (5, 6, 7, 9)], "a"),
    ],
)
def test_numbered_pictures_of_a_folder_are_frames(tmp_path: Path, names: list[str], sequence: str) -> None:
    assert sorted(places(tmp_path, names)) == [(sequence, k) for k in (5, 6, 7, 9)]


@pytest.mark.parametrize(
    "names",
    [
        ["a1.png", "a2.png", "a3.png"],  # too few
        ["a1.png", "a01.png", "a2.png", "a3.png"],  # one number twice
        ["a1.png", "a2.png", "b3.png", "b4.png"],  # two clips
        ["a1.png", "a2.png", "a3.png", "sky.png"],  # no number
        ["1.png", "17.png", "960.png", "4711.png", "90210.png"],  # drawn from many
        [f"2024050112000{k}.png" for k in range(4)],  # times
        [f"0_60_30_0_0000{k}.png" for k in range(4)],  # which state the frame
        [*(f"train/{k}.png" for k in range(4)), *(f"test/{k}.png" for k in range(4))],  # each split counts from 0
    ],
)
def test_other_pictures_stay_without_a_sequence(tmp_path: Path, names: list[str]) -> None:
    assert {*places(tmp_path, names)} == {(None, None)}


def test_a_table_counts_more(tmp_path: Path) -> None:
    rows = "".join(f"a{k}.png,flight,2024-05-0{k}\n" for k in range(1, 5))
    (tmp_path / "metadata.csv").write_text("file,sequence,captured\n" + rows)
    assert {*places(tmp_path, [f"a{k}.png" for k in range(1, 5)])} == {("flight", None)}


def test_neighbours_in_other_splits_are_still_found(tmp_path: Path) -> None:
    for k in range(12):
        picture(tmp_path / ("train", "val")[k % 2] / f"f_{k:03d}.png", k)
    images = dataset_folder.read(tmp_path).images
    assert {i.capture.sequence for i in images} == {"f"}
    assert [(found.images, found.near) for found in leakage(images)] == [(6, 6)]
