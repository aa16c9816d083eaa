"""Rows, views and verdicts of the studio, without a browser."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from infrablend.core.frame_row import FrameRow, InsertRow
from infrablend.core.run_folder import RunFolder
from infrablend.errors import DatasetError, OutputError, Problem
from infrablend.pipeline.runs.review_file import Verdict, read_verdicts
from infrablend.studio.frame_index import View
from infrablend.studio.opened_run import OpenedRun, RowReading
from infrablend.studio.verdicts import Review
from tests.studio_runs import frame_record, write_run, write_sequence


def insert(category: str, size_px: float, visibility: float, contrast: float) -> InsertRow:
    return InsertRow(category, (0, 0, size_px, 3), visibility=visibility, signed_grey=-contrast)


ROWS = (
    FrameRow("test/a", inserts=(insert("drone", 40, 1, 9),), time_of_day="day"),
    FrameRow("test/b", warnings=(Problem("a.png", "low", "low"),)),
    FrameRow("train/c", inserts=(insert("drone", 12, 0.5, 30), insert("car", 20, 1, 31)), time_of_day="night"),
)


def shown(verdicts: dict[str, str] | None = None, **fields: object) -> list[str]:
    return [ROWS[n].id[-1] for n in View(**fields).apply(ROWS, verdicts or {})]


def test_frames_are_sorted_and_those_without_the_value_come_last() -> None:
    assert shown() == ["a", "b", "c"]
    assert shown(descending=True) == ["c", "b", "a"]
    assert shown(sort="size_px") == ["c", "a", "b"]
    assert shown(sort="size_px", descending=True) == ["a", "c", "b"]
    assert shown(sort="warnings", descending=True) == ["b", "a", "c"]


def test_frames_are_filtered() -> None:
    assert shown(category="car") == ["c"]
    assert shown(category="none") == ["b"]
    assert shown(time_of_day="unknown") == ["b"]
    assert shown(warned=True) == ["b"]
    assert shown(text="TRAIN") == ["c"]
    assert shown(limits=(("contrast", 10, None),)) == ["c"]
    assert shown(limits=(("contrast", None, 10),)) == ["a"]
    assert shown({"test/a": "reject"}, verdict="reject") == ["a"]
    assert shown({"test/a": "reject"}, verdict="open") == ["b", "c"]


def test_a_view_survives_its_address() -> None:
    view = View("contrast", True, "drone", "day", "open", True, "0_60", (("size_px", 3.5, None),))
    assert View.from_query(view.to_query()) == view
    assert View.from_query({"sort": "evil", "size_px_min": "nan", "other": "1"}).sort == "id"


def test_rows_are_read_from_the_ledger(tmp_path: Path) -> None:
    names = [f"test/{n}_c0" for n in "abc"]
    write_run(tmp_path, {n: frame_record(n) for n in names})
    reading = RowReading(RunFolder(tmp_path))
    assert reading.ids == names
    a, *others = reading.wait()
    assert (a.classes, a.size_px, a.contrast, a.pitch_deg) == (["drone"], 10, 12, 60)
    assert [row.id for row in others] == names[1:]
    assert reading.is_complete and reading.count == 3


def test_the_frames_of_a_sequence_are_in_order_with_the_tracks_in_them(tmp_path: Path) -> None:
    opened = OpenedRun(write_sequence(tmp_path / "run"))
    assert opened.has_sequences
    (found,) = opened.sequences
    assert (found.name, found.frames, found.times_s[:3]) == ("test/s", tuple(range(24)), (0, 0.04, 0.08))
    drone, original = found.tracks
    assert [(t.category, t.id, t.inserted) for t in found.tracks] == [("drone", "2", True), ("drone", "0", False)]
    assert [at for at, _ in drone.boxes] == [k for k in range(24) if not 10 <= k < 14]
    assert drone.boxes[3] == (3, (8, 20, 14, 26)) and len(original.boxes) == 24


def test_frames_without_times_are_played_at_30_per_second_and_those_without_a_sequence_are_not(tmp_path: Path) -> None:
    run = write_sequence(tmp_path / "run", 4)
    table = run / "images/test/metadata.jsonl"
    rows = [json.loads(line) | {"time_s": None} for line in table.read_text().splitlines()]
    table.write_text("\n".join(json.dumps(row) for row in [{**rows[0], "sequence": ""}, *rows[1:]]))
    opened = OpenedRun(run)
    (found,) = opened.sequences
    assert found.frames == (1, 2, 3) and found.times_s == (0, 0.033333, 0.066667)
    plain = OpenedRun(write_run(tmp_path / "plain", {"test/a_c0": frame_record("test/a_c0")}))
    assert not plain.has_sequences and plain.sequences == []


def test_every_verdict_is_in_the_file_at_once_and_can_be_undone(tmp_path: Path) -> None:
    review = Review(tmp_path / "review.json")
    review.decide("test/a", Verdict("accept"))
    review.decide("test/a", Verdict("reject", "too dark"))
    review.decide("test/b", Verdict("accept"))
    assert read_verdicts(review.path) == {"test/a": Verdict("reject", "too dark"), "test/b": Verdict("accept")}
    assert [review.undo(), review.undo()] == ["test/b", "test/a"]
    assert read_verdicts(review.path) == {"test/a": Verdict("accept")}
    assert [review.undo(), review.undo()] == ["test/a", None]
    assert read_verdicts(review.path) == {}


def test_verdicts_of_others_are_kept(tmp_path: Path) -> None:
    review = Review(tmp_path / "review.json")
    review.decide("test/a", Verdict("accept"))
    review.path.write_text('{"frames": {"test/a": {"verdict": "reject"}, "test/z": {"verdict": "accept"}}}')
    assert review.words["test/z"] == "accept"
    assert review.undo() is None, "somebody else decided on this frame since"
    review.decide("test/b", Verdict("accept"))
    assert set(read_verdicts(review.path)) == {"test/a", "test/b", "test/z"}


def test_runs_that_cannot_be_opened_say_why(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="not the folder of a run"):
        OpenedRun(tmp_path)
    empty = write_run(tmp_path / "empty", {})
    with pytest.raises(DatasetError, match="without frames"):
        OpenedRun(empty)
    run = write_run(tmp_path / "run", {"test/a_c0": frame_record("test/a_c0")})
    (run / "review.json").write_text("[]")
    with pytest.raises(OutputError, match="as a review"):
        OpenedRun(run)
    (run / "review.json").unlink()
    opened = OpenedRun(run)
    with pytest.raises(DatasetError, match="no such frame"):
        opened.row(1)
    assert opened.row(0).id == "test/a_c0"


def test_a_run_that_is_written_again_is_read_again(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", {"test/a_c0": frame_record("test/a_c0")})
    opened = OpenedRun(run)
    shutil.rmtree(run)
    write_run(run, {"test/b_c0": frame_record("test/b_c0")})
    os.utime(run / "run.json", (1, 1))
    assert opened.row(0).id == "test/b_c0"
    shutil.rmtree(run)
    with pytest.raises(DatasetError, match="its frames are gone"):
        opened.row(0)


def test_thumbnails_are_made_once_and_nothing_outside_the_run_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("INFRABLEND_CACHE", str(tmp_path / "cache"))
    frames = {f"test/{n}_c0": frame_record(f"test/{n}_c0") for n in "ab"}
    opened = OpenedRun(write_run(tmp_path / "run", frames))
    row = opened.row(0)
    first = opened.thumbnails.get(row)
    assert first[:2] == b"\xff\xd8"
    (tmp_path / "run/images" / row.image).unlink()
    assert opened.thumbnails.get(row) == first, "from the cache"
    assert not list((tmp_path / "run").rglob(".*")), "the run's folder has nothing of the studio"
    secret = tmp_path / "secret.jpg"
    secret.write_bytes((tmp_path / "run/images" / opened.row(1).image).read_bytes())
    (tmp_path / "run/images" / opened.row(1).image).unlink()
    (tmp_path / "run/images" / opened.row(1).image).symlink_to(secret)
    with pytest.raises(DatasetError, match="link out of"):
        opened.thumbnails.get(opened.row(1))
