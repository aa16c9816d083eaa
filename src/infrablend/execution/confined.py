"""Runs a function on a private folder in a confined process, with limits on time and memory.

Used for files that may be hostile. The process gets nothing but the folder, and returns nothing but files in it: no
objects are exchanged, since unpickling would let the process run code in its parent.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import psutil

from infrablend.execution.confinement import NO_START
from infrablend.execution.process_pool import describe_exit, module_path
from infrablend.execution.worker import ONE_THREAD

_BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from infrablend.execution.confinement import main; "
    "main(sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5]))"
)
_POLL_S = 0.02
_TAIL_BYTES = 4000
# Environment variables that the process needs; tokens and passwords are none of them.
_PASSED = {"PATH", "LANG", "TZ", "LD_LIBRARY_PATH"}

Ending = Literal["done", "no-start", "crash", "time", "memory"]


@dataclass(frozen=True)
class ConfinedLimits:
    """Limits of a confined process.

    Attributes:
        cpu_seconds: Processor time, which does not depend on the load of the machine.
        seconds: Time by the clock, for a process that waits for something.
        memory_bytes: Resident memory of the process.
    """

    cpu_seconds: float = 120.0
    seconds: float = 600.0
    memory_bytes: int = 2 * 2**30


@dataclass(frozen=True)
class ConfinedOutcome:
    """End of a confined process.

    Attributes:
        ending: `done`, or why there is no result: the function could not be imported, the process crashed, or it took
            too much time or memory.
        detail: Exit status or limit, for messages.
        output: End of its output.
        peak_bytes: Highest resident memory that was seen.
    """

    ending: Ending
    detail: str
    output: str
    peak_bytes: int

    @property
    def last_line(self) -> str:
        """Last line of the output, which names the error of a Python program."""
        return next((line.strip() for line in reversed(self.output.splitlines()) if line.strip()), "")


def run_confined(function: str, folder: Path, limits: ConfinedLimits) -> ConfinedOutcome:
    """Call a function (`module:name`) with the path of `folder`, in a process that can reach little else.

    Returns after the process has ended.
    """
    environment = {k: v for k, v in os.environ.items() if k in _PASSED or k.startswith("LC_")}
    private = {"HOME": str(folder), "TMPDIR": str(folder), "PYTHONDONTWRITEBYTECODE": "1", "PYTHONUTF8": "1"}
    # The limit of the kernel counts reserved memory, too: it only catches what grows between two looks.
    reserved = 4 * limits.memory_bytes
    arguments = [function, str(folder), str(os.getpid()), str(reserved)]
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(
            [sys.executable, "-c", _BOOT, json.dumps(module_path()), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env={**environment, **ONE_THREAD, **private},
            cwd=folder,
            process_group=0,
        )
        try:
            ending, detail, peak = _watch(process, limits)
        finally:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        output.seek(0, os.SEEK_END)
        output.seek(max(0, output.tell() - _TAIL_BYTES))
        tail = output.read().decode(errors="replace")
    return ConfinedOutcome(ending, detail, tail, peak)


def _watch(process: subprocess.Popen[bytes], limits: ConfinedLimits) -> tuple[Ending, str, int]:
    """Wait for the end of a process; return early when it passes a limit."""
    watched, peak, spent = psutil.Process(process.pid), 0, 0.0
    give_up_at = time.monotonic() + limits.seconds
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = process.wait(_POLL_S)
            ending: Ending = "done" if code == 0 else "no-start" if code == NO_START else "crash"
            return ending, describe_exit(code), peak
        with contextlib.suppress(psutil.Error):
            peak = max(peak, watched.memory_info().rss)
            spent = sum(watched.cpu_times()[:2])
        if peak > limits.memory_bytes:
            return "memory", f"more than {limits.memory_bytes / 2**30:.2g} GB of memory", peak
        if spent > limits.cpu_seconds:
            return "time", f"more than {limits.cpu_seconds:g} s of processor time", peak
        if time.monotonic() > give_up_at:
            return "time", f"more than {limits.seconds:g} s", peak
