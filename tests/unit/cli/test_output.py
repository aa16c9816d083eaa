"""Problems as people see them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from infrablend.cli.app import build_app
from infrablend.cli.exits import report_error
from infrablend.cli.output import print_problems
from infrablend.config.modes import DROPPED
from infrablend.errors import DatasetError, Problem


def test_fields_that_a_mode_makes_meaningless_share_a_short_line(capsys: pytest.CaptureFixture[str]) -> None:
    reason = "this field has a meaning only with another matching.mode; this recipe has radiometric"
    names = [f"matching.field_{k}" for k in range(8)]
    problems = [Problem(n, DROPPED, f"9 is not used: {reason}", severity="warning") for n in names]
    problems.append(Problem("camera.roll_deg", DROPPED, "0 is not used: this field has no meaning", severity="warning"))
    print_problems(problems, None, Path("run.json"))
    shown = capsys.readouterr().err
    decisive = Problem("data", "scale-missing", "counts", "kelvin", severity="warning")
    report_error(DatasetError("no usable background", [*problems, decisive]), None)
    assert capsys.readouterr().err.splitlines()[1].startswith("  - data: counts")
    assert shown == "1 warning(s):\n  - recipe: 9 fields of the recipe have no meaning in this mode\n"
    print_problems(problems[:1], None, Path("run.json"))
    assert "matching.field_0: 9 is not used: this field has a meaning only with" in capsys.readouterr().err


def test_a_mode_set_on_a_shipped_recipe_is_one_line_and_a_field_set_beside_it_an_error(
    tmp_path: Path, write_tiny_hit_uav: Any
) -> None:
    data = write_tiny_hit_uav(tmp_path / "data", ("normal_json",))
    for name in ("hit-uav-people", "hit-uav-car"):
        fields = ["--set", "appearance.mode=artistic"]
        words = ["-q", "generate", name, "--data", str(data), "--out", str(tmp_path / "out"), "--plan", *fields]
        result = CliRunner().invoke(build_app(), words)
        assert result.exit_code == 0, result.output
        assert re.search(r"^dropped fields +\d+$", result.output, re.MULTILINE), result.output
        wrong = CliRunner().invoke(build_app(), [*words, "--set", "matching.local_share=0.5"])
        assert wrong.exit_code == 2
        assert "matching.local_share: this field has a meaning only with appearance.mode physical" in wrong.output
