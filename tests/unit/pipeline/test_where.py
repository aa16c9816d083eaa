"""Where a run's objects stand: masks of the user, the dataset's labels, the model's version in the run's key."""

import json

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.config.loading import recipe_text
from infrablend.imaging.surfaces import model_version
from tests.command_line import done, said
from tests.run_files import records
from tests.unit.imaging.test_surfaces import road_by_night

FIELDS = [
    "objects.0.count=3", "camera.calibrate=false", "placement.min_contrast=off", "placement.max_relief_grey=0",
    "output.formats=[coco]",
]  # fmt: skip
# What kind of paving or roof it is, only more of the picture could show.
PAVED = "placement.where.surfaces={road: 1, path: 1, structure: 1, water: 1}"


@pytest.fixture
def roads(tmp_path):
    """Three pictures of a road, from above."""
    data = tmp_path / "data"
    data.mkdir()
    rows = ["file,pitch_deg,altitude_m,time_of_day"]
    for n in range(3):
        Image.fromarray(road_by_night()).save(data / f"{n}.png")
        rows.append(f"{n}.png,90,100,night")
    (data / "metadata.csv").write_text("\n".join(rows) + "\n")
    return data


def mask_all(folder, value=255, mode="L", size=(640, 512), names=("0", "1", "2")):
    folder.mkdir()
    for name in names:
        Image.new(mode, size, value).save(folder / f"{name}.png")
    return folder


def run(data, out, *fields, recipe="hit-uav-car", code=0):
    options = ["--data", data, "--out", out, *(f"--set={f}" for f in (*FIELDS, *fields))]
    return said("generate", recipe, *options, code=code)


def left_edges(out):
    return [label.box_xyxy[0] for r in records(out) for label in r.inserted]


def test_cars_are_on_the_road_and_the_model_is_in_the_key(roads, tmp_path):
    run(roads, tmp_path / "run", PAVED)
    x = left_edges(tmp_path / "run")
    assert len(x) >= 3 and all(170 < v < 420 for v in x)
    assert json.loads((tmp_path / "run/run.json").read_text())["key"]["places"] == model_version()
    run(roads, tmp_path / "anywhere", "placement.where=anywhere")
    assert "places" not in json.loads((tmp_path / "anywhere/run.json").read_text())["key"]


def test_masks_are_found_by_split_or_name_beside_the_recipe(roads, tmp_path):
    masks = mask_all(tmp_path / "masks", names=("1", "2"))
    half = np.zeros((512, 640), np.uint8)
    half[:, 320:] = 255
    (masks / "train").mkdir()
    Image.fromarray(half).save(masks / "train/0.png")
    recipe = tmp_path / "own.yaml"
    recipe.write_text(
        recipe_text("hit-uav-car").replace("  mode: metric\n", "  mode: metric\n  where: {masks: masks}\n", 1)
    )
    run(roads, tmp_path / "run", PAVED, recipe=recipe)
    of_first = [
        label.box_xyxy[0] for r in records(tmp_path / "run") if r.image.endswith("0_c0.png") for label in r.inserted
    ]
    assert of_first and all(v > 280 for v in of_first)


@pytest.mark.parametrize(("mask", "told"), [
    ({"size": (320, 256)}, "320x256"), ({"mode": "RGB", "value": (255, 0, 0)}, "colour"),
    ({"mode": "I;16", "value": 65_535}, "16 bits"),
])  # fmt: skip
def test_unfit_masks_are_named_and_other_frames_are_made(roads, tmp_path, mask, told):
    masks = mask_all(tmp_path / "masks")
    (masks / "1.png").unlink()
    wrong = mask_all(tmp_path / "wrong", **mask)
    (wrong / "1.png").rename(masks / "1.png")
    text = run(roads, tmp_path / "run", f"placement.where.masks={masks}", code=1)
    assert "1.png" in text and told in text
    assert len(records(tmp_path / "run")) == 2


def test_missing_masks_are_counted_and_none_at_all_is_refused(roads, tmp_path):
    masks = mask_all(tmp_path / "masks", names=("0",))
    settings = [*FIELDS, f"placement.where.masks={masks}"]
    flat = api.Execution(renderer="flat", in_process=True)
    report = api.generate("hit-uav-car", roads, tmp_path / "run", settings=settings, execution=flat)
    (warned,) = [p for p in report.problems if p.code == "masks-missing"]
    assert "2 of 3" in warned.found
    for folder in (tmp_path / "none", mask_all(tmp_path / "others", names=("x",))):
        text = run(roads, tmp_path / "out", f"placement.where.masks={folder}", code=2)
        assert "placement.where.masks" in text and "0.png" in text


def test_a_mask_that_allows_nothing_leaves_the_picture_without_objects(roads, tmp_path):
    masks = mask_all(tmp_path / "masks", 0)
    text = run(roads, tmp_path / "run", f"placement.where.masks={masks}", code=1)
    assert "no ground" in text and "placement.where" in text and not left_edges(tmp_path / "run")


def test_labels_are_learned_from_and_shown(roads, tmp_path):
    lines = "\n".join(f"0 {0.5 + 0.02 * (k % 3 - 1)} {0.05 + 0.07 * k} 0.02 0.03" for k in range(12)) + "\n"
    for n in range(3):
        (roads / f"{n}.txt").write_text(lines)
    (roads / "classes.txt").write_text("Car\n")
    found = json.loads(done("places", "learn", roads, "--json").stdout)
    ground = found["ground"]["Car"]["any"]
    assert ground["objects"] == 36
    assert ground["around"]["grass"] < 0.1 < 0.5 < ground["anywhere"]["grass"] and ground["factors"]["grass"] < 0.5
    assert "Car" in done("places", "learn", roads).stdout and found["model"] == model_version()


def test_pictures_without_labels_teach_nothing(roads, tmp_path):
    assert "no picture has labelled objects" in said("places", "learn", roads, code=2)
