"""HIT-UAV's real files: read, written and read again in all four forms."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.file_opens import count_opens

from infrablend.core.dataset import Dataset
from infrablend.formats import dataset_folder
from infrablend.formats.labels import yolo
from infrablend.formats.published import hit_uav
from infrablend.formats.read_write import Reading

COUNTS = {"train": (1000, 8706), "val": (290, 2460), "test": (579, 4811)}


def assert_equal(a: Dataset, b: Dataset, atol_px: float = 0.0) -> None:
    assert [i.id for i in a.images] == [i.id for i in b.images]
    for x, y in zip(a.images, b.images, strict=True):
        facts = [
            (i.split, i.size_wh, i.capture.pitch_deg, i.capture.altitude_m, i.capture.time_of_day, i.source_id)
            for i in (x, y)
        ]
        assert facts[0] == facts[1]
        assert len(x.instances) == len(y.instances)
        for p, q in zip(x.instances, y.instances, strict=True):
            assert p.equals(q, atol_px), (x.id, p, q)


def test_all_forms_agree_on_every_object_and_each_file_is_parsed_once(
    real_data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The time that reading takes is in bench/reading.py; what costs most of it is counted here."""
    parsed: list[int] = []
    loads = json.loads

    def counted(text: str) -> Any:
        parsed.append(len(text))
        return loads(text)

    monkeypatch.setattr(json, "loads", counted)
    with count_opens(real_data / "hit-uav") as opens:
        d = dataset_folder.read(real_data / "hit-uav")
    monkeypatch.undo()
    annotations = {p for p in opens if p.suffix in (".json", ".xml", ".txt")}
    twice = [p for p, n in opens.items() if n > 1 and p not in annotations]
    assert len(twice) < 128, "headers are read once; some that are spread over the dataset again, for their orientation"
    assert len(annotations) > 100
    # Detection peeks into the JSON files and parses one of the XML files.
    assert set(opens.values()) <= {1, 2}
    assert [p.suffix for p in annotations if opens[p] == 2 and p.suffix != ".json"] == [".xml"]
    assert len(parsed) == sum(p.suffix == ".json" for p in opens)
    assert d.format == "hit-uav"
    for split, (images, boxes) in COUNTS.items():
        part = [i for i in d.images if i.split == split]
        assert (len(part), sum(len(i.instances) for i in part)) == (images, boxes)
    assert set(d.notes["forms"]) == set(hit_uav.FORMS)
    assert set(d.notes["disagreements"].values()) == {0}
    assert d.notes["boxes_checked"] == 15977 + 513 + 513
    assert [p.code for p in d.problems] == ["form-partial", "form-partial"]
    assert all(i.capture.pitch_deg is not None and i.capture.altitude_m is not None for i in d.images)
    assert sum(o.truncated is not None for i in d.images for o in i.instances) == 513


def test_normal_json_boxes_are_unchanged(real_data: Path) -> None:
    d = dataset_folder.read(real_data / "hit-uav", Reading(splits=["test"]))
    top = json.loads((real_data / "hit-uav/normal_json/annotations/test.json").read_text())
    boxes = {a["id"]: a["bbox"] for a in top["annotation"]}
    assert len(boxes) == 4811
    for image in d.images:
        for o in image.instances:
            x, y, w, h = boxes.pop(o.source_id)
            assert o.box_xyxy.tolist() == [x, y, x + w, y + h]
    assert boxes == {}


@pytest.mark.parametrize("form", hit_uav.FORMS)
def test_written_and_read_again_it_is_equal(real_data: Path, form: hit_uav.Form, tmp_path: Path) -> None:
    d = hit_uav.read(real_data / "hit-uav" / form)
    ids = "source" if form.endswith("_json") else "new"
    written = hit_uav.write(tmp_path, d.images, d.categories, forms=[form], ids=ids, extra=d.extra)
    assert not any(k.endswith("fraction_truncated") for k in written.losses)
    assert_equal(d, hit_uav.read(tmp_path / form))
    key = {"normal_json": "annotation", "rotate_json": "annotations"}.get(form)
    for path in sorted((tmp_path / form / "annotations").glob("*.json")) if key else ():
        theirs = json.loads((real_data / "hit-uav" / path.relative_to(tmp_path)).read_text())
        ours = json.loads(path.read_text())
        assert list(ours) == list(theirs)
        for records in ("images", key):
            assert sorted(ours[records], key=lambda r: r["id"]) == sorted(theirs[records], key=lambda r: r["id"])
        assert ours["categories"] == theirs["categories"]


def test_truncating_oriented_boxes_gives_the_normal_ones(real_data: Path, tmp_path: Path) -> None:
    d = hit_uav.read(real_data / "hit-uav", form="rotate_json")
    written = hit_uav.write(tmp_path, d.images, d.categories, forms=["normal_json"], ids="source", pictures=False)
    for path in written.files:
        ours = {a["id"]: a["bbox"] for a in json.loads(path.read_text())["annotation"]}
        top = json.loads((real_data / "hit-uav" / path.relative_to(tmp_path)).read_text())
        assert ours == {a["id"]: a["bbox"] for a in top["annotation"]}
    assert written.losses["normal_json.fraction_truncated"] > 0


def test_yolo_keeps_boxes_to_a_millionth_of_a_pixel(real_data: Path, tmp_path: Path) -> None:
    d = dataset_folder.read(real_data / "hit-uav", Reading(splits=["val"]))
    written = yolo.write(tmp_path, d.images, d.categories)
    assert written.losses["ignore_dropped"] == 7
    again = dataset_folder.read(tmp_path)
    assert again.format == "yolo"
    for a, b in zip(d.images, again.images, strict=True):
        boxes = [o.box_xyxy for o in a.instances if o.category != "DontCare"]
        np.testing.assert_allclose([o.box_xyxy for o in b.instances], boxes, rtol=0, atol=1e-6) if boxes else None


def test_folders_of_other_data_are_read(real_data: Path) -> None:
    wisard = dataset_folder.read(real_data / "wisard")
    assert wisard.format == "wisard"
    assert [p for p in wisard.problems if p.severity == "error"] == []
    assert sum(len(i.instances) for i in wisard.images) > 30
    assert len(dataset_folder.read(real_data / "birdsai").images) == 7
