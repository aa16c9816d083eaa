"""Locks, the end of processes, files and users, also where functions of the operating system are missing."""

import os
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from infrablend.core import operating_system
from infrablend.core.operating_system import (
    IN_BACKGROUND,
    ask_to_stop,
    describe_exit,
    flush_file,
    hold,
    is_held,
    is_own,
    kill_tree,
    user_id,
)

WAIT_S = 120
HOLDER = (
    "import sys; from pathlib import Path; from infrablend.core.operating_system import hold\n"
    "with hold(Path(sys.argv[1])): print('held', flush=True); sys.stdin.readline()"
)


def start_holder(path: Path) -> subprocess.Popen[str]:
    words = [sys.executable, "-c", HOLDER, str(path)]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    return process


def test_a_lock_is_held_by_one_and_leaves_no_file(tmp_path: Path) -> None:
    lock = tmp_path / "a.lock"
    assert not is_held(lock)
    with hold(lock):
        assert is_held(lock)
        with pytest.raises(BlockingIOError), hold(lock):
            pass
    assert not is_held(lock)
    assert list(tmp_path.iterdir()) == []


def test_a_lock_ends_with_its_process(tmp_path: Path) -> None:
    lock = tmp_path / "a.lock"
    with start_holder(lock) as holder:
        assert is_held(lock)
        with pytest.raises(BlockingIOError), hold(lock):
            pass
        holder.kill()
    assert lock.exists() and not is_held(lock)
    with hold(lock):
        pass
    assert list(tmp_path.iterdir()) == []


# A process that starts another one, says its number and waits.
PARENT = (
    "import subprocess, sys, time\n"
    "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(3600)'])\n"
    "print(child.pid, flush=True); time.sleep(3600)"
)


@pytest.mark.parametrize("groups", [True, False])
def test_a_process_is_killed_with_those_that_it_started(groups: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not groups:
        monkeypatch.delattr(os, "killpg")
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True, **IN_BACKGROUND) as parent:
        child = psutil.Process(int(parent.stdout.readline()))
        kill_tree(parent)
    assert describe_exit(parent.returncode) == "was ended by signal 9 SIGKILL (often: out of memory)"
    assert not psutil.wait_procs([child], timeout=WAIT_S)[1]
    kill_tree(parent)  # again: nothing is left to kill


def test_a_process_in_the_background_can_be_asked_to_stop() -> None:
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(3600)"], **IN_BACKGROUND) as process:
        ask_to_stop(process)
    assert describe_exit(process.returncode) == "was ended by signal 15 SIGTERM"
    assert describe_exit(3) == "ended with exit code 3"


def test_folders_are_flushed_where_they_can_be_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_bytes(b"x")
    flush_file(tmp_path)
    flush_file(tmp_path / "file")

    def refuse(path: object, flags: int) -> int:
        raise PermissionError(13, "denied", path)

    monkeypatch.setattr(operating_system.os, "open", refuse)
    flush_file(tmp_path)
    with pytest.raises(PermissionError):
        flush_file(tmp_path / "file")


def test_users_differ_by_name_where_they_have_no_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert user_id() == str(os.getuid()) and is_own(tmp_path)
    monkeypatch.delattr(os, "getuid")
    monkeypatch.setenv("USERNAME", "ada")
    assert user_id() == "ada" and is_own(tmp_path)
    (tmp_path / "link").symlink_to(tmp_path)
    assert not is_own(tmp_path / "link")
