"""Tables of pitch and height as spreadsheets of different countries write them, through the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from infrablend.cli.app import build_app
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.read_write import Reading
from tests.flights import plain_jpeg

TABLE = "file,pitch_deg,altitude_m\na.jpg,45.5,1200.5\n"


def inspected(folder: Path, table: str, code: int = 0) -> dict[str, Any]:
    plain_jpeg(folder / "a.jpg")
    (folder / "metadata.csv").write_bytes(table.encode())
    result = CliRunner().invoke(build_app(), ["-q", "inspect", "--json", str(folder)])
    assert result.exit_code == code, result.output
    data: dict[str, Any] = json.loads(result.stdout)
    return data


@pytest.mark.parametrize(
    "table",
    [
        TABLE,
        TABLE.replace(",", ";"),
        TABLE.replace(",", ";").replace(".5", ",5"),
        TABLE.replace(",", "\t"),
        TABLE.replace("1200.5", '"1,200.5"'),
        "\ufeff" + TABLE.replace("\n", "\r\n"),
        TABLE + "b;c;d;e;f;g;h.jpg,1,2\n",
    ],
    ids=["plain", "semicolons", "decimal commas", "tabs", "thousands", "a mark and CRLF", "semicolons in names"],
)
def test_separators_and_commas(table: str, tmp_path: Path) -> None:
    coverage = json.dumps(inspected(tmp_path, table)["coverage"])
    assert "45.5" in coverage and "1200.5" in coverage


@pytest.mark.parametrize(
    ("table", "code", "words"),
    [
        (TABLE.replace("altitude_m", "altitude_m,altitude_m"), 2, "column(s) altitude_m more than once"),
        (TABLE.replace("1200.5", "1200.5,7,8"), 0, "2 cell(s) more than columns"),
        (TABLE.replace("1200.5", "nan"), 0, "altitude_m 'nan'"),
        (TABLE.replace("45.5", "-91"), 0, "pitch_deg '-91'"),
    ],
)
def test_tables_that_contradict_themselves_are_named(table: str, code: int, words: str, tmp_path: Path) -> None:
    assert words in str(inspected(tmp_path, table, code)["problems"])


@pytest.mark.parametrize(
    ("table", "sequence"),
    [("file,sequence\na.jpg,north\n", "north"), ("file,captured\na.jpg,2024-05-01T06:30:00\n", None)],
)
def test_a_table_may_hold_sequences_or_dates_alone(table: str, sequence: str | None, tmp_path: Path) -> None:
    inspected(tmp_path, table)
    (image,) = dataset_folder.read(tmp_path).images
    assert image.capture.sequence == sequence and (image.capture.captured is None) == (sequence is not None)


def test_a_row_for_a_picture_precedes_the_annotation_in_all_facts(tmp_path: Path) -> None:
    """`sequence`, `captured`, `frame` and `time_s`, too; what the row leaves open stays the annotation's."""
    images = []
    for n in (1, 2):
        plain_jpeg(tmp_path / f"{n}.jpg")
        images.append({"id": n, "file_name": f"{n}.jpg", "width": 160, "height": 128, "sequence": "south", "frame": n})
    (tmp_path / "annotations.json").write_text(json.dumps({"images": images, "annotations": [], "categories": []}))
    (table := tmp_path.with_suffix(".csv")).write_text("file,sequence,frame\n1.jpg,north,7\n2.jpg,,9\n")
    found = dataset_folder.read(tmp_path, Reading(metadata=table)).images
    assert [(i.capture.sequence, i.capture.frame) for i in found] == [("north", 7), ("south", 9)]


@pytest.mark.parametrize("table", ["sequence\nnorth\n", "file\na.jpg\n", "sequence,weather\nnorth,rain\n"])
def test_a_table_without_any_fact_is_refused(table: str, tmp_path: Path) -> None:
    plain_jpeg(tmp_path / "a.jpg")
    (tmp_path / "metadata.csv").write_text(table)
    with pytest.raises(DatasetError, match="expected one of file, file_name, stem, sequence and some of pitch_deg"):
        dataset_folder.read(tmp_path)
