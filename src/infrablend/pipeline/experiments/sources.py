"""Which of the user's folders is which source of an experiment."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from infrablend.config.experiment import Experiment, Source
from infrablend.errors import DatasetError, InfraBlendError, Problem
from infrablend.fetching.fetch import require_source
from infrablend.formats import detection
from infrablend.pipeline.experiments.dataset_facts import class_key, dataset_facts, read_dataset


def assign_folders(experiment: Experiment, folders: Sequence[tuple[str | None, Path]]) -> dict[str, Path]:
    """Return the user's folders by source.

    A folder without a name is matched with the sources of its format; if there are several, with those whose classes
    all have labels in it.

    Args:
        experiment: Experiment that needs the sources.
        folders: Name of the source, or None, and folder.

    Raises:
        DatasetError: A folder matches no source or several, two match the same one, or a source has no folder.
    """
    given: dict[str, Path] = {}
    problems = []
    for named, folder in folders:
        if not folder.is_dir():
            problems.append(Problem(str(folder), "folder-missing", "no such folder", "the folder of a dataset"))
            continue
        found = detection.detect(folder).format
        names = _matching_sources(experiment, folder, found) if named is None else [named]
        source = experiment.sources.get(names[0]) if len(names) == 1 else None
        if source is None:
            problems.append(_no_single_source(experiment, folder, found, names))
        elif source.format != found:
            what = found or "no known format"
            problems.append(Problem(str(folder), "data-kind", what, f"{source.title} ({source.format})"))
        elif names[0] in given:
            todo = f"name the source of each folder: --data {names[0]}=DIR"
            what = f"a second {found} for {names[0]}"
            problems.append(Problem(str(folder), "data-twice", what, f"only {given[names[0]]}", todo))
        else:
            given[names[0]] = folder
    problems = problems or _missing_folders(experiment, given)
    if problems:
        raise DatasetError(f"experiment {experiment.name}: the data do not fit", problems)
    return given


def _matching_sources(experiment: Experiment, folder: Path, format: str | None) -> list[str]:
    """Return the names of the sources that a folder can be."""
    names = [n for n, s in experiment.sources.items() if s.format == format]
    if len(names) < 2:
        return names
    labels = dataset_facts(read_dataset(folder))["labels"].values()
    labelled = {class_key(c) for of_split in labels for c in of_split}
    return [n for n in names if {class_key(c) for c in experiment.sources[n].classes} <= labelled]


def _no_single_source(experiment: Experiment, folder: Path, format: str | None, names: Sequence[str]) -> Problem:
    """Return the problem of a folder that is no source of the experiment, or that can be several."""
    if len(names) > 1:
        found, todo = f"it can be {' or '.join(names)}", f"name it: --data {names[0]}={folder}"
        return Problem(str(folder), "data-kind", found, "labels of the classes of one of them alone", todo)
    if names:
        return Problem(str(folder), "data-kind", f"no source {names[0]}", f"one of {', '.join(experiment.sources)}")
    sources = experiment.sources.values()
    wanted = " or ".join(f"{s.title} ({', '.join([s.format, *_labels_of(experiment, s)])})" for s in sources)
    return Problem(str(folder), "data-kind", format or "no known format", wanted)


def _labels_of(experiment: Experiment, source: Source) -> list[str]:
    """Return what tells a source apart from others of its format."""
    alone = [s.format for s in experiment.sources.values()].count(source.format) == 1
    return [] if alone else [f"labels of {' and '.join(source.classes)}"]


def _missing_folders(experiment: Experiment, given: dict[str, Path]) -> list[Problem]:
    problems = []
    for name, s in experiment.sources.items():
        if name not in given and not s.optional and s.stand_in is None:
            todo = f"give its folder with --data {name}=DIR ({where_to_get(s)})"
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
