"""Data of experiments: merged and pasted datasets, and folders matched with sources."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from infrablend.api import plan_experiment
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.errors import DatasetError
from infrablend.formats.pictures.images import load_background
from infrablend.lab.experiments.definition import load_experiment
from infrablend.lab.experiments.experiment_request import ExperimentRequest
from infrablend.lab.experiments.makers import draw_images, merge_datasets
from infrablend.lab.experiments.pasting import Paster, cut_objects
from infrablend.lab.experiments.prepare import assign_folders, prepare_experiment
from infrablend.lab.experiments.run_experiment import run_experiment
from infrablend.lab.experiments.stage import read_dataset
from infrablend.lab.world.world_dataset import write_sky_pictures
from infrablend.pipeline.datasets.convert import convert_dataset

BIRDS, DRONES = ("airplane", "bird", "helicopter"), ("drone",)


@pytest.fixture(scope="module")
def birds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("birds") / "backgrounds"
    write_sky_pictures(folder, 8, 0, BIRDS)
    return folder


@pytest.fixture(scope="module")
def drones(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drones") / "drones"
    write_sky_pictures(folder, 8, 0, DRONES)
    return folder


# Merging.


def test_merged_images_keep_labels_splits_and_unique_names(birds: Path, drones: Path, tmp_path: Path) -> None:
    parts = [("a", read_dataset(birds)), ("b", read_dataset(drones)), ("a", read_dataset(birds, splits=["test"]))]
    merged = merge_datasets(parts)
    convert_dataset(merged, "coco", tmp_path / "out")
    found = read_dataset(tmp_path / "out")
    assert [c.name for c in found.categories] == [*BIRDS, *DRONES]
    assert len({c.id for c in found.categories}) == 4
    assert len(found.images) == sum(len(d.images) for _, d in parts)
    assert {i.name.split("/")[0] for i in found.images} == {"a", "b", "a-2"}
    by_name = {(i.split, i.name): i for i in found.images}
    for name, dataset in parts[:2]:
        for image in dataset.images:
            same = by_name[image.split, f"{name}/{image.name}"]
            assert [o.category for o in same.instances] == [o.category for o in image.instances]
            assert same.path.read_bytes() == image.path.read_bytes()


def test_merged_images_can_be_put_in_another_split(birds: Path, drones: Path, tmp_path: Path) -> None:
    """Birds of the splits train and val, in which no drone is looked for, beside the test pictures of drones."""
    mine = tmp_path / "both.yaml"
    mine.write_text(
        "name: both\ntitle: t\ndescription: d\n"
        "sources: {drones: {format: coco, title: D}, birds: {format: coco, title: B}}\n"
        "data:\n  both:\n    kind: merge\n"
        "    parts: [{of: drones, splits: [test]}, {of: birds, splits: [train, val], into: test}]\n"
        "facts: [{title: Both, data: [both]}]\n"
    )
    request = ExperimentRequest(
        str(mine), [f"drones={drones}", f"birds={birds}"], tmp_path / "work", results=tmp_path / "results"
    )
    planned = {s["stage"]: s["images"] for s in plan_experiment(request).facts["stages"]}
    run_experiment(prepare_experiment(request))
    (out,) = (tmp_path / "work" / "merge").glob("*/out")
    images = read_dataset(out).images
    assert {i.split for i in images} == {"test"}
    assert len(images) == planned["merge:both"] == 1 + 6 + 1
    assert sum(any(o.category == "drone" for o in i.instances) for i in images) == 1
    assert {i.name.rpartition("/")[0] for i in images} == {"drones", "birds/train", "birds/val"}


def test_classes_of_one_name_are_one_and_ids_stay_unique() -> None:
    def dataset(*categories: Category) -> Dataset:
        return Dataset(Path("x"), "coco", categories, ())

    one = dataset(Category(1, "bird"), Category(2, "drone", ignore=True))
    other = dataset(Category(1, "drone"), Category(2, "kite"))
    merged = merge_datasets([("a", one), ("b", other)])
    assert merged.categories == (Category(1, "bird"), Category(2, "drone"), Category(3, "kite"))


def test_smaller_draws_are_parts_of_larger_ones(drones: Path) -> None:
    image = read_dataset(drones).images[0]
    images = tuple(replace(image, id=f"{s}{k}", split=s) for s in ("train", "test") for k in range(20))  # type: ignore[arg-type]
    dataset = replace(read_dataset(drones), images=images)

    def drawn(n: int, seed: int = 0) -> set[str]:
        return {i.id for i in draw_images(dataset, {"train": n}, seed).images if i.split == "train"}

    assert len(drawn(5)) == 5 and drawn(5) < drawn(12) < drawn(20) == drawn(99)
    assert drawn(5) == drawn(5) != drawn(5, seed=1)
    assert len(draw_images(dataset, {"train": 3}, 0).images) == 23  # no limit for test


# Pasting.


def frame_of(image: ImageRecord, boxes: list[list[float]]) -> ImageRecord:
    inserts = tuple(Instance("drone", np.array(b), inserted=True) for b in boxes)
    return replace(image, instances=(*image.instances, *inserts))


def test_inserts_are_replaced_by_cut_outs_at_their_places(birds: Path, drones: Path, tmp_path: Path) -> None:
    cuts, unusable = cut_objects(read_dataset(drones), "drone")
    assert len(cuts) == 8 and not unusable
    image = next(i for i in read_dataset(birds).images if i.instances[0].box_xyxy[0] > 60)
    paster = Paster(cuts, "drone", 0)
    frame = frame_of(image, [[20.0, 20.0, 32.0, 28.0]])
    made = paster.replace_inserts(frame, image.path, tmp_path / "a.png")
    kept, pasted = made.instances
    assert kept == image.instances[0] and pasted.inserted and pasted.category == "drone"
    middle = (pasted.box_xyxy[:2] + pasted.box_xyxy[2:]) / 2
    assert np.abs(middle - (26, 24)).max() <= 0.5
    before, after = load_background(image.path).pixels, load_background(tmp_path / "a.png").pixels
    changed = np.argwhere(before != after)
    x0, y0, x1, y1 = pasted.box_xyxy
    assert len(changed) and (changed >= (y0 - 3, x0 - 3)).all() and (changed < (y1 + 3, x1 + 3)).all()
    assert paster.counts == {"objects": 1, "moved": 0, "left_out": 0}
    again = Paster(cuts, "drone", 0).replace_inserts(frame, image.path, tmp_path / "b.png")
    assert again.path.read_bytes() == made.path.read_bytes()


def test_cut_outs_go_elsewhere_in_the_sky_where_they_do_not_fit(birds: Path, drones: Path, tmp_path: Path) -> None:
    cuts, _ = cut_objects(read_dataset(drones), "drone")
    image = read_dataset(birds).images[0]
    on_label, at_edge = image.instances[0].box_xyxy.tolist(), [0.0, 0.0, 6.0, 6.0]
    paster = Paster(cuts, "drone", 0)
    made = paster.replace_inserts(frame_of(image, [on_label, at_edge]), image.path, tmp_path / "a.png")
    assert paster.counts == {"objects": 2, "moved": 2, "left_out": 0}
    boxes = [i.box_xyxy for i in made.instances]
    for n, (a, b, c, d) in enumerate(boxes):
        assert min(a, b) >= 3 and d < 0.85 * 256
        assert all(a >= g or c <= e or b >= h or d <= f for e, f, g, h in boxes[n + 1 :])


def test_frame_without_inserts_stays_as_it_is(birds: Path, drones: Path, tmp_path: Path) -> None:
    cuts, _ = cut_objects(read_dataset(drones), "drone")
    image = read_dataset(birds).images[0]
    made = Paster(cuts, "drone", 0).replace_inserts(image, image.path, tmp_path / "a.png")
    assert made.instances == image.instances and made.path.read_bytes() == image.path.read_bytes()


# Folders and sources.


def given(*folders: str | Path) -> dict[str, Path]:
    return assign_folders(load_experiment("transfer-drone"), ExperimentRequest("x", folders).folders)


def test_sources_of_one_format_are_told_apart_by_their_labels(birds: Path, drones: Path) -> None:
    expected = {"halmstad-backgrounds": birds, "halmstad-drones": drones}
    assert given(birds, drones) == given(drones, birds) == expected
    assert given(f"halmstad-drones={drones}", birds) == expected
    named = ExperimentRequest("x", {"halmstad-drones": str(drones)}).folders
    assert named == [("halmstad-drones", drones)]


def test_folders_that_fit_no_source_or_several_are_explained(birds: Path, drones: Path, tmp_path: Path) -> None:
    def problem(*folders: str | Path) -> str:
        with pytest.raises(DatasetError) as caught:
            given(*folders)
        return str(caught.value)

    both = merge_datasets([("a", read_dataset(birds)), ("b", read_dataset(drones))])
    convert_dataset(both, "coco", tmp_path / "both")
    text = problem(tmp_path / "both")
    assert "it can be halmstad-backgrounds or halmstad-drones" in text and "--data halmstad-drones=" in text
    assert "a second coco for halmstad-drones" in problem(drones, drones)
    assert "no source halmstad" in problem(f"halmstad={drones}")
    assert given(f"halmstad-drones={tmp_path / 'both'}") == {"halmstad-drones": tmp_path / "both"}
    write_sky_pictures(tmp_path / "kites", 3, 0, ["kite"])
    assert "labels of drone" in problem(tmp_path / "kites")


def test_a_folder_with_an_equals_sign_in_its_name_is_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "a=b"
    folder.mkdir()
    assert ExperimentRequest("x", [folder]).folders == [(None, folder)]


def test_experiments_on_drones_are_planned_and_share_stages(birds: Path, drones: Path, tmp_path: Path) -> None:
    def keys(name: str) -> dict[str, str]:
        plan = plan_experiment(ExperimentRequest(name, [birds, drones], tmp_path / "work", scale="small"))
        assert plan.facts["to_do"] == len(plan.facts["stages"])
        return {s["stage"]: s["key"] for s in plan.facts["stages"]}

    drone, mix = keys("transfer-drone"), keys("mix")
    assert not (tmp_path / "work").exists()
    assert {f"train:{n}{k}" for n in ("inserted", "pasted", "real") for k in ("", "-1", "-2")} <= set(drone)
    assert mix["evaluate:with-0"] == drone["evaluate:inserted"]
    assert mix["evaluate:real-185"] == drone["evaluate:real"]
    # Three draws of 10 and of 40 pictures, and all 185, each with and without inserts.
    assert len({v for k, v in mix.items() if k.startswith("merge")}) == 14
