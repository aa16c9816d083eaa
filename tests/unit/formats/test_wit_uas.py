"""WIT-UAS: `.label` files, two cameras per run, boxes without area."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.pictures.images import load_background
from infrablend.formats.published import wit_uas
from infrablend.formats.read_write import Reading
from tests.samples import SAMPLES, picture

RUN = "2022-05-11_FIRE-SGL-111-Confluence_M600/2022-04-27-10-00-00"


def frame(root: Path, folder: str, time: str, label: str | None) -> Path:
    path = picture(root / folder / f"time_{time}.png", 1)
    if label is not None:
        path.with_suffix(".label").write_text(label)
    return path


def test_runs_cameras_and_splits(tmp_path: Path) -> None:
    frame(tmp_path, f"train/{RUN}_flir", "0001.00", "1 2 30 40 h\n")
    frame(tmp_path, f"val/{RUN}_seek", "0001.00", "")
    frame(tmp_path, f"test/{RUN}_flir", "0002.50", None)
    d = dataset_folder.read(tmp_path)
    assert d.format == "wit-uas" and [p.code for p in d.problems] == ["label-missing"]
    assert [(i.split, i.extra["sensor"], i.capture.time_s) for i in d.images] == [
        ("train", "flir", 1.0), ("val", "seek", 1.0), ("test", "flir", 2.5),
    ]  # fmt: skip
    assert {(i.capture.sequence, i.capture.captured) for i in d.images} == {("2022-04-27-10-00-00", "2022-05-11")}
    assert d.images[0].file_name == f"{RUN}_flir/time_0001.00.png"
    assert d.images[2].extra["labelled"] is False
    flir = dataset_folder.read(tmp_path, Reading(options={"camera": "flir", "unlabelled": "drop"}))
    assert [i.extra["sensor"] for i in flir.images] == ["flir"]
    assert flir.notes["rows"]["other_camera"] == 1
    assert [p.code for p in flir.problems] == ["label-missing", "camera-excluded"]
    with pytest.raises(DatasetError, match="both, flir, seek"):
        dataset_folder.read(tmp_path, Reading(options={"camera": "rgb"}))


def test_a_run_alone_and_a_table_by_run(tmp_path: Path) -> None:
    frame(tmp_path, f"{RUN}_seek", "0001.00", "")
    (tmp_path / "t.csv").write_text("sequence,pitch_deg,altitude_m\n2022-04-27-10-00-00,45,60\n")
    d = dataset_folder.read(tmp_path / f"{RUN}_seek", Reading(metadata=tmp_path / "t.csv"))
    (image,) = d.images
    assert (image.capture.pitch_deg, image.capture.altitude_m, image.split, image.capture.captured) == (
        45,
        60,
        "train",
        "2022-05-11",
    )
    assert d.notes["pitch"] == "table t.csv per sequence" and d.problems == ()


LINES = (
    ("1 2 1 40 h", "box-empty"),
    ("1 2 30 2 v", "box-empty"),
    ("30 2 1 40 c", "box-empty"),
    ("70 2 80 40 h", "box-outside"),
    ("-4 2 30 40 h", "box-clipped"),
    ("1 2 30 40 x", "category-unknown"),
    ("1 2 30 40", "label-malformed"),
    ("1 2 30 40 h 1", "label-malformed"),
    ("1 2 3x 40 h", "label-malformed"),
    ("1 2 nan 40 h", "box-not-finite"),
)


@pytest.mark.parametrize(("line", "code"), LINES)
def test_bad_lines_are_named_and_counted(tmp_path: Path, line: str, code: str) -> None:
    frame(tmp_path, f"train/{RUN}_flir", "0001.00", f"1 2 30 40 h\n\n{line}\n1 2 30 40 V\n5 6 7 8 c\n")
    d = wit_uas.read(tmp_path)
    assert [p.code for p in d.problems] == [code] and d.problems[0].where.endswith(".label: line 3")
    kept = [o.category for o in d.images[0].instances]
    assert kept == (["human", "human"] if code == "box-clipped" else ["human"]) + ["vehicle", "vehicle"]
    assert d.images[0].instances[-1].extra == {"code": "c"}
    assert (d.notes["rows"]["objects"], d.notes["rows"]["read"]) == (4, len(kept))


def test_eight_and_sixteen_bits_one_and_three_channels_are_backgrounds(tmp_path: Path) -> None:
    d = dataset_folder.read(SAMPLES["wit-uas"](tmp_path))
    loaded = [load_background(i.path, i.size_wh) for i in d.images]
    assert [(b.bit_depth, b.mode) for b in loaded] == [(16, "I;16"), (8, "RGB"), (8, "RGB")]
    assert all(b.problems == () for b in loaded) and int(loaded[0].pixels.max()) > 255


@given(st.text(max_size=60) | st.lists(st.sampled_from(["1", "9e999", "-0", "nan", "h", "c", "\n"])).map(" ".join))
def test_any_text_gives_boxes_inside_the_frame(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    root = tmp_path_factory.mktemp("w")
    path = frame(root, f"train/{RUN}_flir", "0001.00", None)
    path.with_suffix(".label").write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        d = wit_uas.read(root)
    except DatasetError as error:
        assert error.problems
        return
    for o in d.images[0].instances:
        x0, y0, x1, y1 = o.box_xyxy
        assert 0 <= x0 < x1 <= 64 and 0 <= y0 < y1 <= 48


def test_runs_without_any_label_are_not_claimed(tmp_path: Path) -> None:
    frame(tmp_path, f"train/{RUN}_flir", "0001.00", None)
    assert not wit_uas.detect(tmp_path).ok
