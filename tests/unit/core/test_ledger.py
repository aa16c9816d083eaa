"""Tests of the ledger of a run: rows, damage, readers beside a writer, and kills."""

from __future__ import annotations

import os
import random
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from infrablend.cli.exits import ENVIRONMENT, exit_code
from infrablend.core.frame_row import FrameRecord
from infrablend.core.ledger import LEDGER, DoneFrame, KnownBackground, Ledger
from infrablend.core.tasks import Failure
from infrablend.errors import OutputError
from tests.run_files import edit_ledger, ledger_rows


def record(frame_id: str, **changes: Any) -> FrameRecord:
    return FrameRecord(frame_id, f"{frame_id}.png", "ab", {"id": "a"}, None, None, (0,), (), **changes)


def add(ledger: Ledger, *frame_ids: str, inserted: int = 1) -> None:
    for frame_id in frame_ids:
        ledger.add(frame_id, DoneFrame(f"{frame_id}.png", 7, "ab", inserted), record(frame_id).to_text())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with Ledger.create(tmp_path, {"seed": 3}) as ledger:
        add(ledger, "test/b", "test/a")
        ledger.add_failure("test/c", Failure("error", "RenderError", "no light", traceback="Traceback"))
    return tmp_path


def test_frames_failures_and_the_run_are_read_back(folder: Path) -> None:
    with Ledger.open(folder) as ledger:
        assert ledger.read_run() == {"seed": 3}
        assert ledger.frame_ids() == ["test/a", "test/b"]
        assert ledger.done()["test/a"] == DoneFrame("test/a.png", 7, "ab", 1)
        assert [r.frame_id for r in ledger.records()] == ["test/a", "test/b"]
        assert ledger.record("test/b").to_json() == record("test/b").to_json()
        (failure,) = ledger.failures().values()
        assert (failure.message, failure.traceback) == ("no light", "Traceback")
        with pytest.raises(KeyError):
            ledger.record("test/c")


def test_a_failed_frame_is_replaced_by_the_finished_one(folder: Path) -> None:
    with Ledger.open(folder, write=True) as ledger:
        add(ledger, "test/c", inserted=4)
        assert ledger.failures() == {} and ledger.done()["test/c"].inserted == 4
        ledger.forget("test/c")
        assert "test/c" not in ledger.done()


def test_excluded_frames_keep_their_records(folder: Path) -> None:
    with Ledger.open(folder, write=True) as ledger:
        ledger.exclude({"test/a": "blurred", "test/z": "never made"})
        assert ledger.frame_ids() == ["test/b"]
        assert ledger.excluded() == {"test/a": "blurred", "test/z": "never made"}
        assert set(ledger.done()) == {"test/a", "test/b"}
        add(ledger, "test/a")  # made again, it stays left out
        assert ledger.excluded()["test/a"] == "blurred"
        ledger.exclude({})
        assert ledger.frame_ids() == ["test/a", "test/b"]


def test_backgrounds_and_exports(folder: Path) -> None:
    with Ledger.open(folder, write=True) as ledger:
        picture = folder / "x.png"
        for content, digest in ((b"12345", "cd"), (b"1234567", "ef")):
            picture.write_bytes(content)
            ledger.add_background("test/x", picture, digest)
        ledger.add_background("test/gone", folder / "gone.png", "00")
        assert ledger.backgrounds() == {"test/x": KnownBackground(7, picture.stat().st_mtime_ns, "ef")}
        for _ in range(2):
            ledger.write_exports([("yolo/b.txt", 2, "02"), ("coco/a.json", 1, "01")])
        assert list(ledger.exports()) == [("coco/a.json", 1, "01"), ("yolo/b.txt", 2, "02")]


def test_equal_runs_have_equal_rows_whatever_the_order(tmp_path: Path) -> None:
    for name, frames in (("a", "xyz"), ("b", "zxy")):
        (tmp_path / name).mkdir()
        with Ledger.create(tmp_path / name, {"seed": 0}) as ledger:
            add(ledger, *frames)
            add(ledger, frames[0])
    rows = [ledger_rows(tmp_path / name / LEDGER) for name in "ab"]
    assert rows[0] == rows[1] and len(rows[0]) == 6


@pytest.mark.parametrize("content", [b"no database" * 100, b"", None])
def test_a_damaged_ledger_says_what_to_do(folder: Path, content: bytes | None) -> None:
    whole = (folder / LEDGER).read_bytes()
    (folder / LEDGER).write_bytes(whole[: len(whole) // 3] if content is None else content)
    with pytest.raises(OutputError, match=r"run\.sqlite: .*[Mm]ake the run again"), Ledger.open(folder) as ledger:
        ledger.read_run()
        list(ledger.records())


def test_a_full_disk_is_the_fault_of_the_disk(folder: Path) -> None:
    with Ledger.open(folder, write=True) as ledger:
        ledger._db.execute("PRAGMA max_page_count = 20")
        with pytest.raises(OutputError, match=r"run\.sqlite: No space left on device") as caught:
            for n in range(2000):
                add(ledger, f"test/{n}")
    assert exit_code(caught.value) == ENVIRONMENT
    assert caught.value.problems[0].code == "disk-full"


def test_a_ledger_that_cannot_be_started_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Ledger, record: object) -> None:
        raise OutputError("no space left")

    monkeypatch.setattr(Ledger, "write_run", full)
    with pytest.raises(OutputError, match="no space left"):
        Ledger.create(tmp_path, {})
    assert list(tmp_path.iterdir()) == []


def test_a_kill_amid_a_commit_is_rolled_back_by_the_next_reader(folder: Path) -> None:
    child = os.fork()
    if not child:
        with Ledger.open(folder, write=True) as ledger:
            ledger._db.execute("PRAGMA cache_size = 5")  # so that pages are written before the commit
            add(ledger, *(f"test/{n}" for n in range(500)))
            os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    assert (folder / f"{LEDGER}-journal").stat().st_size > 0
    with Ledger.open(folder) as ledger:
        assert ledger.frame_ids() == ["test/a", "test/b"]


def test_a_damaged_record_is_named(folder: Path) -> None:
    edit_ledger(folder, "UPDATE records SET record = '[1]' WHERE frame_id = 'test/a'")
    with Ledger.open(folder) as ledger, pytest.raises(OutputError, match="the record of test/a is damaged"):
        list(ledger.records())


def test_another_version_and_other_folders_are_refused(folder: Path) -> None:
    edit_ledger(folder, "PRAGMA user_version = 99")
    with pytest.raises(OutputError, match="a ledger of version 99, expected 1"):
        Ledger.open(folder)
    other = folder / "other"
    other.mkdir()
    with pytest.raises(OutputError, match=r"no run\.sqlite; expected the folder of a run"):
        Ledger.open(other)
    (other / LEDGER).symlink_to(folder / LEDGER)
    with pytest.raises(OutputError, match=r"no run\.sqlite"):
        Ledger.open(other)


def test_a_ledger_in_a_folder_that_cannot_be_written_is_read(folder: Path) -> None:
    (folder / LEDGER).chmod(0o444)
    folder.chmod(0o555)
    try:
        with Ledger.open(folder) as ledger:
            assert ledger.frame_ids() == ["test/a", "test/b"]
            with pytest.raises(OutputError, match="readonly"):
                ledger.write_run({})
    finally:
        folder.chmod(0o755)


def test_two_readers_see_what_the_writer_has_committed(folder: Path) -> None:
    with Ledger.open(folder) as one, Ledger.open(folder) as two, Ledger.open(folder, write=True) as writer:
        add(writer, "test/d")
        assert len(one.frame_ids()) == len(two.frame_ids()) == 2
        writer.commit()
        assert len(one.frame_ids()) == len(two.frame_ids()) == 3


WRITER = """
import sys
from pathlib import Path
from infrablend.core.ledger import DoneFrame, KnownBackground, Ledger
with Ledger.open(Path(sys.argv[1]), write=True) as ledger:
    for n in range(10 ** 9):
        ledger.add(f"train/{n}", DoneFrame("a.png", 1, "", 1), "{}" + " " * 3000)
        if n % 7 == 0:
            ledger.commit()
            print(n, flush=True)
"""


def test_kills_lose_no_committed_frame(folder: Path) -> None:
    draw = random.Random(4)
    for _ in range(20):
        command = [sys.executable, "-c", WRITER, str(folder)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            stop, committed = draw.randrange(200), -1
            for line in child.stdout:
                committed = int(line)
                if committed >= stop:
                    os.kill(child.pid, signal.SIGKILL)
        with Ledger.open(folder, write=True) as ledger:  # rolls back what was not committed
            frames = ledger.done()
            assert {f"train/{n}" for n in range(committed + 1)} <= set(frames)
            assert all(ledger.record_text(frame_id) for frame_id in frames)
        database = sqlite3.connect(folder / LEDGER)
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        database.close()


def test_equal_records_have_equal_texts() -> None:
    text = record("test/a", facts={"b": 1, "a": 2}).to_text()
    assert text == record("test/a", facts={"a": 2, "b": 1}).to_text()
    assert FrameRecord.from_text(text).to_text() == text
