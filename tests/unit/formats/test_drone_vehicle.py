"""DroneVehicle: the white border, misspelt classes, boxes at the edge, pairs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend.core.dataset import Dataset
from infrablend.formats import dataset_folder
from infrablend.formats.read_write import Reading
from tests.samples import SAMPLES


def codes(dataset: Dataset) -> list[str]:
    return sorted(p.code for p in dataset.problems)


def polygon(*numbers: float, name: str = "car") -> str:
    corners = "".join(f"<{'xy'[k % 2]}{k // 2 + 1}>{v}</{'xy'[k % 2]}{k // 2 + 1}>" for k, v in enumerate(numbers))
    return f"<object><name>{name}</name><polygon>{corners}</polygon></object>"


@pytest.fixture
def bordered(tmp_path: Path) -> Path:
    """One thermal picture in its published size, grey inside a white border."""
    pixels = np.full((712, 840), 255, np.uint8)
    pixels[100:612, 100:740] = 90
    for folder in ("valimgr", "valimg"):
        (tmp_path / "val" / folder).mkdir(parents=True)
        Image.fromarray(pixels).save(tmp_path / "val" / folder / "00001.jpg", quality=100)
    objects = (
        polygon(300, 200, 340, 210, 335, 230, 295, 220),
        polygon(295, 220, 335, 230, 340, 210, 300, 200, name="feright_car"),
        polygon(80, 150, 120, 150, 120, 160, 80, 160, name="truvk"),
        polygon(10, 10, 50, 10, 50, 20, 10, 20),
        polygon(400, 400, 440, 400, 440, 420, 400, 420, name="*"),
        "<object><name>bus</name><bndbox><xmin>150</xmin><ymin>160</ymin><xmax>180</xmax><ymax>175</ymax></bndbox></object>",
        "<object><name>van</name></object>",
    )
    (tmp_path / "val" / "vallabelr").mkdir()
    text = f"<annotation><filename>00001.jpg</filename>{''.join(objects)}</annotation>"
    (tmp_path / "val" / "vallabelr" / "00001.xml").write_text(text)
    return tmp_path


def test_the_white_border_is_taken_off(bordered: Path) -> None:
    d = dataset_folder.read(bordered)
    assert d.format == "drone-vehicle"
    (image,) = d.images
    assert image.size_wh == (640, 512) and image.split == "val"
    with Image.open(image.path) as picture:
        assert picture.size == (640, 512)
        assert picture.getextrema()[1] < 100
    assert [o.category for o in image.instances] == ["car", "freight car", "truck", "bus"]
    assert image.instances[0].corners_xy.tolist() == [[200, 100], [240, 110], [235, 130], [195, 120]]
    assert image.instances[1].corners_xy.tolist() == [[195, 120], [200, 100], [240, 110], [235, 130]]
    assert image.instances[2].box_xyxy.tolist() == [0, 50, 20, 60]
    assert image.instances[3].box_xyxy.tolist() == [50, 60, 80, 75]
    assert codes(d) == ["annotation-layout", "box-clipped", "box-outside", "category-unknown"]
    rows = d.notes["rows"]
    assert (rows["objects"], rows["read"], rows["outside"], rows["unknown"], rows["cropped"]) == (7, 4, 1, 1, 1)


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (0, 3, 2, 1), (0, 2, 1, 3), (0, 1, 3, 2), (0, 3, 1, 2), (0, 2, 3, 1)])
def test_corners_in_any_order_give_one_outline(order: tuple[int, ...], bordered: Path) -> None:
    corners = [(300, 200), (340, 210), (335, 230), (295, 220)]
    text = polygon(*(v for k in order for v in corners[k]))
    (bordered / "val" / "vallabelr" / "00001.xml").write_text(f"<annotation>{text}</annotation>")
    (image,) = dataset_folder.read(bordered).images
    assert image.instances[0].corners_xy.tolist() == [[200, 100], [240, 110], [235, 130], [195, 120]]


def test_the_border_can_be_kept(bordered: Path) -> None:
    (image,) = dataset_folder.read(bordered, Reading(options={"border": "keep"})).images
    assert image.size_wh == (840, 712) and image.path.parent.name == "valimgr"
    assert image.instances[0].corners_xy[0].tolist() == [300, 200]


def test_pairs_name_their_twin_and_visible_light_is_marked(tmp_path: Path) -> None:
    root = SAMPLES["drone-vehicle"](tmp_path)
    assert {i.extra["twin"] for i in dataset_folder.read(root).images} == {
        "train/trainimg/00001.jpg", "train/trainimg/00002.jpg", "val/valimg/00001.jpg",
    }  # fmt: skip
    both = dataset_folder.read(root, Reading(options={"modality": "both"}))
    assert [i.extra.get("modality") for i in both.images].count("visible") == 3 and len(both.images) == 6


def test_pictures_without_labels_and_labels_without_pictures(tmp_path: Path) -> None:
    root = SAMPLES["drone-vehicle"](tmp_path)
    (root / "train" / "trainlabelr" / "00001.xml").rename(root / "train" / "trainlabelr" / "00009.xml")
    d = dataset_folder.read(root)
    assert len(d.images) == 2 and codes(d) == ["image-missing", "label-missing"]
    kept = dataset_folder.read(root, Reading(options={"unlabelled": "keep"}))
    assert sorted(str(i.extra.get("labelled")) for i in kept.images) == ["False", "None", "None"]
