"""Problems as people see them."""

from __future__ import annotations

from pathlib import Path

import pytest

from infrablend.cli.exits import report_error
from infrablend.cli.results import print_problems
from infrablend.config.modes import DROPPED
from infrablend.errors import DatasetError, Problem


def test_fields_dropped_for_one_reason_share_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    reason = "this field has a meaning only with another matching.mode; this recipe has radiometric"
    names = [f"matching.field_{k}" for k in range(8)]
    problems = [Problem(n, DROPPED, f"9 is not used: {reason}", severity="warning") for n in names]
    problems.append(Problem("camera.roll_deg", DROPPED, "0 is not used: this field has no meaning", severity="warning"))
    print_problems(problems, None, Path("run.json"))
    shown = capsys.readouterr().err
    decisive = Problem("data", "scale-missing", "counts", "kelvin", severity="warning")
    report_error(DatasetError("no usable background", [*problems, decisive]), None)
    assert capsys.readouterr().err.splitlines()[1].startswith("  - data: counts")
    assert shown.startswith("2 warning(s):") and "more, all in" not in shown
    assert f"{', '.join(names)}: not used: these fields have a meaning only with another matching.mode" in shown
    assert "camera.roll_deg: not used: this field has no meaning" in shown
