"""Reports for the studio: realism, evaluations and experiments, read from the files that the commands wrote."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from infrablend.detection.detections import RECORD
from infrablend.lab.pages.evaluation_page import STRATA, class_table, small_text
from infrablend.lab.pages.realism_report import score_table
from infrablend.lab.realism.realism_record import ScoreName
from infrablend.report.figures import decimals, stratum_order
from infrablend.report.page import Table
from infrablend.studio.found_results import ResultReport, ResultTable

REALISM = "realism.json"
_PICTURES = (".png", ".svg")
_SCORES: Final[Mapping[ScoreName, str]] = {
    "auc_boosting": "boosting",
    "floor_logistic": "floor",
    "hard_paste_logistic": "hard paste",
}
_MEASURED = ("instances", "map50", "map50_95")


def report_readers(folder: Path) -> list[tuple[Path, Callable[[Any, Path], ResultReport | None]]]:
    """Return the JSON files of reports in a folder, each with the function that reads it."""
    single = ((folder / RECORD, _evaluation), (folder / REALISM, _realism))
    pages = [p for p in sorted(folder.glob("*.json")) if p.with_suffix(".md").is_file() and p.name != REALISM]
    return [
        *((path, read) for path, read in single if path.is_file()),
        *((path, _experiment) for path in pages if not path.is_symlink()),
    ]


def _pictures(folder: Path, pattern: str) -> tuple[Path, ...]:
    return tuple(sorted(path for path in folder.glob(pattern) if path.suffix in _PICTURES and path.is_file()))


def _shown(title: str, table: Table) -> ResultTable:
    return ResultTable(title, tuple(table.head), tuple(map(tuple, table.rows)))


def _evaluation(record: Mapping[str, Any], path: Path) -> ResultReport:
    dataset = record["dataset"]
    detector = record["detector"]
    lines = [
        f"{dataset['images']} images of {dataset['name']}, split {dataset['split']}; task {record['task']}",
        f"detector: {detector.get('weights') or 'saved detections'}, classes {', '.join(detector['classes'])}",
        f"confidence of the best mean F1: {decimals(record['confidence'])}",
        *(f"{p['severity']}: {p['where']}: {p['found']}" for p in record["problems"]),
    ]
    by_class = class_table(record["classes"], map10=bool(small_text(record["classes"])))
    tables = [_shown("By class", by_class)]
    for kind, title in STRATA.items():
        strata = record["strata"].get(kind, {})
        rows = [
            (name, *(decimals(strata[name]["classes"]["all"][m]) for m in _MEASURED))
            for name in sorted(strata, key=stratum_order)
        ]
        if len(rows) > 1:
            tables.append(_shown(f"By {title}", Table([title, "instances", "mAP50", "mAP50-95"], rows)))
    name = f"Evaluation: {path.parent.name}"
    return ResultReport(name, path.parent, tuple(lines), tuple(tables), _pictures(path.parent, "plots/*.png"))


def _realism(record: Mapping[str, Any], path: Path) -> ResultReport | None:
    if "run" not in record:  # a page that collects the figures of several runs
        return None
    run = record["run"]
    classes = record["classes"]
    lines = [
        f"recipe {run['recipe']}, seed {run['seed']}, time of day: {record['time_of_day']}",
        "An AUC of 0.5: a classifier cannot distinguish inserted objects from real ones; 1: it always can.",
        *(
            f"{name}: the figures are not valid: {'; '.join(of['invalid_because'])}"
            for name, of in classes.items()
            if not of["valid"]
        ),
    ]
    tables = (_shown("AUC of classifiers", score_table("class", classes, _SCORES)),)
    title = f"Realism: {path.parent.name}"
    return ResultReport(title, path.parent, tuple(lines), tables, _pictures(path.parent, "*.png"))


def _experiment(record: Mapping[str, Any], path: Path) -> ResultReport | None:
    if not isinstance(record, dict) or "experiment" not in record:
        return None
    classes = {name: of["classes"] for name, of in record["evaluations"].items()}
    map10 = any(small_text(of) for of in classes.values())
    by_class = {name: class_table(of, map10=map10) for name, of in classes.items()}
    rows = [[name, *row] for name, table in by_class.items() for row in table.rows]
    lines = [str(record.get("title") or record["experiment"]), f"scale {record['scale']}, status {record['status']}"]
    head = ["evaluation", *next(iter(by_class.values())).head] if rows else []
    tables = (_shown("Evaluations", Table(head, rows)),) if rows else ()
    pictures = _pictures(path.parent, f"{path.stem}_*.svg")
    return ResultReport(f"Experiment: {path.stem}", path.parent, tuple(lines), tables, pictures)
