"""Windows' rules, as far as Linux can keep them, for a Python that has this folder on its path, and for its children.

The package does without what Windows lacks: modules, functions of `os` and `signal`, arguments of
`subprocess`. Below the folder that `WINDOWS_RULES` names, files follow Windows' rules for everybody:

* no links of either kind;
* no names with `<>:"|?*`, of devices, or with a dot or blank at the end; names that differ in case alone are one;
* no file that is open or mapped in this process is replaced, renamed or removed, nor a folder with one in it;
* a rename does not replace a file, and folders cannot be opened;
* lines of text end with a carriage return and a newline unless the caller says how, and text is in cp1252;
* temporary files have names.

What cannot be shown here: backslashes, drives, console signals, files that other processes have open, and `LockFileEx`,
in whose place filelock calls `flock`: both end with their process.
"""

# Paths are texts here: functions of `pathlib` would call what is replaced.
# ruff: noqa: PTH100, PTH112, PTH115, PTH208

from __future__ import annotations

import builtins
import errno
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import types
from typing import Any

ROOT = os.path.realpath(os.environ["WINDOWS_RULES"])
PACKAGE = "infrablend"
NO_MODULES = {"fcntl", "resource", "pwd", "grp", "termios", "pty", "tty"}
ABSENT = {
    "os": {
        *("fork", "forkpty", "getuid", "geteuid", "getgid", "getpgid", "getpgrp", "killpg", "setsid", "setpgid"),
        *("chown", "statvfs", "pread", "pwrite", "preadv", "pwritev", "set_blocking", "sysconf", "uname"),
        *(
            "mkfifo",
            "fchmod",
            "sched_getaffinity",
            "sched_setaffinity",
            "posix_fadvise",
            "sendfile",
            "nice",
            "getloadavg",
            "WNOHANG",
        ),
        *("O_DIRECTORY", "O_NONBLOCK", "O_CLOEXEC", "O_NOFOLLOW", "O_SYNC", "O_TMPFILE"),
    },
    "signal": {
        *("SIGKILL", "SIGHUP", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGCHLD", "SIGPIPE", "alarm", "setitimer", "pause"),
    },
}
DEVICE = re.compile(r"(con|prn|aux|nul|(com|lpt)[0-9])(\..*)?", re.IGNORECASE)

_import = builtins.__import__
_busy = threading.local()


class Reduced(types.ModuleType):
    """A module without what Windows does not have."""

    def __init__(self, whole: types.ModuleType) -> None:
        super().__init__(whole.__name__)
        self.__dict__["_whole"] = whole

    def __getattr__(self, name: str) -> Any:
        if name in ABSENT[self.__name__]:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r} (Windows' rules)")
        return getattr(self._whole, name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self._whole, name, value)

    def __dir__(self) -> list[str]:
        return [name for name in dir(self._whole) if name not in ABSENT[self.__name__]]


def import_reduced(name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0) -> Any:
    """Import for the package: nothing that Windows does not have."""
    caller = str((globals or {}).get("__name__", "")).partition(".")[0]
    if level or caller != PACKAGE:
        return _import(name, globals, locals, fromlist, level)
    if name in NO_MODULES:
        raise ModuleNotFoundError(f"No module named {name!r} (Windows' rules)", name=name)
    found = _import(name, globals, locals, fromlist, level)
    if name in ABSENT and isinstance(found, types.ModuleType):
        return REDUCED[name]
    return found


def is_ruled(path: object) -> bool:
    """Whether a path is below the folder with Windows' rules."""
    if not isinstance(path, str | bytes | os.PathLike):
        return False
    return os.path.abspath(os.fsdecode(path)).startswith(ROOT + os.sep)


def require_name(path: object) -> None:
    """Check the name of a file or folder that is made."""
    if not is_ruled(path):
        return
    folder, name = os.path.split(os.path.abspath(os.fsdecode(path)))  # type: ignore[arg-type]
    if re.search('[<>:"|?*\x00-\x1f]|[. ]$', name) or DEVICE.fullmatch(name):
        raise OSError(errno.EINVAL, "no name on Windows", path)
    for there in os.listdir(folder) if os.path.isdir(folder) else ():
        if there != name and there.casefold() == name.casefold():
            raise FileExistsError(errno.EEXIST, f"is {there} on Windows", path)


def require_closed(path: object) -> None:
    """Check that this process has neither a file nor, for a folder, anything in it open or mapped."""
    if not is_ruled(path) or os.fsdecode(path).endswith(".lock"):  # type: ignore[arg-type]
        return
    whole = os.path.abspath(os.fsdecode(path))  # type: ignore[arg-type]
    held = []
    for number in os.listdir("/proc/self/fd"):
        try:
            held.append(os.readlink(f"/proc/self/fd/{number}"))
        except OSError:
            continue
    with _open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:
        held += [line.split(maxsplit=5)[5].rstrip("\n") for line in maps if ROOT in line]
    for file in held:
        if file == whole or file.startswith(whole + os.sep):
            raise PermissionError(errno.EACCES, f"{file} is open, as Windows says of", path)


def audit(event: str, arguments: tuple[Any, ...]) -> None:
    """Keep the rules for files."""
    if event not in ("open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.link", "os.symlink", "os.truncate"):
        return
    if getattr(_busy, "now", False):
        return
    _busy.now = True
    try:
        if event in ("os.link", "os.symlink") and is_ruled(arguments[1]):
            raise OSError(errno.EPERM, "no links on Windows", arguments[1])
        if event == "os.mkdir" or (event == "open" and (arguments[2] or 0) & os.O_CREAT):
            require_name(arguments[0])
        elif event == "os.rename":
            require_name(arguments[1])
            require_closed(arguments[0])
            require_closed(arguments[1])
        elif event in ("os.remove", "os.rmdir"):
            require_closed(arguments[0])
    finally:
        _busy.now = False


_open, _os_open, _rename, _replace = io.open, os.open, os.rename, os.replace


def open_text(
    file: Any,
    mode: str = "r",
    buffering: int = -1,
    encoding: str | None = None,
    errors: str | None = None,
    newline: str | None = None,
    *more: Any,
    **rest: Any,
) -> Any:
    """Open as Windows does: its newlines and its encoding, where the caller says nothing of them."""
    if "b" not in mode and is_ruled(file):
        encoding = "cp1252" if encoding in (None, "locale") else encoding
        newline = "\r\n" if newline is None and set(mode) & set("wax") else newline
    return _open(file, mode, buffering, encoding, errors, newline, *more, **rest)


def open_number(path: Any, flags: int, *arguments: Any, **rest: Any) -> int:
    """Open files, and no folders."""
    if is_ruled(path) and os.path.isdir(path):
        raise PermissionError(errno.EACCES, "no folder can be opened on Windows", path)
    return _os_open(path, flags, *arguments, **rest)


def rename(source: Any, target: Any, **rest: Any) -> None:
    """Rename, if nothing has the new name."""
    if is_ruled(target) and os.path.lexists(target):
        raise FileExistsError(errno.EEXIST, "is there, and no rename replaces it on Windows", target)
    _rename(source, target, **rest)


def replace(source: Any, target: Any, **rest: Any) -> None:
    """Replace a file; no folder."""
    if is_ruled(target) and os.path.isdir(target):
        raise PermissionError(errno.EACCES, "no folder is replaced on Windows", target)
    _replace(source, target, **rest)


class Popen(subprocess.Popen):  # type: ignore[type-arg]
    """Refuses what Windows' `Popen` refuses."""

    def __init__(self, *arguments: Any, **rest: Any) -> None:
        if rest.get("pass_fds") or rest.get("preexec_fn") or rest.get("process_group") is not None:
            raise ValueError("no pass_fds, preexec_fn and process_group on Windows")
        super().__init__(*arguments, **rest)


REDUCED = {"os": Reduced(os), "signal": Reduced(signal)}
builtins.__import__ = import_reduced
sys.addaudithook(audit)
builtins.open = io.open = open_text
os.open, os.rename, os.replace = open_number, rename, replace
subprocess.Popen = Popen  # type: ignore[misc]
tempfile.TemporaryFile = tempfile.NamedTemporaryFile  # type: ignore[assignment]
shutil._use_fd_functions = False  # type: ignore[attr-defined] # it opens folders
