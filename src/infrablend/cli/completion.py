"""Shell completion of names: recipes, models, experiments, datasets and formats.

The shell starts the program for every press of the tab key, so nothing here imports a heavy library.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

_YAML = (".yaml", ".yml")


def complete_recipe(incomplete: str) -> list[str]:
    """Return the shipped recipes and the YAML files that begin like this."""
    from infrablend.core.shipped import shipped_names

    return _beginning(shipped_names("recipes"), incomplete) + _yaml_files(incomplete)


def complete_shipped_recipe(incomplete: str) -> list[str]:
    """Return the shipped recipes that begin like this."""
    from infrablend.core.shipped import shipped_names

    return _beginning(shipped_names("recipes"), incomplete)


def complete_experiment(incomplete: str) -> list[str]:
    """Return the shipped experiments and the YAML files that begin like this."""
    from infrablend.core.shipped import shipped_names

    return _beginning(shipped_names("experiments"), incomplete) + _yaml_files(incomplete)


def complete_model(incomplete: str) -> list[str]:
    """Return the built-in models and the YAML files that begin like this."""
    from infrablend.assets.catalogue import list_models

    return _beginning(list_models(), incomplete) + _yaml_files(incomplete)


def complete_source(incomplete: str) -> list[str]:
    """Return the public datasets that begin like this."""
    from infrablend.formats.sources import SOURCES

    return _beginning((s.name for s in SOURCES), incomplete)


def complete_read_format(incomplete: str) -> list[str]:
    """Return the formats that can be read and begin like this."""
    from infrablend.core.format_table import FORMATS

    return _beginning(sorted(f.name for f in FORMATS), incomplete)


def complete_written_format(incomplete: str) -> list[str]:
    """Return the formats that can be written and begin like this."""
    from infrablend.core.format_table import NATIVE, written_names

    return _beginning([*sorted(written_names()), NATIVE], incomplete)


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
