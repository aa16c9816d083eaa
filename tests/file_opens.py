"""Count what a piece of code opens: unlike its seconds, the same on every machine and under any load."""

from __future__ import annotations

import builtins
import io
import os
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest


@contextmanager
def count_opens(root: Path) -> Iterator[Counter[Path]]:
    """Count how often each file below `root` is opened by Python code."""
    opens: Counter[Path] = Counter()
    open_file = io.open

    def counted(file: Any, *args: Any, **kwargs: Any) -> Any:
        if isinstance(file, str | bytes | os.PathLike):
            path = Path.cwd() / os.fsdecode(file)
            if path.is_relative_to(root):
                opens[path] += 1
        return open_file(file, *args, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(io, "open", counted)
        patch.setattr(builtins, "open", counted)
        yield opens
