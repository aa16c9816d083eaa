"""Reports that belong to a run: realism, evaluations and experiments, read from the files that the commands wrote."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend.core.files import read_regular
from infrablend.errors import DatasetError
from infrablend.evaluation.detections import RECORD
from infrablend.report.evaluation import HEAD, STRATA, table_rows
from infrablend.report.figures import decimals, stratum_order
from infrablend.report.realism import score_cells
from infrablend.studio.opened_run import inner_folders

REALISM = "realism.json"
_PICTURES = (".png", ".svg")
_SCORES = ("auc_boosting", "floor_logistic", "hard_paste_logistic")
_MEASURED = ("instances", "map50", "map50_95")


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
        path, folder = self.reports[report].pictures[number], self.reports[report].folder
        try:
            return read_regular(path, folder), path.suffix.lower()
        except OSError as error:
            raise DatasetError(f"{path}: cannot be read ({error}); repeat the command that wrote it") from error


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
    comparison = run.with_name(f"{run.name}-realism")
    folders = [path for path in (*inside, comparison) if _kinds(path)] + list(further)
    reports, unreadable = [], []
    for folder in folders:
        kinds = _kinds(folder)
        if not kinds:
            expected = f"{RECORD}, {REALISM}, or the JSON of an experiment"
            unreadable.append(f"{folder}: no report; expected {expected}")
        for path, read in kinds:
            try:
                found = read(json.loads(read_regular(path, folder)), path)
            except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
                unreadable.append(f"{path}: cannot be read ({type(error).__name__}: {str(error)[:120]})")
                continue
            if found is not None:
                reports.append(found)
    return FoundResults(tuple(reports), tuple(unreadable))


def _kinds(folder: Path) -> list[tuple[Path, Callable[[Any, Path], ResultReport | None]]]:
    single = ((folder / RECORD, _evaluation), (folder / REALISM, _realism))
    pages = [p for p in sorted(folder.glob("*.json")) if p.with_suffix(".md").is_file() and p.name != REALISM]
    return [
        *((path, read) for path, read in single if path.is_file()),
        *((path, _experiment) for path in pages if not path.is_symlink()),
    ]


def _pictures(folder: Path, pattern: str) -> tuple[Path, ...]:
    return tuple(sorted(path for path in folder.glob(pattern) if path.suffix in _PICTURES and path.is_file()))


def _evaluation(record: Mapping[str, Any], path: Path) -> ResultReport:
    dataset, detector = record["dataset"], record["detector"]
    lines = [
        f"{dataset['images']} images of {dataset['name']}, split {dataset['split']}; task {record['task']}",
        f"detector: {detector.get('weights') or 'saved detections'}, classes {', '.join(detector['classes'])}",
        f"confidence of the best mean F1: {decimals(record['confidence'])}",
        *(f"{p['severity']}: {p['where']}: {p['found']}" for p in record["problems"]),
    ]
    tables = [ResultTable("By class", HEAD, tuple(tuple(row) for row in table_rows(record["classes"])))]
    for kind, title in STRATA.items():
        strata = record["strata"].get(kind, {})
        rows = [
            (name, *(decimals(strata[name]["classes"]["all"][m]) for m in _MEASURED))
            for name in sorted(strata, key=stratum_order)
        ]
        if len(rows) > 1:
            tables.append(ResultTable(f"By {title}", (title, "instances", "mAP50", "mAP50-95"), tuple(rows)))
    name = f"Evaluation: {path.parent.name}"
    return ResultReport(name, path.parent, tuple(lines), tuple(tables), _pictures(path.parent, "plots/*.png"))


def _realism(record: Mapping[str, Any], path: Path) -> ResultReport | None:
    if "run" not in record:  # a page that collects the figures of several runs
        return None
    run = record["run"]
    classes = record["classes"]
    rows = [(name, *score_cells(of, *_SCORES)) for name, of in classes.items()]
    lines = [
        f"recipe {run['recipe']}, seed {run['seed']}, time of day: {record['time_of_day']}",
        "An AUC of 0.5: a classifier cannot distinguish inserted objects from real ones; 1: it always can.",
        *(
            f"{name}: the figures are not valid: {'; '.join(of['invalid_because'])}"
            for name, of in classes.items()
            if not of["valid"]
        ),
    ]
    head = ("class", "pairs", "logistic", "95 %", "boosting", "floor", "hard paste")
    tables = (ResultTable("AUC of classifiers", head, tuple(rows)),)
    title = f"Realism: {path.parent.name}"
    return ResultReport(title, path.parent, tuple(lines), tables, _pictures(path.parent, "*.png"))


def _experiment(record: Mapping[str, Any], path: Path) -> ResultReport | None:
    if not isinstance(record, dict) or "experiment" not in record:
        return None
    rows = [(name, *row) for name, of in record["evaluations"].items() for row in table_rows(of["classes"])]
    lines = [str(record.get("title") or record["experiment"]), f"scale {record['scale']}, status {record['status']}"]
    tables = (ResultTable("Evaluations", ("evaluation", *HEAD), tuple(tuple(r) for r in rows)),) if rows else ()
    pictures = _pictures(path.parent, f"{path.stem}_*.svg")
    return ResultReport(f"Experiment: {path.stem}", path.parent, tuple(lines), tables, pictures)
