"""What a process does to itself before it reads a hostile file: it gives up most of its rights, for good.

It limits its memory and processes, and on Linux 5.13 or newer, Landlock leaves it only its own folder and, for reading,
the folders of Python, of its packages and of the system's libraries. It can then read no other file, open no network
connection (Linux 6.7), and write nowhere else. Only the standard library is imported before that.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import importlib.util
import json
import os
import resource
import signal
import site
import sys
import traceback
from pathlib import Path

from infrablend.core.landlock import CREATE_RULESET, landlock_version

# Exit code of a process that cannot import the function.
NO_START = 97

_PR_SET_PDEATHSIG, _PR_SET_NO_NEW_PRIVS = 1, 38
# These system calls have the same numbers on every architecture.
_ADD_RULE, _RESTRICT_SELF = 445, 446
_RULE_PATH_BENEATH = 1
_EXECUTE, _WRITE_FILE, _READ_FILE, _READ_DIR = 1 << 0, 1 << 1, 1 << 2, 1 << 3
# Rights over files per version of Landlock: 1 has 13, 2 adds links between folders, 3 truncation, 5 device commands.
_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}
_FILE_RIGHTS = _EXECUTE | _WRITE_FILE | _READ_FILE | 1 << 14 | 1 << 15
_TCP = 0b11
_SCOPES = 0b11  # abstract sockets and signals

# Libraries, and what they read while they start. Nothing of a user, no passwords, no settings of the machine.
_SYSTEM = (
    "/usr", "/lib", "/lib32", "/lib64", "/libx32", "/opt", "/nix/store", "/gnu/store",
    "/etc/ld.so.cache", "/etc/ld.so.conf", "/etc/ld.so.conf.d",
    "/etc/localtime", "/proc/self", "/proc/cpuinfo", "/proc/meminfo", "/proc/stat",
    "/sys/devices/system", "/dev/null", "/dev/zero", "/dev/random", "/dev/urandom",
)  # fmt: skip
_WRITABLE_DEVICES = ("/dev/null",)


def main(function: str, folder: str, parent_pid: int, memory_bytes: int) -> None:
    """Confine this process to `folder`, call `function` (`module:name`) with its path, and end without any clean-up."""
    _die_with_parent(parent_pid)
    _limit(memory_bytes)
    confined = confine(Path(folder))
    os.chdir(folder)
    module, _, name = function.partition(":")
    try:
        work = getattr(importlib.import_module(module), name)
    except Exception:
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(NO_START)
    work(folder)
    Path(folder, "done.json").write_text(json.dumps({"landlock": confined}), "utf-8")
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # Blender may hang or crash while it ends


def confine(folder: Path) -> int:
    """Give up access to all files except `folder` and libraries; return the version of Landlock, 0 if there is none."""
    version = landlock_version()
    if not version:
        return 0
    libc = _libc()
    rights = (1 << _RIGHTS[min(version, max(_RIGHTS))]) - 1
    # The kernel accepts a shorter structure from callers that know fewer fields.
    fields = [rights, *([_TCP] if version >= 4 else []), *([_SCOPES] if version >= 6 else [])]
    attributes = (ctypes.c_uint64 * len(fields))(*fields)
    ruleset = libc.syscall(CREATE_RULESET, attributes, ctypes.c_size_t(ctypes.sizeof(attributes)), 0)
    if ruleset < 0:
        return 0
    reading = _EXECUTE | _READ_FILE | _READ_DIR
    _allow(libc, ruleset, str(folder), rights)
    for path in _libraries():
        _allow(libc, ruleset, path, reading)
    for path in _WRITABLE_DEVICES:
        _allow(libc, ruleset, path, _READ_FILE | _WRITE_FILE)
    libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    done = libc.syscall(_RESTRICT_SELF, ruleset, 0)
    os.close(ruleset)
    return version if done == 0 else 0


class _PathBeneath(ctypes.Structure):
    _pack_ = 1
    _fields_ = (("rights", ctypes.c_uint64), ("folder", ctypes.c_int32))


def _allow(libc: ctypes.CDLL, ruleset: int, path: str, rights: int) -> None:
    try:
        handle = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:  # not on this machine
        return
    try:
        if not Path(path).is_dir():
            rights &= _FILE_RIGHTS
        rule = _PathBeneath(rights, handle)
        libc.syscall(_ADD_RULE, ruleset, _RULE_PATH_BENEATH, ctypes.byref(rule), 0)
    finally:
        os.close(handle)


def _libraries() -> list[str]:
    """Return the folders of Python, of its packages and of the system's libraries."""
    found = {
        *_SYSTEM,
        sys.prefix,
        sys.base_prefix,
        sys.exec_prefix,
        *site.getsitepackages(),
        site.getusersitepackages(),
    }
    for name in ("infrablend", "bpy", "numpy", "psutil", "zstandard"):
        spec = importlib.util.find_spec(name)
        found |= {str(Path(p)) for p in (spec.submodule_search_locations or ())} if spec else set()
    found |= {p for p in sys.path if any(Path(p or ".").glob("*.dist-info"))}
    found |= {p for p in os.environ.get("LD_LIBRARY_PATH", "").split(":") if p}
    found.discard("/")
    return sorted({os.path.realpath(p) for p in found} | found)


def _limit(memory_bytes: int) -> None:
    """Limit memory, open files and the size of written files; the parent watches memory more closely."""
    for what, most in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_DATA, memory_bytes),
        (resource.RLIMIT_FSIZE, memory_bytes),
        (resource.RLIMIT_NOFILE, 512),
    ):
        _, hard = resource.getrlimit(what)
        limit = most if hard == resource.RLIM_INFINITY else min(most, hard)
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(what, (limit, limit))


def _die_with_parent(parent_pid: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        _libc().prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent_pid:
            os._exit(1)


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
