"""Fixtures and rules for all tests: where the real data lie, how hypothesis draws."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# The same examples on every machine and in every run; shared machines make deadlines meaningless.
settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    database=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("repeatable")

REAL_DATA_VARIABLE = "INFRABLEND_REAL_DATA"
_skipped_without_real_data: list[str] = []


@pytest.fixture(scope="session")
def real_data_or_none() -> Path | None:
    """The folder of real data that the environment names, or None. Fails if it is named but not there."""
    named = os.environ.get(REAL_DATA_VARIABLE, "")
    if not named:
        return None
    folder = Path(named)
    if not folder.is_dir():
        pytest.fail(f"{REAL_DATA_VARIABLE}={named}: no such folder; name the one that holds hit-uav, or unset it")
    return folder.resolve()


@pytest.fixture
def real_data(real_data_or_none: Path | None, request: pytest.FixtureRequest) -> Path:
    """The folder of real data (it holds `hit-uav/`, read-only); skips, loudly, where none is named."""
    if real_data_or_none is None:
        _skipped_without_real_data.append(request.node.nodeid)
        pytest.skip(f"NEEDS REAL DATA: set {REAL_DATA_VARIABLE} to the folder that holds hit-uav")
    return real_data_or_none


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks follow from fixtures and folders, so that `-m "not blender"` leaves out what it says."""
    for item in items:
        if "real_data" in getattr(item, "fixturenames", ()):
            item.add_marker("realdata")
        if "blender" in item.path.parent.parts[-1:]:
            item.add_marker("blender")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say in the summary what was not tested for lack of data."""
    if _skipped_without_real_data:
        terminalreporter.section("not tested on real data", yellow=True, bold=True)
        terminalreporter.line(
            f"{len(_skipped_without_real_data)} tests were skipped: {REAL_DATA_VARIABLE} names no folder.",
            yellow=True,
        )
