"""The flat renderer for commands that are called in the process of a test.

Works with the sources of earlier versions too: `scripts/regress_at.sh` runs attacks on them.
"""

from __future__ import annotations

import functools
from typing import Any

import pytest


def render_flat(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute frames with the flat renderer in this process, in milliseconds; the command line does not offer it."""
    try:
        from infrablend.pipeline import request

        make = functools.partial(request.Execution, renderer="flat", in_process=True)
        monkeypatch.setattr(request, "Execution", make)
    except (ImportError, AttributeError):
        from infrablend import api

        generate: Any = api.generate  # of cb6733f, where the flat renderer was called fake
        monkeypatch.setattr(api, "generate", functools.partial(generate, renderer="fake", in_process=True))
