"""Experiments: files, stages by content, sharing, interruption, pages. Training and evaluation are faked here."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack, nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import infrablend.lab.experiments
from infrablend import api
from infrablend.cli import main
from infrablend.config.loading import load_recipe
from infrablend.core.dataset import Dataset
from infrablend.core.files import sha256_of
from infrablend.core.workspace import workspace
from infrablend.errors import (
    DatasetError,
    FetchError,
    Interrupted,
    MissingDependencyError,
    ModelError,
    OtherSettingsError,
    OutputError,
    RecipeError,
)
from infrablend.lab.evaluation.evaluation_settings import EvaluationSettings
from infrablend.lab.experiments import experiment_forecast, makers
from infrablend.lab.experiments.definition import Check, Generate, list_experiments, load_experiment, parse_experiment
from infrablend.lab.experiments.experiment_request import DEFAULT_RESULTS, ExperimentRequest
from infrablend.lab.experiments.graph import preset_inputs, preset_of
from infrablend.lab.experiments.prepare import prepare_experiment
from infrablend.lab.experiments.results import check_claim
from infrablend.lab.experiments.stage import RECORD, Stage, spread_images, stage_folder, stage_keys
from infrablend.lab.pages import write_results
from infrablend.lab.pages.experiment_page import list_differences, page_text
from infrablend.lab.pages.write_results import write_page
from infrablend.lab.training.presets import PRESETS, cpu_threads
from infrablend.lab.training.train_request import TrainRequest
from infrablend.pipeline.plans import scenes
from infrablend.pipeline.plans.run_request import Execution
from tests.weights_files import write_weights

RUN = {"scale": "smoke", "renderer": "flat", "workers": 1}
HEAD = "name: few\ntitle: t\ndescription: d\nsources: {hit-uav: {format: hit-uav, title: H}}\n"
SHIPPED = Path(infrablend.lab.experiments.__file__).parent / "shipped"


class Bench:
    """Fake training, evaluation and comparison that count their calls.

    The figures of a detector follow from the number of objects it was trained on.
    """

    def __init__(self) -> None:
        self.trained: list[Path] = []
        self.evaluated: list[Path] = []
        self.compared: list[tuple[int, int]] = []
        self.stop: Callable[[str], None] = lambda what: None

    def train(self, dataset: Dataset, out: Path, request: TrainRequest, **options: Any) -> Any:
        self.stop("train")
        self.trained.append(out)
        images = [i for i in dataset.images if i.split == "train"]
        names = [c.name for c in dataset.categories if not c.ignore]
        objects = {n: sum(o.category == n for i in images for o in i.instances) for n in names}
        out.mkdir(parents=True, exist_ok=True)
        record = {
            "infrablend": "x",
            "preset": request.preset,
            "task": request.task,
            "seed": request.seed,
            "classes": names,
            "settings": json.loads(json.dumps(preset_inputs(request.fitted_to(dataset).chosen_preset()))),
            "start_asked": request.weights,
            "prepared": {
                "images": 8,
                "pictures": {"train": len(images)},
                "objects": {"train": {n: k for n, k in objects.items() if k}},
            },
            "start": {"model": "yolov8n.yaml", "kind": "scratch", "why": ""},
            "device": "cpu",
            "threads": 2,
            "passes": 8,
            "epochs": 1,
            "epochs_done": 1,
            "seconds": 1.5,
        }
        (out / "weights.pt").write_text(json.dumps([names, sum(objects.values())]))
        (out / "train.json").write_text(json.dumps(record))
        return SimpleNamespace(out=out, weights=out / "weights.pt", record=record)

    def evaluate(self, weights: Path, dataset: Dataset, out: Path, settings: EvaluationSettings, **options: Any) -> Any:
        self.stop("evaluate")
        self.evaluated.append(out)
        names, worth = json.loads(weights.read_text())
        images = [i for i in dataset.images if i.split == settings.split]
        chosen = settings.classes or names
        value = round(worth / 100, 6)
        of_all = {"p": value, "r": value, "map50": value, "map50_95": value / 2}
        ci = {"map50": [value - 0.01, value + 0.01], "map50_95": [value / 2 - 0.01, value / 2 + 0.01]}
        targets = {"as_one50": 0.75, "found": 0.9, "named": 0.625, "false_alarms": 2.5}
        table = {
            n: {"images": len(images), "instances": 1, **of_all, **targets, "ci": ci}
            for n in ("all", *(c for c in names if c.casefold() in {x.casefold() for x in chosen}))
        }
        metrics = {
            "classes": table,
            "ultralytics": dict.fromkeys(table, of_all),
            "strata": {"time": {"day": {"images": 1, "classes": {"all": {"instances": 3, **of_all}}}}},
            "curves": {"recall": [0.0, 1.0], "precision": {n: [1.0, 0.5] for n in table if n != "all"}},
        }
        out.mkdir(parents=True)
        if settings.list_first:
            hit = {"image": "test/a", "class": "Car", "box": [1, 2, 3, 4], "rank": 1, "score": 0.9, "iou": 0.5}
            miss = {**hit, "box": [5, 6, 7, 8], "rank": None, "score": None, "iou": None}
            listed = {"first": settings.list_first, "iou": settings.list_iou, "detections": 7, "found": 1}
            metrics["first_detections"] = {**listed, "objects": [hit, miss]}
        (out / "evaluation.json").write_text(json.dumps(metrics))
        (out / "predictions.json").write_text("{}")
        return SimpleNamespace(out=out, metrics=metrics)

    def compare(self, ours: list[Path], theirs: list[Path], **options: Any) -> Any:
        self.compared.append((len(ours), len(theirs)))
        a, b = (json.loads((p[0] / "evaluation.json").read_text())["classes"] for p in (ours, theirs))
        both = [n for n in a if n in b]
        found = {n: {k: a[n][k] - b[n][k] for k in ("map50", "map50_95")} for n in both}
        return {
            "classes": {
                n: {k: {"difference": d, "ci": [d - 0.02, d + 0.02], "same_sign": 1.0} for k, d in of.items()}
                for n, of in found.items()
            },
            "left_out": [],
        }


@pytest.fixture
def bench(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Bench:
    found = Bench()
    monkeypatch.setattr(makers, "train_dataset", found.train)
    monkeypatch.setattr(makers, "evaluate_detector", found.evaluate)
    monkeypatch.setattr(makers, "compare_evaluations", found.compare)
    monkeypatch.setattr(experiment_forecast, "require_trainer", lambda device: None)
    if "charts" not in request.fixturenames:
        monkeypatch.setattr(write_results, "draw_plots", lambda facts: [])
    return found


@pytest.fixture
def data(write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> Path:
    return write_tiny_hit_uav(tmp_path / "hit-uav")


def run(name: str, data: Path | list[Path], work: Path, **more: Any) -> Any:
    on_stage = more.pop("on_stage", None)
    folders = tuple(data) if isinstance(data, list) else (data,)
    request = ExperimentRequest(name, folders, work, work / "results", **{**RUN, **more})
    return api.experiment(request, on_stage=on_stage)


def plan(name: str, data: Path, work: Path, results: Path | None = None, **more: Any) -> Any:
    return api.plan_experiment(ExperimentRequest(name, (data,), work, results, **{"scale": "smoke", **more}))


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# The files.


def test_every_shipped_experiment_is_whole() -> None:
    assert {
        "datasets", "hit-uav", "hit-uav-drone", "leak-free", "mix", "monet-deer", "pitch-alignment", "transfer-car",
        "transfer-car-by-date", "transfer-deer", "transfer-drone", "transfer-person", "visible-vs-thermal",
    } <= set(list_experiments())  # fmt: skip
    for name in list_experiments():
        loaded = load_experiment(name)
        assert loaded.name == name
        for item in loaded.data.values():
            if item.kind == "generate":
                load_recipe(item.recipe, item.settings)


def test_the_papers_figures_of_the_pitch_stand_in_the_file() -> None:
    rows = {r.title: r.paper for r in load_experiment("pitch-alignment").tables[0].rows}
    assert [rows[t].map50_95 for t in ("Fixed at 0°", "Random [0°, 90°]", "Metadata aligned")] == [0.133, 0.910, 0.964]


def test_paths_in_settings_are_relative_to_the_file(tmp_path: Path) -> None:
    settings = "{objects.0.model: fox.yaml, sensor.profile: p.json, objects.1.model: drone, name: a.yaml}"
    text = f"{HEAD}data: {{a: {{kind: generate, of: hit-uav, recipe: hit-uav-drone, settings: {settings}}}}}\n"
    (tmp_path / "few.yaml").write_text(text)
    item = load_experiment(tmp_path / "few.yaml").data["a"]
    assert isinstance(item, Generate) and item.settings == {
        "objects.0.model": str(tmp_path / "fox.yaml"),
        "sensor.profile": str(tmp_path / "p.json"),
        "objects.1.model": "drone",
        "name": "a.yaml",
    }


def test_all_faults_of_a_file_are_reported_at_once() -> None:
    text = """
name: mine
titel: x
description: d
sources: {hit-uav: {format: hit-uav, title: HIT-UAV, limit: 3}}
trainings: {a: {data: hit-uav, task: guess}}
"""
    with pytest.raises(RecipeError) as caught:
        parse_experiment(text, "mine.yaml")
    where = {p.where for p in caught.value.problems}
    assert {"titel", "title", "sources.hit-uav.limit", "trainings.a.task"} <= where


@pytest.mark.parametrize(
    ("more", "what"),
    [
        ("data: {x: {kind: convert, of: nobody}}", "data.x: no source or data nobody"),
        ("data: {x: {kind: merge, parts: [{of: nobody}]}}", "data.x: no source or data nobody"),
        ("data: {x: {kind: paste, of: hit-uav, category: c, like: hit-uav}}", "data.x.like: hit-uav is no data item"),
        ("trainings: {x: {data: nobody}}", "trainings.x.data: no source or data nobody"),
        ("evaluations: {x: {training: nobody, data: hit-uav}}", "evaluations.x.training: no training nobody"),
        ("comparisons: {x: {a: nobody, b: nobody}}", "comparisons.x: no evaluation nobody"),
        ("tables: [{title: T, rows: [{title: R, evaluation: nobody}]}]", "tables.0: R: no evaluation nobody"),
        ("facts: [{title: T, data: [nobody]}]", "facts.0.data: no source or data nobody"),
        ("checks: [{text: T, comparison: nobody, expect: below}]", "checks.0.comparison: no comparison nobody"),
        ("only_at: {nobody: [paper]}", "only_at: no stage nobody"),
        ("trainings: {x: {data: hit-uav, seeds: 2}, x-1: {data: hit-uav}}", "trainings.x: its seeds include x-1"),
    ],
)
def test_names_of_missing_files_are_reported(more: str, what: str) -> None:
    with pytest.raises(RecipeError, match=what.replace("[", r"\[")):
        parse_experiment(HEAD + more, "m.yaml")


def test_unknown_experiment_lists_the_known_ones(data: Path, tmp_path: Path) -> None:
    with pytest.raises(RecipeError, match=r"neither a shipped experiment nor a YAML file.*pitch-alignment"):
        run("pitch", data, tmp_path / "w")


def test_circular_data_items_are_refused(data: Path, tmp_path: Path, bench: Bench) -> None:
    path = tmp_path / "round.yaml"
    path.write_text(HEAD + "data: {a: {kind: convert, of: b}, b: {kind: convert, of: a}}\n")
    with pytest.raises(DatasetError, match="circle"):
        run(str(path), data, tmp_path / "w")


# A run.


def test_the_page_lists_objects_found_and_missed(bench: Bench, data: Path, tmp_path: Path) -> None:
    path = tmp_path / "few.yaml"
    path.write_text(
        HEAD + "trainings: {t: {data: hit-uav}}\n"
        "evaluations: {plain: {training: t, data: hit-uav}, few: {training: t, data: hit-uav, list_first: 9}}\n"
    )
    page = run(str(path), data, tmp_path / "w").page.read_text("utf-8")
    assert "## Found and missed: `few`" in page and "`plain`\n\n1 of 2" not in page
    assert "1 of 2 objects are among the 7 detections with the highest scores (IoU at least 0.3)." in page
    assert "| test/a | Car | 1, 2, 3, 4 | 1 | 0.900 | 0.50 |" in page
    assert "| test/a | Car | 5, 6, 7, 8 | missed |  |  |" in page


def test_tables_and_ratios_take_figures_of_small_targets(bench: Bench, data: Path, tmp_path: Path) -> None:
    path = tmp_path / "few.yaml"
    path.write_text(
        HEAD + "trainings: {t: {data: hit-uav}}\n"
        "evaluations: {plain: {training: t, data: hit-uav}, bodies: {training: t, data: hit-uav, by_body: true}}\n"
        "tables:\n"
        "  - {title: Plain, evaluation: plain, rows: [{title: first, paper: {p: 0.5}}]}\n"
        "  - title: Small\n"
        "    columns: [as_one50, found, named, false_alarms]\n"
        "    rows: [{title: second, evaluation: plain}]\n"
        "checks:\n"
        "  - {text: c, ratio: [plain, bodies], metric: found, expect: at_least, least: 0.8}\n"
    )
    report = run(str(path), data, tmp_path / "w")
    page = report.page.read_text("utf-8")
    assert "| Images | Instances | P | R | mAP50 | mAP50-95 |" in page
    head = "AP50, classes as one | found | named of found | false alarms a picture at recall 0.8 |"
    assert head in page
    assert "| 0.750 | 0.900 | 0.625 | 2.500 |" in page
    assert "| all, found |" in page and "1.000 = 0.900 / 0.900" in page
    assert len(bench.evaluated) == 2  # other settings are another stage


def test_run_writes_a_page_and_repeating_it_does_nothing(bench: Bench, data: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    news: list[tuple[str, str]] = []
    report = run("pitch-alignment", data, work, on_stage=lambda *n: news.append(n[:2]))
    assert report.status == "complete" and report.ok
    assert len(bench.trained) == 3 and len(bench.evaluated) == 3
    assert ("train:fixed", "done") in news
    page = report.page.read_text("utf-8")
    assert report.page.name == "pitch-alignment-smoke.md"
    assert "0.133 → " in page and "A fixed pitch of 0° is worse than a random pitch" in page
    assert "What differs from the paper" in page and "seed" in page and "numpy" in page
    assert str(tmp_path) not in page and str(tmp_path) not in report.page.with_suffix(".json").read_text("utf-8")
    facts = json.loads(report.page.with_suffix(".json").read_text("utf-8"))
    assert facts["scale"] == "smoke" and facts["command"] == (
        "infrablend experiment pitch-alignment --scale smoke --data hit-uav"
    )
    assert all(c["holds"] is None for c in facts["checks"])  # smoke gives no verdicts
    before = files_of(work)
    again = run("pitch-alignment", data, work)
    assert again.made == () and len(bench.trained) == 3
    assert files_of(work) == before


def test_the_page_names_start_weights_and_what_was_found(bench: Bench, data: Path, tmp_path: Path) -> None:
    write_weights(tmp_path / "start.pt")
    report = run("hit-uav-drone", data, tmp_path / "work", weights=str(tmp_path / "start.pt"))
    assert " --scale smoke --weights start.pt --data hit-uav\n" in report.page.read_text("utf-8")
    (row,) = {r["evaluation"]: r for t in report.facts["tables"] for r in t["rows"]}.values()
    row["means_of"] = ["aligned", "aligned-1"]
    for name, found in (("aligned", 1), ("aligned-1", 3)):
        by = {"size": {"8-16": {"objects": 5, "found": found}}, "visibility": {"<0.5": {"objects": 0, "found": 0}}}
        report.facts["evaluations"][name] = report.facts["evaluations"]["aligned"] | {"targets": {"by": by}}
    page = page_text(report.facts)
    assert "|  | 8-16 px | <0.5 visible |" in page and "| `aligned` | 0.40 of 10 | - |" in page


def test_the_page_says_when_published_weights_were_not_found(bench: Bench, data: Path, tmp_path: Path) -> None:
    facts = run("hit-uav-drone", data, tmp_path / "work").facts
    training = facts["trainings"]["aligned"] | {"threads": 1}

    def page(why: str) -> str:
        start = {"model": "yolov8n.yaml", "kind": "scratch", "why": why}
        return page_text(facts | {"trainings": {"aligned": {**training, "start": start}}})

    assert "add `--weights scratch`" in page("yolov8n.pt is not available")
    assert "add `--weights scratch`" not in page("requested")
    assert "trained in 1.5 s with 1 thread." in page("requested")


def test_only_what_is_needed_is_generated(bench: Bench, data: Path, tmp_path: Path) -> None:
    report = run("pitch-alignment", data, tmp_path / "work")
    images = {s["stage"]: s["images"] for s in report.facts["stages"]}
    # 2 train, 1 val, 1 test, two scenes each.
    assert (images["generate:fixed"], images["generate:aligned"], images["generate:aligned-test"]) == (6, 6, 2)
    for stage in ("fixed", "aligned"):
        coco = folder_of(tmp_path / "work", "generate", stage) / "out" / "coco"
        assert {p.stem for p in coco.glob("*.json")} == {"train", "val"}


def folder_of(work: Path, kind: str, name: str) -> Path:
    (found,) = [p for p in (work / kind).iterdir() if json.loads((p / RECORD).read_text())["name"] == name]
    return found


def test_experiments_share_what_is_the_same(bench: Bench, data: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    run("pitch-alignment", data, work)
    report = run("hit-uav-drone", data, work)
    assert report.made == () and "train:aligned" in report.reused
    more = run("hit-uav", data, work)
    assert set(more.made) == {
        "train:original", "evaluate:original", "evaluate:aligned-on-original", "compare:added-class",
    }  # fmt: skip


def test_joint_classes_are_those_of_detector_and_images(bench: Bench, data: Path, tmp_path: Path) -> None:
    report = run("hit-uav", data, tmp_path / "work")
    # The only test image shows an OtherVehicle; the detector knows all five classes.
    assert set(report.facts["evaluations"]["aligned-on-original"]["classes"]) == {"all", "OtherVehicle"}
    assert set(report.facts["comparisons"]["added-class"]["classes"]) == {"all", "OtherVehicle"}


@pytest.mark.parametrize("where", ["train", "evaluate"])
def test_interrupted_run_is_reported_and_resumes(bench: Bench, data: Path, tmp_path: Path, where: str) -> None:
    work = tmp_path / "work"
    calls = []

    def stop(what: str) -> None:
        calls.append(what)
        if calls.count(where) == 2 and what == where:
            raise Interrupted("Stopped; the same command with --resume begins it again.")

    bench.stop = stop
    with pytest.raises(Interrupted, match=r"Run the same command to continue\.$"):
        run("pitch-alignment", data, work)
    page = (work / "results" / "pitch-alignment-smoke.md").read_text("utf-8")
    assert "This run is not finished" in page and f"`{where}:fixed`" in page
    bench.stop = lambda what: None
    before = len(bench.trained)
    report = run("pitch-alignment", data, work)
    assert report.status == "complete"
    assert len(bench.trained) - before == (2 if where == "train" else 0)


KILLED = """
import os, signal, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from infrablend import api
from infrablend.lab.experiments import experiment_forecast, makers
from infrablend.lab.pages import write_results
from tests.lab.experiments.test_experiment import Bench, run
bench = Bench()
calls = []
def killing(name, function):
    def call(*args, **kwargs):
        calls.append(name)
        if name == {at!r} and calls.count(name) == 2:
            function(*args, **kwargs)  # done, but not recorded
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*args, **kwargs)
    return call
makers.train_dataset = killing("train", bench.train)
makers.evaluate_detector = killing("evaluate", bench.evaluate)
makers.run_request = killing("generate", makers.run_request)
makers.compare_evaluations = killing("compare", bench.compare)
experiment_forecast.require_trainer = lambda device: None
write_results.draw_plots = lambda facts: []
run("pitch-alignment", Path({data!r}), Path({work!r}))
"""


def test_a_run_killed_in_one_stage_after_the_other_resumes(bench: Bench, data: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    root = Path(__file__).resolve().parents[3]
    for at in ("generate", "train", "evaluate", "compare"):
        code = KILLED.format(tests=str(root), at=at, data=str(data), work=str(work))
        done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=False)
        assert done.returncode == -9, done.stderr
    report = run("pitch-alignment", data, work)
    assert report.status == "complete" and report.reused and report.made
    whole = run("pitch-alignment", data, tmp_path / "other")
    figures = ("evaluations", "comparisons", "tables", "checks")
    assert {k: report.facts[k] for k in figures} == {k: whole.facts[k] for k in figures}
    keys = [[s["key"] for s in r.facts["stages"]] for r in (report, whole)]
    assert keys[0] == keys[1]


def test_a_stage_that_another_process_makes_comes_later(
    bench: Bench, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = tmp_path / "work"
    news: list[tuple[str, str]] = []
    graph = prepare_experiment(ExperimentRequest("pitch-alignment", (data,), work, **RUN)).graph
    folder = stage_folder(work, graph.by_id["train:fixed"], graph.keys["train:fixed"])
    with ExitStack() as other:
        other.enter_context(workspace(folder, "stage train:fixed", RECORD, keep=True))

        def ends(seconds: float) -> None:
            assert news[-1] == ("compare:aligned-random", "done")  # all others are made
            other.close()

        monkeypatch.setattr("infrablend.lab.experiments.run_experiment.time.sleep", ends)
        report = run("pitch-alignment", data, work, on_stage=lambda *n: news.append(n[:2]))
    assert report.status == "complete"
    of_fixed = [event for stage, event in news if stage == "train:fixed"]
    assert of_fixed == ["started", "waiting", "done"]
    assert news.index(("train:fixed", "done")) < news.index(("evaluate:fixed", "started"))


def test_interrupted_stage_with_other_settings_starts_again(
    bench: Bench, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if an earlier version had started it."""
    asked: list[tuple[str, str]] = []

    def refusing(name: str, make: Callable[..., Any]) -> Callable[..., Any]:
        def call(first: Any, *rest: Any, **options: Any) -> Any:
            existing = options.get("existing") or first.existing
            asked.append((name, existing))
            if existing == "resume":
                raise OtherSettingsError("was started with other settings")
            return make(first, *rest, **options)

        return call

    monkeypatch.setattr(makers, "train_dataset", refusing("train", bench.train))
    monkeypatch.setattr(makers, "run_request", refusing("generate", makers.run_request))
    assert run("hit-uav-drone", data, tmp_path / "work").status == "complete"
    assert {("train", "resume"), ("train", "overwrite"), ("generate", "resume"), ("generate", "overwrite")} == {*asked}


def test_interrupted_run_counts_all_finished_frames(bench: Bench, data: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    run("pitch-alignment", data, work)
    gone = folder_of(work, "train", "fixed")
    shutil.rmtree(gone)

    def stop(what: str) -> None:
        raise Interrupted("Stopped.")

    bench.stop = stop
    with pytest.raises(Interrupted, match="13 of 14 stages are done"):  # several come after the one that is missing
        run("pitch-alignment", data, work, only=["train"])


def test_page_reports_a_failed_stage(bench: Bench, data: Path, tmp_path: Path) -> None:
    def fail(what: str) -> None:
        if what == "evaluate":
            raise DatasetError("no such thing")

    bench.stop = fail
    with pytest.raises(DatasetError, match="no such thing"):
        run("hit-uav-drone", data, tmp_path / "work")
    page = (tmp_path / "work" / "results" / "hit-uav-drone-smoke.md").read_text("utf-8")
    assert "It stopped: DatasetError: evaluate:aligned" in page


def test_selected_stages_include_their_dependencies(bench: Bench, data: Path, tmp_path: Path) -> None:
    report = run("pitch-alignment", data, tmp_path / "work", only=["train:fixed"])
    assert report.made == ("source:hit-uav", "generate:fixed", "train:fixed") and report.status == "unfinished"
    with pytest.raises(DatasetError, match="no such stage") as caught:
        run("pitch-alignment", data, tmp_path / "work", only=["train:foxed"])
    assert "train:fixed" in caught.value.problems[0].expected


def test_data_of_a_finished_training_are_not_regenerated(bench: Bench, data: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    run("pitch-alignment", data, work)
    gone = folder_of(work, "generate", "fixed")
    shutil.rmtree(gone)
    report = run("pitch-alignment", data, work)
    assert report.made == () and report.status == "complete" and not gone.exists()
    assert {s["stage"]: s["status"] for s in report.facts["stages"]}["generate:fixed"] == "not needed"


def test_data_whose_folder_is_gone_are_made_again(bench: Bench, data: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    run("pitch-alignment", data, work)
    stage = folder_of(work, "generate", "fixed")
    labels = stage / "out" / "coco" / "train.json"
    whole = labels.read_bytes()
    shutil.rmtree(labels.parent)
    shutil.rmtree(work / "train")
    report = run("pitch-alignment", data, work)
    assert report.status == "complete" and "generate:fixed" in report.made
    assert labels.read_bytes() == whole


# Keys.


def test_keys_and_folders_of_finished_stages_stay_valid(tmp_path: Path) -> None:
    """Finished stages are found by these keys: a change would make every user repeat every training."""
    chain = [
        Stage("world", "town", {"layout": "hit-uav", "images": 8, "seed": 0, "version": "0.1.0"}, {}),
        Stage("source", "town", {"limits": {"train": 4}}, {"of": "world:town"}),
        Stage("generate", "run", {"recipe": {"name": "x"}, "splits": ["train"], "seed": 0}, {"of": "source:town"}),
        Stage("convert", "part", {"only": "drone", "splits": ["train"], "seed": 0}, {"of": "generate:run"}),
        Stage("split", "dates", {"by": "date", "gap": None, "shares": [0.7, 0.1, 0.2]}, {"of": "source:town"}),
        Stage("train", "a", {"preset": {"epochs": 1}, "seed": 0, "weights": "auto"}, {"data": "convert:part"}),
        Stage("evaluate", "a", {"split": "test", "bootstrap": 9}, {"training": "train:a", "data": "split:dates"}),
        Stage("compare", "aa", {"bootstrap": 9, "seed": 0}, {"a": "evaluate:a", "b": "evaluate:a"}),
    ]
    keys = stage_keys(chain)
    assert keys == PINNED_KEYS
    assert stage_folder(tmp_path, chain[5], keys["train:a"]) == tmp_path / "train" / keys["train:a"]
    assert RECORD == "stage.json"


PINNED_KEYS = {
    "world:town": "81ff0957bf684635",
    "source:town": "8e78b60f022cf6b1",
    "generate:run": "930df668961ee733",
    "convert:part": "d4220a5febd71675",
    "split:dates": "11aad7823a427131",
    "train:a": "3e99774b396f2601",
    "evaluate:a": "af877eae6f25297b",
    "compare:aa": "281096c80df7c430",
}


def keys(name: str, data: Path, tmp_path: Path, **more: Any) -> dict[str, str]:
    facts = plan(name, data, tmp_path / "none", **{"renderer": "flat", **more}).facts
    return {s["stage"]: s["key"] for s in facts["stages"]}


def test_keys_follow_seed_recipe_and_data(data: Path, tmp_path: Path) -> None:
    one = keys("pitch-alignment", data, tmp_path)
    assert one == keys("pitch-alignment", data, tmp_path)
    assert len(set(one.values())) == len(one)
    other = keys("pitch-alignment", data, tmp_path, seed=1)
    assert one["source:hit-uav"] == other["source:hit-uav"]
    assert not {k for k in one if one[k] == other[k]} - {"source:hit-uav"}
    drone = keys("hit-uav-drone", data, tmp_path)
    assert drone["evaluate:aligned"] == one["evaluate:aligned"]

    mine = tmp_path / "mine.yaml"
    text = (SHIPPED / "hit-uav-drone.yaml").read_text()
    mine.write_text(text.replace("recipe: hit-uav-drone,", "recipe: hit-uav-drone, settings: {camera.roll_deg: 3},"))
    changed = keys(str(mine), data, tmp_path)
    assert changed["source:hit-uav"] == drone["source:hit-uav"]
    assert all(changed[k] != drone[k] for k in drone if k != "source:hit-uav")

    weights = tmp_path / "start.pt"
    start = text.replace("{data: aligned, paper_images: 4058}", f"{{data: aligned, weights: {weights}}}")
    assert start != text
    mine.write_text(start)
    by_content = []
    for network in ("yolov5n", "yolov8n"):
        write_weights(weights, network=network)
        by_content.append(keys(str(mine), data, tmp_path)["train:aligned"])
    assert len(set(by_content)) == 2

    picture = next((data / "rotate_json" / "train").glob("*.jpg"))
    for form in ("rotate_json", "normal_json"):  # the same picture, another pixel
        path = data / form / "train" / picture.name
        path.write_bytes(path.read_bytes()[:-2] + b"\x00\xff\xd9")
    pixels = keys("pitch-alignment", data, tmp_path)
    assert all(pixels[k] != one[k] for k in one)


def test_plan_writes_nothing_and_lists_finished_stages(bench: Bench, data: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    facts = plan("pitch-alignment", data, work, renderer="flat").facts
    assert not work.exists()
    assert facts["to_do"] == len(facts["stages"]) == 14
    assert facts["about_s"] > 0 and facts["disk_bytes"] > 0
    run("hit-uav-drone", data, work)
    before = files_of(work)
    facts = plan("pitch-alignment", data, work, renderer="flat").facts
    assert files_of(work) == before
    status = {s["stage"]: s["status"] for s in facts["stages"]}
    assert status["train:aligned"] == "done" and status["train:fixed"] == "to do"
    small = plan("pitch-alignment", data, work, scale="small").facts
    assert next(s for s in small["stages"] if s["stage"] == "train:fixed")["training"]["passes"] > 1000


def test_plan_learns_from_stages_of_this_machine_alone(
    bench: Bench, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run("pitch-alignment", data, tmp_path / "work")
    trained = {}
    for threads in ("1", "2"):
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        trained[threads] = [
            kind for kind, _ in experiment_forecast.measured_rates(tmp_path / "work") if kind == "train"
        ]
    assert trained == {"1": [], "2": ["train"]}
    for record in (tmp_path / "work").glob("*/*/stage.json"):
        facts = json.loads(record.read_text())
        facts["machine"]["cores"] += 14
        record.write_text(json.dumps(facts))
    assert not experiment_forecast.measured_rates(tmp_path / "work")


def test_plan_matches_the_run_of_the_same_command(bench: Bench, data: Path, tmp_path: Path) -> None:
    def statuses(**more: Any) -> dict[str, Any]:
        facts = plan("pitch-alignment", data, tmp_path / "work", **more).facts
        return {s["stage"]: s["status"] for s in facts["stages"]} | {"to_do": facts["to_do"]}

    one = {"source:hit-uav": "to do", "generate:fixed": "to do", "train:fixed": "to do", "to_do": 3}
    assert statuses(only=["train:fixed"], renderer="flat") == one
    with pytest.raises(DatasetError, match=r"Did you mean train:fixed\?"):
        statuses(only=["train:foxed"])
    with pytest.raises(DatasetError, match=r"Did you mean train:fixed\?"):
        statuses(adopt={"train:foxed": data})
    with pytest.raises(DatasetError, match="a stage of evaluate; expected a stage of train"):
        statuses(adopt={"evaluate:fixed": data})
    with pytest.raises(DatasetError, match="generate:fixed is not finished"):
        statuses(adopt={"train:fixed": data})
    with pytest.raises(DatasetError, match="no such folder"):
        statuses(adopt={"generate:fixed": tmp_path / "nowhere"})
    taken = statuses(adopt={"generate:fixed": data, "train:fixed": data}, only=["evaluate:fixed"])
    assert (taken["train:fixed"], taken["generate:fixed"], taken["to_do"]) == ("adopted", "adopted", 3)
    with pytest.raises(OutputError, match="data folder"):
        plan("pitch-alignment", data, tmp_path / "work", data, scale="smoke")
    assert not (tmp_path / "work").exists()


def test_plan_requires_the_requested_device(
    bench: Bench, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(device: str) -> None:
        raise MissingDependencyError(f"no {device}")

    monkeypatch.setattr(experiment_forecast, "require_trainer", refuse)
    plan("pitch-alignment", data, tmp_path / "work", scale="smoke", device="cpu")
    with pytest.raises(MissingDependencyError, match="no cuda"):
        plan("pitch-alignment", data, tmp_path / "work", scale="smoke", device="cuda")
    plan("pitch-alignment", data, tmp_path / "work", scale="smoke", device="cuda", only=["generate"])


def test_misspelt_setting_is_refused_before_any_work(bench: Bench, data: Path, tmp_path: Path) -> None:
    pytest.importorskip("ultralytics")
    wrong = {"training": {"pases": 100}}
    with pytest.raises(OutputError, match="pases"):
        plan("pitch-alignment", data, tmp_path / "work", scale="smoke", **wrong)
    with pytest.raises(OutputError, match="pases"):
        run("pitch-alignment", data, tmp_path / "work", **wrong)
    assert not (tmp_path / "work").exists()
    plan("pitch-alignment", data, tmp_path / "work", scale="smoke", training={"passes": 100, "lr0": 0.1})


def test_the_users_settings_win_over_those_of_the_file() -> None:
    """The key and the trainer use the same preset."""
    spec = load_experiment("hit-uav").trainings["aligned-longer"]
    assert preset_of(ExperimentRequest("hit-uav"), spec).passes == 18840
    chosen = preset_of(ExperimentRequest("hit-uav", training={"passes": 4000}), spec)
    assert chosen.passes == 4000


def test_start_weights_of_the_request_count_by_content_wherever_they_lie(data: Path, tmp_path: Path) -> None:
    found = []
    for folder, network in (("a", "yolov5n"), ("b", "yolov5n"), ("c", "yolov8n")):
        given = str(write_weights(tmp_path / folder / "start.pt", network=network))
        found.append(keys("hit-uav-drone", data, tmp_path, scale="medium", weights=given)["train:aligned"])
    assert found[0] == found[1] != found[2]
    assert found[0] != keys("hit-uav-drone", data, tmp_path, scale="medium")["train:aligned"]
    with pytest.raises(FetchError, match=r"no such file; expected a \.pt file"):
        plan("hit-uav-drone", data, tmp_path / "w", weights=str(tmp_path / "nothing.pt.zip"))


def test_a_training_with_a_network_of_its_own_does_not_start_from_given_weights(data: Path, tmp_path: Path) -> None:
    given = write_weights(tmp_path / "start.pt", network="yolov5n")
    request = ExperimentRequest("detectability", [data], tmp_path / "w", scale="small", weights=str(given))
    graph = prepare_experiment(request).graph
    assert graph.by_id["train:real"].inputs["weights"] == "start.pt"
    assert graph.by_id["train:real-other"].inputs["weights"] == "auto"


def test_unfit_start_weights_are_refused_before_any_work(bench: Bench, data: Path, tmp_path: Path) -> None:
    mine, weights = tmp_path / "mine.yaml", write_weights(tmp_path / "start.pt", "OBB")
    text = (SHIPPED / "hit-uav-drone.yaml").read_text()
    mine.write_text(text.replace("{data: aligned, paper_images: 4058}", f"{{data: aligned, weights: {weights}}}"))
    for call in (plan, run):
        with pytest.raises(ModelError, match="weights for obb; expected detect"):
            call(str(mine), data, tmp_path / "work")
    weights.write_bytes(weights.read_bytes()[:-30])
    for call in (plan, run):
        with pytest.raises(ModelError, match="expected a complete"):
            call(str(mine), data, tmp_path / "work")
    assert not (tmp_path / "work").exists()


def test_plan_names_start_weights_and_their_network(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("INFRABLEND_LOG", str(tmp_path / "log.txt"))
    weights = write_weights(tmp_path / "start.pt")
    command = ["experiment", "hit-uav-drone", "--data", str(data), "--work", str(tmp_path / "w"), "--scale", "smoke",
               "--weights", str(weights), "--plan"]  # fmt: skip
    assert main(command) == 0
    assert "start.pt, their network yolov5n" in capsys.readouterr().out
    assert main([*command, "--json"]) == 0
    (row,) = [s for s in json.loads(capsys.readouterr().out)["stages"] if "training" in s]
    assert (row["weights"], row["network"]) == ("start.pt", "yolov5n")


def test_rates_are_those_of_a_network_and_weigh_trainings_by_their_images(
    bench: Bench, data: Path, tmp_path: Path
) -> None:
    run("pitch-alignment", data, tmp_path / "work")
    records = sorted((tmp_path / "work" / "train").glob("*/stage.json"))[:3]
    for path, (passes, seconds) in zip(records, ((8, 9), (100, 25), (100, 15)), strict=True):
        facts = json.loads(path.read_text())
        facts["result"]["record"] |= {"passes": passes, "seconds": seconds, "threads": cpu_threads()}
        path.write_text(json.dumps(facts))
    shutil.rmtree(tmp_path / "work" / "evaluate")
    rates = {k: rate for k, rate in experiment_forecast.measured_rates(tmp_path / "work").items() if k[0] == "train"}
    assert rates == {("train", "yolov8n 160"): pytest.approx((4 + 20 + 10) / 208)}
    facts["inputs"] |= {"weights": "start.pt", "weights_sha256": "5" * 64}
    path.write_text(json.dumps(facts))
    assert experiment_forecast.measured_rates(tmp_path / "work")["train", f"{'5' * 64} 160"] == pytest.approx(10 / 100)


def test_a_scale_that_an_experiment_lacks_is_refused(data: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="transfer-car has no scale medium; expected one of smoke, small, paper"):
        plan("transfer-car", data, tmp_path / "w", scale="medium")


def test_the_page_goes_to_the_current_folder_unless_another_is_named(tmp_path: Path) -> None:
    assert ExperimentRequest("hit-uav").results_folder == DEFAULT_RESULTS == Path("results")
    assert ExperimentRequest("hit-uav", work=tmp_path, scale="smoke").results_folder == tmp_path / "results"
    assert ExperimentRequest("hit-uav", results=tmp_path).results_folder == tmp_path
    with pytest.raises(DatasetError, match="expected one of smoke, small, medium, paper"):
        ExperimentRequest("hit-uav", scale="huge")  # type: ignore[arg-type]


def test_the_same_with_other_seeds(bench: Bench, data: Path, tmp_path: Path) -> None:
    """`seeds` adds trainings on the same data; the page states that a comparison has several."""
    text = (SHIPPED / "hit-uav.yaml").read_text()
    mine = tmp_path / "mine.yaml"
    text = text.replace(": [small]", ": [small, smoke]").replace("scales: [small]", "scales: [small, smoke]")
    mine.write_text(text.replace("{small: 3}", "{smoke: 3}"))
    one = keys(str(mine), data, tmp_path)
    assert len({one[f"train:{n}"] for n in ("original", "original-1", "original-2")}) == 3
    assert one["train:original"] == keys("hit-uav", data, tmp_path)["train:original"]  # as if there were no others

    report = run(str(mine), data, tmp_path / "work")
    trained = [json.loads(p.read_text()) for p in (tmp_path / "work").glob("train/*/out/train.json")]
    assert sorted(t["seed"] for t in trained) == [0, 0, 0, 1, 1, 2, 2]
    assert bench.compared.count((3, 3)) == 1
    facts = json.loads(report.page.with_suffix(".json").read_text())
    assert facts["comparisons"]["added-class-seeds"]["a"] == ["aligned-longer", "aligned-longer-1", "aligned-longer-2"]
    assert "the detectors are drawn as well" in report.page.read_text()
    assert "seed 2" in report.page.read_text()


@pytest.mark.parametrize("which", ["[aligned-longer, original]", "[original, aligned]"])
def test_only_evaluations_on_the_same_images_are_compared(which: str, data: Path, tmp_path: Path) -> None:
    text = (SHIPPED / "hit-uav.yaml").read_text()
    mine = tmp_path / "mine.yaml"
    mine.write_text(text.replace("b: original, title: trained with drones -", f"b: {which}, title: trained with -"))
    if "aligned]" in which:  # `aligned` is on other images
        with pytest.raises(DatasetError, match="the same images"):
            keys(str(mine), data, tmp_path, scale="small")
    else:
        assert "compare:added-class" in keys(str(mine), data, tmp_path, scale="small")


def test_merged_and_pasted_data_are_made_and_rows_show_means(bench: Bench, tmp_path: Path) -> None:
    """On drawn pictures of the sky, which stand in for both sources of `transfer-drone`."""
    text = (SHIPPED / "transfer-drone.yaml").read_text()
    mine = tmp_path / "mine.yaml"
    text = text.replace("{small: 3, paper: 3}", "3").replace("{train: 8, val: 2}", "{train: 3, val: 1}")
    mine.write_text(text.replace("settings:\n  small: {passes: 4000}", "settings:\n  smoke: {epochs: 3}"))
    report = run(str(mine), [], tmp_path / "work")
    assert report.status == "complete" and len(bench.trained) == 9 and bench.compared == [(3, 3), (3, 3)]
    trained = [json.loads(p.read_text()) for p in (tmp_path / "work").glob("train/*/out/train.json")]
    assert all(t["settings"]["epochs"] == 3 for t in trained)
    records = {p.parent.parent.name: json.loads(p.read_text()) for p in (tmp_path / "work").glob("*/*/stage.json")}
    pasted, real = (records[k]["result"] for k in ("paste", "merge"))
    made = [json.loads(p.read_text())["result"] for p in (tmp_path / "work").glob("generate/*/stage.json")]
    (inserted,) = (m for m in made if m["run"]["objects_inserted"] == pasted["pasted"]["objects"])  # drones alone
    assert pasted["labels"] == inserted["labels"] and pasted["pasted"]["left_out"] == 0
    assert pasted["pasted"]["objects"] == inserted["run"]["objects_inserted"] > 0
    assert real["images"] == {"train": 3 + 6, "val": 1} and real["labels"]["train"]["drone"] == 6
    row = report.facts["tables"][0]["rows"][0]
    assert row["means_of"] == ["inserted", "inserted-1", "inserted-2"] and set(row["ours"]["range"]) >= {"map50"}
    page = report.page.read_text("utf-8")
    assert "show means of 3 trainings" in page and "Control: no sensor chain" not in page
    assert "infrablend experiment transfer-drone --scale smoke\n" in page


# What does not fit.


def test_data_of_the_wrong_kind_are_refused(bench: Bench, data: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError) as caught:
        run("monet-deer", data, tmp_path / "w")
    (problem,) = caught.value.problems
    assert problem.found == "hit-uav" and "MONET" in problem.expected
    with pytest.raises(DatasetError, match="no HIT-UAV"):
        run("hit-uav", [], tmp_path / "w")
    with pytest.raises(DatasetError, match="no such folder"):
        run("hit-uav", tmp_path / "nowhere", tmp_path / "w")
    with pytest.raises(DatasetError, match="a second hit-uav"):
        run("hit-uav", [data, shutil.copytree(data, tmp_path / "copy")], tmp_path / "w")


def test_required_class_must_exist(bench: Bench, data: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text(HEAD.replace("title: H", "title: H, classes: [Zebra]") + "trainings: {a: {data: hit-uav}}\n")
    with pytest.raises(DatasetError, match="no label of Zebra"):
        run(str(mine), data, tmp_path / "w")


def test_empty_split_is_reported_before_any_work(bench: Bench, data: Path, tmp_path: Path) -> None:
    for form in ("rotate_json", "normal_json"):
        (data / form / "annotations" / "test.json").unlink()
        shutil.rmtree(data / form / "test")
    with pytest.raises(DatasetError, match="no image in test"):
        run("pitch-alignment", data, tmp_path / "w")
    assert not (tmp_path / "w").exists()


def test_lack_of_space_is_reported_before_any_work(
    bench: Bench, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1000))
    with pytest.raises(OutputError, match="not enough disk space") as caught:
        run("hit-uav-drone", data, tmp_path / "w")
    assert caught.value.problems[0].code == "disk-full" and not bench.trained


def test_without_a_trainer_nothing_starts(
    bench: Bench, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(device: str) -> None:
        raise MissingDependencyError('pip install "infrablend[train]"')

    monkeypatch.setattr(experiment_forecast, "require_trainer", refuse)
    with pytest.raises(MissingDependencyError):
        run("hit-uav-drone", data, tmp_path / "w")
    assert not (tmp_path / "w" / "generate").exists()
    assert run("datasets", data, tmp_path / "w").status == "complete"  # trains nothing


def test_the_work_folder_is_not_in_the_data(bench: Bench, data: Path) -> None:
    with pytest.raises(OutputError, match="inside the data folder"):
        run("hit-uav-drone", data, data / "work")


# Skipped stages and substitutes.


def test_missing_dataset_is_explained_and_other_stages_run(bench: Bench, data: Path, tmp_path: Path) -> None:
    report = run("visible-vs-thermal", data, tmp_path / "work")
    assert report.status == "complete"
    assert "github.com/wangdongdut/DUT-Anti-UAV" in report.facts["left_out"]["dut-anti-uav"]
    page = report.page.read_text("utf-8")
    assert "Complete for the data at hand." in page
    index = (report.page.parent / "index.md").read_text("utf-8")
    assert "| complete for the data at hand |" in index
    assert "0.429 → -" in page and "DUT-Anti-UAV: no folder of DUT-Anti-UAV was given" in page
    assert [p.code for p in report.problems] and len(bench.trained) == 1


def test_datasets_are_counted_without_training(bench: Bench, data: Path, tmp_path: Path) -> None:
    report = run("datasets", data, tmp_path / "work")
    rows = {d["title"]: d for d in report.facts["datasets"]}
    assert rows["HIT-UAV"]["ours"]["images"] == 4 and rows["HIT-UAV"]["ours"]["classes"] == 4
    drone = rows["HIT-UAV-drone"]["ours"]
    assert (drone["images"], drone["classes"], drone["labels"]) == (8, 5, ["AABB", "OBB", "Masks"])
    assert rows["HIT-UAV"]["ours"]["labels"] == ["AABB", "OBB"]
    assert rows["MONET"]["ours"] is None and "no folder of MONET" in rows["MONET"]["missing"]
    assert "2,898 → 4" in report.page.read_text("utf-8")
    assert not bench.trained


def test_a_part_of_a_source_holds_every_class(write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> None:
    dataset = api.read_dataset(write_tiny_hit_uav(tmp_path / "d"))
    some = list(spread_images(dataset, {"train": 1}))
    assert [i.split for i in some] == ["train", "val", "test"]
    assert {o.category for o in some[0].instances} == {"Car", "Person"}  # not the empty image


# What was made elsewhere.


def test_equal_training_from_elsewhere_is_adopted(bench: Bench, data: Path, tmp_path: Path) -> None:
    first = tmp_path / "first"
    run("hit-uav-drone", data, first)
    made, generated = folder_of(first, "train", "aligned"), folder_of(first, "generate", "aligned")
    trained = len(bench.trained)
    adopt = {"generate:aligned": generated / "out", "train:aligned": made / "out"}
    report = run("hit-uav-drone", data, tmp_path / "second", adopt=adopt)
    assert report.status == "complete" and len(bench.trained) == trained
    assert "adopted and checked" in report.page.read_text("utf-8")

    record = json.loads((made / "out" / "train.json").read_text())
    other = tmp_path / "other"
    other.mkdir()
    (other / "weights.pt").write_text("x")
    record["seed"], record["prepared"]["pictures"]["train"], record["start_asked"] = 7, 99, "scratch"
    record["passes"] = 4000
    (other / "train.json").write_text(json.dumps(record))
    with pytest.raises(DatasetError) as caught:
        run("hit-uav-drone", data, tmp_path / "third", adopt={**adopt, "train:aligned": other})
    assert {p.where for p in caught.value.problems} == {
        "train:aligned, seed", "train:aligned, images", "train:aligned, weights", "train:aligned, images shown",
    }  # fmt: skip
    weights = write_weights(tmp_path / "given" / "start.pt")
    record = json.loads((made / "out" / "train.json").read_text()) | {"start_asked": "elsewhere/start.pt"}
    for digest, differs in (
        ({}, False),
        ({"weights_sha256": sha256_of(weights)}, False),
        ({"weights_sha256": "0"}, True),
    ):
        (other / "train.json").write_text(json.dumps(record | digest))
        work = tmp_path / f"adopts{len(list(tmp_path.iterdir()))}"
        with pytest.raises(DatasetError) if differs else nullcontext() as caught:
            run("hit-uav-drone", data, work, weights=str(weights), adopt={**adopt, "train:aligned": other},
                only=["train:aligned"])  # fmt: skip
        assert not differs or [p.where for p in caught.value.problems] == ["train:aligned, SHA-256 of the weights"]
    with pytest.raises(DatasetError) as caught:
        run("hit-uav-drone", data, tmp_path / "fourth", seed=1, adopt={"generate:aligned": generated / "out"})
    assert {p.where for p in caught.value.problems} == {"generate:aligned, seed"}


def test_training_on_tiles_that_fit_small_pictures_is_adopted(
    bench: Bench, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PRESETS, "smoke", replace(PRESETS["smoke"], tile=2048, image_size=2048))
    first = tmp_path / "first"
    run("hit-uav-drone", data, first)
    trained, generated = (folder_of(first, kind, "aligned") / "out" for kind in ("train", "generate"))
    assert json.loads((trained / "train.json").read_text())["settings"]["tile"] == 512
    adopt = {"generate:aligned": generated, "train:aligned": trained}
    before = len(bench.trained)
    run("hit-uav-drone", data, tmp_path / "second", adopt=adopt, only=["train:aligned"])
    assert len(bench.trained) == before


def test_adopted_run_has_the_number_of_scenes_that_the_recipe_chooses(
    bench: Bench, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = tmp_path / "few.yaml"
    arm = "{kind: generate, of: hit-uav, recipe: hit-uav-drone, settings: {configurations: auto}, splits: [train]}"
    mine.write_text(f"{HEAD}data: {{a: {arm}}}\ntrainings: {{t: {{data: a}}}}\n")
    monkeypatch.setattr(scenes, "WANTED_OBJECTS", 6)
    run(str(mine), data, tmp_path / "first", only=["generate:a"])
    made = folder_of(tmp_path / "first", "generate", "a") / "out"
    assert json.loads((made / "run.json").read_text())["recipe"]["configurations"] == 3  # of two backgrounds
    adopt = {"generate:a": made}
    assert run(str(mine), data, tmp_path / "second", adopt=adopt, only=["generate:a"]).status
    monkeypatch.setattr(scenes, "WANTED_OBJECTS", 3)
    with pytest.raises(DatasetError) as caught:
        run(str(mine), data, tmp_path / "third", adopt=adopt, only=["generate:a"])
    assert [p.where for p in caught.value.problems] == ["generate:a, recipe"]


def test_finished_stage_is_not_adopted_and_that_is_reported(
    bench: Bench, data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run("hit-uav-drone", data, tmp_path / "work")
    report = run("hit-uav-drone", data, tmp_path / "work", adopt={"train:aligned": tmp_path})
    assert report.status == "complete" and report.made == ()
    assert [r.levelname for r in caplog.records if "--adopt train:aligned=" in r.message] == ["WARNING"]


def test_an_unfinished_run_leaves_a_complete_page_alone(bench: Bench, data: Path, tmp_path: Path) -> None:
    work = tmp_path / "work"
    report = run("hit-uav-drone", data, work)
    before = report.page.read_bytes()
    again = run("hit-uav-drone", data, work, seed=5, only=["source"])
    assert (again.status, again.page.name) == ("unfinished", report.page.stem + "-unfinished.md")
    assert report.page.read_bytes() == before
    assert f"[{again.page.stem}.json]" in again.page.read_text("utf-8")
    done = run("hit-uav-drone", data, work, seed=5)
    assert (done.status, done.page.name) == ("complete", report.page.name)
    assert not list(report.page.parent.glob("*-unfinished*"))
    assert "-unfinished" not in (report.page.parent / "index.md").read_text("utf-8")


# Conclusions and the page.


def difference(low: float, high: float) -> dict[str, Any]:
    found = {"difference": (low + high) / 2, "ci": [low, high], "same_sign": 1.0}
    return {"c": {"classes": {"drone": {"map50_95": found}}}}


@pytest.mark.parametrize(
    ("expect", "low", "high", "holds"),
    [
        ("below", -0.2, -0.1, True),
        ("below", -0.2, 0.1, False),
        ("above", 0.1, 0.2, True),
        ("above", -0.1, 0.2, False),
        ("within", -0.1, 0.1, True),
        ("within", 0.01, 0.1, False),
        ("not_below", -0.1, 0.1, True),
        ("not_below", 0.05, 0.1, True),
        ("not_below", -0.2, -0.1, False),
        ("report", -0.2, -0.1, None),
    ],
)
def test_conclusions_follow_from_intervals(expect: Any, low: float, high: float, holds: bool | None) -> None:
    check = Check(text="t", comparison="c", category="Drone", expect=expect)
    found = check_claim(check, {}, difference(low, high), {})
    assert found["holds"] is holds and found["ci"] == [low, high]


def ratio_check(ratio: Any, least: float, **more: Any) -> Check:
    return Check(text="t", ratio=ratio, category="Person", metric="map50", expect="at_least", least=least, **more)


def test_ratio_is_compared_with_its_minimum() -> None:
    figures: Any = {n: {"classes": {"Person": {"map50": v}}} for n, v in (("a", 0.35), ("b", 0.5))}
    check = ratio_check((("a",), ("b",)), 0.7)
    found = check_claim(check, figures, {}, {})
    assert found["ratio"] == 0.7 and found["holds"] is True
    figures["a"]["classes"]["Person"]["map50"] = 0.34
    assert check_claim(check, figures, {}, {})["holds"] is False
    assert check_claim(check, {}, {}, {})["holds"] is None
    assert check_claim(check, {}, {}, {})["missing"] == "not run yet"
    figures["b"]["classes"]["Person"]["map50"] = 0.0
    assert check_claim(check, figures, {}, {})["missing"] == "the second figure is 0"
    by_day = check.model_copy(update={"time": "day"})
    assert check_claim(by_day, figures, {}, {})["missing"] == "no such figure in the evaluation"


def test_claim_about_a_time_of_day_uses_the_figures_of_its_images_alone():
    def evaluation(by_day: float) -> Any:
        return {
            "classes": {"Person": {"map50": 0.7}},
            "strata": {"time": {"day": {"classes": {"Person": {"map50": by_day}}}}},
        }

    check = ratio_check((("a",), ("b",)), 0.7, time="day")
    found = check_claim(check, {"a": evaluation(0.2), "b": evaluation(0.5)}, {}, {})
    assert (found["ratio"], found["holds"]) == (0.4, False)
    night = check.model_copy(update={"time": "night"})
    assert check_claim(night, {"a": evaluation(0.2), "b": evaluation(0.5)}, {}, {})["holds"] is None


def test_ratio_of_several_seeds_is_that_of_their_means() -> None:
    values = {"a": 0.3, "a-1": 0.5, "b": 0.4, "b-1": 0.6}
    figures: Any = {n: {"classes": {"Person": {"map50": v}}} for n, v in values.items()}
    check = ratio_check((("a", "a-1"), ("b", "b-1")), 0.8)
    found = check_claim(check, figures, {}, {})
    assert found["values"] == [0.4, 0.5] and found["ratio"] == 0.8 and found["holds"] is True
    assert found["ratio_of"] == ["a, a-1", "b, b-1"]
    del figures["b-1"]
    unfinished = check_claim(check, figures, {}, {"b-1": "too few"})
    assert (unfinished["missing"], unfinished["least"]) == ("too few", 0.8)


@pytest.mark.parametrize(
    ("scale", "said"), [("smoke", "figures mean nothing"), ("small", "with each other"), ("paper", None)]
)
def test_page_states_the_limits_of_its_figures(
    scale: str, said: str | None, bench: Bench, data: Path, tmp_path: Path
) -> None:
    facts = run("hit-uav-drone", data, tmp_path / "work").facts
    text = " ".join(list_differences(facts | {"scale": scale}))
    assert [s for s in ("figures mean nothing", "with each other") if s in text] == ([said] if said else [])


def test_pages_of_scales_stand_side_by_side(bench: Bench, data: Path, tmp_path: Path) -> None:
    report = run("hit-uav-drone", data, tmp_path / "work")
    out = tmp_path / "results"
    small = {**report.facts, "scale": "small"}
    write_page(small, out)
    write_page(report.facts, out)
    assert {"hit-uav-drone.md", "hit-uav-drone-smoke.md", "index.md"} <= {p.name for p in out.iterdir()}
    index = (out / "index.md").read_text("utf-8")
    assert "| small | complete |" in index and "| smoke | complete |" in index
    before = files_of(out)
    write_page(report.facts, out)
    assert files_of(out) == before


def test_page_is_made_from_the_json_only(charts: None, bench: Bench, data: Path, tmp_path: Path) -> None:
    """All of it but the curves, which are left out of the JSON."""
    report = run("hit-uav", data, tmp_path / "work")
    facts = json.loads(report.page.with_suffix(".json").read_text("utf-8"))
    shown = [
        (p.name, title)
        for name, title in (
            ("bars", "Ours with 95 % intervals, the paper's figures as crosses"),
            ("differences", "Paired differences with 95 % intervals"),
            ("pr", "Precision over recall at IoU 0.5"),
        )
        for p in [report.page.with_name(f"hit-uav-smoke_{name}.svg")]
    ]
    assert all((report.page.parent / name).is_file() for name, _ in shown)
    assert page_text(facts, shown) == report.page.read_text("utf-8")


# The command.


def test_the_command_lists_plans_runs_and_says_when_nothing_is_to_do(
    bench: Bench, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    make = makers.run_request
    flat = Execution(renderer="flat", in_process=True)
    monkeypatch.setattr(makers, "run_request", lambda run, tell: make(replace(run, execution=flat), tell))
    monkeypatch.setenv("INFRABLEND_LOG", str(tmp_path / "log.txt"))
    assert main(["experiment", "--list"]) == 0
    assert "pitch-alignment" in capsys.readouterr().out
    command = ["experiment", "hit-uav-drone", "--data", str(data), "--work", str(tmp_path / "w"), "--scale", "smoke"]
    assert main([*command, "--plan", "--only", "generate"]) == 0
    shown = capsys.readouterr().out
    assert "train:aligned" not in shown and "3 of 3 stages" in shown
    assert main([*command, "--plan", "--only", "trian"]) == 2
    assert "no such stage" in capsys.readouterr().err
    assert main([*command, "--plan"]) == 0
    shown = capsys.readouterr().out
    assert "train:aligned" in shown and "5 of 5 stages" in shown and not (tmp_path / "w").exists()
    assert main(command) == 0
    output = capsys.readouterr()
    assert "0.898" in output.out and output.out.rstrip().endswith("hit-uav-drone-smoke.md")
    assert "stage 4 of 5, train:aligned: done" in output.err
    assert main([*command, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["made"] == [] and facts["status"] == "complete"
    assert main(command) == 0
    assert "nothing to do: every stage was finished before" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["hit-uav-dron"], "neither a shipped experiment"),
        (["hit-uav-dron"], "Did you mean hit-uav-drone?"),
        ([], "which experiment?"),
        (["hit-uav"], "no HIT-UAV"),
        (["hit-uav", "--adopt", "train"], "KEY=VALUE"),
    ],
)
def test_wrong_commands_are_reported(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("INFRABLEND_LOG", str(tmp_path / "log.txt"))
    assert main(["experiment", *words, "--work", str(tmp_path / "w")]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "w").exists()
