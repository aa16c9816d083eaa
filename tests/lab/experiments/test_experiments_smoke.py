"""Every shipped experiment at the smoke scale, with real training and evaluation, on virtual worlds."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from infrablend import api
from infrablend.lab.experiments import run_experiment
from infrablend.lab.experiments.definition import list_experiments, load_experiment
from infrablend.lab.experiments.experiment_request import ExperimentRequest
from infrablend.lab.experiments.stage import Stage
from tests.coarse_world import coarse_worlds
from tests.unit.formats.test_clips import write_clip

pytestmark = [pytest.mark.slow, pytest.mark.blender, pytest.mark.long]


@pytest.fixture(scope="module", autouse=True)
def coarse() -> Iterator[None]:
    with coarse_worlds():
        yield


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A town in HIT-UAV's form, with days, and with images whose people or cars have no labels."""
    root = api.make_world(tmp_path_factory.mktemp("data") / "hit-uav", 16, 5, workers=2)
    for path in sorted(root.glob("*/annotations/*.json")):
        content = json.loads(path.read_text())
        key = "annotation" if "annotation" in content else "annotations"
        number = {i["id"]: k for k, i in enumerate(content["images"])}
        for image in content["images"]:
            image["date_captured" if "date_captured" in image else "date"] = f"2021010{1 + number[image['id']] % 6}"
        # Person is 0, Car is 1: images without the one, without the other.
        content[key] = [a for a in content[key] if number[a["image_id"]] % 2 != a["category_id"]]
        path.write_text(json.dumps(content))
    return root


@pytest.fixture(scope="module")
def world_as_coco(world: Path) -> Path:
    """The same town as another camera's dataset."""
    api.convert(world, world.parent / "coco", to="coco")
    return world.parent / "coco"


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four clips of a narrow view."""
    root = tmp_path_factory.mktemp("data") / "clips"
    names = ("4", "7", "18", "40")
    for name in names:
        write_clip(root, f"{name}.avi", rows="".join(f"{n}.avi,0.2,3.0\n" for n in names))
    return root


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("work")


@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", list_experiments())
@pytest.mark.filterwarnings("ignore")  # of torch and Ultralytics
def test_every_experiment_runs_at_the_smoke_scale(
    name: str,
    ultralytics: None,
    world: Path,
    world_as_coco: Path,
    clips: Path,
    work: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sources = load_experiment(name).sources
    of_clips = [f"{n}={clips}" for n, s in sources.items() if s.format == "anti-uav"]
    of_coco = [
        f"{n}={world_as_coco}"
        for n, s in sources.items()
        if s.format == "coco" and s.stand_in is None and not s.optional
    ]
    stand_ins = all(s.stand_in is not None for s in sources.values())
    of_world = not stand_ins and (not of_clips or any(s.format == "hit-uav" for s in sources.values()))
    data: list[Path | str] = [*of_clips, *of_coco, *([world] if of_world else [])]
    request = ExperimentRequest(name, data, work, work / "results", scale="smoke", device="cpu", workers=2)
    report = api.experiment(request)
    assert report.status == "complete"
    facts = json.loads(report.page.with_suffix(".json").read_text("utf-8"))
    assert facts["scale"] == "smoke" and facts["hardware"] and facts["versions"]
    page = report.page.read_text("utf-8")
    given = len(of_clips) == len(sources)  # then nothing stands in for a source
    assert given or "a rendered virtual world stands in for it" in page
    assert str(work) not in page
    for row in (r for t in facts["tables"] for r in t["rows"] if r["evaluation"] in facts["evaluations"]):
        if row["ours"] is not None:
            assert 0 <= (row["ours"]["map50"] or 0) <= 1
    assert name == "datasets" or facts["evaluations"] or facts["detectabilities"]
    by_stage = {s["stage"]: s["images"] for s in facts["stages"]}
    if "convert:synthetic" in by_stage:
        # The limit on contrast applies to each look: a control may leave out the only object of a picture.
        assert by_stage["convert:synthetic"] == by_stage["convert:real"] >= by_stage.get("convert:flat", 1) > 0

    def never(stage: Stage, *args: Any, **kwargs: Any) -> Any:
        raise AssertionError(f"{stage.id} is made again")

    monkeypatch.setattr(run_experiment, "make_stage", never)
    again = api.experiment(request)
    assert again.made == () and again.page.read_text("utf-8") == page
