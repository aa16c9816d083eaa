"""The Blender renderer: geometry, light, cropping, repeatability, memory."""

import dataclasses

import numpy as np
import pytest

from infrablend.core.mesh import make_mesh
from infrablend.core.operating_system import CHILD_BYTES, resident_bytes
from infrablend.core.render import place
from infrablend.core.scene import PartState, Weather
from infrablend.rendering.flat import FlatRenderer
from infrablend.rendering.lattice import crops_of

from .conftest import ball_mesh, box_mesh, paste, scene, thing


@pytest.fixture(params=["flat", "blender"])
def renderer(request):
    return FlatRenderer() if request.param == "flat" else request.getfixturevalue("blender")


class TestContract:
    """Properties of every renderer."""

    def test_shapes_and_ranges(self, renderer):
        r = renderer.render(place(scene([thing(), thing(0.8, 0.4)]), [box_mesh(), box_mesh((0.3, 0.3, 0.3))]))
        assert r.coverage.shape == (2, *r.alpha.shape)
        assert 0 <= r.alpha.min() <= r.alpha.max() <= 1
        assert (r.coverage.sum(axis=0) <= r.alpha + 1e-4).all()
        assert (r.radiance <= r.alpha + 1e-4).all()

    def test_level_of_a_hot_body(self, renderer):
        """300 K between 275 and 305 K, emissivity 1, no rim: 25/30."""
        r = renderer.render(place(scene([thing(kelvin=300.0)]), [box_mesh()]))
        inside = r.alpha > 0.999
        assert inside.sum() > 500
        assert r.radiance[inside] == pytest.approx(25 / 30, abs=2e-3)

    def test_emissivity_mixes_in_the_surroundings(self, renderer):
        r = renderer.render(place(scene([thing(kelvin=300.0, emissivity=0.6)], surroundings_k=281.0), [box_mesh()]))
        inside = r.alpha > 0.999
        assert r.radiance[inside] == pytest.approx(0.6 * 25 / 30 + 0.4 * 6 / 30, abs=2e-3)

    def test_body_at_ambient_temperature_has_ambient_radiance(self, renderer):
        """Isothermal cavity: a body at the temperature of its surroundings looks like them at any emissivity."""
        for emissivity in (0.1, 0.9):
            spec = scene([thing(kelvin=290.0, emissivity=emissivity, ior=1.5)], surroundings_k=290.0)
            r = renderer.render(place(spec, [box_mesh()]))
            inside = r.alpha > 0.999
            assert r.radiance[inside] == pytest.approx(0.5, abs=2e-3)

    def test_the_nearer_object_hides_the_farther(self, renderer):
        near, far = thing(0, -1.5, 1.2, yaw=0), thing(0, 0, 0, yaw=0)
        r = renderer.render(place(scene([far, near], roll_rad=0), [box_mesh(), box_mesh((0.6, 0.5, 0.5))]))
        alone = renderer.render(place(scene([far], roll_rad=0), [box_mesh()]))
        assert r.coverage[0].sum() < 0.9 * alone.coverage[0].sum()
        assert r.coverage[1].sum() > 100

    def test_unlabelled_parts_are_in_the_picture_but_not_in_the_coverage(self, renderer):
        r = renderer.render(place(scene([thing(label=False)]), [box_mesh()]))
        assert r.alpha.max() > 0.999
        assert r.coverage.max() == 0

    def test_nothing_in_view_gives_an_empty_crop(self, renderer):
        r = renderer.render(place(scene([thing(50.0)]), [box_mesh()]))
        assert r.alpha.size == 0
        r = renderer.render(place(scene([]), []))
        assert r.alpha.size == 0

    def test_cut_by_the_frame(self, renderer):
        r = renderer.render(place(scene([thing(2.1)]), [box_mesh()]))
        assert r.offset_xy[0] + r.alpha.shape[1] == 320
        assert r.alpha[:, -1].max() == pytest.approx(1, abs=1e-3)

    def test_arrays_are_read_only(self, renderer):
        r = renderer.render(place(scene([thing()]), [box_mesh()]))
        with pytest.raises(ValueError, match="read-only"):
            r.alpha[0, 0] = 1


def test_both_renderers_agree_on_geometry(blender):
    for roll, yaw, x, y in ((0.0, 0.0, 0.0, 0.0), (0.15, 1.0, 0.7, -0.5), (-0.1, 4.0, -0.9, 0.8)):
        s = scene([thing(x, y, yaw=yaw)], roll_rad=roll, samples=256)
        a = paste(blender.render(place(s, [box_mesh()])))[1]
        b = paste(FlatRenderer().render(place(s, [box_mesh()])))[1]
        assert abs(a.sum() / b.sum() - 1) < 2e-3
        assert np.abs(a - b).max() < 0.2  # 4 x 4 samples against 256
        assert np.abs(a - b).mean() < 2e-4


@pytest.mark.parametrize(("focal_length_mm", "sensor_width_mm"), [(0.5, 0.36), (5.0, 3.6), (0.05, 0.036)])
def test_only_the_ratio_of_lens_and_sensor_counts(blender, focal_length_mm, sensor_width_mm):
    """Blender knows no length below 1 mm."""
    spec = scene([thing()])
    camera = dataclasses.replace(spec.camera, focal_length_mm=focal_length_mm, sensor_width_mm=sensor_width_mm)
    expected = blender.render(place(spec, [box_mesh()]))
    found = blender.render(place(dataclasses.replace(spec, camera=camera), [box_mesh()]))
    assert found.offset_xy == expected.offset_xy
    np.testing.assert_allclose(found.alpha, expected.alpha, atol=0.05)


@pytest.mark.parametrize("samples", [16, 0])
def test_crops_equal_those_parts_of_the_full_frame(blender, monkeypatch, samples):
    """Two objects close together and one far from them: two crops in one frame, which share the built scene."""
    things = [thing(x, y, kelvin=297, emissivity=0.4, ior=1.5) for x, y in ((1.2, 0.5), (-1.3, -0.6), (-1.0, -0.5))]
    s, mesh = scene(things, samples=samples, texture_k=2.0), box_mesh((0.3, 0.3, 0.3))
    placed = place(dataclasses.replace(s, weather=Weather(285.0, 275.0, 0.5, 280.0, 286.0)), [mesh] * 3)
    assert [group for _, group in crops_of(placed)] == [[0], [1, 2]]
    cropped = blender.render(placed)
    monkeypatch.setattr(blender, "_whole_frame", True)
    full = blender.render(placed)
    (x, y), (h, w) = cropped.offset_xy, cropped.alpha.shape
    for name in ("radiance", "alpha", "coverage"):
        part = np.zeros_like(getattr(full, name))
        part[..., y : y + h, x : x + w] = getattr(cropped, name)
        assert (part == getattr(full, name)).all()


def test_same_scene_same_bytes_and_other_seed_other_noise(blender):
    s, mesh = scene([thing(ior=1.5, emissivity=0.9)], samples=16), box_mesh()
    a, b = (blender.render(place(s, [mesh])) for _ in range(2))
    assert a.radiance.tobytes() == b.radiance.tobytes()
    assert a.coverage.tobytes() == b.coverage.tobytes()
    c = blender.render(place(dataclasses.replace(s, render_seed=6), [mesh]))
    assert c.alpha.tobytes() != a.alpha.tobytes()


def test_order_of_frames_does_not_matter(blender):
    mesh = box_mesh()
    scenes = [scene([thing(0.1 * k)], seed=k) for k in range(3)]
    forward = [blender.render(place(s, [mesh])).radiance.tobytes() for s in scenes]
    backward = [blender.render(place(s, [mesh])).radiance.tobytes() for s in reversed(scenes)]
    assert forward == backward[::-1]


def test_alpha_is_the_covered_area(blender):
    """A face-on square of known size: no filter makes it larger or smaller."""
    mesh = box_mesh((1.0, 1.0, 0.002))
    s = scene([thing(yaw=0)], pitch_rad=np.pi / 2, roll_rad=0.0, samples=256)
    r = blender.render(place(s, [mesh]))
    side = 1.0 / (6.0 - 0.001) * s.camera.focal_px
    assert r.alpha.sum() == pytest.approx(side**2, rel=2e-3)
    assert r.coverage[0].sum() == pytest.approx(side**2, rel=2e-3)


def test_parts_have_their_own_temperature(blender):
    a, b = box_mesh((0.5, 0.5, 0.5), "cold"), box_mesh((0.5, 0.5, 0.5), "hot")
    joined = make_mesh(
        [
            ("cold", a.vertices_m - [0.6, 0, 0], a.triangles, False),
            ("hot", b.vertices_m + [0.6, 0, 0], b.triangles, False),
        ]
    )
    spec = dataclasses.replace(
        thing(yaw=0), parts={"cold": PartState(278.0, 1.0, True, 1.0), "hot": PartState(302.0, 1.0, True, 1.0)}
    )
    r = blender.render(place(scene([spec], roll_rad=0), [joined]))
    inside = r.alpha > 0.999
    middle = r.alpha.shape[1] // 2
    left, right = inside.copy(), inside.copy()
    left[:, middle:] = False
    right[:, :middle] = False
    assert r.radiance[left] == pytest.approx(0.1, abs=2e-3)
    assert r.radiance[right] == pytest.approx(0.9, abs=2e-3)


def test_smooth_surfaces_darken_to_the_rim(blender):
    """Fresnel: seen at a grazing angle a surface mirrors the (colder) surroundings."""
    ball = ball_mesh()

    def profile(ior):
        r = blender.render(place(scene([thing(ior=ior)], samples=64), [ball]))
        rows, columns = r.alpha.shape
        across = r.radiance[rows // 2] / np.maximum(r.alpha[rows // 2], 1e-6)
        return across[columns // 2], across[r.alpha[rows // 2] > 0.999][1]

    centre, rim = profile(1.5)
    assert centre == pytest.approx(25 / 30 * 0.96, abs=0.01)
    assert rim < 0.85 * centre
    flat_centre, flat_rim = profile(1.0)
    assert flat_rim == pytest.approx(flat_centre, abs=3e-3)


def test_memory_stays_flat_and_no_data_is_left(blender):
    code = "import bpy; d = bpy.data; answer = [len(x) for x in (d.meshes, d.materials, d.objects, d.images)]"
    mesh = box_mesh()
    for k in range(20):
        blender.render(place(scene([thing(-1.3), thing(1.3)], samples=1, seed=k), [mesh] * 2))
    blocks, before, own = blender.run(code), sum(CHILD_BYTES.values()), resident_bytes()
    assert before > 50 * 2**20
    for k in range(100):
        blender.render(place(scene([thing(-1.3), thing(1.3)], samples=1, seed=k), [mesh] * 2))
    assert sum(CHILD_BYTES.values()) - before < 8 * 2**20
    assert resident_bytes() - own < 16 * 2**20
    assert blender.run(code) == blocks
