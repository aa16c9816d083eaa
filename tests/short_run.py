"""What `make test` runs of all tests: those without the mark `long`, and of thinned ones a few that cover all values.

`make test ALL=1` runs everything. A test is long if it needs torch, a browser, object storage, Ray or libraries of
others, if it attacks the program for minutes, or if it makes whole runs for what a shorter test shows as well.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import pytest

LONG_FIXTURES = {"ultralytics", "tools_python", "nicegui", "chromium", "started_ray"}
"""Fixtures of what only the long run installs."""
LONG_FILES = ("tests/contract/test_ray.py", "tests/contract/test_storage.py")
"""Files that import what only the long run installs."""

Goal = frozenset[tuple[str, str]]
"""Values of one or two parameters that a test has together."""


def is_long(item: pytest.Item) -> bool:
    """Return whether only the long run has a test."""
    fixtures = getattr(item, "fixturenames", ())
    return item.get_closest_marker("long") is not None or not LONG_FIXTURES.isdisjoint(fixtures)


def thinned_out(items: Iterable[pytest.Item]) -> set[pytest.Item]:
    """Return the tests that the short run leaves out of those with the mark `thinned`."""
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("thinned") and hasattr(item, "callspec"):
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    left_out: set[pytest.Item] = set()
    for of_function in cases.values():
        parameters = [item.callspec.params for item in of_function]  # type: ignore[attr-defined]
        kept = covering(parameters)
        left_out |= {item for n, item in enumerate(of_function) if n not in kept}
    return left_out


def covering(cases: Sequence[dict[str, Any]]) -> set[int]:
    """Return the numbers of a few cases that cover every pair of values, or every value of one or two parameters."""
    goals = [_goals(case) for case in cases]
    missing = set().union(*goals)
    kept: set[int] = set()
    while missing:
        best = max(range(len(goals)), key=lambda n: (len(goals[n] & missing), -n))
        missing -= goals[best]
        kept.add(best)
    return kept


def _goals(case: dict[str, Any]) -> set[Goal]:
    values = [(name, repr(value)) for name, value in sorted(case.items())]
    together = 2 if len(values) > 2 else 1
    return {frozenset(some) for some in itertools.combinations(values, together)}
