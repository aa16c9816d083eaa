"""What differs between operating systems: locks, the end of processes, their memory, processors, folders in memory.

Other modules do not ask which system this is. Blender's side (`infrablend.blender`) is apart: it runs on Linux only.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import logging
import os
import platform
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil

log = logging.getLogger(__name__)

_PROCESSOR = Path("/proc/cpuinfo")
_PR_SET_PDEATHSIG = 1
_CHECK_EVERY_S = 1.0

CHILD_BYTES: dict[int, int] = {}
"""Resident memory that children of this process last reported, by process number."""

READ_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)
"""Flags to open a file for reading, without waiting where it is a pipe."""

STOP_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGBREAK") if hasattr(signal, name))
"""Signals that ask a command to stop; `ask_to_stop` sends SIGBREAK on Windows and SIGTERM elsewhere."""

IN_BACKGROUND: dict[str, Any] = {"start_new_session": True}
"""Arguments of `subprocess.Popen` for a process that Ctrl-C in this terminal does not reach."""
if sys.platform == "win32":
    IN_BACKGROUND = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}

# Errors of file systems that have no locks, such as NFS without its lock daemon.
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL}

_core_locks = contextlib.ExitStack()


# ---- locks and files


@contextlib.contextmanager
def hold(path: Path) -> Iterator[None]:
    """Hold a lock, which is a file, until the end of the block; it ends with its process, however that ends.

    The file is removed with the block; a killed process leaves it, and the next one takes it over. Where the file
    system has no locks, a warning is logged.

    Raises:
        BlockingIOError: Another process, or another block of this one, holds the lock.
        OSError: The file cannot be made.
    """
    import filelock  # takes as long to load as `infrablend --help`'s own modules

    # Not of one thread: whoever ends the block may be another one than who began it.
    lock = filelock.FileLock(path, timeout=0, thread_local=False)
    try:
        lock.acquire()
    except filelock.Timeout as error:
        raise BlockingIOError(errno.EWOULDBLOCK, "held by another process", str(path)) from error
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        log.warning("%s: cannot be locked (%s); do not let two commands write here", path, error)
        yield
        return
    try:
        yield
    finally:
        if isinstance(lock, filelock.UnixFileLock):  # the others remove it themselves
            with contextlib.suppress(OSError):
                path.unlink()  # while it is held: whoever has just opened it sees that it is gone
        lock.release()


def is_held(path: Path) -> bool:
    """Return whether somebody holds a lock of `hold`, as far as the file system has locks."""
    if not path.exists():
        return False
    try:
        with hold(path):
            return False
    except BlockingIOError:
        return True
    except OSError:
        return False


def flush_file(path: Path) -> None:
    """Flush a file to disk, or the renames in a folder where the system can do that."""
    try:
        handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    except PermissionError:  # Windows opens no folders
        if path.is_dir():
            return
        raise
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # not every file system can, least of all for folders
            raise
    finally:
        os.close(handle)


def memory_folder() -> Path | None:
    """Return a folder that is in memory and may be written, or None."""
    folder = Path("/dev/shm")
    return folder if os.access(folder, os.W_OK) else None


def user_id() -> str:
    """Return a short text that differs between the users of this machine."""
    return str(os.getuid()) if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")


def is_own(path: Path) -> bool:
    """Return whether a file or folder, no link, belongs to this user; True where files say nothing of that."""
    return not path.is_symlink() and (not hasattr(os, "getuid") or path.stat().st_uid == os.getuid())


# ---- processes


def resident_bytes() -> int:
    """Return the resident memory of this process and of its children in `CHILD_BYTES`."""
    return int(psutil.Process().memory_info().rss) + sum(CHILD_BYTES.values())


def describe_exit(code: int) -> str:
    """Return how a process ended, by the return code of `subprocess`."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = "unknown"
    hint = " (often: out of memory)" if name == "SIGKILL" else ""
    return f"was ended by signal {-code} {name}{hint}"


def die_with_parent(parent_pid: int) -> None:
    """Ask Linux to kill this process when its parent ends, even while C code holds Python's lock.

    On other systems, call `watch_parent` as well.
    """
    if sys.platform != "linux":
        return
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent_pid:  # the parent ended before the request
        os._exit(1)


def watch_parent(parent_pid: int) -> None:
    """Start a thread that ends this process within a second or so after its parent."""
    try:
        parent = psutil.Process(parent_pid)
    except psutil.NoSuchProcess:
        os._exit(1)

    def watch() -> None:
        while parent.is_running() and parent.status() != psutil.STATUS_ZOMBIE:
            time.sleep(_CHECK_EVERY_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def ask_to_stop(process: subprocess.Popen[Any]) -> None:
    """Ask a process that was started with `IN_BACKGROUND` to stop, as Ctrl-C in its terminal does."""
    if sys.platform == "win32":
        process.send_signal(signal.CTRL_BREAK_EVENT)
    else:
        process.terminate()  # where a studio in the background has children that ignore SIGINT, too


def kill_tree(process: subprocess.Popen[Any]) -> None:
    """Kill a process that leads a group of its own, and what it has started; safe in a signal handler."""
    if process.poll() is not None:
        return
    with contextlib.suppress(ProcessLookupError, PermissionError, psutil.Error):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, getattr(signal, "SIGKILL", signal.SIGTERM))
        else:
            for child in psutil.Process(process.pid).children(recursive=True):
                child.kill()
    process.kill()


def flush_c_output() -> None:
    """Write what C libraries have printed and still hold; nothing on Windows, whose libraries each have a C library."""
    if sys.platform != "win32":
        ctypes.CDLL(None).fflush(None)


# ---- processors


def processor_name() -> str:
    """Return the model name of the processor, or its architecture where the system does not report a name."""
    for line in read_system_file(_PROCESSOR).splitlines():
        if line.startswith("model name"):
            return " ".join(line.partition(":")[2].split())
    return platform.processor() or platform.machine()


def has_matrix_units() -> bool:
    """Return whether the processor has matrix units for bfloat16 (AMX), which double the speed of a training."""
    return "amx_tile" in read_system_file(_PROCESSOR)


def read_system_file(path: Path) -> str:
    """Return the text of a file of facts, such as those in /proc; empty where the system has none."""
    with contextlib.suppress(OSError, UnicodeDecodeError):
        return path.read_text("utf-8")
    return ""


def usable_processors() -> list[int]:
    """Return the numbers of the processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def take_core() -> None:
    """Pin this process to a processor core that no other worker on this machine uses; where the system can do that.

    Measured: with one render thread, the main thread of Cycles waits by spinning and burns as much processor time as
    the render itself; on a single core it cannot. File locks, which end with the process, assign the cores. Without a
    free core (more workers than cores) nothing is pinned.
    """
    if not hasattr(os, "sched_setaffinity"):
        return
    folder = memory_folder() or Path(tempfile.gettempdir())
    for core in usable_processors():
        try:
            _core_locks.enter_context(hold(folder / f"infrablend_core_{core}_{user_id()}.lock"))
        except BlockingIOError:
            continue
        except OSError:
            return
        os.sched_setaffinity(0, {core})
        return
    log.info("no free core to pin this worker to")
