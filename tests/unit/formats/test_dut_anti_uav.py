"""DUT-Anti-UAV: bad boxes, empty files, doubled folders; visible light is never a background."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.published import dut_anti_uav
from tests.unit.formats.test_voc import box, codes, xml

UAV = "<name>UAV</name><pose>Unspecified</pose><truncated>0</truncated><difficult>0</difficult>"


@pytest.fixture(params=["", "train"])
def data(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """Three pictures of train in colour, in its own folder or in a doubled one, and one of test."""
    colour = np.zeros((80, 100, 3), np.uint8) + np.array([30, 120, 200], np.uint8)
    root = tmp_path / "data"
    train = root / "train" / request.param
    for folder, name in ((train, "00001"), (train, "00002"), (train, "00003"), (root / "test", "00001")):
        (folder / "img").mkdir(parents=True, exist_ok=True)
        Image.fromarray(colour).save(folder / "img" / f"{name}.jpg")
        xml(folder / "xml" / f"{name}.xml", name=f"{name}.jpg")
    bad = (box(120, 10, 130, 20), box(10, 10, 10, 20), box(30, 10, 20, 20), box(-5, -5, -1, -1))
    good = (box(10, 10, 20, 16), box(90, 70, 104, 80))
    xml(train / "xml" / "00002.xml", *(UAV + b for b in (*good, *bad)), name="00002.jpg")
    return root


def test_bad_boxes_are_counted_and_empty_files_mean_no_drone(data: Path) -> None:
    d = dataset_folder.read(data)
    counts = [(i.split, i.file_name, len(i.instances)) for i in d.images]
    assert d.format == "dut-anti-uav" and sorted(counts) == [
        ("test", "00001.jpg", 0), ("train", "00001.jpg", 0), ("train", "00002.jpg", 2), ("train", "00003.jpg", 0),
    ]  # fmt: skip
    assert sorted(codes(d)) == ["box-empty", "box-empty", "box-outside", "box-outside"]
    assert codes(d, "warning") == ["box-clipped"]
    assert d.notes["rows"] == {"files": 4, "objects": 6, "read": 2, "parts": 0, "unlabelled": 0}
    image = next(i for i in d.images if i.instances)
    assert image.instances[1].box_xyxy.tolist() == [90, 70, 100, 80]
    assert {i.extra["modality"] for i in d.images} == {"visible"} and d.notes["pitch"] == "none"
    assert len({i.id for i in d.images}) == 4
    assert len(dut_anti_uav.read(data, splits=["test"]).images) == 1


def test_colour_is_never_a_background(data: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="visible light") as caught:
        api.generate(
            "hit-uav-drone",
            data,
            tmp_path / "run",
            execution=api.Execution(renderer="flat", in_process=True),
            settings=["camera.pitch={fixed_deg: 40}", "output.formats=[coco]"],
        )
    assert sum(p.code == "image-visible" for p in caught.value.problems) == 4
    assert not (tmp_path / "run").exists()


def test_other_names_are_new_categories(data: Path) -> None:
    xml(data / "test" / "xml" / "00001.xml", f"<name>bird</name>{box(1, 2, 30, 40)}")
    d = dut_anti_uav.read(data, splits=["test"])
    assert [(c.id, c.name) for c in d.categories] == [(0, "UAV"), (1, "bird")]
    assert codes(d, "warning") == ["category-unknown"]
