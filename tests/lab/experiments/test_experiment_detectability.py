"""Detectabilities in experiments: definitions, stages, seeds, figures on the page, and claims about recall."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.detection.detections import Detections
from infrablend.errors import RecipeError
from infrablend.lab.experiments import experiment_forecast, makers
from infrablend.lab.experiments.definition import Check, load_experiment, parse_experiment
from infrablend.lab.experiments.experiment_forecast import stage_seconds
from infrablend.lab.experiments.experiment_request import ExperimentRequest
from infrablend.lab.experiments.graph import OTHER_SCALES
from infrablend.lab.experiments.prepare import prepare_experiment, repeat_seeds
from infrablend.lab.experiments.recall_cells import detectability_figures
from infrablend.lab.experiments.result_record import DetectabilityFigures
from infrablend.lab.experiments.results import check_claim
from infrablend.lab.experiments.stage import read_dataset
from infrablend.lab.pages.experiment_page import page_text
from infrablend.lab.pages.write_results import draw_plots
from infrablend.lab.world.world_dataset import write_sky_pictures
from infrablend.pipeline.datasets.convert import convert_dataset
from infrablend.pipeline.flights import detectability
from infrablend.pipeline.flights.detectability import DetectabilityRequest
from tests.lab.experiments.test_experiment import Bench, bench, data, run  # noqa: F401

HEAD = "name: few\ntitle: t\ndescription: d\nsources: {hit-uav: {format: hit-uav, title: H, classes: [Person]}}\n"
FEW = (
    HEAD
    + """
trainings: {t: {data: hit-uav, seeds: {smoke: 2, small: 3}}, other: {data: hit-uav, reseed: 7}}
detectabilities:
  people: {title: People, training: t, data: hit-uav, recipe: hit-uav-people, until: {small: 0.1, smoke: 0.25}}
  cars: {training: other, data: hit-uav, split: val, recipe: hit-uav-cars, group: gap}
checks:
  - {text: Near, recall: {of: people, by: confidence}, expect: at_most, most: 0.04}
  - {text: Most hold, recall: {of: [people, cars]}, expect: at_least, least: 0.85}
"""
)


def recall(predicted: float, actual: float, real: int = 100, half: float = 0.05, **more: Any) -> dict[str, Any]:
    """Return a row of `detectability.json`; the interval of the difference is `half` to each side."""
    apart = predicted - actual
    return {
        "predicted": predicted,
        "low": predicted - 0.03,
        "high": predicted + 0.03,
        "inserted": 300,
        "actual": actual,
        "actual_low": actual - 0.04,
        "actual_high": actual + 0.04,
        "real": real,
        "difference": [apart, apart - half, apart + half],
        **more,
    }


CELLS = [
    recall(0.7, 0.71, by="size", value="8-16 px", real=150),
    recall(0.9, 0.8, by="size", value="16-32 px", real=149),  # leaves out 0
    recall(0.6, 0.62, by="time", value="day"),
    recall(0.8, 0.79, by="time", value="night", real=39),  # too few
    # A real object of a size that no inserted one has.
    {
        "by": "size", "value": ">=32 px", "predicted": None, "low": None, "high": None, "inserted": 0,
        "actual": 1.0, "actual_low": 0.2, "actual_high": 1.0, "real": 1,
    },
    {"by": "target", "value": "standing", "predicted": 0.5, "low": 0.4, "high": 0.6, "inserted": 50},
]  # fmt: skip
FACTS: Any = {
    "category": "Person",
    "confidence": 0.25,
    "recall": recall(0.745, 0.754),
    "confidences": [
        recall(0.909, 0.899, confidence=0.1, alarms_per_picture=1.25),
        recall(0.745, 0.754, confidence=0.25, alarms_per_picture=0.5),
        recall(0.6, 0.57, confidence=0.4, alarms_per_picture=0.25),
    ],
    "cells": CELLS,
    "kind": "measured",
    "trained_on": "2,000 real and 0 inserted objects",
    "recipe": "hit-uav-people",
    "pictures": 579,
    "not_counted": {"without_place": 3},
    "real_of_other_sizes": 2,
}


def figures(**more: Any) -> DetectabilityFigures:
    spec = load_experiment("detectability").detectabilities["people"]
    facts: Any = {**FACTS, **more}
    return detectability_figures("people", spec, facts)


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[tuple[DetectabilityRequest, Path]]:
    """Requests of detectabilities, which are answered with the same facts."""
    asked: list[tuple[DetectabilityRequest, Path]] = []

    def measure(request: DetectabilityRequest, out: Path, **options: Any) -> Any:
        asked.append((request, out))
        out.mkdir()
        for name in ("detectability.json", "detectability.html"):
            (out / name).write_text("{}")
        return SimpleNamespace(out=out, facts=FACTS)

    monkeypatch.setattr(makers, "measure_detectability", measure)
    return asked


# The file.


@pytest.mark.parametrize(
    ("more", "what"),
    [
        (
            "detectabilities: {x: {training: nobody, data: hit-uav, recipe: hit-uav-people}}",
            "detectabilities.x.training: no training nobody",
        ),
        (
            "trainings: {t: {data: hit-uav}}\n"
            "detectabilities: {x: {training: t, data: nobody, recipe: hit-uav-people}}",
            "detectabilities.x.data: no source or data nobody",
        ),
        ("checks: [{text: T, recall: {of: nobody}, expect: report}]", "checks.0.recall: no detectability nobody"),
        (
            "trainings: {t: {data: hit-uav, seeds: 2}, u: {data: hit-uav}}\n"
            "detectabilities:\n"
            "  {x: {training: t, data: hit-uav, recipe: r}, x-1: {training: u, data: hit-uav, recipe: r}}",
            "detectabilities.x: its seeds include x-1",
        ),
        ("checks: [{text: T, recall: {of: x}, expect: below}]", "expect: below needs a comparison"),
        ("checks: [{text: T, recall: {of: x}, expect: at_most}]", "at_most and most need each other"),
        ("checks: [{text: T, recall: {of: x}, expect: at_least}]", "at_least and least need each other"),
        ("checks: [{text: T, ratio: [x, x], expect: at_most, most: 1}]", "expect: at_most needs recall"),
        ("checks: [{text: T, recall: {of: x}, comparison: x, expect: report}]", "one of comparison, ratio and recall"),
        ("checks: [{text: T, recall: {of: x, by: weather}, expect: report}]", "recall.by"),
    ],
)
def test_mistakes_in_the_file_are_named(more: str, what: str) -> None:
    with pytest.raises(RecipeError) as caught:
        parse_experiment(HEAD + more, "m.yaml")
    assert what in "\n".join([str(caught.value), *(f"{p.where} {p.found}" for p in caught.value.problems)])


def test_paths_of_recipe_and_profile_are_relative_to_the_file(tmp_path: Path) -> None:
    entry = "{training: t, data: hit-uav, recipe: own.yaml, settings: {sensor.profile: p.json}}"
    (tmp_path / "few.yaml").write_text(HEAD + f"trainings: {{t: {{data: hit-uav}}}}\ndetectabilities: {{x: {entry}}}\n")
    spec = load_experiment(tmp_path / "few.yaml").detectabilities["x"]
    assert spec.recipe == str(tmp_path / "own.yaml") and spec.settings == {"sensor.profile": str(tmp_path / "p.json")}


def test_each_seed_of_a_training_has_its_detectability() -> None:
    spelled = repeat_seeds(parse_experiment(FEW, "few.yaml"), "small")
    assert {n: (d.training, d.title) for n, d in spelled.detectabilities.items()} == {
        "people": ("t", "People"),
        "people-1": ("t-1", "People, seed 2"),
        "people-2": ("t-2", "People, seed 3"),
        "cars": ("other", ""),
    }
    of = [c.recall.of for c in spelled.checks if c.recall is not None]
    assert of == [("people", "people-1", "people-2"), ("people", "people-1", "people-2", "cars")]


# Stages.


@pytest.fixture
def few(tmp_path: Path) -> Path:
    path = tmp_path / "few.yaml"
    path.write_text(FEW)
    return path


def test_stages_depend_on_recipe_until_training_and_data(few: Path, data: Path, tmp_path: Path) -> None:  # noqa: F811
    def keys(text: str = FEW) -> dict[str, str]:
        few.write_text(text)
        request = ExperimentRequest(few, [data], tmp_path / "w", scale="smoke", workers=1)
        return dict(prepare_experiment(request).graph.keys)

    first = keys()
    assert {k for k in first if k.startswith("detectability:")} == {
        "detectability:people",
        "detectability:people-1",
        "detectability:cars",
    }
    assert len(set(first.values())) == len(first)
    for old, new, changed in (
        ("smoke: 0.25", "smoke: 0.2", {"people", "people-1"}),
        ("small: 0.1,", "small: 0.2,", set()),
        ("recipe: hit-uav-cars", "settings: {objects.0.count: 1}, recipe: hit-uav-cars", {"cars"}),
        ("group: gap", "group: image", {"cars"}),
        ("reseed: 7", "reseed: 8", {"cars"}),
    ):
        other = keys(FEW.replace(old, new))
        assert {k for k in first if k.startswith("detectability:") and other[k] != first[k]} == {
            f"detectability:{n}" for n in changed
        }, old


def test_a_narrower_interval_takes_longer_up_to_all_rounds(few: Path, data: Path, tmp_path: Path) -> None:  # noqa: F811
    request = ExperimentRequest(few, [data], tmp_path / "w", scale="smoke", workers=1, device="cpu")
    stage = prepare_experiment(request).graph.by_id["detectability:people"]
    assert stage.images == {"test": 1}

    def seconds(until: float) -> float:
        return stage_seconds(SimpleNamespace(**{**vars(stage), "inputs": {"until": until}}), {}, request)  # type: ignore[arg-type]

    assert seconds(0.5) < seconds(0.3) < seconds(0.05) == seconds(0.01)
    # Ten rounds of a picture, a search each, and one of the picture as it is.
    assert seconds(0.01) > experiment_forecast.START_S + 11 * experiment_forecast.PREDICT_S["cpu"]


def test_a_run_measures_each_detector_and_shows_the_figures(
    bench: Bench,  # noqa: F811
    measured: list[tuple[DetectabilityRequest, Path]],
    few: Path,
    data: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    report = run(str(few), data, tmp_path / "work")
    assert report.status == "complete" and len(measured) == 3
    people, seed_2, cars = (request for request, _ in measured)
    assert (people.recipe, people.settings.until, people.reading.splits) == ("hit-uav-people", 0.25, ("test",))
    assert (cars.settings.until, cars.settings.group, cars.reading.splits) == (0.03, "gap", ("val",))
    assert people.data == data and people.execution.in_process and people.execution.renderer == "flat"
    assert people.detector != seed_2.detector and people.detector.name == "weights.pt" and people.detector.is_file()
    facts = json.loads(report.page.with_suffix(".json").read_text("utf-8"))
    assert facts["detectabilities"]["people-1"]["title"] == "People, seed 2"
    assert facts["detectabilities"]["cars"]["title"] == "cars"
    page = report.page.read_text("utf-8")
    assert (
        "## Predicted and actual recall" in page
        and "### By time of day, at confidence 0.25" in page
        and "### By size" in page
    )
    assert "| People | hit-uav-people | 2,000 real and 0 inserted objects | 579 | measured | 2 of 3 (0.67) |" in page
    assert "| all |  |  |  |  | 6 of 9 (0.67) |" in page
    assert "| People | 0.1 | 1.25 | 300 | 0.909 |" in page
    assert "| cars | 8-16 px | 300 | 0.700 |" in page and "standing" not in page
    assert "| cars | >=32 px | 0 | - | - | 1 | 1.000 | 0.200 to 1.000 |  |  |" in page
    assert [c["holds"] for c in facts["checks"]] == [None, None]  # smoke gives no verdicts
    assert page_text(facts) == page and str(tmp_path) not in page
    again = run(str(few), data, tmp_path / "work")
    assert again.made == () and len(measured) == 3


class BlindFinder:
    """A detector that finds nothing."""

    classes = ("drone",)
    facts: Mapping[str, str] = MappingProxyType({"name": "weights.pt"})
    problems = ()

    def find(self, pixels: Any, confidence: float = 0.01, scale: Any = None) -> Detections:
        empty = np.zeros((0, 4))
        return Detections(empty, np.zeros(0), np.zeros(0, np.int64))


def test_the_stage_measures_as_the_command_does(
    bench: Bench,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    """Objects are inserted indeed; only the detector is not a real one."""
    monkeypatch.setattr(detectability, "load_finder", lambda path, **options: BlindFinder())
    write_sky_pictures(tmp_path / "sky", 12, 0, ("drone",))
    path = tmp_path / "sky.yaml"
    path.write_text(
        "name: sky\ntitle: t\ndescription: d\nsources: {sky: {format: coco, title: S, classes: [drone]}}\n"
        "data: {clips: {kind: convert, of: sky, clips: true}}\n"
        "trainings: {t: {data: clips}}\n"
        "detectabilities:\n"
        "  drones: {training: t, data: clips, recipe: drone-sky, group: sequence, until: {smoke: 0.4}}\n"
    )
    report = run(str(path), tmp_path / "sky", tmp_path / "work")
    found = report.facts["detectabilities"]["drones"]
    assert found["category"] == "drone" and found["recipe"] == "drone-sky"
    assert found["recall"]["predicted"] == 0.0 and found["recall"]["inserted"] >= 1
    assert found["recall"]["actual"] == 0.0 and found["recall"]["real"] >= 1
    assert found["pictures"] == len(read_dataset(tmp_path / "sky", splits=["test"]).images)


def test_clips_in_names_become_sequences_of_images_without_one(tmp_path: Path) -> None:
    write_sky_pictures(tmp_path / "sky", 8, 0, ("drone",))
    dataset = read_dataset(tmp_path / "sky", splits=["train"])
    names = [f"IR_DRONE_00{1 + k // 2}_{30 * (k % 2):05}.png" for k in range(4)]
    images = [rename(i, n) for i, n in zip(dataset.images, names, strict=False)]
    found = makers._with_clips(images)
    assert [i.capture.sequence for i in found] == [
        "IR_DRONE_001_*",
        "IR_DRONE_001_*",
        "IR_DRONE_002_*",
        "IR_DRONE_002_*",
    ]
    convert_dataset(Dataset(dataset.root, "coco", dataset.categories, found), "coco", tmp_path / "out")
    assert {i.capture.sequence for i in read_dataset(tmp_path / "out").images} == {"IR_DRONE_001_*", "IR_DRONE_002_*"}
    assert makers._with_clips(found) == found  # they have one now


def rename(image: ImageRecord, name: str) -> ImageRecord:
    return replace(image, id=name.removesuffix(".png"), file_name=name)


# Claims.


def claim(recall: dict[str, Any], expect: str, left_out: Any = None, **more: Any) -> Any:
    check = Check(text="t", recall={"of": ["people", "cars"], **recall}, expect=expect, **more)  # type: ignore[arg-type]
    cars = figures(category="Car", cells=[c for c in CELLS if c["by"] != "size"])
    return check_claim(check, {}, {}, left_out or {}, {"people": figures(), "cars": cars})


@pytest.mark.parametrize(
    ("recall", "most", "holds", "cells"),
    [
        ({"by": "confidence"}, 0.04, True, 6),
        ({"by": "confidence"}, 0.02, False, 6),
        ({"by": "size"}, 0.08, False, 2),
        ({"by": "size", "least_real": 150}, 0.08, True, 1),
        ({"by": "time"}, 0.03, True, 2),
        ({"by": "confidence", "value": "0.25"}, 0.01, True, 2),
    ],
)
def test_the_largest_difference_decides(recall: Any, most: float, holds: bool, cells: int) -> None:
    found = claim(recall, "at_most", most=most)
    assert (found["holds"], found["cells"], found["class"]) == (holds, cells, "Person, Car")
    assert (abs(found["difference"]) <= most) is holds


def test_the_share_of_intervals_that_hold_0_decides() -> None:
    """Of two ranges of sizes and day of the one, and day of the other, one interval leaves out 0."""
    found = claim({}, "at_least", least=0.75)
    assert (found["holds"], found["holding"], found["cells"]) == (True, 3, 4)
    assert found["where"] == "People, detector of real ones, size 16-32 px"
    assert claim({}, "at_least", least=0.76)["holds"] is False
    assert claim({}, "report")["holds"] is None


def test_claims_without_figures_say_why() -> None:
    assert claim({"by": "time", "value": "night"}, "report")["missing"] == "no such condition with 40 real objects"
    assert claim({"of": ["people", "lost"]}, "report")["missing"] == "not run yet"
    assert claim({"of": ["people", "lost"]}, "report", {"lost": "no folder"})["missing"] == "no folder"
    # Seeds of other scales are no loss.
    found = claim({"of": ["people", "people-1"]}, "report", {"people-1": OTHER_SCALES})
    assert found["recall_of"] == ["people"] and "missing" not in found
    assert claim({"of": ["gone"]}, "report", {"gone": OTHER_SCALES})["missing"] == OTHER_SCALES


def test_the_chart_has_a_panel_per_class_and_a_point_per_compared_cell() -> None:
    facts: Any = {
        "tables": [],
        "evaluations": {},
        "comparisons": {},
        "detectabilities": {"a": figures(), "b": figures(category="Car", title="x"), "c": figures(cells=CELLS[3:])},
    }
    ((name, title, svg),) = draw_plots(facts)
    assert name == "recall" and "40 real objects" in title
    assert b"Person" in svg and b"Car" in svg and svg == draw_plots(facts)[0][2]
    facts["detectabilities"] = {"c": figures(cells=CELLS[3:])}
    assert draw_plots(facts) == []


def test_the_shipped_experiment_compares_three_detectors_of_each_class() -> None:
    loaded = load_experiment("detectability")
    of = {n: (d.training, d.recipe) for n, d in loaded.detectabilities.items()}
    for recipe in ("hit-uav-people", "hit-uav-cars", "drone-sky"):
        trainings = {training for training, its in of.values() if its == recipe}
        assert len(trainings) == 3 and any(t.startswith("inserted-") for t in trainings)
    networks = {n: t.settings.get("model") for n, t in loaded.trainings.items()}
    assert networks["real"] is None and networks["real-other"] == "yolo11n"
    assert sum(c.expect != "report" for c in loaded.checks) == 6
