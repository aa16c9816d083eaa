"""Tests of the workspace of an output folder: complete or not there, whatever happens."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import filelock
import pytest

from infrablend.core.workspace import CONTENTS, NOTE, is_being_written, partial_of, unfinished, workspace
from infrablend.errors import OutputError

RECORD = "thing.json"


def write(out: Path, text: str = "a", *, existing: str = "refuse", keep: bool = False, finish: bool = True) -> None:
    with workspace(out, "thing", RECORD, existing, keep=keep) as space:  # type: ignore[arg-type]
        (space.folder / "deep").mkdir(exist_ok=True)
        (space.folder / "deep" / "file.txt").write_text(text)
        if finish:
            space.finish({"fact": 1})


def names(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def test_a_folder_appears_whole(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    with workspace(out, "thing", RECORD) as space:
        (space.folder / "file.txt").write_text("x")
        assert not out.exists()
        assert space.folder == out.with_name(".out.partial")
        space.finish({"fact": 1})
        assert not out.exists()
    assert names(out) == ["file.txt", RECORD]
    record = json.loads((out / RECORD).read_text())
    assert record["fact"] == 1
    assert record["contents"] == {"names": ["file.txt", RECORD], "files": 2}
    assert sorted(p.name for p in out.parent.iterdir()) == ["out"]


@pytest.mark.parametrize(("keep", "written"), [(False, True), (True, True), (True, False)])
def test_a_failure_leaves_nothing_or_what_can_be_resumed(tmp_path: Path, keep: bool, written: bool) -> None:
    out = tmp_path / "out"
    with pytest.raises(RuntimeError), workspace(out, "thing", RECORD, keep=keep) as space:
        if written:
            (space.folder / "file.txt").write_text("x")
        raise RuntimeError
    assert [p.name for p in tmp_path.iterdir()] == ([partial_of(out).name] if keep and written else [])
    assert (unfinished(out) is not None) == (keep and written)


def test_resume_goes_on_with_what_was_left(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out, "first", keep=True, finish=False)
    with pytest.raises(OutputError, match=r"unfinished thing.*--resume"):
        write(out, keep=True)
    with workspace(out, "thing", RECORD, "resume", keep=True) as space:
        assert space.state == "started"
        assert (space.folder / "deep" / "file.txt").read_text() == "first"
        space.finish({})
    assert names(out) == ["deep/file.txt", RECORD]


@pytest.mark.parametrize("note", ['{"noun": "thing"}', "{"])  # the latter was killed at its note
def test_what_cannot_be_resumed_starts_again(tmp_path: Path, note: str) -> None:
    partial = partial_of(tmp_path / "out")
    partial.mkdir()
    (partial / NOTE).write_text(note)
    (partial / "old.txt").write_text("of a killed call")
    write(tmp_path / "out")
    assert names(tmp_path) == ["out/deep/file.txt", f"out/{RECORD}"]


def test_a_foreign_folder_with_the_name_of_a_workspace_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / ".out.partial").mkdir()
    (tmp_path / ".out.partial" / "mine.txt").write_text("x")
    with pytest.raises(OutputError, match=r"found mine\.txt"):
        write(tmp_path / "out", existing="overwrite")
    assert (tmp_path / ".out.partial" / "mine.txt").exists()


def test_results_are_refused_unless_asked_for(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out)
    with pytest.raises(OutputError, match=r"not empty \(found deep, thing\.json\).*--overwrite"):
        write(out, "b")
    assert (out / "deep" / "file.txt").read_text() == "a"


def test_overwrite_replaces_the_folder_as_a_whole(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out)
    with workspace(out, "thing", RECORD, "overwrite") as space:
        assert (out / RECORD).exists()  # until the new one is complete
        (space.folder / "new.txt").write_text("x")
        space.finish({})
    assert names(out) == ["new.txt", RECORD]
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_failed_overwrite_leaves_the_old_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out)
    before = (out / RECORD).read_bytes()
    write(out, "b", existing="overwrite", finish=False)
    assert (out / RECORD).read_bytes() == before
    assert (out / "deep" / "file.txt").read_text() == "a"


@pytest.mark.parametrize("added", ["mine.txt", "deep/mine.txt"])
def test_overwrite_refuses_what_somebody_added(tmp_path: Path, added: str) -> None:
    out = tmp_path / "out"
    write(out)
    (out / added).write_text("mine")
    with pytest.raises(OutputError, match=r"not part of the thing"):
        write(out, "b", existing="overwrite")
    assert (out / added).read_text() == "mine"


@pytest.mark.parametrize("contents", [{"names": [{}], "files": 2}, {"names": 5}, {"files": {}}])
def test_overwrite_refuses_a_record_that_does_not_say_what_was_written(tmp_path: Path, contents: object) -> None:
    out = tmp_path / "out"
    write(out)
    record = json.loads((out / RECORD).read_text())
    (out / RECORD).write_text(json.dumps({**record, CONTENTS: contents}))
    with pytest.raises(OutputError, match=r"not part of the thing"):
        write(out, "b", existing="overwrite")


@pytest.mark.parametrize("record", [None, "{}", '{"infrablend": "1"}', "no JSON"])
def test_overwrite_refuses_a_folder_of_others(tmp_path: Path, record: str | None) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "file.txt").write_text("x")
    if record is not None:
        (tmp_path / "out" / RECORD).write_text(record)
    with pytest.raises(OutputError, match="not a thing of InfraBlend"):
        write(tmp_path / "out", existing="overwrite")
    assert (tmp_path / "out" / "file.txt").exists()


def test_an_empty_folder_is_accepted(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    write(tmp_path / "out")
    assert names(tmp_path / "out") == ["deep/file.txt", RECORD]


def test_a_file_or_a_loose_link_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    (tmp_path / "link").symlink_to(tmp_path / "gone" / "deeper")
    with pytest.raises(OutputError, match="is a file"):
        write(tmp_path / "file")


def test_the_working_folder_is_filled_and_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    out.mkdir()
    monkeypatch.chdir(out)
    inode = out.stat().st_ino
    write(Path())
    assert names(out) == ["deep/file.txt", RECORD]
    write(Path(), "b", existing="overwrite")
    assert (out / "deep" / "file.txt").read_text() == "b"
    assert out.stat().st_ino == inode
    assert sorted(p.name for p in out.iterdir()) == ["deep", RECORD]


def test_a_workspace_in_the_folder_is_found_from_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    out.mkdir()
    with monkeypatch.context() as there:
        there.chdir(out)
        write(Path(), keep=True, finish=False)
    with workspace(out, "thing", RECORD, "resume", keep=True) as space:
        assert space.state == "started"
        space.finish({})
    assert names(out) == ["deep/file.txt", RECORD]


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize("fails_at", [1, 2, 3])
def test_a_call_that_was_killed_while_it_published_is_completed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, inside: bool, fails_at: int
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    if inside:
        monkeypatch.chdir(out)
    write(out)
    rename, calls = Path.rename, 0

    def kill(path: Path, target: Path) -> Path:
        nonlocal calls
        calls += 1
        if calls == fails_at:
            raise KeyboardInterrupt  # as abrupt as a kill: nothing below handles it
        return rename(path, target)

    with monkeypatch.context() as killed:
        killed.setattr(Path, "rename", kill)
        try:
            write(out, "b", existing="overwrite")
        except KeyboardInterrupt:
            assert unfinished(out) is not None
    with workspace(out, "thing", RECORD, "resume", keep=True) as space:
        assert space.state == "complete"
    assert names(out) == ["deep/file.txt", RECORD]
    assert (out / "deep" / "file.txt").read_text() == "b"
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_finished_folder_can_be_changed(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out, keep=True)
    with workspace(out, "thing", RECORD, "resume", keep=True) as space:
        assert space.folder == out
        space.reopen()
        assert not out.exists()
        (space.folder / "more.txt").write_text("x")
        assert is_being_written(out)
        space.finish({"fact": 2})
    assert json.loads((out / RECORD).read_text())["contents"]["files"] == 3
    assert names(out) == ["deep/file.txt", "more.txt", RECORD]


def test_a_note_that_a_kill_left_in_a_finished_folder_is_deleted(tmp_path: Path) -> None:
    out = tmp_path / "out"
    write(out)
    (out / NOTE).write_text("{}")
    with pytest.raises(OutputError, match="--overwrite"):
        write(out)
    assert names(out) == ["deep/file.txt", RECORD]


def test_two_processes_do_not_write_one_folder(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from infrablend.core.workspace import workspace\n"
        f"with workspace(Path({str(tmp_path / 'out')!r}), 'thing', {RECORD!r}):\n"
        "    print('ready', flush=True); sys.stdin.read()\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        assert is_being_written(tmp_path / "out")
        with pytest.raises(OutputError, match="another process is writing this thing"):
            write(tmp_path / "out")
    assert not is_being_written(tmp_path / "out")
    write(tmp_path / "out")


def test_a_file_system_without_locks_gives_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(lock: filelock.FileLock) -> None:
        raise OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP))

    monkeypatch.setattr(filelock.FileLock, "_acquire", refuse)
    write(tmp_path / "out")
    assert "cannot be locked" in caplog.text
    assert (tmp_path / "out" / RECORD).exists()
