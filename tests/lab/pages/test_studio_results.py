"""Reports of a run, and where a detector disagrees with its labels."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from infrablend.core.frame_row import FrameRow
from infrablend.core.run_folder import RunFolder
from infrablend.errors import DatasetError
from infrablend.studio.found_results import find_results
from infrablend.studio.frame_index import View
from infrablend.studio.run_labels import Disagreement, RunLabel, RunLabels, compare, read_disagreement
from tests.samples import picture

SCORES = {"images": 1, "instances": 4, "p": 0.5, "r": 0.25, "map50": 0.4, "map50_95": 0.2, "ci": None}
EVALUATION = {
    "dataset": {"name": "run", "split": "test", "images": 1}, "detector": {"classes": ["car"]}, "task": "detect",
    "confidence": 0.3, "classes": {"Car": SCORES, "all": SCORES}, "problems": [],
    "strata": {"size": {">=128": {"classes": {"all": SCORES}}, "8-16": {"classes": {"all": SCORES}}}},
}  # fmt: skip
REALISM = {
    "run": {"recipe": "hit-uav-car", "seed": 0}, "time_of_day": "night",
    "classes": {"Car": {
        "n": 12, "auc_logistic": 0.8, "ci": [0.7, 0.9], "auc_boosting": 0.7, "floor_logistic": 0.5,
        "hard_paste_logistic": 0.99, "valid": False, "invalid_because": ["12 pairs"],
    }},
}  # fmt: skip


def written(folder: Path, name: str, content: Any) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(content if isinstance(content, str) else json.dumps(content))
    return folder


def test_reports_are_found_in_the_run_and_in_named_folders(tmp_path: Path) -> None:
    run = tmp_path / "run"
    picture(written(run / "realism", "realism.json", REALISM) / "car_random.png", 1)
    evaluation = written(tmp_path / "evaluation", "evaluation.json", EVALUATION)
    picture(evaluation / "plots/pr.png", 2)
    damaged = written(tmp_path / "damaged", "evaluation.json", "{")
    found = find_results(run, [evaluation, damaged, tmp_path / "nothing"])
    assert [r.title for r in found.reports] == ["Realism: realism", "Evaluation: evaluation"]
    assert any("not valid: 12 pairs" in line for line in found.reports[0].lines)
    by_class, by_size = found.reports[1].tables
    assert by_class.rows[0] == ("Car", "1", "4", "0.500", "0.250", "0.400", "0.200")
    assert [row[0] for row in by_size.rows] == ["8-16", ">=128"]
    assert ["cannot be read" in text for text in found.unreadable] == [True, False]
    assert found.picture(1, 0)[1] == ".png"


def test_an_experiment_without_detectors_has_no_table(tmp_path: Path) -> None:
    record = {"experiment": "datasets", "title": "Datasets", "scale": "small", "status": "complete", "evaluations": {}}
    written(tmp_path / "pages", "datasets.json", record).joinpath("datasets.md").touch()
    (report,) = find_results(written(tmp_path / "run", "run.json", {}), [tmp_path / "pages"]).reports
    assert (report.title, report.tables, report.lines[0]) == ("Experiment: datasets", (), "Datasets")


def test_tables_of_small_objects_have_map10(tmp_path: Path) -> None:
    car = {**SCORES, "map10": 0.9}
    small = {**EVALUATION, "classes": {"Car": {**car, "median_px": 31.5}, "all": car}}
    (evaluation,) = find_results(
        written(tmp_path / "run", "run.json", {}), [written(tmp_path / "small", "evaluation.json", small)]
    ).reports
    by_class = evaluation.tables[0]
    assert by_class.head[5:7] == ("mAP10", "mAP50") and by_class.rows[0][5:7] == ("0.900", "0.400")
    both = {"a": {"classes": {"Car": {**car, "median_px": 32.0}}}, "b": {"classes": small["classes"]}}
    record = {"experiment": "few", "title": "Few", "scale": "small", "status": "complete", "evaluations": both}
    written(tmp_path / "pages", "few.json", record).joinpath("few.md").touch()
    (experiment,) = find_results(tmp_path / "run", [tmp_path / "pages"]).reports
    table = experiment.tables[0]
    assert table.head[:2] == ("evaluation", "class") and table.head[6:8] == ("mAP10", "mAP50")
    assert {row[0]: len(row) for row in table.rows} == dict.fromkeys(("a", "b"), len(table.head))


def test_a_run_that_was_removed_is_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"run: cannot be read .*opened"):
        find_results(tmp_path / "run")


def test_only_pictures_of_the_reports_are_served(tmp_path: Path) -> None:
    folder = written(tmp_path / "evaluation", "evaluation.json", EVALUATION)
    picture(tmp_path / "secret.png", 1)
    (folder / "plots").mkdir()
    (folder / "plots/link.png").symlink_to(tmp_path / "secret.png")
    found = find_results(tmp_path / "evaluation", [folder])
    for report, number in ((0, 0), (0, 1), (-1, 0), (3, 0)):
        with pytest.raises(DatasetError):
            found.picture(report, number)


def test_detections_are_matched_by_class_and_overlap() -> None:
    car, drone = RunLabel("Car", (10, 10, 20, 20)), RunLabel("drone", (40, 40, 50, 50), inserted=True)
    region = RunLabel("DontCare", (60, 60, 90, 90), ignore=True)
    exact, far, other = (10.0, 10.0, 20.0, 20.0), (30.0, 10.0, 40.0, 20.0), (70.0, 70.0, 75.0, 75.0)
    assert compare([("car", exact)], [car, drone, region]) == Disagreement(missed=1, false=0)
    assert compare([("car", exact), ("car", exact)], [car]) == Disagreement(missed=0, false=1), "one object, one hit"
    assert compare([("drone", exact), ("car", far)], [car]) == Disagreement(missed=1, false=2)
    assert compare([("car", other)], [region]) == Disagreement(missed=0, false=0)


def test_frames_are_sorted_by_the_disagreement_of_an_evaluation(tmp_path: Path) -> None:
    run = tmp_path / "run"
    objects = {"bbox": [[10, 10, 10, 10]], "category": ["Car"], "inserted": [False]}
    lines = [json.dumps({"file_name": f"{n}.png", "objects": objects}) for n in "abc"]
    written(run / "images/test", "metadata.jsonl", "\n".join(lines))
    boxes = [(1, [10, 10, 10, 10], 0.9), (2, [50, 50, 9, 9], 0.9), (2, [10, 10, 10, 10], 0.1)]
    predictions = {
        "task": "detect", "categories": [{"id": 1, "name": "car"}],
        "images": [{"id": k, "file_name": f"test/{n}.png", "width": 64, "height": 64} for k, n in ((1, "a"), (2, "b"))],
        "annotations": [{"image_id": i, "category_id": 1, "bbox": b, "score": s} for i, b, s in boxes],
    }  # fmt: skip
    evaluation = written(tmp_path / "evaluation", "evaluation.json", EVALUATION)
    written(evaluation, "predictions.json", predictions)
    images = [f"test/{n}.png" for n in "abc"]
    found = read_disagreement(evaluation, RunLabels(RunFolder(run)), images)
    assert found == {"test/a.png": Disagreement(0, 0), "test/b.png": Disagreement(1, 1)}
    rows = [FrameRow(f"test/{n}_c0", image=f"test/{n}.png") for n in "abc"]
    assert View(sort="disagreement", descending=True).apply(rows, {}, found) == [1, 0, 2]
    with pytest.raises(DatasetError, match="not an evaluation"):
        read_disagreement(run, RunLabels(RunFolder(run)), images)
