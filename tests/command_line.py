"""Calls the command line in the process of a test."""

from __future__ import annotations

from click.testing import Result
from typer.testing import CliRunner

from infrablend.cli.app import build_app


def run(*words: object) -> Result:
    """Run a command quietly."""
    return CliRunner().invoke(build_app(), ["-q", *(str(w) for w in words)])


def done(*words: object) -> Result:
    """Run a command that must succeed."""
    ended = run(*words)
    assert ended.exit_code == 0, ended.output
    return ended


def said(*words: object, code: int = 0) -> str:
    """Run a command that must end with this exit code; return all that it printed, on one line."""
    ended = run(*words)
    assert ended.exit_code == code, ended.output
    return " ".join(ended.output.split())
