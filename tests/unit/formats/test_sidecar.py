"""What readers of label files beside pictures share: checked objects, counts, and pictures without a label file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from infrablend.core.dataset import Instance
from infrablend.formats.published.sidecar import Fault, LabelledFolder, Stated, checked, if_file, line_reader
from infrablend.formats.records import Findings
from tests.samples import picture


def stated(line: str, size_wh: tuple[int, int]) -> Stated:
    """A line of four numbers is a fox; a dash is nothing, anything else a fault."""
    words = line.split()
    if line == "-":
        return None
    return Instance("fox", np.array([float(w) for w in words])) if len(words) == 4 else Fault("bad", line, "numbers")


def test_entries_become_objects_or_problems_and_are_counted(tmp_path: Path) -> None:
    found = Findings(tmp_path)
    entries = [(f"line {n}", stated(s, (64, 48))) for n, s in enumerate(("1 2 9 8", "-", "x", "-4 2 9 8", "9 9 9 9"))]
    assert [o.box_xyxy.tolist() for o in checked(found, entries, (64, 48))] == [[1, 2, 9, 8], [0, 2, 9, 8]]
    assert [(p.where, p.code) for p in found.problems] == [
        ("line 2", "bad"), ("line 3", "box-clipped"), ("line 4", "box-empty"),
    ]  # fmt: skip
    assert found.rows("read", "box-clipped", "box-empty") == {"read": 2, "box-clipped": 1, "box-empty": 1}
    quiet = Findings(tmp_path)
    checked(quiet, entries, (64, 48), silent=("box-clipped",))
    assert [p.code for p in quiet.problems] == ["bad", "box-empty"] and quiet.counts["box-clipped"] == 1


def test_pictures_without_a_label_file_are_kept_as_unlabelled_or_left_out(tmp_path: Path) -> None:
    pictures = {name: picture(tmp_path / name, k) for k, name in enumerate(("a.png", "b.png", "c.png"))}
    (tmp_path / "a.txt").write_text("1 2 9 8\n\n")
    (tmp_path / "b.txt").write_bytes(b"\xff")
    folder = LabelledFolder(
        where="here",
        pictures=pictures,
        label_of=lambda p: if_file(p.with_suffix(".txt")),
        missing="no text",
        is_visible=lambda stem: stem == "c",
    )
    found = Findings(tmp_path)
    kept = list(folder.read(found, "keep", line_reader("lines", stated)))
    assert [(r.name, len(r.instances), r.extra) for r in kept] == [
        ("a.png", 1, {}), ("c.png", 0, {"modality": "visible", "labelled": False}),
    ]  # fmt: skip
    assert [p.code for p in found.problems] == ["annotation-unreadable", "label-missing"]
    assert found.rows("labelled", "objects", "unlabelled") == {"labelled": 1, "objects": 1, "unlabelled": 1}
    assert [r.name for r in folder.read(Findings(tmp_path), "drop", line_reader("lines", stated))] == ["a.png"]
