"""Per-user folders outside of any project: for downloads, imported geometry and the log.

They follow the platform's rules (on Linux `$XDG_CACHE_HOME`, else `~/.cache`, and `$XDG_STATE_HOME`, else
`~/.local/state`). Nothing is created here.
"""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs

NAME = "infrablend"


def cache_folder() -> Path:
    """Return the folder for what can be downloaded or computed again: `$INFRABLEND_CACHE`, else the platform's."""
    own = os.environ.get("INFRABLEND_CACHE")
    return Path(own) if own else platformdirs.user_cache_path(NAME, appauthor=False)


def weights_folder() -> Path:
    """Return the folder for published weights of detectors."""
    return cache_folder() / "weights"


def state_folder() -> Path:
    """Return the folder for logs, which survive a restart but need no backup."""
    return platformdirs.user_state_path(NAME, appauthor=False)
