"""`configurations: auto`: the number follows from the usable backgrounds of train, and a run has the bytes of it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from infrablend import api
from infrablend.config.loading import load_recipe
from infrablend.config.recipe import Recipe
from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord
from infrablend.errors import RecipeError
from infrablend.lab.experiments.graph import about_scenes as scenes_of_experiment
from infrablend.pipeline.plans import scenes
from infrablend.pipeline.plans.scenes import Scenes, choose_scenes
from infrablend.pipeline.plans.selection import FrameSelection
from tests.command_line import done
from tests.flat_renderer import render_flat
from tests.unit.pipeline.test_run import dataset, hashes

__all__ = ["dataset"]

RECIPE = "hit-uav-drone"
AUTO = ["configurations=auto", "output.formats=[yolo, coco]"]
FLAT = api.Execution(renderer="flat", in_process=True)


def recipe(*settings: str) -> Recipe:
    return load_recipe(RECIPE, ["configurations=auto", *settings])


def pictures(count: int, split: str = "train", **facts: object) -> list[ImageRecord]:
    capture = Capture(**facts)  # type: ignore[arg-type]
    return [ImageRecord(f"{k}", Path(f"{k}.png"), split, None, (), capture=capture) for k in range(count)]


def chosen(images: list[ImageRecord], *settings: str) -> Scenes:
    made = recipe(*settings)
    return choose_scenes(made, [o.category or o.model for o in made.objects], images)


@pytest.mark.parametrize(
    ("backgrounds", "number"),
    [(1, 16), (100, 16), (125, 16), (130, 16), (140, 15), (681, 3), (1000, 2), (2000, 1), (50_000, 1)],
)
def test_the_number_asks_for_two_thousand_objects_within_its_limits(backgrounds: int, number: int) -> None:
    assert chosen(pictures(backgrounds)).number == number
    assert scenes_of_experiment(recipe(), backgrounds) == number


def test_weights_of_counts_empty_frames_and_the_first_class_count() -> None:
    images = pictures(500)
    assert chosen(images, "objects.0.count={values: [0, 4], weights: [3, 1]}").number == 4
    assert chosen(images, "objects.0.count={values: [0, 4], weights: [1, 3]}").number == 2
    assert chosen(images, "empty_share=0.5").number == 8
    two = "[{model: drone}, {model: deer, count: 9}, {model: drone, count: 3}, {model: deer, category: drone}]"
    found = chosen(images, f"objects={two}")
    assert (found.per_scene, found.rarest, found.number) == (500 * 5, 500, 4)
    assert "about 10,000 objects of class drone" in found.describe()
    assert "2,000 or more by each of their entries" in found.describe()
    assert chosen(images, "objects.0.count=0").number == 1
    by_flight = "objects.0.count={values: [1], by_flight: [{time_of_day: night, values: [3]}]}"
    mixed = [*pictures(100, time_of_day="night"), *pictures(100, time_of_day="day")]
    assert chosen(mixed, by_flight).per_scene == 400


def test_backgrounds_of_val_and_test_do_not_count_beside_train() -> None:
    others = [*pictures(700, "val"), *pictures(700, "test")]
    assert chosen([*pictures(500), *others]).number == 4
    assert chosen(others).number == 2


def test_the_choice_is_said_in_words() -> None:
    assert chosen(pictures(681, "test"), "objects.0.count={values: [0, 1], weights: [1, 3]}").describe() == (
        "4 scenes of each of 681 backgrounds, about 2,043 objects of class drone (configurations: auto)"
    )
    assert chosen(pictures(2000)).describe() == (
        "1 scene of each background, about 2,000 objects of class drone in the 2,000 backgrounds of train "
        "(configurations: auto)"
    )
    few = "about 800 objects of class drone in the 50 backgrounds of train, fewer than 2,000, as 16 scenes are the most"
    assert few in chosen(pictures(50)).describe()


def test_sequences_need_a_number() -> None:
    with pytest.raises(RecipeError) as error:
        load_recipe("drone-video", ["configurations=auto"])
    assert "a whole sequence; state a number" in str(error.value.problems[0])


@pytest.fixture
def few_objects(monkeypatch: pytest.MonkeyPatch) -> None:
    """Aim at ten objects, and not at 2,000: the dataset has few backgrounds."""
    render_flat(monkeypatch)
    monkeypatch.setattr(scenes, "WANTED_OBJECTS", 10)


def planned(data: Path, out: Path, *words: object) -> Mapping[str, object]:
    fields = [word for field in AUTO for word in ("--set", field)]
    text = done("generate", RECIPE, "--data", data, "--out", out, *fields, "--plan", "--json", *words).stdout
    found: Mapping[str, object] = json.loads(text)
    return found


def test_a_run_has_the_bytes_of_the_number_and_says_that_it_was_automatic(
    dataset: Path, tmp_path: Path, few_objects: None
) -> None:
    said = str(planned(dataset, tmp_path / "auto")["scenes"])
    number = int(said.partition(" ")[0])
    assert said.endswith("(configurations: auto)") and 1 < number < 16
    plan = done("generate", RECIPE, "--data", dataset, "--out", tmp_path / "auto", "--set", AUTO[0], "--plan").stdout
    assert said in plan
    api.generate(RECIPE, dataset, tmp_path / "auto", settings=AUTO, execution=FLAT)
    api.generate(RECIPE, dataset, tmp_path / "number", settings=[f"configurations={number}", AUTO[1]], execution=FLAT)
    known = {"run.json", "report.html", "README.md"}
    ours, theirs = hashes(tmp_path / "auto"), hashes(tmp_path / "number")
    assert {k: v for k, v in ours.items() if k not in known} == {k: v for k, v in theirs.items() if k not in known}
    record = json.loads((tmp_path / "auto/run.json").read_text())
    assert (record["recipe"]["configurations"], record["request"]["configurations"]) == (number, said)
    for name in ("report.html", "README.md"):
        assert said in (tmp_path / "auto" / name).read_text() and said not in (tmp_path / "number" / name).read_text()
    assert api.generate(RECIPE, dataset, tmp_path / "auto", settings=AUTO, execution=FLAT, existing="resume").ok
    frame = next(p for p in sorted((tmp_path / "auto/images").rglob("*.jpg")) if f"_c{number - 1}" in p.name)
    again = api.rerender(tmp_path / "auto", f"{frame.parent.name}/{frame.stem}", tmp_path / "again.jpg")
    assert again.read_bytes() == frame.read_bytes()
    memory = api.Frames(api.FramesRequest(RECIPE, dataset, settings=AUTO, execution=FLAT))
    assert len(memory) == record["frames"]


def test_all_shards_have_the_number_of_the_whole_run(dataset: Path, tmp_path: Path, few_objects: None) -> None:
    api.generate(RECIPE, dataset, tmp_path / "whole", settings=AUTO, execution=FLAT)
    request = api.RunRequest(RECIPE, dataset, tmp_path / "parts", settings=AUTO, execution=FLAT)
    for number in (1, 2, 3):
        api.generate_shard(replace(request, shard=api.ShardRequest(number, 3)))
    api.merge([tmp_path / "parts"], tmp_path / "merged")
    assert hashes(tmp_path / "merged") == hashes(tmp_path / "whole")


def test_chosen_frames_are_those_of_the_whole_run(dataset: Path, tmp_path: Path, few_objects: None) -> None:
    whole = planned(dataset, tmp_path / "out")
    number = int(str(whole["scenes"]).partition(" ")[0])
    for words in (("--limit", 1), ("--sample", 1)):
        part = planned(dataset, tmp_path / "out", *words)
        assert part["frames"] == number
        assert part["scenes"] == f"as in a run of all frames: {whole['scenes']}"
    pictures = planned(dataset, tmp_path / "out", "--pictures", 3)
    assert pictures["frames"] == 3 and "scenes" not in pictures
    api.generate(RECIPE, dataset, tmp_path / "out", settings=AUTO, execution=FLAT)
    last = next(p for p in sorted((tmp_path / "out/images").rglob("*.jpg")) if f"_c{number - 1}" in p.name)
    selection = FrameSelection(frames=[f"{last.parent.name}/{last.stem}"])
    api.generate(RECIPE, dataset, tmp_path / "one", selection=selection, settings=AUTO, execution=FLAT)
    assert next((tmp_path / "one/images").rglob("*.jpg")).read_bytes() == last.read_bytes()
