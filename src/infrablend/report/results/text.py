"""Words and numbers that several parts of a results page share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

INDEX_FILE = "index.md"
PAGE_MARK = "This command writes the page:"
"""Words of every page of an experiment, by which a later call knows that it may replace it."""
UNFINISHED_END = "-unfinished"
"""End of the name of an unfinished run's page beside a complete one."""
METRICS = {"p": "P", "r": "R", "map50": "mAP50", "map50_95": "mAP50-95"}


def page_name(experiment: str, scale: str) -> str:
    """Return the stem of an experiment's files: its name, followed by the scale unless that is `small`."""
    return experiment if scale == "small" else f"{experiment}-{scale}"


def run_state(facts: Mapping[str, Any]) -> str:
    """Return the state of a run; if some datasets were not given, it is complete only for the others."""
    some_left_out = facts["status"] == "complete" and facts["left_out"]
    return "complete for the data at hand" if some_left_out else str(facts["status"])


def paper_and_ours(paper: str | None, ours: str | None) -> str:
    """Return `paper → ours`, or ours alone where the paper has no figure."""
    return f"{paper or '-'} → {ours or '-'}" if paper else ours or "-"


def count(n: int | None) -> str | None:
    """Return a whole number with separators, or None."""
    return None if n is None else f"{n:,}"


def figure(x: float | None) -> str | None:
    """Return a figure with three decimals, or None."""
    return None if x is None else f"{x:.3f}"


def duration(seconds: float) -> str:
    """Return seconds, minutes, or hours and minutes."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02} min"


def class_order(name: str) -> tuple[bool, str]:
    """Return the sorting key of a class name: `all` first, then alphabetically."""
    return name != "all", name.casefold()
