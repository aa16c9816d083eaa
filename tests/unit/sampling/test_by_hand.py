"""Objects that a recipe places by hand: exactly there, never moved or left out, and nothing else changes."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from infrablend import api
from infrablend.assets.catalogue import load_model
from infrablend.config.loading import load_recipe
from infrablend.core.capture import Capture
from infrablend.core.scene import SceneSpec
from infrablend.errors import RecipeError
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.plans.selection import FrameSelection
from infrablend.sampling.scene_sampler import sample_scene
from infrablend.sampling.site import FrameKey, Site
from tests.command_line import done
from tests.flat_renderer import render_flat

FLAT = Execution(renderer="flat", in_process=True)
KEY = FrameKey("a", "test", 0, (640, 512), Capture(pitch_deg=50.0))
SITE = Site(np.full((512, 640), 90, np.uint8), altitude_m=60.0)
PLACE = {"x_px": 100.0, "y_px": 400.0, "range_m": 21.5, "yaw_deg": 30.0}


def scene(recipe: str, *objects: dict[str, float], **settings: object) -> SceneSpec:
    by_hand = {"frames": {"test/a_c0": {"objects": list(objects)}}} if objects else {}
    loaded = load_recipe(recipe, {**settings, **by_hand})
    models = {o.model: load_model(o.model) for o in loaded.objects}
    return sample_scene(KEY, loaded, models, 5, SITE).spec


@pytest.mark.parametrize("recipe", ["hit-uav-drone", "hit-uav-drone-physical"])
def test_a_flying_object_is_where_the_recipe_says(recipe: str) -> None:
    drawn, placed = scene(recipe), scene(recipe, PLACE)
    (o,) = placed.objects
    ((x, y),), _ = placed.camera.project(np.array([o.position_m]))
    assert (x, y) == pytest.approx((100, 400))
    assert np.linalg.norm(np.asarray(o.position_m) - placed.camera.position_m) == pytest.approx(21.5)
    assert math.degrees(o.yaw_rad) == pytest.approx(30)
    assert o.by_hand and not drawn.objects[0].by_hand
    assert placed.camera == drawn.camera and o.parts == drawn.objects[0].parts and o.params == drawn.objects[0].params
    assert SceneSpec.from_json(placed.to_json()) == placed
    assert "by_hand" not in drawn.to_json()["objects"][0], "records of other frames stay as they were"


def test_what_is_not_stated_stays_as_drawn() -> None:
    drawn = scene("hit-uav-drone-physical", **{"objects.0.count": 2})
    moved = scene("hit-uav-drone-physical", {}, {"x_px": 50, "y_px": 60}, **{"objects.0.count": 2})
    assert moved.objects[0] == drawn.objects[0]
    before, after = (np.asarray(s.objects[1].position_m) - s.camera.position_m for s in (drawn, moved))
    assert np.linalg.norm(after) == pytest.approx(np.linalg.norm(before))
    assert moved.objects[1].yaw_rad == drawn.objects[1].yaw_rad


def test_a_standing_object_is_on_the_ground() -> None:
    settings = {"objects.0.count": 1}
    placed = scene("hit-uav-person", {"x_px": 320, "y_px": 500}, **settings)
    (o,) = placed.objects
    ((x, y),), _ = placed.camera.project(np.array([o.position_m]))
    assert (x, y) == pytest.approx((320, 500))
    assert placed.view is not None and o.position_m[2] == placed.view.ground_z_m
    with pytest.raises(RecipeError, match="stands on the ground"):
        scene("hit-uav-person", PLACE, **settings)
    with pytest.raises(RecipeError, match="below the horizon"):
        scene("hit-uav-person", {"x_px": 320, "y_px": -5000}, **settings)


def test_wrong_entries_are_refused() -> None:
    with pytest.raises(RecipeError, match="at most 1"):
        scene("hit-uav-drone", PLACE, PLACE)
    for entry in ({"x_px": 1}, {"range_m": 0}, {"z_m": 1}):
        with pytest.raises(RecipeError, match="frames"):
            scene("hit-uav-drone", entry)


def test_a_recipe_placed_by_hand_gives_the_same_bytes_from_the_shell(
    write_tiny_hit_uav: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = write_tiny_hit_uav(tmp_path / "data")
    frame, other = "test/0_130_90_0_00004_c0", "test/0_130_90_0_00004_c1"
    recipe = tmp_path / "placed.yaml"
    text = api.show_recipe("hit-uav-drone")
    # Half outside the frame, which no draw would accept.
    recipe.write_text(f"{text}\nframes:\n  {frame}: {{objects: [{{x_px: 636, y_px: 200, range_m: 4, yaw_deg: 45}}]}}\n")
    tried = api.try_recipe(recipe, data, frame, execution=FLAT).frame
    assert tried.scene is not None and tried.scene.objects[0].by_hand
    assert tried.inserted[0].truncated
    render_flat(monkeypatch)
    done("generate", recipe, "--data", data, "--out", tmp_path / "run", "--split", "test")
    assert (tmp_path / "run/images" / tried.record.image).read_bytes() == tried.image_bytes
    untouched = api.try_recipe("hit-uav-drone", data, other, execution=FLAT).frame
    assert (tmp_path / "run/images" / untouched.record.image).read_bytes() == untouched.image_bytes


def test_a_frame_that_does_not_exist_is_a_warning(write_tiny_hit_uav: Callable[..., Path], tmp_path: Path) -> None:
    settings = {"frames": {"test/nowhere_c0": {"objects": [PLACE]}}}
    frames = api.frames(
        "hit-uav-drone", write_tiny_hit_uav(tmp_path), settings=settings, execution=FLAT, selection=FrameSelection()
    )
    assert [p.where for p in frames.problems if p.code == "frame-unknown"] == ["frames.test/nowhere_c0"]
    frames.close()
