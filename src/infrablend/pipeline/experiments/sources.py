"""Which of the user's folders is which source of an experiment."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from infrablend.config.experiment import Experiment, Source
from infrablend.errors import DatasetError, InfraBlendError, Problem
from infrablend.fetching.fetch import require_source
from infrablend.formats import detection


def assign_folders(experiment: Experiment, folders: Sequence[Path]) -> dict[str, Path]:
    """Return the user's folders by source, matched by their formats.

    Raises:
        DatasetError: A folder matches no source, two match the same one, or a source has no folder.
    """
    given: dict[str, Path] = {}
    problems = []
    for folder in folders:
        if not folder.is_dir():
            problems.append(Problem(str(folder), "folder-missing", "no such folder", "the folder of a dataset"))
            continue
        found = detection.detect(folder).format
        name = next((n for n, s in experiment.sources.items() if s.format == found), None)
        wanted = " or ".join(f"{s.title} ({s.format})" for s in experiment.sources.values())
        if name is None:
            problems.append(Problem(str(folder), "data-kind", found or "no known format", wanted))
        elif name in given:
            problems.append(Problem(str(folder), "data-twice", f"a second {found}", f"only {given[name]}"))
        else:
            given[name] = folder
    problems = problems or _missing_folders(experiment, given)
    if problems:
        raise DatasetError(f"experiment {experiment.name}: the data do not fit", problems)
    return given


def _missing_folders(experiment: Experiment, given: dict[str, Path]) -> list[Problem]:
    problems = []
    for name, s in experiment.sources.items():
        if name not in given and not s.optional and s.stand_in is None:
            todo = f"give its folder with --data ({where_to_get(s)})"
            problems.append(Problem("--data", "data-missing", f"no {s.title}", f"a folder of {s.format}", todo))
    if not given and all(s.optional for s in experiment.sources.values()):
        wanted = " or ".join(s.title for s in experiment.sources.values())
        problems.append(Problem("--data", "data-missing", "no folder", wanted))
    return problems


def where_to_get(source: Source) -> str:
    """Return one line on how to obtain a source."""
    try:
        return f"see {require_source(source.format).page}"
    except InfraBlendError:
        return "docs/how_to/fetch_data.md"
