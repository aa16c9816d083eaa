"""Hugging Face's imagefolder: types that agree between splits, and lines that nobody should trust."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from infrablend.core.dataset import ImageRecord
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.labels import huggingface
from tests.samples import records, with_facts


def lines(out: Path, split: str) -> list[dict[str, Any]]:
    return [json.loads(s) for s in (out / split / huggingface.FILE).read_text().splitlines()]


def written(folder: Path, change: Callable[[ImageRecord], ImageRecord]) -> tuple[huggingface.Written, Path]:
    images, categories = records(folder / "source")
    return huggingface.write(folder / "out", [change(i) for i in images], categories), folder / "out"


def test_columns_of_objects_have_a_value_for_every_object(tmp_path: Path) -> None:
    """JSON has no typed null: a null where another split has a list would keep `datasets` from loading anything."""
    _, out = written(tmp_path, lambda i: i)
    for split in ("train", "val", "test"):
        for row in lines(out, split):
            assert None not in row.values()
            for name, values in row["objects"].items():
                assert len(values) == len(row["objects"]["bbox"]) and None not in values, name
    (bicycle,) = (r["objects"] for r in lines(out, "test"))
    assert (bicycle["segmentation"], bicycle["oriented"]) == ([""], [False])
    assert bicycle["obb"] == [[10, 20, 18, 20, 18, 25, 10, 25]]


def test_a_number_that_a_split_lacks_is_left_out_of_all_and_counted(tmp_path: Path) -> None:
    done, out = written(tmp_path, lambda i: with_facts(i, pitch_deg=None) if i.split == "val" else i)
    assert done.losses == {"telemetry_dropped": 3}
    assert all("pitch_deg" not in r and "altitude_m" in r for s in ("train", "val", "test") for r in lines(out, s))


def test_the_first_line_gives_every_column_its_type(tmp_path: Path) -> None:
    """Arrow takes the types from the first megabytes."""
    done, out = written(tmp_path, lambda i: with_facts(i, pitch_deg=None) if i.instances and i.split == "train" else i)
    assert not done.losses
    first, second = lines(out, "train")
    assert (first["pitch_deg"], first["objects"]["bbox"]) == (90.0, []) or second["pitch_deg"] is not None
    assert {r["file_name"] for r in (first, second)} == {"0_60_30_0_00001.jpg", "1_90_60_0_00012.jpg"}


def test_a_column_of_numbers_has_one_type(tmp_path: Path) -> None:
    """Arrow takes 60 and 60.5 for two types."""
    _, out = written(
        tmp_path, lambda i: with_facts(i, pitch_deg=60, frame=3, camera="M3T" if i.split == "val" else None)
    )
    rows = [r for s in ("train", "val", "test") for r in lines(out, s)]
    assert {(str(r["pitch_deg"]), str(r["frame"])) for r in rows} == {("60.0", "3")}
    assert {r["camera"] for r in rows} == {"M3T", ""} and all("altitude_from" not in r for r in rows)


def test_a_split_without_any_object_is_left_out_with_a_warning(tmp_path: Path) -> None:
    done, out = written(tmp_path, lambda i: replace(i, instances=()) if i.split == "test" else i)
    (problem,) = done.problems
    assert (problem.code, problem.severity) == ("split-without-objects", "warning") and "test" in problem.found
    assert not (out / "test" / huggingface.FILE).exists() and (out / "train" / huggingface.FILE).exists()


def test_a_dataset_without_objects_has_no_column_of_them(tmp_path: Path) -> None:
    done, out = written(tmp_path, lambda i: replace(i, instances=()))
    assert not done.problems and all("objects" not in r for s in ("train", "val", "test") for r in lines(out, s))
    assert len(dataset_folder.read(out).images) == 4


@pytest.mark.parametrize("moment", ["2021-01-31", "2021-01-31T08:30:00", "2021-01-31 08:30:00.5"])
def test_a_time_stays_text(tmp_path: Path, moment: str) -> None:
    """Arrow would take it for another type than the empty text of a picture without one."""
    _, out = written(tmp_path, lambda i: with_facts(i, captured=moment if i.split == "train" else None))
    assert {r["captured"] for r in lines(out, "train")} == {f"on {moment}"}
    assert {i.capture.captured for i in dataset_folder.read(out).images if i.split == "train"} == {moment}


def test_hugging_faces_own_example_is_read(tmp_path: Path) -> None:
    """Numbers as categories and no size: https://huggingface.co/docs/datasets/image_dataset, object detection."""
    images, _ = records(tmp_path / "train")
    rows = [
        {"file_name": images[0].name, "objects": {"bbox": [[30.0, 10.0, 7.0, 5.0]], "categories": [0]}},
        {"file_name": images[1].name, "objects": {"bbox": [[8.0, 2.0, 7.0, 9.0]], "categories": [1]}},
    ]
    (tmp_path / "train" / huggingface.FILE).write_text("".join(json.dumps(r) + "\n" for r in rows))
    dataset = dataset_folder.read(tmp_path)
    assert dataset.format == "huggingface"
    assert [(c.id, c.name) for c in dataset.categories] == [(0, "class 0"), (1, "class 1")]
    assert [i.instances[0].box_xyxy.tolist() for i in dataset.images] == [[30, 10, 37, 15], [8, 2, 15, 11]]
    assert [p.code for p in dataset.problems] == ["image-unlisted"]


@pytest.mark.parametrize(
    "line, code",
    [
        ("{", "annotation-not-json"),
        ("[" * 100_000, "annotation-not-json"),
        ('{"file_name": "../x.jpg"}', "name-climbs"),
        ('{"file_name": "gone.jpg"}', "image-missing"),
        ('{"file_name": "0_60_30_0_00001.jpg"}', "image-duplicate"),
        ('{"file_name": "1_90_60_0_00012.jpg", "objects": {"bbox": 3}}', "annotation-layout"),
        ('{"file_name": "1_90_60_0_00012.jpg", "objects": {"bbox": [[1, 2, 3, 4]], "label": []}}', "annotation-layout"),
        (
            '{"file_name": "1_90_60_0_00012.jpg", "objects": {"bbox": [[1, 2, 1e999, 4]], "category": ["a"]}}',
            "box-not-finite",
        ),
        (
            '{"file_name": "1_90_60_0_00012.jpg", "width": 64, "height": 48, '
            '"objects": {"bbox": [[1, 2, 3, 4]], "category": ["a"], "segmentation": ["zzzz"]}}',
            "mask-malformed",
        ),
    ],
)  # fmt: skip
def test_bad_lines_are_named_and_the_others_read(tmp_path: Path, line: str, code: str) -> None:
    _, out = written(tmp_path, lambda i: i)
    path = out / "train" / huggingface.FILE
    first = path.read_text().splitlines()[0]
    path.write_text(f"{first}\n{line}\n")
    dataset = dataset_folder.read(out)
    assert code in [p.code for p in dataset.problems]
    assert any(i.name == "0_60_30_0_00001.jpg" for i in dataset.images)


def test_nothing_readable_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "train").mkdir()
    (tmp_path / "train" / huggingface.FILE).write_text("{}\n")
    with pytest.raises(DatasetError, match="nothing to read"):
        huggingface.read(tmp_path)
