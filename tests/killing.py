"""Calls that die at a chosen moment, without any clean-up."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path


def run_until_killed(renames: int, call: Callable[[], object]) -> None:
    """Make a call in a process that dies just before it gives a file or folder its name, after this many renames."""
    child = os.fork()
    if not child:
        left = [renames]

        def counted(rename: Callable[[Path, Path], Path]) -> Callable[[Path, Path], Path]:
            def call_or_die(path: Path, target: Path) -> Path:
                left[0] -= 1
                if left[0] < 0:
                    os._exit(137)
                return rename(path, target)

            return call_or_die

        Path.replace = counted(Path.replace)  # type: ignore[assignment,method-assign]
        Path.rename = counted(Path.rename)  # type: ignore[assignment,method-assign]
        try:
            call()
        finally:
            os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 137, "ended before it was killed"
