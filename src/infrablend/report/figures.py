"""Numbers as text: the same form in pages, cards and on the command line."""

from __future__ import annotations

import re
from collections.abc import Sequence


def stratum_order(name: str) -> tuple[float, bool, str]:
    """Return the sorting key of a stratum: `<8`, `8-16`, `16-32`, then names without numbers."""
    found = re.search(r"\d+(\.\d+)?", name)
    return float(found.group()) if found else float("inf"), not name.startswith("<"), name


def decimals(value: float | None) -> str:
    """Return a number with three decimals, a whole number as it is, and `-` for an unknown one."""
    return "-" if value is None else str(value) if isinstance(value, int) else f"{value:.3f}"


def compact(value: float | None) -> str:
    """Return a number with three decimals at most, three digits from 100 on, and `-` for an unknown one."""
    return "-" if value is None else f"{value:.3g}" if abs(value) >= 100 else f"{value:.3f}".rstrip("0").rstrip(".")


def interval(ends: Sequence[float | None] | None, *, signed: bool = False) -> str:
    """Return `0.871 to 0.912`, or `-` for an unknown interval."""
    if ends is None or None in ends:
        return "-"
    form = "+.3f" if signed else ".3f"
    return f"{ends[0]:{form}} to {ends[1]:{form}}"


def human_seconds(s: float) -> str:
    """Format a duration, e.g. `8.2 s`, `3 min 05 s`, `2 h 10 min`."""
    if s < 60:
        return f"{s:.1f} s"
    whole = round(s)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02} min"
