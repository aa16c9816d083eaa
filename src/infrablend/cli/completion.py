"""Shell completion of names: recipes, models, datasets and formats.

The shell starts the program for every press of the tab key, so nothing here imports a heavy library.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from infrablend.assets.catalogue import list_models
from infrablend.core.format_table import FORMATS, NATIVE, written_names
from infrablend.core.shipped_files import RECIPES
from infrablend.formats.published.sources import SOURCES

_YAML = (".yaml", ".yml")


def offered(names: Callable[[], Iterable[str]], *, files: bool = False) -> Callable[[str], list[str]]:
    """Return a function for Typer: the names, and with `files` the YAML files, that begin like the text so far."""

    def complete(incomplete: str) -> list[str]:
        return _beginning(names(), incomplete) + (_yaml_files(incomplete) if files else [])

    return complete


complete_recipe = offered(lambda: RECIPES.names, files=True)
complete_shipped_recipe = offered(lambda: RECIPES.names)
complete_model = offered(list_models, files=True)
complete_source = offered(lambda: (s.name for s in SOURCES))
complete_read_format = offered(lambda: sorted(f.name for f in FORMATS))
complete_written_format = offered(lambda: [*sorted(written_names()), NATIVE])


def complete_written_formats(incomplete: str) -> list[str]:
    """Return what a list of formats can become once its last name is completed."""
    before, comma, last = incomplete.rpartition(",")
    given = before.split(",")
    return [f"{before}{comma}{name}" for name in complete_written_format(last) if name not in given]


def _beginning(names: Iterable[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


def _yaml_files(incomplete: str) -> list[str]:
    """Return the folders and YAML files beside the path typed so far; none before anything is typed."""
    if not incomplete:
        return []
    typed = Path(incomplete)
    folder = typed if incomplete.endswith("/") else typed.parent
    prefix = incomplete[: incomplete.rfind("/") + 1]
    try:
        beside = sorted(folder.iterdir())
    except OSError:
        return []
    shown = [p for p in beside if not p.name.startswith(".") and (p.suffix in _YAML or p.is_dir())]
    return _beginning((prefix + p.name + ("/" if p.is_dir() else "") for p in shown), incomplete)
