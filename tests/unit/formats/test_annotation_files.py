"""Files appear complete or not at all; disk errors have a remedy; polygons cover their masks."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np
import pytest

from infrablend.core.boxes import polygon_area
from infrablend.core.files import link_or_copy, part_path, write_bytes, write_text
from infrablend.core.rle_masks import Mask
from infrablend.errors import DatasetError, OutputError
from infrablend.formats import polygons
from infrablend.formats.annotation_files import read_json, read_text, read_xml
from infrablend.formats.base import require_options
from infrablend.formats.box_checks import snap
from infrablend.formats.pictures.listing import assign_ids
from infrablend.formats.polygons import outline, rasterise


def test_a_full_disk_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_text(tmp_path / "a" / "x.txt", "old")

    def full(self: Path, mode: str) -> BinaryIO:
        self.touch()
        return os.fdopen(os.open("/dev/full", os.O_WRONLY), "wb")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", full)
        with pytest.raises(OutputError, match="No space") as caught:
            write_bytes(path, b"new")
    assert caught.value.problems[0].code == "disk-full"
    assert path.read_text() == "old" and not part_path(path).exists()


def test_durable_files_are_synced_before_they_are_renamed(tmp_path: Path, monkeypatch) -> None:
    path, seen = tmp_path / "f.json", []
    monkeypatch.setattr(os, "fsync", lambda handle: seen.append((os.fstat(handle).st_ino, path.exists())))
    write_bytes(path, b"x")
    assert seen == []
    path.unlink()
    write_bytes(path, b"y", durable=True)
    assert seen == [(path.stat().st_ino, False), (tmp_path.stat().st_ino, True)]

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="No space"):
        write_bytes(path, b"z", durable=True)
    assert path.read_bytes() == b"y"


def test_folder_at_the_output_path_is_an_output_error(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("a file")
    with pytest.raises(OutputError, match="cannot write"):
        write_text(tmp_path / "a" / "x.txt", "new")


def test_links_are_made_repeated_and_replaced(tmp_path: Path) -> None:
    source = write_text(tmp_path / "s", "one")
    target = link_or_copy(source, tmp_path / "d" / "t")
    assert target.samefile(source)
    assert link_or_copy(source, target).samefile(source)
    other = write_text(tmp_path / "o", "two")
    assert link_or_copy(other, target).read_text() == "two"
    assert sorted(p.name for p in (tmp_path / "d").iterdir()) == ["t"]
    (tmp_path / "link").symlink_to(source)
    assert not link_or_copy(tmp_path / "link", tmp_path / "d" / "u").is_symlink()


def test_where_links_are_impossible_files_are_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EXDEV, os.strerror(errno.EXDEV))

    monkeypatch.setattr(os, "link", refuse)
    source = write_text(tmp_path / "s", "one")
    target = link_or_copy(source, tmp_path / "t")
    assert target.read_text() == "one" and not target.samefile(source)
    with pytest.raises(OutputError):
        link_or_copy(tmp_path / "absent", tmp_path / "u")


def test_ids_are_stems_where_they_can_be() -> None:
    names = ["a/x.jpg", "b/x.jpg", "b/y.jpg", "c/z.jpg", "c/z.png"]
    assert assign_ids(reversed(names)) == {
        "a/x.jpg": "a__x", "b/x.jpg": "b__x", "b/y.jpg": "y", "c/z.jpg": "c__z_jpg", "c/z.png": "c__z_png",
    }  # fmt: skip
    assert len(set(assign_ids(["a/b.jpg", "c/b.jpg", "a__b.jpg", "q/a__b.jpg"]).values())) == 4


def disc(radius_px: float, size: int = 80) -> np.ndarray:
    y, x = np.mgrid[:size, :size]
    return np.asarray((x - size / 2 + 0.5) ** 2 + (y - size / 2 + 0.5) ** 2 <= radius_px**2)


def test_outline_of_one_part_is_exact() -> None:
    rectangle = np.zeros((20, 30), np.bool_)
    rectangle[5:12, 4:15] = True
    made = outline(Mask.from_array(rectangle))
    assert made.raster_difference_px == 0 and len(made.polygon_xy) == 4
    inset = polygons.INSET_PX
    assert polygon_area(made.polygon_xy) == pytest.approx((11 - 2 * inset) * (7 - 2 * inset))
    for radius in (0.8, 3, 10, 35):
        made = outline(Mask.from_array(disc(radius)))
        assert made.raster_difference_px == 0
        assert abs(polygon_area(made.polygon_xy)) == pytest.approx(disc(radius).sum(), rel=0.06)


@pytest.mark.parametrize("radius", [3.0, 7.3, 20.0])
def test_points_added_along_the_outline_change_nothing(radius: float) -> None:
    """Ultralytics resamples every polygon to 1,000 points before it cuts them to integers."""
    mask = disc(radius)
    polygon = outline(Mask.from_array(mask)).polygon_xy
    share = np.linspace(0, 1, 20, endpoint=False)[None, :, None]
    dense = polygon[:, None] + share * (np.roll(polygon, -1, axis=0) - polygon)[:, None]
    assert (rasterise(dense.reshape(-1, 2), (mask.shape[1], mask.shape[0])) == mask).all()


def test_outline_of_a_single_pixel_and_of_nothing() -> None:
    one = np.zeros((9, 9), np.bool_)
    one[3, 8] = True
    made = outline(Mask.from_array(one))
    assert made.raster_difference_px == 0 and (rasterise(made.polygon_xy, (9, 9)) == one).all()
    np.testing.assert_allclose([made.polygon_xy.min(0), made.polygon_xy.max(0)], [[8, 3], [9, 4]], atol=0.011)
    assert outline(Mask.from_array(one & False)).polygon_xy.shape == (0, 2)


def test_holes_stay_holes_and_parts_are_bridged() -> None:
    ring = disc(30) & ~disc(12)
    made = outline(Mask.from_array(ring))
    assert made.raster_difference_px == 0
    assert abs(polygon_area(made.polygon_xy)) == pytest.approx(ring.sum(), rel=0.02)
    two = np.zeros((20, 40), np.bool_)
    two[5:10, 2:10] = True
    two[5:10, 18:30] = True
    made = outline(Mask.from_array(two))
    assert made.raster_difference_px == 8  # one row of pixels, columns 10 to 17
    assert not (two & ~rasterise(made.polygon_xy, (40, 20))).any()


def test_a_ragged_mask_stays_below_the_corner_limit() -> None:
    noise = np.random.default_rng(0).random((200, 200)) < 0.9
    mask = disc(95, 200) & noise
    made = outline(Mask.from_array(mask))
    assert len(made.polygon_xy) <= polygons.MAX_CORNERS
    differ = (rasterise(made.polygon_xy, (200, 200)) != mask).sum()
    assert made.raster_difference_px == differ > 0
    assert cv2.contourArea(made.polygon_xy.astype(np.float32)) > 0.7 * disc(95, 200).sum()


def test_files_too_large_to_parse_are_not_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a"
    with path.open("wb") as file:
        file.truncate(300_000_000)  # a hole: no disk, no memory
    monkeypatch.setattr(Path, "read_text", lambda *_, **__: pytest.fail("opened"))
    for _, problem in (read_text(path, "a", "text"), read_xml(path, "a")):
        assert problem is not None and problem.code == "annotation-too-large" and "300 MB" in problem.found
    with pytest.raises(DatasetError, match=r"not JSON \(Expecting value at byte 0"):
        read_json(path)  # JSON has no limit: it is read until the first fault


def test_text_and_xml_that_cannot_be_read_are_problems(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"\xff\xfe\xff")
    for name in ("a", "missing"):
        text, problem = read_text(tmp_path / name, name, "a label file")
        assert text == "" and problem is not None and problem.code == "annotation-unreadable"
        root, problem = read_xml(tmp_path / name, name)
        assert root is None and problem is not None and problem.code == "annotation-not-xml"


def test_unknown_values_of_options_are_named_all_at_once(tmp_path: Path) -> None:
    require_options(tmp_path, a=("x", ("x", "y")))
    with pytest.raises(DatasetError) as caught:
        require_options(tmp_path, a=("z", ("x", "y")), b=("x", ("x",)), c=("", ("p",)))
    assert [p.where for p in caught.value.problems] == ["option a", "option c"]
    assert "a=z; expected one of x, y" in str(caught.value)


def test_only_rounding_is_moved_onto_the_edge() -> None:
    assert [snap(v, 10) for v in (-5e-7, 10 + 5e-7, -1e-5, 10.1, 4)] == [0, 10, -1e-5, 10.1, 4]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<annotation><object>", "damaged XML (no element found: line 1, column 20)"),
        ('<!DOCTYPE a [<!ENTITY e "x">]><a>&e;</a>', "XML with a document type or entities, which are refused"),
        ('<!DOCTYPE a SYSTEM "file:///etc/passwd"><a/>', "XML with a document type or entities, which are refused"),
        (
            '<?xml version="1.0" encoding="nonsense"?><a/>',
            "XML that is not in the encoding it declares (unknown encoding: nonsense)",
        ),
    ],
)
def test_xml_that_is_refused_is_explained_in_plain_words(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text(text)
    problem = read_xml(tmp_path / "a.xml", "a.xml")[1]
    assert problem is not None and problem.found.startswith(words)
    assert "Error" not in problem.found and "Forbidden" not in problem.found and str(tmp_path) not in problem.found


@pytest.mark.parametrize("head", ["", '<?xml version="1.0" encoding="utf-8"?>'])
@pytest.mark.parametrize(("encoding", "name"), [("GB18030", "人"), ("WINDOWS-1252", "vélo")])
def test_xml_that_is_not_in_utf8_names_its_encoding(tmp_path: Path, head: str, encoding: str, name: str) -> None:
    (tmp_path / "a.xml").write_bytes(f"{head}<a>{name}</a>".encode(encoding))
    problem = read_xml(tmp_path / "a.xml", "a.xml")[1]
    assert problem is not None and f"iconv -f {encoding} -t UTF-8 a.xml" in problem.todo
