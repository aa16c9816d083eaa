"""Merging original and new labels."""

from __future__ import annotations

import numpy as np
import pytest

from infrablend.annotation import merge_labels as merging
from infrablend.annotation.merge_labels import MergeSettings, Removal, covered_pixels, covered_share, partly_covered
from infrablend.core.boxes import corners_of_cxcywha
from infrablend.core.dataset import Instance
from infrablend.core.rle_masks import Mask

HW = (48, 64)


def merge(
    original: list[Instance], new: list[Instance], settings: MergeSettings | None = None
) -> tuple[tuple[Instance, ...], tuple[Removal, ...]]:
    """The labels of the image, originals first, and the removed ones."""
    found = merging.merge(original, new, settings or MergeSettings())
    return (*(original[n] for n in found.kept), *found.inserted), found.removed


def original(box: tuple[float, float, float, float], category: str = "Car", **more: object) -> Instance:
    return Instance(category, np.array(box, np.float64), **more)  # type: ignore[arg-type]


def drone(x0: int, y0: int, x1: int, y1: int) -> Instance:
    pixels = np.zeros(HW, np.bool_)
    pixels[y0:y1, x0:x1] = True
    return Instance("drone", np.array([x0, y0, x1, y1], np.float64), mask=Mask.from_array(pixels), inserted=True)


def test_originals_come_first_and_are_the_same_objects() -> None:
    cars, new = [original((1, 1, 5, 5)), original((20, 20, 30, 30))], [drone(40, 40, 45, 45)]
    kept, removed = merge(cars, new)
    assert kept == (*cars, *new)
    assert removed == ()


def test_completely_covered_object_is_removed_and_recorded() -> None:
    car = original((10, 10, 20, 20), source_id=17)
    kept, removed = merge([car], [drone(8, 8, 22, 22)])
    assert [i.category for i in kept] == ["drone"]
    assert removed[0].to_json() == {
        "reason": "covered",
        "category": "Car",
        "source_id": 17,
        "box_xyxy": [10.0, 10.0, 20.0, 20.0],
        "covered_share": 1.0,
        "inserted": False,
    }


@pytest.mark.parametrize(("missing", "gone"), [(1, True), (2, False)])
def test_covering_99_percent_of_pixels_counts_as_complete(missing: int, gone: bool) -> None:
    cover = np.zeros(HW, np.bool_)
    cover[10:20, 10:20] = True
    cover[10, 10 : 10 + missing] = False
    new = Instance("drone", np.array([10.0, 10, 20, 20]), mask=Mask.from_array(cover))
    _, removed = merge([original((10, 10, 20, 20))], [new])
    assert bool(removed) is gone


def test_several_new_objects_cover_together() -> None:
    car = original((10, 10, 20, 20))
    halves = [drone(10, 10, 15, 20), drone(15, 10, 20, 20)]
    assert merge([car], halves[:1])[1] == ()
    assert len(merge([car], halves)[1]) == 1


def test_the_oriented_box_decides_where_it_is_known() -> None:
    corners = corners_of_cxcywha(np.array([30.0, 24, 28, 4, np.pi / 4]))
    box = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
    band = np.zeros(HW, np.bool_)
    y, x = np.mgrid[: HW[0], : HW[1]] + 0.5
    band[np.abs((x - 30) - (y - 24)) < 3] = True
    new = Instance("drone", np.array([0.0, 0, 64, 48]), mask=Mask.from_array(band))
    assert covered_share(original(tuple(box), corners_xy=corners), band) == 1.0
    assert covered_share(original(tuple(box), corners_xy=corners[::-1].copy()), band) == 1.0
    assert covered_share(original(tuple(box)), band) < 0.4
    _, removed = merge([original(tuple(box), corners_xy=corners), original(tuple(box))], [new])
    assert len(removed) == 1


def test_pixels_belong_to_a_box_by_their_centre() -> None:
    cover = np.zeros(HW, np.bool_)
    cover[10:12, 10:12] = True
    assert covered_share(original((9.6, 9.6, 12.4, 12.4)), cover) == 1.0
    assert covered_share(original((9.5, 9.5, 12.5, 12.5)), cover) == pytest.approx(4 / 9)


@pytest.mark.parametrize("box", [(10.1, 10.1, 10.3, 10.4), (10.2, 10.0, 10.2, 11.0), (10, 10, 10, 10)])
def test_box_smaller_than_a_pixel_grows_to_its_pixel(box: tuple[float, float, float, float]) -> None:
    cover = np.zeros(HW, np.bool_)
    assert covered_share(original(box), cover) == 0.0
    cover[10, 10] = True
    assert covered_share(original(box), cover) == 1.0
    sliver = corners_of_cxcywha(np.array([10.7, 10.3, 0.2, 0.1, 0.3]))
    assert covered_share(original(box, corners_xy=sliver), cover) == 1.0


def test_boxes_over_and_beyond_the_frames_edge() -> None:
    cover = np.ones(HW, np.bool_)
    assert covered_share(original((-5, -5, 3, 3)), cover) == 1.0
    assert covered_share(original((64, 10, 64, 20)), cover) == 1.0
    assert covered_share(original((-9, 10, -2, 20)), cover) == 0.0
    assert covered_share(original((70, 10, 90, 20)), cover) == 0.0
    cover[:, 60:] = False
    assert covered_share(original((50, 10, 80, 20)), cover) == pytest.approx(10 / 14)


def test_categories_to_keep_bind_originals_only() -> None:
    labels = [original((1, 1, 5, 5), "Person"), original((1, 1, 5, 5)), drone(30, 30, 40, 40)]
    kept, removed = merge(labels[:2], labels[2:], MergeSettings(keep_categories=("Person",)))
    assert [i.category for i in kept] == ["Person", "drone"]
    assert [(r.reason, r.category) for r in removed] == [("category", "Car")]


@pytest.mark.parametrize(
    ("labels", "expected"), [("merged", ["Car", "drone"]), ("new", ["drone"]), ("original", ["Car"])]
)
def test_label_selection_accounts_for_every_label(labels: str, expected: list[str]) -> None:
    cars, new = [original((1, 1, 5, 5)), original((11, 11, 15, 15))], [drone(10, 10, 20, 20)]
    kept, removed = merge(cars, new, MergeSettings(labels=labels))  # type: ignore[arg-type]
    assert [i.category for i in kept] == expected
    assert len(kept) + len(removed) == 3
    if labels == "original":
        assert [(r.reason, r.inserted) for r in removed] == [("covered", False), ("labels", True)]


def test_a_new_label_without_mask_is_refused() -> None:
    with pytest.raises(ValueError, match="needs a mask"):
        merge([], [original((1, 1, 2, 2), "drone")])


def test_the_mask_decides_where_it_is_known_and_removals_list_it() -> None:
    pixels = np.zeros(HW, np.bool_)
    pixels[10:20, 10:12] = True
    corners = np.array([[10.0, 10], [20, 10], [20, 20], [10, 20]])
    car = original((10, 10, 20, 20), mask=Mask.from_array(pixels), corners_xy=corners)
    kept, removed = merge([car], [drone(9, 9, 12, 21)])
    assert [i.category for i in kept] == ["drone"]
    listed = removed[0].to_json()
    assert (listed["corners_xy"], listed["mask"]) == (corners.tolist(), Mask.from_array(pixels).to_coco())
    assert merge([original((10, 10, 20, 20))], [drone(9, 9, 12, 21)])[1] == ()


def test_partly_covered_originals_are_less_visible() -> None:
    pixels = np.zeros(HW, np.bool_)
    pixels[10:20, 10:20] = True
    labels = [
        original((10, 10, 20, 20)),
        original((10, 10, 20, 20), visibility=0.5),
        original((10, 10, 20, 20), mask=Mask.from_array(pixels)),
        original((40, 40, 50, 45), visibility=0.5),
    ]
    covered = partly_covered(labels, covered_pixels([drone(0, 0, 13, 48)]))
    assert {n: i.visibility for n, i in covered.items()} == {0: 0.7, 1: 0.35, 2: 0.7}
    assert covered[2].mask is not None and covered[2].mask.area_px == 70
    assert not covered[2].mask.to_array()[:, :13].any()
    assert all((i.box_xyxy == labels[n].box_xyxy).all() for n, i in covered.items())
    assert partly_covered(labels, covered_pixels([])) == {}
