"""Partly hidden objects in the pipeline, with the software renderer."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.compositing.occlusion import Occluder, Scenery
from infrablend.config.recipe import Occlusion
from infrablend.core.frame_row import FrameRecord
from infrablend.pipeline.compose.partly_hidden import Cover
from tests.recipes import ANYWHERE
from tests.run_files import records

SHARE = "occlusion={share: 1, visible: [0.4, 0.75]}"


def wood(seed: int, branches: int = 2500) -> np.ndarray:
    """Even ground under bright branches in all directions, as seen by night."""
    rng = np.random.default_rng(seed)
    picture = np.full((512, 640), 70.0)
    for _ in range(branches):
        x, y, turn, length = rng.uniform((0, 0, 0, 10), (640, 512, np.pi, 40))
        dx, dy = length / 2 * np.cos(turn), length / 2 * np.sin(turn)
        ends = [(int(x + s * dx), int(y + s * dy)) for s in (-1, 1)]
        cv2.line(picture, ends[0], ends[1], float(rng.uniform(100, 150)), 2)
    grain = rng.normal(0, 1.5, picture.shape)
    return np.clip(cv2.GaussianBlur(picture, (0, 0), 0.8) + grain, 16, 235).round().astype(np.uint8)


def folder(root: Path, *pictures: np.ndarray) -> Path:
    root.mkdir()
    rows = ["file,pitch_deg,altitude_m,time_of_day"]
    for n, picture in enumerate(pictures):
        Image.fromarray(picture).save(root / f"{n}.png")
        rows.append(f"{n}.png,60,100,night")
    (root / "metadata.csv").write_text("\n".join(rows) + "\n")
    return root


def generate(data: Path, out: Path, *settings: str, limit: int | None = None) -> Any:
    given = [ANYWHERE, "output.image=png", "objects=[{model: deer, count: 3}]", "placement.min_contrast=off", *settings]
    how = api.Execution(renderer="flat", in_process=True)
    return api.generate("monet-deer-physical", data, out, settings=given, limit=limit, execution=how)


def pictures(run: Path, data: Path, record: FrameRecord) -> tuple[np.ndarray, np.ndarray]:
    before, after = (Image.open(p) for p in (data / record.background["path"], run / "images" / record.image))
    return np.array(before).astype(int), np.array(after).astype(int)


@pytest.mark.parametrize("kind", ["8 bit", "16 bit"])
def test_boxes_fit_what_is_visible_of_partly_hidden_objects(tmp_path: Path, kind: str) -> None:
    picture: Any = wood(0)
    picture = {"8 bit": picture, "16 bit": picture.astype(np.uint16) * 20 + 7000}[kind]
    data = folder(tmp_path / "data", picture)
    more = ["placement.max_noise_grey=50", "sensor.profile=off", "overlay.softness_px=0"]
    generate(data, tmp_path / "shape", SHARE, *more)
    fitted = generate(data, tmp_path / "visible", SHARE, "labels.fit=visible", *more)
    assert fitted.counts["boxes_fit"] == "visible"
    (record,) = records(tmp_path / "visible")
    before, after = pictures(tmp_path / "visible", data, record)
    change = np.abs(after - before)

    def annotations(run: str) -> list[Any]:
        return json.loads((tmp_path / run / "coco" / "train.json").read_text())["annotations"]

    assert [label.extra.get("occluded") for label in record.inserted].count(True) >= 2
    moved = 0
    for label, shape, seen in zip(record.inserted, annotations("shape"), annotations("visible"), strict=True):
        assert label.mask is not None
        # The exact boxes and masks stay; the box as written is inside the visible one, and holds what changed most.
        assert seen.get("tight_bbox", seen["bbox"]) == shape["bbox"]
        assert seen.get("segmentation") == shape.get("segmentation")
        (x, y, w, h), (sx, sy, sw, sh) = shape["bbox"], seen["bbox"]
        assert sx >= x - 1e-6 and sy >= y - 1e-6 and sx + sw <= x + w + 1e-6 and sy + sh <= y + h + 1e-6
        most = label.mask.to_array() & (change > 0.6 * change[label.mask.to_array()].max())
        v, u = np.nonzero(most)
        assert sx <= u.min() + 1 and u.max() <= sx + sw and sy <= v.min() + 1 and v.max() <= sy + sh
        assert seen["bbox"] == seen.get("seen_bbox", shape["bbox"])
        moved += seen["bbox"] != shape["bbox"]
    assert moved == fitted.counts.get("boxes_loosened", 0)


@pytest.mark.parametrize("kind", ["8 bit", "black-hot", "16 bit"])
def test_the_labels_describe_what_the_picture_shows(tmp_path: Path, kind: str) -> None:
    picture: Any = wood(0)
    picture = {"8 bit": picture, "black-hot": 255 - picture, "16 bit": picture.astype(np.uint16) * 20 + 7000}[kind]
    data, run = folder(tmp_path / "data", picture), tmp_path / "run"
    more = ["placement.max_noise_grey=50", f"matching.polarity={'black' if kind == 'black-hot' else 'white'}-hot"]
    generate(data, run, SHARE, "sensor.profile=off", "overlay.softness_px=0", *more)
    generate(data, tmp_path / "amodal", SHARE, "sensor.profile=off", "labels.occluded_box=amodal", *more)
    (record,), (amodal,) = records(run), records(tmp_path / "amodal")
    before, after = pictures(run, data, record)
    changed = before != after
    occluders = {o["object"]: o for o in record.facts["occlusion"] if "window" in o}
    hidden = [i for i in record.inserted if i.extra.get("occluded")]
    assert {i.extra["object"] for i in hidden} == set(occluders)
    assert len(hidden) >= 2
    every = np.zeros(changed.shape, np.bool_)
    for label, whole in zip(record.inserted, amodal.inserted, strict=True):
        assert label.mask is not None and label.visibility is not None
        mask = label.mask.to_array()
        every |= mask
        # The object is far warmer than branches and ground, so its pixels change; at outlines they may do so by less
        # than a level.
        assert changed[mask].mean() > 0.9
        if not label.extra.get("occluded"):
            continue
        assert 0.4 <= label.visibility <= 0.75
        assert label.visibility == pytest.approx(occluders[label.extra["object"]]["visible"], abs=0.03)
        assert label.extra["amodal_box"] == whole.extra["amodal_box"] == pytest.approx(whole.box_xyxy.tolist())
        assert label.extra["visible_box"] == pytest.approx(label.box_xyxy.tolist())
        rows, columns = np.nonzero(mask)
        tight = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
        assert label.box_xyxy == pytest.approx(tight, abs=1)
    # What changes beside the masks are pixels at outlines, which object and background share.
    near = cv2.dilate(every.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    assert changed[~near].sum() <= 0.05 * changed.sum()


def test_other_frames_and_rerendering_do_not_change_the_bytes(tmp_path: Path) -> None:
    data = folder(tmp_path / "data", wood(0), wood(1))
    generate(data, tmp_path / "both", SHARE)
    generate(data, tmp_path / "one", SHARE, limit=1)
    record, _ = records(tmp_path / "both")
    assert [r.to_json() for r in records(tmp_path / "one")] == [record.to_json()]
    assert any(i.extra.get("occluded") for i in record.inserted)
    again = api.rerender(tmp_path / "both", record.frame_id, tmp_path / "again.png")
    assert again.read_bytes() == (tmp_path / "both" / "images" / record.image).read_bytes()


def test_the_sensor_chain_does_not_change_what_is_in_front(tmp_path: Path) -> None:
    data = folder(tmp_path / "data", wood(0))
    generate(data, tmp_path / "run", SHARE)
    (record,) = records(tmp_path / "run")
    before, after = pictures(tmp_path / "run", data, record)
    scenery = Scenery(before.astype(np.uint8))
    found = [Occluder.from_json(o) for o in record.facts["occlusion"] if "window" in o]
    assert found
    opaque = []
    for occluder in found:
        left, top, right, bottom = occluder.window
        opaque.append(np.ones(before.shape, np.bool_))
        opaque[-1][top:bottom, left:right] = scenery.matte(occluder) >= 1
        assert opaque[-1][top:bottom, left:right].any()
    # A pixel keeps its value if it is in front of every object whose window contains it.
    assert (before == after)[np.logical_and.reduce(opaque)].all()


def test_objects_are_in_front_where_nothing_can_hide_them(tmp_path: Path) -> None:
    data = folder(tmp_path / "data", wood(0, branches=0))
    report = generate(data, tmp_path / "run", SHARE)
    assert report.counts["partly_hidden"] == {"wanted": 3, "hidden": 0}
    assert "nothing-in-front" in [p.code for p in report.problems]
    generate(data, tmp_path / "off")
    (record,), (off,) = records(tmp_path / "run"), records(tmp_path / "off")
    assert len(record.inserted) == len(off.inserted) == 3
    assert [o["reason"] for o in record.facts["occlusion"]] == ["no_occluder"] * 3
    assert "occlusion" not in off.facts
    assert all("amodal_box" not in i.extra for i in record.inserted)
    assert record.scene is not None
    assert record.scene.draws["rejected"]["no_occluder"] > 0


def test_coco_has_both_boxes_and_other_formats_count_the_loss(tmp_path: Path) -> None:
    data = folder(tmp_path / "data", wood(0))
    report = generate(data, tmp_path / "run", SHARE, "output.formats=[coco, yolo]")
    annotations = json.loads((tmp_path / "run" / "coco" / "train.json").read_text())["annotations"]
    hidden = [a for a in annotations if a.get("occluded")]
    assert len(hidden) >= 2
    for a in hidden:
        assert a["bbox"] == a["bbox_visible"]
        assert a["bbox_amodal"][2] * a["bbox_amodal"][3] >= a["bbox_visible"][2] * a["bbox_visible"][3]
        assert a["visibility"] < 0.76
    assert report.ok
    losses = json.loads((tmp_path / "run" / "run.json").read_text())["losses"]
    assert losses["yolo.occlusion_dropped"] == len(hidden)
    assert "coco.occlusion_dropped" not in losses


def test_what_would_be_less_visible_than_stated_is_left_out_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from infrablend.pipeline.compose import frame

    monkeypatch.setattr(frame, "too_hidden", lambda labels, report, occluded, *limits: sorted(occluded))
    report = generate(folder(tmp_path / "data", wood(0)), tmp_path / "run", SHARE, "placement.contrast_redraws=1")
    (record,) = records(tmp_path / "run")
    assert record.scene is not None
    assert record.scene.draws["absent"]["too_hidden"] >= 1
    assert report.counts["frames_without_object"] == int(not record.inserted)


def test_the_least_visibility_of_all_objects_holds_for_those_behind_branches(tmp_path: Path) -> None:
    data = folder(tmp_path / "data", wood(0), wood(1))
    generate(data, tmp_path / "run", SHARE)
    shown = [i.visibility or 0.0 for r in records(tmp_path / "run") for i in r.inserted if i.extra.get("occluded")]
    assert min(shown) < 0.7
    generate(data, tmp_path / "held", SHARE, "placement.min_visibility=0.7")
    held = [i.visibility or 0.0 for r in records(tmp_path / "held") for i in r.inserted if i.extra.get("occluded")]
    assert all(v >= 0.7 for v in held)


def test_the_box_that_is_written_does_not_decide_what_is_seen(tmp_path: Path) -> None:
    data = folder(tmp_path / "data", wood(0))
    measured = []
    for name in ("visible", "amodal"):
        generate(data, tmp_path / name, SHARE, f"labels.occluded_box={name}", "placement.min_contrast=real")
        (record,) = records(tmp_path / name)
        assert any(i.extra.get("occluded") for i in record.inserted)
        measured.append((record.facts["contrast"], record.image_sha256))
    assert measured[0] == measured[1]


def test_what_is_in_front_of_an_object_that_stays_is_the_same_in_all_frames(tmp_path: Path) -> None:
    rng, data = np.random.default_rng(1), tmp_path / "data"
    data.mkdir()
    whole = wood(0).astype(float)
    for k in range(8):  # the camera glides, and loses a fifth of its contrast
        shown = (1 - 0.03 * k) * whole[k : 440 + k, 4 * k : 560 + 4 * k] + 10 + rng.normal(0, 2, (440, 560))
        Image.fromarray(np.clip(shown, 0, 255).round().astype(np.uint8)).save(data / f"wood_{k:03}.png")
    camera = ["camera.pitch={fixed_deg: 60}", "camera.altitude={fixed_m: 60}", "placement.max_noise_grey=50"]
    generate(data, tmp_path / "run", SHARE, *camera, "objects.0.motion={kind: still}")
    fronts: dict[int, list[dict[str, Any]]] = {}
    for record in records(tmp_path / "run"):
        found = {o["object"]: o for o in record.facts["occlusion"] if "window" in o}
        for label in record.inserted:
            fronts.setdefault(label.track_id, []).append(found.get(label.extra["object"], {}))
    hidden = [fs for fs in fronts.values() if any(fs)]
    assert len(hidden) >= 2
    for front in hidden:
        assert len(front) == 8 and all(front)
        assert len({(f["bright"], f["width_px"]) for f in front}) == 1
        visible, limits = [f["visible"] for f in front], [f["limit_grey"] for f in front]
        # What is left is grain, of a tenth of the structures, at the edges of a few hundred pixels.
        assert max(visible) - min(visible) < 0.1
        assert limits == sorted(limits, reverse=True) and limits[-1] == pytest.approx(0.79 * limits[0], rel=0.05)


def test_nothing_hides_an_object_outside_the_frame() -> None:
    cover = Cover(Occlusion(share=1), Scenery(wood(0)), {})
    outside = np.array([[[-30.0, 100.0], [-10.0, 100.0], [-20.0, 140.0]]])
    assert cover._find(outside, (640, 512), 0.5, stands=True) is None
