"""Small real runs with Blender, which repeat for any number of workers and after an interruption."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.compositing.overlay import blur_radius_px
from infrablend.core.tasks import Progress
from infrablend.errors import Interrupted
from tests.run_files import hashes, records

SETTINGS = {"output.image": "png", "objects.0.count": 2, "placement.size_px": [10, 160]}


@pytest.fixture(scope="module")
def backgrounds(tmp_path_factory) -> Path:
    """Three small grey pictures with the pitch in their names."""
    root = tmp_path_factory.mktemp("backgrounds")
    rng = np.random.default_rng(2)
    for n, pitch in enumerate((30, 60, 90)):
        grey = np.clip(rng.normal(120, 25, (256, 320)), 16, 235).astype(np.uint8)
        Image.fromarray(grey).save(root / f"1_80_{pitch}_0_0000{n}.png")
    return root


@pytest.fixture(scope="module")
def whole(backgrounds, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "whole"
    report = api.generate("hit-uav-drone", backgrounds, out, execution=api.Execution(workers=2), settings=SETTINGS)
    assert report.ok
    assert report.counts["frames"] == 6
    return out


def test_one_worker_and_an_interruption_give_the_same_bytes(whole, backgrounds, tmp_path):
    out = tmp_path / "run"

    def stop(progress: Progress) -> None:
        if progress.done == 2:
            raise Interrupted("stop")

    with pytest.raises(Interrupted):
        api.generate(
            "hit-uav-drone", backgrounds, out, execution=api.Execution(workers=1), settings=SETTINGS, on_progress=stop
        )
    api.generate(
        "hit-uav-drone", backgrounds, out, execution=api.Execution(workers=1), settings=SETTINGS, existing="resume"
    )
    assert hashes(out) == hashes(whole)


@pytest.mark.long
def test_merged_shards_have_the_same_bytes(whole, backgrounds, tmp_path):
    for number in (2, 1):
        shard = api.ShardRequest(number, 2)
        api.generate_shard(
            api.RunRequest(
                "hit-uav-drone", backgrounds, tmp_path / "out", settings=SETTINGS,
                execution=api.Execution(workers=1), shard=shard,
            )
        )  # fmt: skip
    assert [s.state for s in api.status(tmp_path / "out")] == ["done", "done"]
    api.merge([tmp_path / "out"], tmp_path / "merged")
    assert hashes(tmp_path / "merged") == hashes(whole)


def test_labels_against_pixels(whole, backgrounds, blender):
    """Changed pixels lie in coverage dilated by the blur; mask pixels predicted to change by 2 levels have changed."""
    from infrablend.assets.catalogue import load_model
    from infrablend.compositing.mapping import GreyMapping
    from infrablend.compositing.overlay import blend, make_layer
    from infrablend.sampling.scene_sampler import rebuild_scene

    models = {"drone": load_model("drone")}
    softness = 0.45
    reach = blur_radius_px(softness)
    seen = 0
    for record in records(whole):
        before = np.array(Image.open(backgrounds / record.background["path"]))
        after = np.array(Image.open(whole / "images" / record.image))
        changed = before != after
        result = blender.render(rebuild_scene(record.scene, models))
        covered = np.zeros(before.shape, np.uint8)
        (x0, y0), (h, w) = result.offset_xy, result.alpha.shape
        covered[y0 : y0 + h, x0 : x0 + w] = result.alpha > 0
        import cv2

        grown = cv2.dilate(covered, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)).astype(bool)
        assert not (changed & ~grown).any()
        mapping = GreyMapping(**record.mapping)
        layer = make_layer(result, mapping, softness)
        (lx, ly), (rows_, columns_) = layer.offset_xy, layer.alpha.shape
        predicted = np.zeros(before.shape)
        part = (slice(ly, ly + rows_), slice(lx, lx + columns_))
        predicted[part] = blend(before, layer) - before[part]
        for instance in record.inserted:
            mask = instance.mask.to_array()
            must = mask & (np.abs(predicted) >= 2)
            assert must.any()
            assert changed[must].all()
            seen += int(must.sum())
            rows, columns = np.nonzero(mask)
            bx0, by0, bx1, by1 = instance.box_xyxy
            assert bx0 - 1 <= columns.min()
            assert columns.max() + 1 <= bx1 + 1
            assert by0 - 1 <= rows.min()
            assert rows.max() + 1 <= by1 + 1
    assert seen > 500


def test_rerender_gives_the_same_bytes(whole, tmp_path):
    record = records(whole)[3]
    again = api.rerender(whole, record.frame_id, tmp_path / "again.png")
    assert again.read_bytes() == (whole / "images" / record.image).read_bytes()


def test_run_record_names_versions_and_draws(whole):
    run = json.loads((whole / "run.json").read_text())
    assert run["packages"]["blender"].startswith("4.5.")
    assert run["draws"]["distance_m"]["first_draw"]["mean"] > 0
    assert run["timing"]["peak_worker_rss_mb"] < 1024


def test_infrared_effect_asset(tmp_path, blender):
    path = api.write_infrared_effect(tmp_path / "infrared_effect.blend")
    code = """
import bpy
names = ["InfraredEffect", "InfraredEffect Physical"]
with bpy.data.libraries.load(given["path"], assets_only=True) as (source, _):
    assets = sorted(source.node_groups)
# What this process has already made is in use elsewhere; appended groups get names of their own.
with bpy.data.libraries.load(given["path"]) as (source, target):
    target.node_groups = names
    materials = list(source.materials)
groups = []
for group in target.node_groups:
    sockets = [[s.name, s.description] for s in group.interface.items_tree if s.in_out == "INPUT"]
    groups.append({"kinds": sorted({n.type for n in group.nodes}), "sockets": sockets})
    bpy.data.node_groups.remove(group)
answer = {"assets": assets, "materials": materials, "groups": groups}
"""
    found = blender.run(code, path=str(path))
    assert found["assets"] == ["InfraredEffect", "InfraredEffect Physical"]
    assert {"InfraredEffect example", "InfraredEffect Physical example"} <= set(found["materials"])
    artistic, physical = found["groups"]
    assert {"EMISSION", "VALTORGB", "FRESNEL"} <= set(artistic["kinds"])
    assert {"EMISSION", "BSDF_GLOSSY", "TEX_NOISE", "FRESNEL"} <= set(physical["kinds"])
    for group in (artistic, physical):
        assert [name for name, _ in group["sockets"]][:2] == ["Temperature", "Emissivity"]
        assert "Celsius" in group["sockets"][0][1]


def test_turntable(tmp_path):
    sheet = api.show_model("drone", tmp_path / "drone.png", options={"body": "shell"})
    with Image.open(sheet) as picture:
        pixels = np.array(picture.convert("L"))
    assert pixels.shape[0] > 1000
    assert pixels.std() > 8
    # The first row looks up at the sky, the fifth down at the ground; the object is brighter than either.
    height = (pixels.shape[0] - 480) // 8  # the last row shows the parts
    below, above = pixels[20 : height - 2, 5:215], pixels[4 * height + 20 : 5 * height - 2, 5:215]
    assert np.median(below) < 60 < np.median(above)
    assert below.max() > np.median(below) + 50 and above.max() > np.median(above) + 50
