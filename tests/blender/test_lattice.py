"""The lattice is held to converged renders of Cycles."""

import dataclasses

import numpy as np
import pytest

from infrablend.assets.catalogue import list_models, load_model
from infrablend.core.camera import CameraSpec
from infrablend.core.mesh import Mesh, make_mesh
from infrablend.core.render import PlacedScene, place
from infrablend.core.rng import stream
from infrablend.core.scene import Appearance, ObjectSpec, PartState, SceneSpec, Weather
from infrablend.rendering import lattice
from infrablend.rendering.lattice import needs_no_tracing, render_on_lattice
from infrablend.thermal.radiometry import band_radiance, band_radiance_slope

from .conftest import box_mesh, scene, sheet, thing

SPAN_GREY = 200.0


def traced(blender, placed: PlacedScene, samples: int = 384):
    return blender.render(dataclasses.replace(placed, spec=dataclasses.replace(placed.spec, samples=samples)))


def differences(result, reference) -> np.ndarray:
    """Grey levels between two pictures over a background of 30 %, at all pixels that the reference covers."""
    assert result.offset_xy == reference.offset_xy and result.alpha.shape == reference.alpha.shape
    a, b = (SPAN_GREY * (r.radiance + (1 - r.alpha) * 0.3) for r in (result, reference))
    return np.abs(a - b)[reference.alpha > 0]


def model_scene(name: str, size_px: float, number: int = 0) -> PlacedScene:
    """A model in a random shape and pose, with a texture."""
    rng, model = stream(7, "emission", name, number), load_model(name)
    params = model.sample(rng, {})
    mesh = model.build(params)
    parts = {
        part: PartState(
            285.0 + rng.uniform(*role.delta_t_k),
            rng.uniform(*role.emissivity),
            role.label,
            role.ior,
            opacity=role.opacity,
        )
        for part, role in sorted(model.parts.items())
        if part in mesh.part_names
    }
    distance_m = 900 * float(mesh.size_m.max()) / size_px
    camera = CameraSpec(distance_m, rng.uniform(-0.3, 1.5), rng.uniform(-0.2, 0.2), 50.0, 36.0, (640, 512))
    spec = ObjectSpec(name, model.category, params, parts, (0.0, 0.0, 0.0), rng.uniform(0, 6.28))
    look = Appearance(271.0, 309.0, 275.0, 1.5)
    return place(SceneSpec(f"t/{name}", "t", "t", 0, camera, (spec,), 285.0, look, 0, number, {}), [mesh])


@pytest.mark.long
@pytest.mark.parametrize("name", list_models())
def test_a_fine_lattice_converges_to_cycles(blender, monkeypatch, name):
    """What remains is the noise of Cycles: shading, normals, depth and coverage are the same."""
    placed = model_scene(name, 60)
    monkeypatch.setattr(lattice, "SUPERSAMPLE", (20, 20))
    fine, reference = render_on_lattice(placed), traced(blender, placed, 1024)
    wrong = differences(fine, reference)
    assert wrong.mean() < 0.25 and np.percentile(wrong, 99) < 2 and wrong.max() < 5
    assert np.abs(fine.coverage - reference.coverage).max() < 0.04


@pytest.mark.long
def test_pictures_stay_within_the_limits(blender):
    """The limits of docs/explanation/quality.md, pooled over all models, for objects of twice the contrast."""
    wrong = []
    for number, name in enumerate(list_models()):
        placed = model_scene(name, (25, 50, 100)[number % 3], 1)
        wrong.append(differences(blender.render(placed), traced(blender, placed)))
    pooled = np.concatenate(wrong)
    assert pooled.mean() < 0.5
    assert np.percentile(pooled, 99) < 4


def layered() -> Mesh:
    body = box_mesh()
    return make_mesh(
        [
            sheet(0.8, "upper", 1.0),
            ("body", body.vertices_m, body.triangles, False),
            sheet(0.5, "lower"),
            sheet(-0.6, "below", 2.4),
        ]
    )


@pytest.mark.parametrize("pitch_rad", [1.2, 0.2, -0.7])
def test_translucent_layers_in_any_order(blender, pitch_rad):
    """Sheets before, behind and across a body, from above and from below (where they show their backs)."""
    states = {
        "body": PartState(300.0, 0.9, True, 1.5),
        "upper": PartState(282.0, 0.9, False, 1.5, opacity=0.3),
        "lower": PartState(304.0, 0.8, False, 1.0, opacity=0.6),
        "below": PartState(278.0, 0.9, False, 1.5, opacity=0.5),
    }
    spec = ObjectSpec("a", "a", {}, states, (0.0, 0.0, 0.0), 0.3)
    other = thing(0.4, 0.2, 0.3, yaw=1.0, kelvin=290.0, emissivity=0.7, ior=1.4)
    placed = place(
        scene([spec, other], pitch_rad=pitch_rad, distance_m=16.0, samples=0), [layered(), box_mesh((0.6, 0.5, 0.9))]
    )
    drawn, reference = blender.render(placed), traced(blender, placed)
    inside = reference.alpha > 0
    assert (np.abs(drawn.alpha - reference.alpha)[inside] < 0.002).mean() > 0.8  # all but the outlines
    np.testing.assert_allclose(drawn.coverage.sum(axis=(1, 2)), reference.coverage.sum(axis=(1, 2)), rtol=0.01)
    wrong = differences(drawn, reference)
    assert np.median(wrong) < 0.05 and wrong.mean() < 0.5


def test_surfaces_seen_from_behind_and_at_all_angles(blender):
    """A smooth open tube shows its inside, and both sides reach grazing angles."""
    n = 40
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)
    ring = np.stack([0.5 * np.cos(t), 0.5 * np.sin(t), np.zeros(n)], 1)
    v = np.concatenate([ring - [0, 0, 0.7], ring + [0, 0, 0.7]])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    faces = np.concatenate([np.stack([i, j, n + i], 1), np.stack([j, n + j, n + i], 1)]).astype(np.int32)
    tube = make_mesh([("body", v, faces, True)])
    for pitch_rad in (0.1, 0.6, 1.4):
        placed = place(scene([thing(ior=1.5)], pitch_rad=pitch_rad, distance_m=12.0, samples=0, texture_k=2.0), [tube])
        drawn, reference = blender.render(placed), traced(blender, placed)
        both = (drawn.alpha > 0.999) & (reference.alpha > 0.999)
        assert both.sum() > 150
        assert np.percentile(np.abs(drawn.radiance - reference.radiance)[both], 90) < 3e-3


@pytest.mark.parametrize(("look", "samples"), [("artistic", 0), ("artistic", 64), ("physical", 64)])
@pytest.mark.parametrize("opacity", [1.0, 0.5])
def test_faces_wound_the_wrong_way_look_like_others(blender, look, opacity, samples):
    """As in a user's file; at 60 degrees the back of a dense body would reflect everything."""
    state = PartState(304.0, 0.95, opacity == 1, 1.5, opacity=opacity)
    weather = Weather(283.15, 276.15, 0.0, 276.15, 285.15)
    seen = []
    for turned in (False, True):
        part, v, t, smooth = sheet(0.0, "body")
        mesh = make_mesh([(part, v, t[:, ::-1] if turned else t, smooth)])
        spec = scene([ObjectSpec("a", "a", {}, {"body": state}, (0.0, 0.0, 0.0), 0.3)], pitch_rad=0.52, samples=samples)
        if look == "physical":
            spec = dataclasses.replace(spec, weather=weather)
        seen.append(blender.render(place(spec, [mesh])))
    front, back = seen
    inside = (front.alpha > 0.999 * front.alpha.max()) & (back.alpha > 0.999 * back.alpha.max())
    assert inside.sum() > 500
    level = float(np.median(front.radiance[inside]))
    assert level > 0.3 * opacity
    assert float(np.median(back.radiance[inside])) == pytest.approx(level, rel=2e-3)


def test_the_backs_of_shipped_propeller_discs_keep_their_look():
    """Runs of earlier versions are made again with the same bytes."""
    part, v, t, smooth = sheet(0.0, "body")
    state = PartState(304.0, 0.95, False, 1.5, opacity=0.5)
    levels = []
    for closed in (False, True):
        mesh = make_mesh([(part, v, t[:, ::-1], smooth)], closed=closed)
        spec = scene([ObjectSpec("a", "a", {}, {"body": state}, (0.0, 0.0, 0.0), 0.3)], pitch_rad=0.52, samples=0)
        levels.append(float(np.median(render_on_lattice(place(spec, [mesh])).radiance)))
    assert levels[1] < 0.5 * levels[0]


def test_large_objects_are_drawn_in_bands_with_the_same_bytes(monkeypatch):
    placed = model_scene("drone", 150)
    whole = render_on_lattice(placed)
    for limit in (3_000, 400_000_000):
        monkeypatch.setattr(lattice, "BAND_FRAGMENTS", limit)
        banded = render_on_lattice(placed)
        for name in ("radiance", "alpha", "coverage"):
            assert getattr(banded, name).tobytes() == getattr(whole, name).tobytes()


def test_objects_far_apart_are_drawn_one_by_one_with_the_same_bytes(monkeypatch):
    things = [thing(x, y, emissivity=0.9, ior=1.5) for x, y in ((1.2, 0.5), (-1.3, -0.6), (-1.0, -0.5))]
    veil = PartState(280.0, 0.9, label=False, opacity=0.4)
    things[2] = dataclasses.replace(things[2], parts=dict.fromkeys(things[2].parts, veil))
    placed = place(scene(things, samples=0, texture_k=2.0), [box_mesh((0.3, 0.3, 0.3))] * 3)
    apart = render_on_lattice(placed)
    assert len(lattice.crops_of(placed)) == 2
    monkeypatch.setattr(lattice, "crops_of", lambda s: [(lattice.crop_of(s), [0, 1, 2])])
    whole = render_on_lattice(placed)
    for name in ("radiance", "alpha", "coverage"):
        assert getattr(apart, name).tobytes() == getattr(whole, name).tobytes()


@pytest.mark.parametrize("name", list_models())
def test_backs_of_solids_are_hidden(monkeypatch, name):
    """Leaving out the backs of closed parts changes nothing but which of two touching surfaces counts."""
    placed = model_scene(name, 80, 2)
    (whole,) = placed.objects
    mesh = dataclasses.replace(whole.mesh, closed_parts=frozenset({"none"}))  # not two-sided: discs look the same
    assert whole.mesh.closed_parts >= set(mesh.part_names) - {n for n, s in whole.spec.parts.items() if s.opacity < 1}
    monkeypatch.setattr(lattice, "SUPERSAMPLE", (6, 6))
    a, b = (render_on_lattice(place(placed.spec, [m])) for m in (whole.mesh, mesh))
    assert a.alpha.tobytes() == b.alpha.tobytes() and a.coverage.tobytes() == b.coverage.tobytes()
    np.testing.assert_allclose(a.radiance, b.radiance, atol=0.02)
    assert (a.radiance != b.radiance).mean() < 0.001


def physical(placed: PlacedScene, weather: Weather) -> PlacedScene:
    return place(dataclasses.replace(placed.spec, weather=weather), [o.mesh for o in placed.objects])


def kelvin_apart(result, reference, weather: Weather) -> np.ndarray:
    """Kelvins between two pictures over ground, at all pixels that the reference covers."""
    assert result.offset_xy == reference.offset_xy and result.alpha.shape == reference.alpha.shape
    ground, slope = (float(f(weather.ground_k)) for f in (band_radiance, band_radiance_slope))
    a, b = ((r.radiance + (1 - r.alpha) * ground) / slope for r in (result, reference))
    return (a - b)[reference.alpha > 0]


CLEAR = Weather(288.15, 278.15, 0.0, 281.15, 293.15)
CLOUDY = Weather(288.15, 278.15, 0.6, 276.15, 283.15)


@pytest.mark.parametrize("weather", [CLEAR, CLOUDY], ids=["clear", "cloudy"])
@pytest.mark.parametrize("ior", [1.0, 1.5], ids=["rough", "smooth"])
@pytest.mark.parametrize("pitch_rad", [1.3, -0.9])
def test_convex_bodies_mirror_sky_and_ground_as_in_cycles(blender, monkeypatch, weather, ior, pitch_rad):
    """A convex body does not see itself, so nothing is missing; 0.6 of what it shows is the surroundings."""
    monkeypatch.setattr(lattice, "SUPERSAMPLE", (12, 12))
    state = PartState(296.0, 0.6, True, ior, roughness=0.02)
    body = ObjectSpec("a", "a", {}, {"body": state}, (0.0, 0.0, 0.0), 0.4)
    placed = physical(place(scene([body], pitch_rad=pitch_rad, distance_m=20.0, samples=0), [ball()]), weather)
    wrong = kelvin_apart(render_on_lattice(placed), traced(blender, placed, 256), weather)
    # Cycles samples the light of a rough surface, and of the step at the horizon, at random.
    assert abs(wrong.mean()) < 0.05
    assert np.abs(wrong).mean() < 0.5


@pytest.mark.long
def test_what_the_physical_look_lacks_is_small(blender):
    """Light between surfaces, under a clear sky, pooled over all models at a contrast of 120 levels."""
    shares = []
    for number, name in enumerate(list_models()):
        placed = physical(model_scene(name, (25, 50, 100)[number % 3], 1), CLEAR)
        reference = traced(blender, placed)
        wrong = kelvin_apart(blender.render(placed), reference, CLEAR)
        slope = float(band_radiance_slope(CLEAR.ground_k))
        shares.append(wrong * 120 * slope / np.ptp(reference.radiance[reference.alpha > 0.99]))
    pooled = np.abs(np.concatenate(shares))
    assert pooled.mean() < 1.5
    assert np.percentile(pooled, 99) < 20


def ball() -> Mesh:
    n, m = 48, 24
    t, p = np.meshgrid(np.arange(n) * 2 * np.pi / n, (np.arange(1, m)) * np.pi / m, indexing="ij")
    v = np.stack([np.cos(t) * np.sin(p), np.sin(t) * np.sin(p), np.cos(p)], -1).reshape(-1, 3)
    v = np.concatenate([v, [[0, 0, 1], [0, 0, -1]]])
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(m - 2), indexing="ij"))
    a, b = i * (m - 1) + j, (i + 1) % n * (m - 1) + j
    k = np.arange(n)
    first, after = k * (m - 1), (k + 1) % n * (m - 1)
    top, bottom = np.full(n, len(v) - 2), np.full(n, len(v) - 1)
    faces = [np.stack(f, 1) for f in ((a, a + 1, b), (b, a + 1, b + 1), (top, first, after))]
    faces.append(np.stack((bottom, after + m - 2, first + m - 2), 1))
    return make_mesh([("body", v, np.concatenate(faces).astype(np.int32), True)], closed=True)


def test_who_draws_what(blender, monkeypatch):
    """Cycles draws a given number of samples, mirrors, and what reaches behind the camera."""

    class DrawnError(Exception):
        pass

    def stop(_):
        raise DrawnError

    monkeypatch.setattr("infrablend.rendering.engine.renderer.render_on_lattice", stop)
    mesh = box_mesh()
    plain = place(scene([thing()], samples=0), [mesh])
    for placed in (plain, physical(plain, CLEAR)):
        with pytest.raises(DrawnError):
            blender.render(placed)
    assert blender.render(place(scene([thing()], samples=4), [mesh])).alpha.any()
    around = place(scene([thing()], samples=0, distance_m=0.2), [mesh])
    mirror = physical(place(scene([thing(emissivity=0.1)], samples=0), [mesh]), CLEAR)
    for placed in (around, mirror):
        assert not needs_no_tracing(placed)
        assert blender.render(placed).alpha.any()
