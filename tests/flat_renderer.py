"""The flat renderer for commands that are called in the process of a test."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest

from infrablend.pipeline.plans.run_request import Execution


def flat_defaults() -> tuple[Any, ...]:
    """Return defaults of `Execution` that compute frames with the flat renderer in this process, in milliseconds."""
    return tuple({"renderer": "flat", "in_process": True}.get(f.name, f.default) for f in fields(Execution))


def render_flat(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute frames with the flat renderer in this process; the command line does not offer it."""
    monkeypatch.setattr(Execution.__init__, "__defaults__", flat_defaults())
