"""Reports that belong to a run, found in its folder, beside it and in further folders.

What reads a report belongs to the lab: `READERS` names the function that finds the reports of a folder.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend.core.files import read_regular
from infrablend.core.lazy_names import resolve
from infrablend.errors import DatasetError
from infrablend.studio.opened_run import inner_folders

READERS = "infrablend.lab.pages.studio_results:report_readers"


@dataclass(frozen=True)
class ResultTable:
    """A table of a report."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class ResultReport:
    """A report: its kind and folder, what it is about in sentences, its tables, and its plots and sheets."""

    title: str
    folder: Path
    lines: tuple[str, ...]
    tables: tuple[ResultTable, ...]
    pictures: tuple[Path, ...]


@dataclass(frozen=True)
class FoundResults:
    """Reports, and what is wrong with those that cannot be read, in words."""

    reports: tuple[ResultReport, ...]
    unreadable: tuple[str, ...]

    def picture(self, report: int, number: int) -> tuple[bytes, str]:
        """Return a picture and its suffix.

        Raises:
            DatasetError: There is no such picture, or it is a link out of its folder.
        """
        if not 0 <= report < len(self.reports) or not 0 <= number < len(self.reports[report].pictures):
            raise DatasetError(f"report {report}, picture {number}: no such picture")
        path = self.reports[report].pictures[number]
        folder = self.reports[report].folder
        try:
            return read_regular(path, folder), path.suffix.lower()
        except OSError as error:
            raise DatasetError(f"{path}: cannot be read ({error}); repeat the command that wrote it") from error


ReportReaders = Callable[[Path], list[tuple[Path, Callable[[Any, Path], ResultReport | None]]]]
"""Return the JSON files of reports in a folder, each with the function that reads it."""


def find_results(run: Path, further: Sequence[Path] = ()) -> FoundResults:
    """Return the reports directly inside a run, in its comparison beside it, and in further folders.

    Raises:
        DatasetError: The run was removed.
    """
    try:
        inside = inner_folders(run)
    except OSError as error:
        raise DatasetError(
            f"{run}: cannot be read ({error.strerror}); expected the run that was opened. If it was removed or is "
            "being written again, open it again when it is finished"
        ) from error
    report_readers: ReportReaders = resolve(READERS)
    comparison = run.with_name(f"{run.name}-realism")
    folders = [path for path in (*inside, comparison) if report_readers(path)] + list(further)
    reports = []
    unreadable = []
    for folder in folders:
        readers = report_readers(folder)
        if not readers:
            expected = "evaluation.json, realism.json, or the JSON of an experiment"
            unreadable.append(f"{folder}: no report; expected {expected}")
        for path, read in readers:
            try:
                found = read(json.loads(read_regular(path, folder)), path)
            except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
                unreadable.append(f"{path}: cannot be read ({type(error).__name__}: {str(error)[:120]})")
                continue
            if found is not None:
                reports.append(found)
    return FoundResults(tuple(reports), tuple(unreadable))
