"""Translucent parts in real Cycles renders: their share of the light, and labels that look through them."""

import dataclasses

import numpy as np
import pytest

from infrablend.annotation.labels import annotate
from infrablend.assets.drone import NOMINAL, build_drone
from infrablend.assets.drone import parts_for as drone_parts
from infrablend.assets.rotors import DISC_RINGS
from infrablend.core.mesh import Mesh, make_mesh
from infrablend.core.render import place
from infrablend.core.scene import ObjectSpec, PartState, Weather
from infrablend.rendering.flat import FlatRenderer
from infrablend.thermal.radiometry import band_radiance
from infrablend.thermal.sky import sky_radiance
from tests.thermal_reference import leaving_radiance

from .conftest import box_mesh, paste, scene, sheet, thing

AIR_K = 283.15
CLEAR = Weather(AIR_K, 276.15, 0.0, AIR_K - 7, AIR_K + 2)
SMALL = {"size_wh": (160, 128)}
LEVEL = {"pitch_rad": np.pi / 2, "roll_rad": 0.0, **SMALL}


def disc(width=1.6, z=1.0) -> Mesh:
    return make_mesh([sheet(z, "disc", width)])


def both(mode, blender, spec, meshes):
    weather = CLEAR if mode == "physical" else None
    return blender.render(place(dataclasses.replace(spec, weather=weather), meshes))


@pytest.mark.parametrize("opacity", [0.08, 0.3, 0.8])
def test_over_the_background_alpha_is_the_opacity(blender, opacity):
    """A translucent sheet emits exactly its opacity times the light of an opaque sheet, without noise."""
    spec = scene([thing(kelvin=300.0, label=False, parts=("disc",), opacity=opacity, emissivity=0.9)], **LEVEL)
    full = scene([thing(kelvin=300.0, label=False, parts=("disc",), emissivity=0.9)], **LEVEL)
    for mode in ("artistic", "physical"):
        thin, solid = (both(mode, blender, s, [disc()]) for s in (spec, full))
        inside = solid.alpha > 0.999
        assert inside.sum() > 1000
        np.testing.assert_allclose(thin.alpha, opacity * solid.alpha, atol=1e-5)
        # An opaque sheet scatters: traced mirrors against the sky in one direction.
        tolerance = 1e-5 if mode == "artistic" else 0.02
        np.testing.assert_allclose(thin.radiance[inside], opacity * solid.radiance[inside], rtol=tolerance)
        assert not thin.coverage.any()


def test_ground_that_an_object_warms_adds_its_light_without_texture(blender):
    """A glow of 3 K over ground at air temperature, black, whatever the texture of bodies."""
    state = PartState(AIR_K + 3.0, 1.0, label=False, ior=1.0, opacity=0.4, glow=True)
    spec = scene([ObjectSpec("a", "a", {}, {"disc": state}, (0.0, 0.0, 0.0), 0.0)], **LEVEL)
    look = dataclasses.replace(spec.appearance, texture_k=4.0)
    seen = both("physical", blender, dataclasses.replace(spec, appearance=look), [disc()])
    assert seen.ground_radiance == pytest.approx(float(band_radiance(AIR_K)))
    inside = seen.alpha > 0.399
    added = seen.radiance[inside] - np.float32(seen.ground_radiance) * seen.alpha[inside]
    expected = 0.4 * float(band_radiance(AIR_K + 3.0) - band_radiance(AIR_K))
    np.testing.assert_allclose(added, expected, rtol=0.02)
    propeller = PartState(AIR_K, 0.9, label=False, opacity=0.1)
    mixed = [ObjectSpec("a", "a", {}, {"disc": s}, (0.0, 0.0, 0.0), 0.0) for s in (state, propeller)]
    assert both("physical", blender, scene(mixed, **LEVEL), [disc(), disc()]).ground_radiance is None


def test_a_thin_smooth_sheet_mirrors_the_sky_above_it(blender):
    for pitch, beyond in ((np.pi / 2, sky_radiance(AIR_K, CLEAR.dew_point_k, 0.07)), (-np.pi / 2, None)):
        surface = thing(kelvin=AIR_K, label=False, parts=("disc",), opacity=0.5, emissivity=0.6, ior=1.5)
        spec = scene([surface], pitch_rad=pitch, roll_rad=0.0, **SMALL)
        seen = both("physical", blender, spec, [disc(z=0.0)])
        mirrored = band_radiance(CLEAR.ground_k) if beyond is None else beyond
        expected = 0.5 * leaving_radiance(0.6, band_radiance(AIR_K), mirrored)
        assert float(np.median(seen.radiance[seen.alpha > 0.4999])) == pytest.approx(float(expected), rel=0.004)


@pytest.mark.parametrize("opacity", [0.1, 0.7])
@pytest.mark.parametrize("mode", ["artistic", "physical"])
def test_labels_look_through(blender, mode, opacity):
    """Mask, coverage and box of a body behind sheets of its own and of another object: as if they were not there."""
    body = make_mesh([("body", *(getattr(box_mesh(), n) for n in ("vertices_m", "triangles")), False)])
    own = make_mesh(
        [(m.part_names[0], m.vertices_m, m.triangles, False) for m in (body, disc(z=0.6), disc(0.8, z=0.8))]
    )
    states = {"body": PartState(300.0, 0.9), "disc": PartState(290.0, 0.9, label=False, opacity=opacity)}
    covered = ObjectSpec("a", "a", {}, states, (0.0, 0.0, 0.0), 0.3)
    bare = dataclasses.replace(covered, parts={"body": states["body"]})
    above = thing(z=1.0, label=True, parts=("disc", "body"), opacity=1.0)
    above = dataclasses.replace(above, parts=states, position_m=(0.2, 0.1, 1.0))
    with_sheets = scene([covered, above], **SMALL)
    # The other object: its sheet covers the body, its own body is off to the side.
    aside = make_mesh([("body", body.vertices_m + (3.0, 0, 0), body.triangles, False)])
    other = make_mesh([(m.part_names[0], m.vertices_m, m.triangles, False) for m in (aside, disc(2.0, z=0.3))])
    without = scene([bare, dataclasses.replace(above, parts={"body": states["body"]})], **SMALL)
    a = both(mode, blender, with_sheets, [own, other])
    b = both(mode, blender, without, [body, aside])
    (la, ra), (lb, rb) = annotate(place(with_sheets, [own, other]), a), annotate(place(without, [body, aside]), b)
    assert len(la) == len(lb) >= 1 and ra == rb
    for x, y in zip(la, lb, strict=True):
        assert np.array_equal(x.box_xyxy, y.box_xyxy) and np.array_equal(x.corners_xy, y.corners_xy)
        assert np.array_equal(x.mask.to_array(), y.mask.to_array())
        assert x.visibility == y.visibility == 1.0
    # Also where there is no render, and with the renderer that is not Blender.
    assert annotate(place(with_sheets, [own, other]))[0][0].mask == annotate(place(without, [body, aside]))[0][0].mask
    flat = FlatRenderer()
    fa, fb = (
        annotate(place(s, m), flat.render(place(s, m)))
        for s, m in ((with_sheets, [own, other]), (without, [body, aside]))
    )
    assert [i.mask for i in fa[0]] == [i.mask for i in fb[0]]


def test_the_other_renderer_agrees_on_alpha_and_light(blender):
    body, veil = box_mesh(), disc()
    mesh = make_mesh([(m.part_names[0], m.vertices_m, m.triangles, False) for m in (body, veil)])
    states = {"body": PartState(300.0, 1.0, True, 1.0), "disc": PartState(285.0, 1.0, False, 1.0, opacity=0.3)}
    spec = scene([ObjectSpec("a", "a", {}, states, (0.0, 0.0, 0.0), 0.3)])
    cycles, flat = (paste(r.render(place(spec, [mesh]))) for r in (blender, FlatRenderer()))
    for a, b in zip(cycles, flat, strict=True):
        assert np.abs(a - b).mean() < 2e-3
        assert np.percentile(np.abs(a - b), 98) < 0.02


def drone(propellers, pitch_rad, size_px=200):
    params = {**NOMINAL, "propellers": propellers}
    mesh = build_drone(params)
    states = {
        n: PartState(AIR_K + r.delta_t_k[1], r.emissivity[0], r.label, r.ior, r.roughness, r.metal, r.opacity)
        for n, r in drone_parts(params).items()
        if n in mesh.part_names
    }
    spec = ObjectSpec("drone", "drone", params, states, (0.0, 0.0, 0.0), 0.5)
    distance = 0.6 * 50 / 36 * 320 / size_px
    return scene([spec], pitch_rad=pitch_rad, distance_m=distance, samples=16), mesh


@pytest.mark.parametrize("pitch_deg", [20, 75, -40])
@pytest.mark.parametrize("mode", ["artistic", "physical"])
def test_a_drone_in_flight_has_the_labels_of_one_without_blades(blender, mode, pitch_deg):
    spec, mesh = drone("spinning", np.radians(pitch_deg))
    spinning = np.isin(np.array(mesh.part_names)[mesh.part_of_triangle], list(DISC_RINGS))
    bare = Mesh(
        mesh.vertices_m,
        mesh.triangles[~spinning],
        mesh.part_of_triangle[~spinning],
        mesh.part_names,
        mesh.smooth[~spinning],
    )
    flying, naked = (both(mode, blender, spec, [m]) for m in (mesh, bare))
    (a,), (b,) = (annotate(place(spec, [m]), r)[0] for m, r in ((mesh, flying), (bare, naked)))
    assert np.array_equal(a.box_xyxy, b.box_xyxy) and np.array_equal(a.corners_xy, b.corners_xy)
    assert a.mask == b.mask and a.visibility == b.visibility
    # The blades count for labels while they do not spin.
    still_spec, still_mesh = drone("still", np.radians(pitch_deg))
    (still,) = annotate(place(still_spec, [still_mesh]), both(mode, blender, still_spec, [still_mesh]))[0]
    assert still.mask.area_px > 1.05 * a.mask.area_px
    # Discs: a faint veil of 3 to 25 %, brighter towards the hub, never a crisp blade.
    pasted = [paste(r)[1] for r in (flying, naked)]
    veil = pasted[0][(pasted[1] == 0) & (pasted[0] > 0)]
    assert veil.size > 2000
    assert 0.03 < np.median(veil) < 0.2 and np.percentile(veil, 99) < 0.4
