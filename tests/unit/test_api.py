"""The Python interface: its examples run, and the package root exports what it lists."""

from __future__ import annotations

import doctest
import pkgutil
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import infrablend
from infrablend import api
from infrablend.core.workspace import Existing
from infrablend.errors import ArgumentError, InfraBlendError, OutputError, RecipeError
from infrablend.lab.experiments.experiment_request import ExperimentRequest
from infrablend.pipeline.plans.run_request import RunRequest


def test_the_examples_in_the_docstrings_run(
    write_tiny_hit_uav: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_tiny_hit_uav(tmp_path / "hit-uav")
    finder = doctest.DocTestFinder()
    modules = [import_module(f"infrablend.api.{m.name}") for m in pkgutil.iter_modules(api.__path__)]
    names = {name: getattr(api, name) for name in api.__all__}
    examples = [t for m in modules for t in finder.find(m, globs=names.copy()) if t.examples]
    assert len(examples) >= 8
    runner = doctest.DocTestRunner()
    for example in examples:
        runner.run(example, clear_globs=False)
    assert runner.summarize(verbose=False).failed == 0


def test_the_package_root_offers_what_it_lists() -> None:
    assert set(infrablend.__all__) <= set(dir(infrablend))
    for name in infrablend.__all__:
        found = getattr(infrablend, name)
        assert name == "__version__" or found.__name__ == name
    assert infrablend.generate is api.generate
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = getattr(infrablend, "no_such_name")  # noqa: B009 - type checkers know that it is missing


def test_importing_the_package_is_light() -> None:
    code = "import infrablend, sys; print(sorted({'numpy', 'bpy', 'pydantic', 'infrablend.api'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


FLAT = api.Execution(renderer="flat", in_process=True)


def test_realism_reads_the_backgrounds_as_the_run_did(
    write_tiny_hit_uav: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_tiny_hit_uav(tmp_path / "hit-uav", ("normal_json",))
    data = tmp_path / "data"
    data.mkdir()
    for k, picture in enumerate(sorted((tmp_path / "hit-uav").rglob("*.jpg"))):
        picture.rename(data / f"{k}.jpg")
    for name, time in (("table", "night"), ("other", "day")):
        rows = "".join(f"{k}.jpg,60,{time}\n" for k in range(4))
        (tmp_path / f"{name}.csv").write_text(f"file,pitch_deg,time_of_day\n{rows}")
    reading = api.Reading(metadata=tmp_path / "table.csv")
    api.generate("hit-uav-drone", data, tmp_path / "run", limit=1, reading=reading, execution=FLAT)
    seen = []
    monkeypatch.setattr("infrablend.lab.realism.compare_objects.compare", lambda _, dataset, *a: seen.append(dataset))
    api.realism(tmp_path / "run", data, time_of_day="night")
    api.realism(tmp_path / "run", data, reading=api.Reading(metadata=tmp_path / "other.csv"))
    assert [{i.capture.time_of_day for i in dataset.images} for dataset in seen] == [{"night"}, {"day"}]


loose: Any = api
"""The interface for those who check no types."""


def _generate(tmp_path: Path, **options: Any) -> object:
    return loose.generate("hit-uav-drone", tmp_path, tmp_path / "out", **{"execution": FLAT, **options})


CALLS: dict[str, tuple[Callable[[Path], object], type[InfraBlendError], str]] = {
    "a negative limit": (lambda p: _generate(p, limit=-1), ArgumentError, "^limit: found -1, expected a whole number"),
    "no background": (lambda p: _generate(p, limit=0), ArgumentError, "^limit: found 0, .* from 1 up$"),
    "a limit as text": (lambda p: _generate(p, limit="2"), ArgumentError, "^limit: found '2'"),
    "a seed as text": (lambda p: _generate(p, seed="a"), ArgumentError, "^seed: found 'a', expected a whole number$"),
    "a choice in generate": (lambda p: _generate(p, existing="x"), OutputError, "^existing: found 'x', expected"),
    "a choice in plan": (
        lambda p: loose.plan("hit-uav-drone", p, p / "out", existing="x"),
        OutputError,
        "^existing: found 'x', expected",
    ),
    "settings as text": (lambda p: _generate(p, settings="output.image=png"), RecipeError, "^settings: .*a list of"),
    "settings by number": (lambda p: _generate(p, settings={1: 2}), RecipeError, r"^settings: found {1: 2}, expected"),
    "no settings": (lambda p: _generate(p, settings=None), RecipeError, "^settings: found None"),
    "an item of a list": (lambda p: _generate(p, settings={"objects.\u00b2.model": "car"}), RecipeError, "no item"),
    "no worker": (lambda p: loose.Execution(workers=0), ArgumentError, "^workers: found 0, .* from 1 up"),
    "fewer workers": (lambda p: loose.Execution(workers=-1), ArgumentError, "^workers"),
    "workers as text": (lambda p: loose.Execution(workers="2"), ArgumentError, "^workers"),
    "a device": (lambda p: loose.Execution(device="tpu", renderer="flat"), ArgumentError, "^device: found 'tpu'"),
    "a renderer": (lambda p: loose.Execution(renderer="x"), ArgumentError, "^renderer: .*one of blender, flat"),
    "ids": (lambda p: loose.WriteSettings(ids="x"), ArgumentError, "^ids: .*new, source"),
    "ids of categories": (lambda p: loose.WriteSettings(category_ids="x"), ArgumentError, "^category_ids"),
    "ignored regions": (lambda p: loose.WriteSettings(dont_care="x"), ArgumentError, "^dont_care"),
    "a layout": (lambda p: loose.make_world(p / "out", 1, layout="x"), ArgumentError, "^layout: found 'x'"),
    "an engine": (lambda p: loose.make_world(p / "out", 1, engine="x"), ArgumentError, "^engine: .*blender, lattice"),
    "something to draw": (
        lambda p: loose.preview(p, p / "a.png", draw=("x",)),
        ArgumentError,
        "^draw: found 'x', expected one of boxes",
    ),
    "a single thing to draw": (
        lambda p: loose.preview(p, p / "a.png", draw="boxes"),
        ArgumentError,
        r"^draw: found the text 'boxes', .* Write \['boxes'\]",
    ),
    "an empty sheet": (lambda p: loose.preview(p, p / "a.png", 0), ArgumentError, "^count"),
    "an empty ground sheet": (lambda p: loose.preview_ground(p, p / "a.png", 0), ArgumentError, "^count"),
    "nothing to compare": (lambda p: loose.compare_evaluations([], []), ArgumentError, "^ours: found no folder"),
    "negative draws": (lambda p: loose.compare_evaluations(p, p, bootstrap=-5), ArgumentError, "^bootstrap: found -5"),
    "classes to compare": (
        lambda p: loose.compare_evaluations(p, p, classes="Car"),
        ArgumentError,
        "^classes: found the",
    ),
    "classes to train": (lambda p: loose.TrainRequest(classes="Car"), ArgumentError, "^classes: found the text 'Car'"),
    "classes to evaluate": (lambda p: loose.EvaluationSettings(classes="Car"), ArgumentError, "^classes: found the"),
    "classes to drop": (lambda p: loose.ClassChanges(drop="Car"), ArgumentError, "^drop: found the text 'Car'"),
    "classes to avoid": (lambda p: loose.Selection(without="Car"), ArgumentError, "^without: found the text 'Car'"),
    "splits": (lambda p: loose.Reading(splits="train"), ArgumentError, r"^splits: .* Write \['train'\]"),
    "parts": (lambda p: loose.FetchRequest(parts="train"), ArgumentError, "^parts: found the text 'train'"),
    "stages": (
        lambda p: loose.ExperimentRequest("hit-uav", only="train"),
        ArgumentError,
        "^only: found the text 'train'",
    ),
}


@pytest.mark.parametrize("name", CALLS)
def test_invalid_arguments_are_refused_before_anything_is_written(name: str, tmp_path: Path) -> None:
    call, error, message = CALLS[name]
    with pytest.raises(error, match=message):
        call(tmp_path)
    assert not (tmp_path / "out").exists()


def test_categories_of_a_comparison_are_a_list(write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> None:
    data = write_tiny_hit_uav(tmp_path / "data")
    with pytest.raises(ArgumentError, match=r"^categories: found the text 'drone'"):
        api.realism(tmp_path / "run", data, categories="drone")


@pytest.mark.parametrize("existing", ["refuse", "resume", "overwrite"])
def test_valid_choices_are_accepted(existing: Existing) -> None:
    assert RunRequest("hit-uav-drone", Path("data"), seed=1, existing=existing).existing == existing


def test_texts_are_accepted_as_paths(write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> None:
    data, work = write_tiny_hit_uav(tmp_path / "data"), tmp_path / "work"
    of_paths = ExperimentRequest(
        "hit-uav-drone", [data], work, tmp_path / "page", "smoke", adopt={"train:aligned": tmp_path}
    )
    of_texts: dict[str, Any] = {
        "data": [str(data)], "work": str(work), "results": str(tmp_path / "page"), "scale": "smoke",
        "adopt": {"train:aligned": str(tmp_path)},
    }  # fmt: skip
    for folders in ([str(data)], str(data), data):
        assert ExperimentRequest("hit-uav-drone", **{**of_texts, "data": folders}) == of_paths
    plan = api.plan_experiment(ExperimentRequest("hit-uav-drone", **{**of_texts, "adopt": {}}))
    assert plan.facts["experiment"] == "hit-uav-drone"
    archive: Any = str(tmp_path / "none.zip")
    with pytest.raises(InfraBlendError, match="no such file"):
        api.fetch("hit-uav", tmp_path / "out", api.FetchRequest(archive=archive))
