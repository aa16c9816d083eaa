"""Recipe fields that no shipped recipe sets have their documented effect."""

import numpy as np
import pytest

from infrablend import api
from infrablend.assets.catalogue import load_model
from infrablend.config.loading import load_recipe
from infrablend.core.capture import Capture
from infrablend.core.dataset import Instance
from infrablend.formats import dataset_folder
from infrablend.pipeline.plans.run_request import Execution
from infrablend.sampling.scene_sampler import sample_scene
from infrablend.sampling.site import FrameKey, Site
from tests.run_files import records

WH = (640, 512)
FLAT = Execution(renderer="flat", in_process=True)


def draw(recipe: str, settings=(), time_of_day="night", labels=(), number=0):
    loaded = load_recipe(recipe, settings)
    models = {o.model: load_model(o.model) for o in loaded.objects}
    key = FrameKey(f"f{number}", "train", 0, WH, Capture(pitch_deg=60.0, time_of_day=time_of_day))
    site = Site(np.full(WH[::-1], 120, np.uint8), tuple(labels), frozenset({"DontCare"}), 80.0)
    return sample_scene(key, loaded, models, 0, site).spec


def generate(tmp_path, write_tiny_hit_uav, name, settings):
    data = tmp_path / "data"
    if not data.exists():
        write_tiny_hit_uav(data, ("normal_json", "rotate_json"))
    out = tmp_path / name
    api.generate("hit-uav-drone", data, out, limit=1, settings={"output.image": "png", **settings}, execution=FLAT)
    return out, [r for r in records(out) if r.scene is not None]


def test_the_dew_point_lies_below_the_air_by_the_drawn_difference():
    dry, damp = (draw("hit-uav-person", {"environment.dew_point_below_air_k": k}).weather for k in (20, 3))
    assert dry.air_k - dry.dew_point_k == pytest.approx(20)
    assert damp.air_k - damp.dew_point_k == pytest.approx(3)
    # Nothing else of the weather changes.
    assert (dry.air_k, dry.cloud, dry.cloud_base_k, dry.ground_k) == (damp.air_k, damp.cloud, damp.cloud_base_k,
                                                                     damp.ground_k)  # fmt: skip


@pytest.mark.parametrize(("time_of_day", "above"), [("day", 30), ("night", -20), (None, -20)])
def test_the_ground_is_warmer_than_the_air_by_the_time_of_day(time_of_day, above):
    settings = {"environment.ground_above_air_day_k": 30, "environment.ground_above_air_night_k": -20}
    weather = draw("hit-uav-person", settings, time_of_day).weather
    assert weather.ground_k - weather.air_k == pytest.approx(above)


def test_surroundings_are_colder_than_the_air_and_change_the_picture(tmp_path, write_tiny_hit_uav):
    _, usual = generate(tmp_path, write_tiny_hit_uav, "usual", {})
    _, cold = generate(tmp_path, write_tiny_hit_uav, "cold", {"appearance.surroundings_below_air_k": -15})
    for a, b in zip(usual, cold, strict=True):
        assert a.scene.ambient_k - a.scene.appearance.surroundings_k == pytest.approx(10)
        assert b.scene.ambient_k - b.scene.appearance.surroundings_k == pytest.approx(-15)
        assert a.scene.objects == b.scene.objects
        assert a.image_sha256 != b.image_sha256


def test_the_ends_of_the_grey_scale_are_the_percentiles_of_the_background(tmp_path, write_tiny_hit_uav):
    from PIL import Image

    settings = {"matching.low_percentile": 10, "matching.high_percentile": 70, "matching.min_span": 0}
    _, found = generate(tmp_path, write_tiny_hit_uav, "run", settings)
    for r in found:
        pixels = np.array(Image.open(tmp_path / "data" / r.background["path"]).convert("L"))
        low, high = np.percentile(pixels, [10, 70])
        assert (r.mapping["dark"], r.mapping["bright"]) == pytest.approx((low, max(high, low + 1)), abs=1)


def test_objects_may_cover_labels_if_the_recipe_says_so():
    annotated = [Instance("Car", np.array([0.0, 0, 640, 512]))]
    three = {"objects.0.count": 3, "camera.calibrate": False, "placement.where": "anywhere"}
    kept = draw("hit-uav-person", three, labels=annotated)
    assert not kept.objects and kept.draws["rejected"]["on_annotated"] > 0
    over = draw("hit-uav-person", {**three, "placement.clear_of_labels": False}, labels=annotated)
    assert len(over.objects) == 3 and "on_annotated" not in over.draws["rejected"]


@pytest.mark.parametrize(("recipe", "default"), [("hit-uav-drone", False), ("hit-uav-drone-physical", True)])
def test_ignore_regions_are_kept_clear_by_default_with_metric_placement_only(recipe, default):
    ignored = [Instance("DontCare", np.array([0.0, 0, 640, 512]))]
    for settings, clear in (({}, default), ({"placement.clear_of_ignored": not default}, not default)):
        spec = draw(recipe, {**settings, "placement.attempts": 30}, labels=ignored)
        assert (len(spec.objects) == 0) is clear
        assert ("on_ignored" in spec.draws["rejected"]) is clear


def test_originals_without_masks_are_left_out_of_yolo_seg_or_written_as_their_oriented_boxes(
    tmp_path, write_tiny_hit_uav
):
    only_seg = {"output.formats": ["yolo-seg"]}
    omitted, _ = generate(tmp_path, write_tiny_hit_uav, "omit", only_seg)
    written, _ = generate(tmp_path, write_tiny_hit_uav, "obb", {**only_seg, "labels.seg_originals": "obb"})

    def lines(run):
        texts = (p.read_text().split("\n") for p in sorted((run / "yolo-seg" / "labels").rglob("*.txt")))
        return [line for text in texts for line in text if line]

    originals = sum(len(i.instances) for i in dataset_folder.read(tmp_path / "data").images[:1]) * 2
    assert originals > 0
    more = len(lines(written)) - len(lines(omitted))
    assert 0 < more <= originals
    corners = [line for line in lines(written) if line not in lines(omitted)]
    assert len(corners) == more and all(len(line.split()) == 9 for line in corners)
