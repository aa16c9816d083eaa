"""Tiles: every object is whole in at least one, at native size, with labels that match its pixels."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from infrablend.core.boxes import corners_of_cxcywha
from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.rle_masks import Mask
from infrablend.detection.tiles import MIN_SHARE, PAD_GREY, plan_tiles, write_tiles

SIDE = 64


def record(path: Path, size_wh: tuple[int, int], objects: list[Instance], name: str = "a") -> ImageRecord:
    return ImageRecord(
        name,
        path,
        "train",
        size_wh,
        tuple(objects),
        capture=Capture(pitch_deg=45.0, altitude_m=60.0, time_of_day="night"),
    )


def box(*xyxy: float, **more) -> Instance:
    return Instance("car", np.array(xyxy, np.float64), **more)


def picture(path: Path, size_wh: tuple[int, int], objects: list[Instance], level: int = 250) -> Path:
    """Black, each object's box (or mask) at `level`."""
    pixels = np.zeros((size_wh[1], size_wh[0]), np.uint8)
    for o in objects:
        if o.mask is not None:
            pixels[o.mask.to_array()] = level
        else:
            x0, y0, x1, y1 = o.box_xyxy.astype(int)
            pixels[y0:y1, x0:x1] = level
    assert cv2.imwrite(str(path), pixels)
    return path


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 190), st.integers(0, 140), st.integers(1, 55), st.integers(1, 55)), max_size=12),
    st.integers(0, 5),
)
def test_every_object_is_whole_in_a_tile_at_native_resolution(rows, seed):
    objects = [box(x, y, min(x + w, 200), min(y + h, 150)) for x, y, w, h in rows]
    image = record(Path("unread.png"), (200, 150), objects)
    tiles = plan_tiles([image], SIDE, seed=seed)
    assert tiles == plan_tiles([image], SIDE, seed=seed)
    assert tiles, "a picture without objects gives a tile, too"
    for o in objects:
        held = [t for t in tiles if (label := t.label(o)) is not None and not label.truncated]
        assert held, o.box_xyxy
        for t in held:
            assert t.scale == 1
            assert np.array_equal(t.label(o).box_xyxy, o.box_xyxy - np.tile(t.origin_xy, 2))
    for t in tiles:
        assert min(t.origin_xy) >= 0
        assert t.origin_xy[0] + t.span_px <= 200
        assert t.origin_xy[1] + t.span_px <= 150


def test_labels_lie_on_the_pixels_also_where_cut_and_small(tmp_path):
    rng = np.random.default_rng(7)
    objects: list[Instance] = []
    for k in range(14):  # 3 to 12 px, in a grid so that they do not touch
        w, h = rng.integers(3, 13, 2)
        x, y = 4 + 28 * (k % 7), 10 + 60 * (k // 7)
        objects.append(box(x, y, x + w, y + h))
    image = record(picture(tmp_path / "a.png", (200, 150), objects), (200, 150), objects)
    records, counts = write_tiles(plan_tiles([image], SIDE, seed=1), tmp_path / "out")
    assert counts["labels"] == sum(len(r.instances) for r in records) >= len(objects)
    seen_cut = 0
    for r in records:
        pixels = cv2.imread(str(r.path), cv2.IMREAD_UNCHANGED)
        assert pixels.shape == (SIDE, SIDE)
        assert r.size_wh == (SIDE, SIDE)
        lit = np.zeros_like(pixels, bool)
        for o in r.instances:
            x0, y0, x1, y1 = o.box_xyxy
            seen_cut += bool(o.truncated)
            assert o.box_xyxy.min() >= 0
            assert o.box_xyxy.max() <= SIDE
            assert (pixels[int(y0) : int(y1), int(x0) : int(x1)] == 250).all()
            lit[int(y0) : int(y1), int(x0) : int(x1)] = True
        rest = int((pixels[~lit] == 250).sum())
        assert rest == 0 or counts["labels_left_out"], "lit pixels without a label that nobody counted"
    assert seen_cut == counts["labels_cut"]


def test_cut_objects_are_kept_from_a_quarter_of_their_box_and_counted_below(tmp_path):
    big = box(10, 10, 50, 50)
    for x, kept in ((50 + 4, True), (50 + 24, True), (85, False)):
        other = box(x, 20, x + 16, 36)
        image = record(
            picture(tmp_path / "a.png", (70 if kept else 92, 64), [big, other]), (70 if kept else 92, 64), [big]
        )
        tile = plan_tiles([image], SIDE, seed=0)[0]
        label = tile.label(other)
        share = max(0.0, min(x + 16, tile.origin_xy[0] + SIDE) - x) / 16
        assert (label is not None) == (share >= MIN_SHARE)


def test_objects_larger_than_a_tile_get_a_wider_window_scaled_down(tmp_path):
    large, small = box(20, 20, 120, 110), box(150, 100, 158, 108)
    image = record(picture(tmp_path / "a.png", (200, 150), [large, small]), (200, 150), [large, small])
    tiles = plan_tiles([image], SIDE, seed=0)
    assert [t.scale == 1 for t in tiles] == [False, True]  # the small one is there at its own size, too
    records, counts = write_tiles(tiles, tmp_path / "out")
    assert counts["tiles_reduced"] == 1
    pixels = cv2.imread(str(records[0].path), cv2.IMREAD_UNCHANGED)
    label = records[0].instances[0]
    ys, xs = np.nonzero(pixels > 125)
    assert np.allclose(label.box_xyxy, [xs.min(), ys.min(), xs.max() + 1, ys.max() + 1], atol=1.0)


def test_a_picture_smaller_than_a_tile_is_padded_and_labels_end_with_it(tmp_path):
    one = box(20, 10, 40, 30)
    image = record(picture(tmp_path / "a.png", (40, 30), [one]), (40, 30), [one])
    records, _ = write_tiles(plan_tiles([image], SIDE, seed=0), tmp_path / "out")
    pixels = cv2.imread(str(records[0].path), cv2.IMREAD_UNCHANGED)
    assert (pixels[30:] == PAD_GREY).all()
    assert (pixels[:, 40:] == PAD_GREY).all()
    assert np.array_equal(records[0].instances[0].box_xyxy, one.box_xyxy)
    assert not records[0].instances[0].truncated


def test_oriented_boxes_and_masks_are_cut_with_the_picture(tmp_path):
    corners = corners_of_cxcywha(np.array([[70.0, 70.0, 50.0, 12.0, 0.6]]))[0]
    drawn = np.zeros((150, 200), np.uint8)
    cv2.fillPoly(drawn, [np.round(corners).astype(np.int32)], 1)
    mask = Mask.from_array(drawn > 0)
    ys, xs = np.nonzero(drawn)
    o = box(xs.min(), ys.min(), xs.max() + 1, ys.max() + 1, corners_xy=corners, mask=mask)
    rest = [box(100, 60, 160, 118)]
    image = record(picture(tmp_path / "a.png", (200, 150), [o]), (200, 150), [*rest, o])
    records, _ = write_tiles(plan_tiles([image], SIDE, seed=3), tmp_path / "out")
    found = [(r, i) for r in records for i in r.instances if i.mask is not None]
    assert any(not i.truncated for _, i in found)
    for r, i in found:
        pixels = cv2.imread(str(r.path), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(i.mask.to_array(), pixels > 125)
        assert i.corners_xy.min() >= -1e-9
        assert i.corners_xy.max() <= SIDE + 1e-9


@pytest.mark.parametrize("most", [1, 5])
def test_a_limit_spreads_over_the_pictures(most):
    images = [record(Path("x"), (200, 150), [box(5, 5, 9, 9)], f"i{n}") for n in range(9)]
    tiles = plan_tiles(images, SIDE, seed=0, most=most)
    assert len(tiles) == most
    assert len({t.image.id for t in tiles}) == most
