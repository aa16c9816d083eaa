"""WiSARD: clips, names with blanks, labelled and unlabelled pictures, the burnt-in logo, rounding at edges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.published import wisard
from infrablend.formats.read_write import Reading
from tests.samples import codes, picture

IR, FLIR, VIS = (
    "210529_Carnation_Enterprise_IR_0024",
    "210327_Airfield_FLIR_IR_8",
    "210529_Carnation_Enterprise_VIS_0023",
)


def frame(root: Path, clip: str, name: str, label: str | None, size_wh: tuple[int, int] = (64, 48)) -> Path:
    path = picture(root / clip / name, 1, size_wh)
    if label is not None:
        path.with_suffix(".txt").write_text(label)
    return path


def test_missing_and_empty_labels_are_not_the_same(tmp_path: Path) -> None:
    frame(tmp_path, IR, "a_IR_0008_out_frame_00001.jpeg", "0 0.5 0.5 0.25 0.5\n")
    frame(tmp_path, IR, "20200929_134258_IR 127.jpg", "")
    frame(tmp_path, IR, "DJI_0402.mp4_00006.jpg", None)
    (tmp_path / IR / "count.txt").write_text("1417\n0\n")
    (tmp_path / IR / "DJI_0402.mp4_00012.txt").write_text("0 0.5 0.5 0.25 0.5\n")
    d = dataset_folder.read(tmp_path)
    assert d.format == "wisard" and codes(d) == []
    assert codes(d, "warning") == ["image-missing", "label-missing"]
    by_frame = {i.capture.frame: i for i in d.images}
    assert by_frame.keys() == {1, 6, 127}
    assert by_frame[1].instances[0].box_xyxy.tolist() == [24, 12, 40, 36]
    assert [by_frame[k].extra.get("labelled", True) for k in (1, 127, 6)] == [True, True, False]
    assert {(i.capture.sequence, i.capture.captured, i.split) for i in d.images} == {(IR, "2021-05-29", "train")}
    rows = d.notes["rows"]
    assert (rows["labelled"], rows["empty"], rows["unlabelled"], rows["objects"], rows["read"]) == (2, 1, 1, 1, 1)
    assert len(wisard.read(tmp_path, unlabelled="drop").images) == 2


def test_one_clip_alone_is_a_dataset_too(tmp_path: Path) -> None:
    frame(tmp_path, IR, "x_1.jpg", "")
    d = dataset_folder.read(tmp_path / IR)
    assert (d.format, d.images[0].capture.sequence, d.images[0].file_name) == ("wisard", IR, f"{IR}/x_1.jpg")


def test_visible_clips_are_left_out_and_counted(tmp_path: Path) -> None:
    frame(tmp_path / "WiSARDv1", IR, "x_1.jpg", "")
    frame(tmp_path / "WiSARDv1", VIS, "x_0.jpg", "0 0.5 0.5 0.25 0.5\n")
    d = dataset_folder.read(tmp_path)
    assert [i.capture.sequence for i in d.images] == [IR] and codes(d, "warning") == ["modality-excluded"]
    assert "1 clip(s) with 1 pictures" in d.problems[0].found
    vis = dataset_folder.read(tmp_path, Reading(options={"modality": "vis"}))
    assert [i.extra["modality"] for i in vis.images] == ["visible"]
    assert len(wisard.read(tmp_path, modality="all").images) == 2


def test_the_logo_of_flir_clips_is_a_region_to_ignore(tmp_path: Path) -> None:
    frame(tmp_path, FLIR, "x_1.jpg", "0 0.5 0.5 0.25 0.5\n", (640, 512))
    frame(tmp_path, IR, "x_1.jpg", "")
    d = dataset_folder.read(tmp_path)
    by_clip = {i.capture.sequence: i for i in d.images}
    assert [o.category for o in by_clip[FLIR].instances] == ["human", "Logo"]
    assert by_clip[FLIR].instances[1].box_xyxy.tolist() == [0, 448, 128, 512]
    assert by_clip[IR].instances == () and d.category("Logo").ignore
    assert codes(d, "warning") == ["logo-assumed"] and d.notes["rows"]["read"] == 1
    d = dataset_folder.read(tmp_path, Reading(options={"logo": "0,470,90,512"}))
    assert {i.capture.sequence: i for i in d.images}[FLIR].instances[1].box_xyxy.tolist() == [0, 470, 90, 512]
    assert codes(d, "warning") == [] and d.notes["logo"] == "0,470,90,512"
    d = dataset_folder.read(tmp_path, Reading(options={"logo": "none"}))
    assert [c.name for c in d.categories] == ["human"] and d.problems == ()


@pytest.mark.parametrize("options", [{"logo": "left"}, {"logo": "5,0,1,1"}, {"logo": "0,0,nan,1"}, {"modality": "rgb"},
                                     {"unlabelled": ""}, {"split": "all"}])  # fmt: skip
def test_unknown_values_of_options_are_refused(tmp_path: Path, options: dict[str, str]) -> None:
    frame(tmp_path, IR, "x_1.jpg", "")
    with pytest.raises(DatasetError) as caught:
        dataset_folder.read(tmp_path, Reading(options=options))
    (problem,) = caught.value.problems
    assert problem.code == "option-value" and next(iter(options)) in problem.where and problem.expected


def test_the_split_is_an_option(tmp_path: Path) -> None:
    frame(tmp_path, IR, "x_1.jpg", "")
    assert dataset_folder.read(tmp_path, Reading(options={"split": "test"}, splits=["test"])).images[0].split == "test"
    with pytest.raises(DatasetError, match="no picture"):
        dataset_folder.read(tmp_path, Reading(splits=["val"]))


LINES = (
    ("0 0.750001 0.5 0.5 0.5", [32 + 6.4e-5, 12, 64, 36], 1, None),
    ("0 0.249999 0.5 0.5 0.5", [0, 12, 32 - 6.4e-5, 36], 1, None),
    ("0 0.95 0.5 0.2 0.5", [54.4, 12, 64, 36], 0, "box-clipped"),
    ("0 1.0000005 0.5 0.000001 0.5", None, 1, "box-empty"),
    ("0 0.5 0.5 0 0.5", None, 0, "box-empty"),
    ("0 1.5 0.5 0.1 0.5", None, 0, "box-outside"),
    ("1 0.5 0.5 0.1 0.5", None, 0, "category-unknown"),
    ("0 0.1 0.1 0.2 0.1 0.2 0.2", None, 0, "category-unknown"),
    ("0 0.5 0.5 0.1", None, 0, "label-malformed"),
    ("0 nan 0.5 0.1 0.1", None, 0, "box-not-finite"),
)


@pytest.mark.parametrize(("line", "expected", "snapped", "code"), LINES)
def test_every_line_is_read_or_reported(
    tmp_path: Path, line: str, expected: list[float] | None, snapped: int, code: str | None
) -> None:
    frame(tmp_path, IR, "x_1.jpg", f"{line}\n")
    d = wisard.read(tmp_path)
    boxes = [o.box_xyxy.tolist() for o in d.images[0].instances]
    assert boxes == ([] if expected is None else [pytest.approx(expected, abs=1e-9)])
    assert [p.code for p in d.problems] == ([] if code is None else [code])
    assert d.notes["rows"]["snapped"] == snapped
    if code:
        assert d.problems[0].where == f"{IR}/x_1.txt: line 1"


def test_unreadable_picture_is_named(tmp_path: Path) -> None:
    frame(tmp_path, IR, "x_1.jpg", "")
    frame(tmp_path, IR, "x_2.jpg", "0 0.5 0.5 0.25 0.5\n").write_bytes(b"no picture")
    frame(tmp_path, IR, "x_3.jpg", None).with_suffix(".txt").write_bytes(b"\xff\xfe")
    d = wisard.read(tmp_path)
    assert codes(d) == ["image-unreadable", "annotation-unreadable"] and len(d.images) == 1


@pytest.mark.parametrize(
    ("name", "modality"),
    [("210417_MtErie_Enterprise_0003_0004_IR", "ir"), ("200402_Karen_Inspire_VIS_695", "vis"), ("IR_clip", None),
     ("210417_FIRE_1", None), ("2104_MtErie_IR_1", None)],
)  # fmt: skip
def test_names_of_clips(name: str, modality: Any) -> None:
    assert wisard.modality_of(name) == modality


words = st.sampled_from(["0", "1", "-1", "0.5", "1.0000001", "1e308", "nan", "inf", "", "x", "٣", "\x00", "\n"])


@given(st.lists(words, max_size=14).map(" ".join) | st.binary(max_size=80).map(lambda b: b.decode("latin-1")))
def test_any_text_gives_boxes_inside_the_frame(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    root = tmp_path_factory.mktemp("w")
    frame(root, IR, "x_1.jpg", text)
    d = wisard.read(root)
    for o in d.images[0].instances:
        x0, y0, x1, y1 = o.box_xyxy
        assert 0 <= x0 < x1 <= 64 and 0 <= y0 < y1 <= 48
    assert d.notes["rows"]["objects"] == d.notes["rows"]["read"] + len(codes(d))


def test_the_shared_clips_are_read(real_data: Path) -> None:
    d = dataset_folder.read(real_data / "wisard")
    assert d.format == "wisard" and d.problems == ()
    assert {i.size_wh for i in d.images} == {(640, 512)} and len({i.capture.sequence for i in d.images}) == 3
    texts = [p.read_text().splitlines() for p in sorted((real_data / "wisard").rglob("*.txt"))]
    assert sum(len(i.instances) for i in d.images) == sum(map(len, texts)) == d.notes["rows"]["read"]
    assert len(d.images) == len(texts) and d.notes["rows"]["empty"] == sum(not t for t in texts)
    assert d.notes["pitch"] == "none" and {i.capture.captured for i in d.images} == {"2021-04-17", "2021-09-24"}


def test_clips_without_any_label_are_not_claimed(tmp_path: Path) -> None:
    frame(tmp_path, f"train/{IR}", "x 1.jpg", None)
    match = wisard.detect(tmp_path)
    assert not match.ok and "no label file" in match.reason
