"""A confined process: what it can reach, its limits, and how it ends."""

from __future__ import annotations

import json
import socket
import time
from pathlib import Path

import pytest

from infrablend.core.landlock import landlock_version
from infrablend.execution.confined import ConfinedLimits, ConfinedOutcome, run_confined

REACH = """
import json, os, socket
def reached(what):
    try:
        what()
    except OSError:
        return False
    return True
folder = os.getcwd()
result = {
    "own file": reached(lambda: open("input.txt").read()),
    "beside": reached(lambda: open("../secret.txt").read()),
    "link": reached(lambda: open("link.txt").read()),
    "passwords": reached(lambda: open("/etc/passwd").read()),
    "list": reached(lambda: os.listdir("..")),
    "write beside": reached(lambda: open("../written.txt", "w")),
    "rename": reached(lambda: os.rename("input.txt", "../moved.txt")),
    "network": reached(lambda: socket.create_connection(("127.0.0.1", PORT), 1)),
    "token": "SECRET_TOKEN" in os.environ,
}
json.dump(result, open("result.json", "w"))
"""


def run(folder: Path, code: str, limits: ConfinedLimits | None = None) -> ConfinedOutcome:
    """Run code in a confined process: `runpy` runs `__main__.py` of its folder."""
    folder.mkdir(exist_ok=True)
    (folder / "__main__.py").write_text(code)
    return run_confined("runpy:run_path", folder, limits or ConfinedLimits())


def test_a_confined_process_reaches_its_folder_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    version = landlock_version()
    if not version:
        pytest.skip("NEEDS LANDLOCK: Linux 5.13 or newer")
    monkeypatch.setenv("SECRET_TOKEN", "abc")
    (tmp_path / "secret.txt").write_text("secret")
    folder = tmp_path / "own"
    folder.mkdir()
    (folder / "input.txt").write_text("mine")
    (folder / "link.txt").symlink_to("../secret.txt")
    with socket.create_server(("127.0.0.1", 0)) as server:
        outcome = run(folder, REACH.replace("PORT", str(server.getsockname()[1])))
    assert outcome.ending == "done", outcome.output
    reached = [what for what, could in json.loads((folder / "result.json").read_text()).items() if could]
    assert reached == ["own file"] + (["network"] if version < 4 else [])
    assert json.loads((folder / "done.json").read_text()) == {"landlock": version}


def test_a_function_that_cannot_be_imported_is_no_crash(tmp_path: Path) -> None:
    outcome = run_confined("infrablend.no_such_module:run", tmp_path, ConfinedLimits())
    assert (outcome.ending, outcome.last_line.split(":")[0]) == ("no-start", "ModuleNotFoundError")


@pytest.mark.parametrize(
    ("code", "ending"),
    [
        ("import time; time.sleep(60)", "time"),
        ("while True: pass", "time"),
        ("blocks = []\nwhile True: blocks.append(b'x' * 50_000_000)", "memory"),
        ("import os; os.abort()", "crash"),
        ("raise ValueError('what went wrong')", "crash"),
    ],
)
def test_limits_end_a_confined_process(tmp_path: Path, code: str, ending: str) -> None:
    started = time.monotonic()
    seconds = 1.0 if "sleep" in code else 60.0
    outcome = run(tmp_path / "own", code, ConfinedLimits(0.5 if "pass" in code else 30.0, seconds, 300_000_000))
    assert outcome.ending == ending
    assert time.monotonic() - started < 59
    assert outcome.peak_bytes < 2_000_000_000
    assert ("what went wrong" in outcome.output) == code.startswith("raise")
