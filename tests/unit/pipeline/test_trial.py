"""One frame without a run folder: the same bytes as in a run, rendered again when a file changes."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from infrablend import api
from infrablend.errors import ArgumentError, InfraBlendError, OutputError, RecipeError
from infrablend.pipeline.compose import trial
from infrablend.pipeline.compose.composed import ComposedFrame
from infrablend.pipeline.compose.frame import FrameComposer
from infrablend.pipeline.plans.plan import PlannedFrame
from infrablend.pipeline.plans.run_request import Execution
from tests.command_line import done

FLAT = Execution(renderer="flat", in_process=True)
RECIPE = "hit-uav-drone"
FRAME = "test/0_130_90_0_00004_c1"


@pytest.fixture
def data(write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> Path:
    return write_tiny_hit_uav(tmp_path / "hit-uav")


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    file = tmp_path / "recipe.yaml"
    file.write_text(api.show_recipe(RECIPE))
    return file


def test_a_tried_frame_has_the_bytes_labels_and_scene_of_the_run(data: Path, tmp_path: Path) -> None:
    """With the physical look, whose grey levels depend on all backgrounds."""
    api.generate("hit-uav-drone-physical", data, tmp_path / "run", execution=FLAT)
    tried = api.try_recipe("hit-uav-drone-physical", data, FRAME, execution=FLAT).frame
    assert tried.image_bytes == (tmp_path / "run" / "images" / f"{FRAME}.jpg").read_bytes()
    written = api.show(tmp_path / "run", FRAME)
    assert json.loads(json.dumps(tried.record.to_json())) == json.loads(json.dumps(written))
    assert [i.to_json() for i in tried.inserted] == written["inserted"]


def test_only_the_chosen_frame_is_composed(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    composed: list[str] = []
    usual = FrameComposer.compose

    def compose(self: FrameComposer, frame: PlannedFrame) -> ComposedFrame:
        composed.append(frame.frame_id)
        return usual(self, frame)

    monkeypatch.setattr(FrameComposer, "compose", compose)
    api.try_recipe(RECIPE, data, "0_130_90_0_00004", execution=FLAT)
    assert composed == ["test/0_130_90_0_00004_c0"]


def test_the_sheet_is_replaced_but_no_other_file(data: Path, tmp_path: Path) -> None:
    found = api.try_recipe(RECIPE, data, FRAME, execution=FLAT)
    sheet = found.write(tmp_path / "try.png")
    with Image.open(found.write(sheet)) as picture:
        assert picture.width > 640
    Image.new("L", (4, 4)).save(tmp_path / "mine.png")
    with pytest.raises(OutputError, match=r"mine\.png: exists"):
        found.write(tmp_path / "mine.png")


def test_an_unknown_frame_is_refused_with_similar_ones(data: Path) -> None:
    with pytest.raises(ArgumentError) as caught:
        api.try_recipe(RECIPE, data, "test/0_130_90_0_00005_c1", execution=FLAT)
    assert FRAME in caught.value.problems[0].expected


def watched(recipe: Path, data: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[api.Trial | InfraBlendError]:
    monkeypatch.setattr(trial, "_DATA_POLL_S", 0.0)
    return api.watch_recipe(recipe, data, FRAME, execution=FLAT)


def test_a_watched_frame_follows_recipe_and_data(data: Path, recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = watched(recipe, data, monkeypatch)

    def pixels(found: Any) -> bytes:
        assert isinstance(found, api.Trial), found
        return found.frame.pixels.tobytes()

    text, first = recipe.read_text(), pixels(next(shown))
    recipe.write_text(text.replace("configurations: 2", "configurations: 2\nseeed: 1"))
    assert isinstance(next(shown), RecipeError)
    recipe.write_text(text + "\nempty_share: 1.0\n")
    assert pixels(next(shown)) != first
    recipe.write_text(text)
    assert pixels(next(shown)) == first
    background = data / "normal_json" / "test" / f"{FRAME[5:-3]}.jpg"
    Image.new("L", (640, 512), 90).save(background)
    assert pixels(next(shown)) != first
    shown.close()  # type: ignore[attr-defined]


def test_the_command_writes_and_describes_one_frame(
    data: Path, recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(api, "try_recipe", lambda *a, **k: _flat(*a, **k))
    out = tmp_path / "shown.png"
    first, second, *_, last = done("try", recipe, "--data", data, "--frame", FRAME, "--out", out).stdout.splitlines()
    assert first.startswith(f"{FRAME}, ") and second.startswith("drone: ") and last == str(out)
    assert out.is_file()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["hit-uav", "recipe.yaml", "shown.png"]
    as_json = json.loads(done("try", RECIPE, "--data", data, "--out", out, "--json").stdout)
    assert as_json["frame"] == "train/0_60_30_0_00001_c0"


def test_the_command_prints_the_gain_of_the_physical_look(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(api, "try_recipe", lambda *a, **k: _flat(*a, **k))
    said = done("try", "hit-uav-drone-physical", "--data", data, "--out", tmp_path / "shown.png").stdout
    assert re.search(r"^gain \(\w+\) \d+\.\d grey levels per kelvin, from ", said, re.MULTILINE)


def _flat(*arguments: Any, **options: Any) -> Any:
    from infrablend.api import runs as functions

    return functions.try_recipe(*arguments, **{**options, "execution": FLAT})


@pytest.mark.blender
def test_blender_gives_the_bytes_of_a_run_too(data: Path, tmp_path: Path) -> None:
    tried = api.try_recipe(RECIPE, data, FRAME).frame
    selection = api.FrameSelection(frames=[FRAME])
    api.generate(RECIPE, data, tmp_path / "run", selection=selection, execution=Execution(workers=1))
    assert tried.image_bytes == (tmp_path / "run" / "images" / f"{FRAME}.jpg").read_bytes()
