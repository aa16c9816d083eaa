"""Records with values that InfraBlend never writes end in an error that names them, never in a traceback."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

from infrablend.core.ledger import Ledger
from tests.command_line import done, run
from tests.flat_renderer import render_flat
from tests.run_files import frame_ids
from tests.samples import SAMPLES

FORMATS = "yolo,coco"


@pytest.fixture(autouse=True)
def flat(monkeypatch: pytest.MonkeyPatch) -> None:
    render_flat(monkeypatch)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return SAMPLES["coco"](tmp_path / "data")


@pytest.fixture
def made(data: Path, tmp_path: Path) -> Path:
    done(*generate(data, tmp_path / "run"))
    return tmp_path / "run"


def generate(data: Path, out: Path, *more: object) -> list[object]:
    return ["generate", "hit-uav-drone", "--data", data, "--out", out, "--to", FORMATS, *more]


def named(ended: Result, *words: str) -> None:
    """Check that a command ended in an error with a name."""
    assert ended.exit_code in (1, 2, 3), ended.output
    assert "Traceback" not in ended.output
    for word in words:
        assert word in ended.output


# -- the record of a run

DAMAGES: dict[str, dict[str, Any]] = {
    "data": {"data": None},
    "data, text": {"data": "x"},
    "request": {"request": 5},
    "request.selection": {"request": {"selection": []}},
}


@pytest.mark.parametrize("values", DAMAGES.values(), ids=DAMAGES)
def test_fields_of_a_run_record_of_another_type_are_named(made: Path, data: Path, values: dict[str, Any]) -> None:
    with Ledger.open(made, write=True) as ledger:
        ledger.write_run({**ledger.read_run(), **values})
    frame = frame_ids(made)[0]
    for words in (["exclude", made, frame], ["rerender", made, frame]):
        named(run(*words), "run.json: cannot be read", "--overwrite")
    assert run("preview", made).exit_code in (0, 2)
    assert run("preview", made, "--ground").exit_code == 2
    assert run("check", made).exit_code in (0, 1, 2)
    done(*generate(data, made, "--overwrite"))
    done("check", made)
