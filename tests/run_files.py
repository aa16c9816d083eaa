"""What differs between the files of equal runs: the times in the record and in the report."""

from __future__ import annotations

import re

_TIMES = re.compile(rb'<section id="time">.*?</section>', re.DOTALL)


def without_times(name: str, data: bytes) -> bytes:
    """Return the bytes of a file of a run; those of its report without the section of times."""
    return _TIMES.sub(b"", data) if name.endswith("report.html") else data
