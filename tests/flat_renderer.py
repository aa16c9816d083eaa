"""The flat renderer for commands that are called in the process of a test.

Works with the sources of earlier versions too: `scripts/regress_at.sh` runs attacks on them.
"""

from __future__ import annotations

import functools
from dataclasses import fields
from typing import Any

import pytest


def flat_defaults() -> tuple[Any, ...]:
    """Return defaults of `Execution` that compute frames with the flat renderer in this process, in milliseconds."""
    from infrablend.pipeline.request import Execution

    return tuple({"renderer": "flat", "in_process": True}.get(f.name, f.default) for f in fields(Execution))


def render_flat(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute frames with the flat renderer in this process; the command line does not offer it."""
    try:
        from infrablend.pipeline import request

        monkeypatch.setattr(request.Execution.__init__, "__defaults__", flat_defaults())
    except (ImportError, AttributeError):
        from infrablend import api

        generate: Any = api.generate  # of cb6733f, where the flat renderer was called fake
        monkeypatch.setattr(api, "generate", functools.partial(generate, renderer="fake", in_process=True))
