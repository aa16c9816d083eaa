"""Writing files so that a reader never sees half of one."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from infrablend.errors import OutputError


@contextmanager
def replace_atomically(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; move it onto `path` when the block ends well, remove it if not.

    Raises:
        OutputError: If the folder cannot be written or the disk is full; `path` is then as it was before.
    """
    # The process id keeps two workers that (re)make one file from writing into each other's temporary.
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):  # e.g. the folder is a file
            temporary.unlink(missing_ok=True)
        if isinstance(error, OutputError):
            raise
        raise OutputError(
            f"{path}: cannot be written ({error.strerror or error}); expected a writable folder with free space. "
            "Free some space or choose another output folder; finished files are intact."
        ) from error
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` to `path`, whole or not at all."""
    with replace_atomically(path) as temporary:
        temporary.write_bytes(data)


def write_json(path: Path, data: Any, *, indent: int | None = 1) -> None:
    """Write `data` as JSON with sorted keys, whole or not at all; the same data gives the same bytes."""
    text = json.dumps(data, sort_keys=True, indent=indent, ensure_ascii=False, allow_nan=False)
    write_bytes(path, (text + "\n").encode())
