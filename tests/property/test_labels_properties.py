"""Properties of the labels of any scene."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from infrablend.annotation.labels import annotate
from infrablend.core import boxes
from infrablend.core.camera import CameraSpec
from infrablend.core.mesh import Mesh, make_mesh
from infrablend.core.render import place
from infrablend.core.scene import Appearance, ObjectSpec, PartState, SceneSpec

WH = (160, 128)


def brick(size_m: tuple[float, float, float]) -> Mesh:
    signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    return make_mesh([("body", signs * np.array(size_m) / 2, triangles, False)])


sizes = st.tuples(*[st.floats(0.05, 1.5)] * 3)
things = st.tuples(
    sizes, st.floats(-3, 3), st.floats(-3, 3), st.floats(-1, 1), st.floats(0, 2 * math.pi), st.booleans()
)


def build(distance_m: float, pitch_deg: float, roll_deg: float, drawn: list[tuple]) -> tuple[SceneSpec, list[Mesh]]:
    view = CameraSpec(distance_m, math.radians(pitch_deg), math.radians(roll_deg), 50.0, 36.0, WH)
    objects, meshes = [], []
    for size_m, x, y, z, yaw, label in drawn:
        parts = {"body": PartState(300.0, 0.9, label)}
        objects.append(ObjectSpec("brick", "drone", {}, parts, (x, y, z), yaw))
        meshes.append(brick(size_m))
    return SceneSpec("test/a_c0", "a", "test", 0, view, tuple(objects), 290.0, Appearance(), 0, 0), meshes


@settings(max_examples=120, deadline=None)
@given(
    st.floats(1, 10),
    st.floats(-20, 90),
    st.floats(-10, 10),
    st.lists(things, min_size=1, max_size=3),
    st.sampled_from(["min_area", "heading"]),
)
def test_labels_hold_together(
    distance_m: float, pitch_deg: float, roll_deg: float, drawn: list[tuple], obb: str
) -> None:
    scene, meshes = build(distance_m, pitch_deg, roll_deg, drawn)
    found, report = annotate(place(scene, meshes), obb=obb)  # type: ignore[arg-type]
    assert sorted([*report.kept, *(d.index for d in report.drops)]) == list(range(len(drawn)))
    assert [i.extra["object"] for i in found] == list(report.kept)
    taken = np.zeros(WH[::-1], int)
    for instance in found:
        x0, y0, x1, y1 = instance.box_xyxy
        assert 0 <= x0 < x1 <= WH[0]
        assert 0 <= y0 < y1 <= WH[1]
        corners = instance.corners_xy
        assert corners is not None
        assert boxes.corners_in_frame(corners, WH)
        # The oriented box reaches each side of the upright one.
        reach = boxes.box_of_points(corners)
        assert (reach[:2] <= instance.box_xyxy[:2] + 1e-6).all()
        assert (reach[2:] >= instance.box_xyxy[2:] - 1e-6).all()
        if obb == "min_area":
            assert boxes.polygon_area(corners) <= (x1 - x0) * (y1 - y0) * (1 + 1e-9) + 1e-9
        assert instance.visibility is not None
        assert 0 <= instance.visibility <= 1
        assert instance.mask is not None
        mask = instance.mask.to_array()
        rows, columns = np.nonzero(mask)
        # A pixel of the mask is at least half covered, so it lies within half a pixel of the box, plus one sample
        # where something nearer cuts the box.
        assert columns.min() >= math.floor(x0 - 0.5)
        assert rows.min() >= math.floor(y0 - 0.5)
        assert columns.max() + 1 <= math.ceil(x1 + 0.5)
        assert rows.max() + 1 <= math.ceil(y1 + 0.5)
        k = instance.extra["object"]
        if k not in report.mask_fallbacks:
            taken += mask
    # Coverage of exactly one half may tie.
    assert (taken <= 2).all()
    assert (taken > 1).mean() < 0.02


@settings(max_examples=60, deadline=None)
@given(st.floats(2, 10), st.floats(0, 90), st.lists(things, min_size=2, max_size=3))
def test_another_object_never_makes_a_label_larger(distance_m: float, pitch_deg: float, drawn: list[tuple]) -> None:
    scene, meshes = build(distance_m, pitch_deg, 0.0, drawn)
    alone, alone_report = annotate(place(SceneSpec(**{**vars(scene), "objects": scene.objects[:1]}), meshes[:1]))
    found, report = annotate(place(scene, meshes))
    if 0 not in report.kept:
        return
    assert alone_report.kept == (0,)
    first = found[0]
    assert (first.box_xyxy[:2] >= alone[0].box_xyxy[:2]).all()
    assert (first.box_xyxy[2:] <= alone[0].box_xyxy[2:]).all()
    assert first.visibility is not None
    assert alone[0].visibility is not None
    assert first.visibility <= alone[0].visibility + 0.02
    assert first.truncated == alone[0].truncated
