"""Unfinished folders name the whole command that finishes them, ready for a shell."""

import shlex
from pathlib import Path

import pytest

from infrablend.core.typed_command import command_facts, recorded_command, set_typed_command, typed_command


def test_command_that_finishes_has_all_options_quoted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "my runs"
    out.mkdir()
    with typed_command():
        set_typed_command(shlex.split("generate r --data 'a b' --out 'my runs' --limit 5 --json --overwrite"))
        record = command_facts()
    assert command_facts() == {}
    expected = "infrablend generate r --data 'a b' --out 'my runs' --limit 5 --resume"
    assert recorded_command(record, out) == expected
    # Elsewhere, relative paths mean nothing without the folder.
    (tmp_path / "else").mkdir()
    monkeypatch.chdir(tmp_path / "else")
    assert recorded_command(record, out) == f"cd {tmp_path} && {expected}"
    moved = out.rename(tmp_path / "moved")
    assert f"--out {moved} " in str(recorded_command(record, moved))


@pytest.mark.parametrize("words", [["fetch", "hit-uav"], ["studio"], [], ["generate", "\udcff"]])
def test_other_commands_and_names_that_json_cannot_hold_are_not_recorded(words):
    with typed_command():
        set_typed_command(words)
        assert command_facts() == {}


@pytest.mark.parametrize("command", [1, {}, {"words": "rm", "folder": "/"}, {"words": ["rm"], "folder": "/"}])
def test_damaged_record_has_no_command(command):
    assert recorded_command({"command": command}, Path("out")) is None
