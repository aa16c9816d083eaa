"""Labels of partly hidden objects."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from infrablend.annotation.labels import annotate, label_occluded
from infrablend.core.boxes import box_of_points
from infrablend.core.render import PlacedScene, RenderResult, place
from tests.unit.annotation.test_labels import camera, plate, rendered, scene, thing


def plate_20_by_10() -> PlacedScene:
    """A plate of 20 x 10 px in the middle of the frame, from (310, 251) to (330, 261)."""
    return place(scene(camera(), thing(yaw_deg=10, category="deer")), [plate(20, 10, camera())])


def seen_from_column(first: int) -> RenderResult:
    """What is visible with everything to the left of a column (counted from 310) hidden."""
    coverage = np.zeros((1, 10, 20), np.float32)
    coverage[0, :, first:] = 1
    return rendered(coverage, (310, 251))


@pytest.mark.parametrize("written", ["visible", "amodal"])
def test_both_boxes_are_recorded_and_one_is_written(written: str) -> None:
    scene = plate_20_by_10()
    (whole,), _ = annotate(scene, seen_from_column(0))
    (label,), _ = annotate(scene, seen_from_column(12))
    found = label_occluded(label, scene.objects[0], 0.4, written)  # type: ignore[arg-type]
    assert found.extra["occluded"] is True
    assert found.visibility == pytest.approx(0.4)
    # The heading of 10 degrees narrows the plate to 19.7 px.
    assert_allclose(found.extra["amodal_box"], whole.box_xyxy, atol=1e-6)
    assert_allclose(found.extra["visible_box"], [322, 251, whole.box_xyxy[2], 261], atol=0.2)
    assert_allclose(found.box_xyxy, found.extra[f"{written}_box"], atol=1e-6)
    assert found.corners_xy is not None
    assert_allclose(box_of_points(found.corners_xy), found.box_xyxy, atol=0.3)
    assert found.mask is not None
    assert found.mask.area_px == 80


def test_the_oriented_box_along_the_heading_describes_the_visible_part() -> None:
    scene = plate_20_by_10()
    (label,), _ = annotate(scene, seen_from_column(12), "heading")
    found = label_occluded(label, scene.objects[0], 0.4, obb="heading")
    assert found.corners_xy is not None
    assert_allclose(box_of_points(found.corners_xy), found.box_xyxy, atol=0.3)
