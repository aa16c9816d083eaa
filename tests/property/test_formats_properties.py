"""Any numbers survive writing and reading."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from infrablend.core.boxes import corners_of_cxcywha, polygon_area
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.rle_masks import Mask
from infrablend.formats.box_checks import check_box, obb_from_corners
from infrablend.formats.labels import yolo
from infrablend.formats.losses import Losses
from infrablend.formats.pictures.listing import check_name
from infrablend.formats.polygons import outline, rasterise
from infrablend.formats.records import Findings

SIZES = st.tuples(st.integers(16, 4096), st.integers(16, 4096))
SHARES = st.floats(0, 1, allow_subnormal=False)


def text(size_wh: tuple[int, int], instance: Instance, task: yolo.Task) -> str:
    image = ImageRecord("a", Path("a.png"), "train", size_wh, (instance,))
    return yolo.label_text(image, {"cow": 0}, task, Losses())


def read(made: str, size_wh: tuple[int, int], task: yolo.Task) -> Instance:
    found = Findings(Path())
    (again,) = yolo._instances(found, yolo.parse_labels(made, "a.txt"), {0: "cow"}, size_wh, "a.txt", task)
    assert task != "detect" or found.problems == []
    return again


@given(SIZES, SHARES, SHARES, SHARES, SHARES)
def test_yolo_boxes_come_back_within_a_millionth(
    size_wh: tuple[int, int], a: float, b: float, c: float, d: float
) -> None:
    w, h = size_wh
    x0, x1 = sorted((a * w, b * w))
    y0, y1 = sorted((c * h, d * h))
    if x1 - x0 < 1e-3 or y1 - y0 < 1e-3:
        return
    box = np.array([x0, y0, x1, y1])
    made = text(size_wh, Instance("cow", box), "detect")
    again = read(made, size_wh, "detect")
    np.testing.assert_allclose(again.box_xyxy, box, rtol=0, atol=1e-6)
    second = text(size_wh, again, "detect")
    np.testing.assert_allclose([float(v) for v in second.split()], [float(v) for v in made.split()], rtol=0, atol=2e-10)


@given(SIZES, st.lists(SHARES, min_size=8, max_size=8))
def test_yolo_corners_come_back_within_a_millionth(size_wh: tuple[int, int], shares: list[float]) -> None:
    corners = np.array(shares).reshape(4, 2) * size_wh
    area = polygon_area(corners)
    if (np.ptp(corners, axis=0) < 1e-3).any() or abs(area) < 1e-3:
        return
    box = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
    again = read(text(size_wh, Instance("cow", box, corners), "obb"), size_wh, "obb")
    assert again.corners_xy is not None
    # Corners are clockwise on screen, from the first one on.
    clockwise = corners if area > 0 else corners[[0, 3, 2, 1]]
    np.testing.assert_allclose(again.corners_xy, clockwise, rtol=0, atol=1e-6)


@given(
    st.floats(0, 640),
    st.floats(0, 512),
    st.floats(0.5, 300),
    st.floats(0.5, 300),
    st.floats(0, np.pi, exclude_max=True),
)
def test_oriented_numbers_and_corners_are_inverse(cx: float, cy: float, w: float, h: float, angle: float) -> None:
    corners = corners_of_cxcywha(np.array([cx, cy, w, h, angle]))
    again = corners_of_cxcywha(np.array(obb_from_corners(corners)))
    assert 0 <= obb_from_corners(corners)[4] < np.pi
    apart = min(float(np.abs(np.roll(again, k, axis=0) - corners).max()) for k in (0, 2))
    assert apart < 1e-9


@given(st.lists(st.floats(), min_size=4, max_size=4))
def test_box_outside_the_frame_is_clipped_or_reported(values: list[float]) -> None:
    box, problem = check_box(values, (640, 512), "here")
    if box is None:
        assert problem is not None and problem.severity == "error"
    else:
        assert 0 <= box[0] < box[2] <= 640 and 0 <= box[1] < box[3] <= 512
        assert (problem is None) == (box.tolist() == values)


@given(st.integers(1, 24), st.integers(1, 24), st.data())
def test_every_mask_is_under_its_polygon(h: int, w: int, data: st.DataObject) -> None:
    bits = data.draw(st.lists(st.booleans(), min_size=h * w, max_size=h * w))
    mask = np.array(bits, np.bool_).reshape(h, w)
    made = outline(Mask.from_array(mask))
    if not mask.any():
        return
    raster = rasterise(made.polygon_xy, (w, h))
    assert int((raster != mask).sum()) == made.raster_difference_px
    assert not (mask & ~raster).any()
    shares = (made.polygon_xy / [w, h]).round(10).astype(np.float32) * np.array([w, h], np.float32)
    assert (rasterise(shares.astype(np.float64), (w, h)) == raster).all()


@given(st.text(max_size=30))
def test_accepted_name_stays_inside_the_folder(name: str) -> None:
    if check_name(name, "here") is None:
        root = Path("/data/pictures")
        assert (root / name).resolve().is_relative_to(root)
