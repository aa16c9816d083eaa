"""The physical look in real Cycles renders."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from infrablend.core.mesh import make_mesh
from infrablend.core.render import place
from infrablend.core.scene import Sun, Weather
from infrablend.thermal.radiometry import band_radiance
from infrablend.thermal.sky import sky_radiance
from tests.thermal_reference import apparent_temperature, leaving_radiance

from .conftest import ball_mesh, box_mesh, paste, scene, thing

AIR_K = 283.15
CLEAR = Weather(AIR_K, 276.15, 0.0, AIR_K - 7, AIR_K + 2)


def render(blender, kelvin, emissivity, ior, weather=CLEAR, mesh=None, surface=None, **camera):
    body = thing(yaw=0, kelvin=kelvin, emissivity=emissivity, ior=ior, **(surface or {}))
    spec = scene([body], samples=64, size_wh=(160, 128), **camera)
    r = blender.render(place(dataclasses.replace(spec, weather=weather), [mesh or box_mesh()]))
    inside = r.alpha > 0.999
    assert inside.sum() > 100
    return r.radiance[inside]


TOP = {"pitch_rad": np.pi / 2, "roll_rad": 0.0}
BARE = {"metal": True, "roughness": 0.1}


@pytest.mark.parametrize(
    ("emissivity", "ior", "surface"),
    [
        (0.05, 1.0, {}),
        (0.3, 2.5, {}),
        (0.95, 1.5, {}),
        (0.98, 1.0, {}),
        (0.86, 1.7, {"roughness": 0.02}),
        (0.1, 1.0, BARE),
        (0.05, 1.0, {"metal": True, "roughness": 0.0}),
        (0.5, 1.0, {"metal": True, "roughness": 0.8}),
    ],
)
def test_isothermal_cavity(blender, emissivity, ior, surface):
    """In surroundings of its own temperature a body is invisible, whatever its surface: contrast below 0.5 %.

    But for a handful of pixels on the box's very edges, where single samples leave into the other face. A rough mirror
    is sampled at random: grainy in single pixels, right on the whole.
    """
    kelvin = 290.0
    uniform = Weather(kelvin, 280.0, 1.0, kelvin, kelvin)
    seen = render(blender, kelvin, emissivity, ior, uniform, surface=surface)
    contrast = np.abs(seen / float(band_radiance(kelvin)) - 1)
    if surface.get("roughness", 0) <= 0.1:
        assert np.percentile(contrast, 99) < 0.005
        assert contrast.mean() < 1e-3
    else:
        assert abs(float(seen.mean()) / float(band_radiance(kelvin)) - 1) < 1e-3
        assert contrast.mean() < 0.005


@pytest.mark.parametrize("kelvin", [250.0, 283.15, 310.15, 373.15])
def test_a_black_body_shines_by_planck(blender, kelvin):
    assert render(blender, kelvin, 1.0, 1.0) == pytest.approx(float(band_radiance(kelvin)), rel=1e-3)


def test_a_level_panel_mirrors_the_zenith(blender):
    """Seen from straight above, smooth and flat: eps L(T) + (1 - eps) L_sky near the zenith."""
    panel = box_mesh((1.0, 1.0, 0.01))
    for emissivity in (0.95, 0.85, 0.2):
        seen = render(blender, AIR_K, emissivity, 1.5, mesh=panel, pitch_rad=np.pi / 2, roll_rad=0.0)
        sky = sky_radiance(AIR_K, CLEAR.dew_point_k, np.radians(4.0))
        expected = leaving_radiance(emissivity, band_radiance(AIR_K), sky)
        assert float(np.median(seen)) == pytest.approx(float(expected), rel=0.004)


def test_an_underside_mirrors_the_ground(blender):
    """Looked at from below a bare panel shows the ground's temperature, not the sky's."""
    panel = box_mesh((1.0, 1.0, 0.01))
    seen = render(blender, AIR_K, 0.1, 1.5, mesh=panel, pitch_rad=-np.pi / 2, roll_rad=0.0)
    expected = leaving_radiance(0.1, band_radiance(AIR_K), band_radiance(CLEAR.ground_k))
    assert float(np.median(seen)) == pytest.approx(float(expected), rel=0.004)


def test_clouds_warm_what_mirrors_them(blender):
    panel = box_mesh((1.0, 1.0, 0.01))
    camera = {"pitch_rad": np.pi / 2, "roll_rad": 0.0}
    overcast = dataclasses.replace(CLEAR, cloud=1.0)
    clear, cloudy = (float(np.median(render(blender, AIR_K, 0.85, 1.5, w, panel, **camera))) for w in (CLEAR, overcast))
    assert 5 < float(apparent_temperature(cloudy) - apparent_temperature(clear)) < 9


def test_rough_surfaces_have_no_rim_and_smooth_ones_do(blender):
    """On a sphere towards the sky the smooth rim mirrors it, the rough one keeps its emissivity."""
    ball = ball_mesh()
    spread = {}
    for ior in (1.0, 1.5):
        kelvin = apparent_temperature(render(blender, AIR_K + 20, 0.96, ior, mesh=ball, pitch_rad=np.pi / 4))
        spread[ior] = float(np.median(kelvin) - np.percentile(kelvin, 2))
    assert spread[1.0] < 1.5
    assert spread[1.5] > 1.8
    assert spread[1.5] > 3 * spread[1.0]


def test_bare_metal_is_black_from_above_and_anodised_metal_is_not(blender):
    """A motor can at +25 K on a clear night: bare (0.2) it looks 43 K colder than air, dark and smooth (0.85) +15 K."""
    panel = box_mesh((1.0, 1.0, 0.01))
    above = {"pitch_rad": np.radians(70), "roll_rad": 0.0}

    def above_air(emissivity, **surface):
        seen = render(blender, AIR_K + 25, emissivity, 1.0, mesh=panel, surface=surface, **above)
        return float(apparent_temperature(np.median(seen)) - AIR_K)

    assert above_air(0.2, **BARE) == pytest.approx(-43, abs=1.5)
    smooth = render(blender, AIR_K + 25, 0.85, 1.5, mesh=panel, **above)
    assert float(apparent_temperature(np.median(smooth)) - AIR_K) == pytest.approx(15, abs=1)
    # A surface that scatters shows the mean of the sky, not the zenith; a mirror seen from below shows the ground.
    assert above_air(0.2) > above_air(0.2, **BARE) + 5
    side = render(blender, AIR_K + 25, 0.85, 1.5, mesh=panel, pitch_rad=-np.pi / 2, roll_rad=0.0)
    assert float(apparent_temperature(np.median(side)) - AIR_K) == pytest.approx(22, abs=1)


def test_a_metals_emissivity_is_the_same_at_all_angles(blender):
    """In a uniform world a hot bare panel is as bright edge-on as straight on; a painted one is darker there."""
    uniform = Weather(AIR_K, 280.0, 1.0, AIR_K, AIR_K)
    panel = box_mesh((1.0, 1.0, 0.01))

    def hot(ior, pitch_deg, **surface):
        camera = {"pitch_rad": np.radians(pitch_deg), "roll_rad": 0.0, "distance_m": 3.0}
        return float(np.median(render(blender, AIR_K + 60, 0.5, ior, uniform, panel, surface, **camera)))

    assert hot(1.0, 15, **BARE) == pytest.approx(hot(1.0, 90, **BARE), rel=0.003)
    assert hot(1.5, 15) < 0.97 * hot(1.5, 90)


def test_roughness_widens_what_a_metal_mirrors(blender):
    """At 25 degrees above the horizon a sharp mirror shows the sky there, a rough one warmer and colder sky as well."""
    panel = box_mesh((1.0, 1.0, 0.01))
    camera = {"pitch_rad": np.radians(45), "roll_rad": 0.0}
    sharp, blurred = (
        render(blender, AIR_K, 0.05, 1.0, mesh=panel, surface={"metal": True, "roughness": r}, **camera)
        for r in (0.0, 0.9)
    )
    sky = leaving_radiance(0.05, band_radiance(AIR_K), sky_radiance(AIR_K, CLEAR.dew_point_k, np.radians(45)))
    assert float(np.median(sharp)) == pytest.approx(float(sky), rel=0.02)
    assert float(np.median(blurred)) > 1.1 * float(np.median(sharp))


def test_glass_is_darker_than_the_paint_beside_it(blender):
    """Windscreen at -4 K, 0.86, against a roof at -5 K, 0.93, on the worked example's night: 14 levels darker."""
    panel = box_mesh((1.0, 1.0, 0.01))
    camera = {"pitch_rad": np.radians(70), "roll_rad": 0.0}
    glass = render(blender, AIR_K - 4, 0.86, 1.7, mesh=panel, surface={"roughness": 0.02}, **camera)
    paint = render(blender, AIR_K - 5, 0.93, 1.5, mesh=panel, surface={"roughness": 0.05}, **camera)
    asphalt = render(blender, AIR_K + 3, 0.95, 1.5, mesh=panel, **camera)
    assert 8.4 * float(np.median(glass) - np.median(asphalt)) == pytest.approx(-64, abs=5)
    assert 8.4 * float(np.median(glass) - np.median(paint)) == pytest.approx(-14, abs=4)


def test_the_artistic_look_is_untouched_by_a_physical_frame_before_it(blender):
    s, mesh = scene([thing(emissivity=0.9, ior=1.5)]), box_mesh()
    before = blender.render(place(s, [mesh])).radiance.tobytes()
    render(blender, AIR_K, 0.9, 1.5)
    assert blender.render(place(s, [mesh])).radiance.tobytes() == before


def test_worked_scene_of_a_night(blender):
    """Air 10 C, dew point 3 C, clear, 8.4 grey levels per W m^-2 sr^-1, against asphalt at +3 K, eps 0.95.

    A car's roof (-5 K, paint 0.93) is 45 to 55 levels darker, a face (28 C, 0.98) 105 to 120 brighter.
    """
    gain = 8.4
    panel = box_mesh((1.0, 1.0, 0.01))
    # Seen at 20 degrees from the vertical, as in the worked example.
    camera = {"pitch_rad": np.radians(70), "roll_rad": 0.0}

    def level(kelvin, emissivity, ior):
        return gain * float(np.median(render(blender, kelvin, emissivity, ior, mesh=panel, **camera)))

    asphalt = level(AIR_K + 3, 0.95, 1.5)
    assert -55 < level(AIR_K - 5, 0.93, 1.5) - asphalt < -45
    assert 105 < level(301.15, 0.98, 1.5) - asphalt < 120
    assert -50 < level(AIR_K, 0.86, 1.5) - asphalt < -38  # a carbon arm's top
    assert 48 < level(AIR_K + 12, 0.95, 1.5) - asphalt < 62  # a battery


def test_the_group_has_a_temperature_texture_of_its_own(blender):
    """As in Blender's editor: Texture is the largest deviation in kelvin (0: none), Texture Size that of patches."""
    panel = box_mesh((1.0, 1.0, 0.01))
    render(blender, AIR_K + 10, 1.0, 1.0, mesh=panel, **TOP)
    code = """
from infrablend.blender.materials import object_material
nodes = object_material(0, physical=True, two_sided=True).node_tree.nodes
node = next(n for n in nodes if n.bl_idname == "ShaderNodeGroup")
answer = node.inputs["Texture"].default_value, node.node_tree.name
for name, value in given.items():
    node.inputs[name].default_value = value
"""
    assert blender.run(code) == [0, "InfraredEffect Physical"]
    spread = {}
    try:
        for amplitude, size in ((0.0, 0.2), (2.0, 0.2), (2.0, 50.0)):
            blender.run(code, **{"Texture": amplitude, "Texture Size": size})
            kelvin = apparent_temperature(render(blender, AIR_K + 10, 1.0, 1.0, mesh=panel, **TOP)) - AIR_K - 10
            spread[amplitude, size] = kelvin
    finally:
        blender.run(code, **{"Texture": 0.0, "Texture Size": 0.3})
    assert np.abs(spread[0.0, 0.2]).max() < 0.05
    patches = spread[2.0, 0.2]
    assert np.abs(patches).max() <= 2.05
    assert patches.std() > 0.3 and abs(patches.mean()) < 0.6
    assert spread[2.0, 50.0].std() < 0.1 * patches.std()


def test_the_manual_shows_every_socket(blender):
    code = """
from infrablend.blender import materials, physical
answer = [[s[0] for s in sockets] for sockets in (materials.SOCKETS, physical.SOCKETS)]
"""
    page = (Path(__file__).parents[2] / "docs/how_to/infrared_effect.md").read_text()
    _, artistic, surface = re.split(r"^## .*$", page, flags=re.M)[:3]
    for text, sockets in zip((artistic, surface), blender.run(code), strict=True):
        named = [n for line in text.splitlines() if line.startswith("| ") for n in line.split("|")[1].split(",")]
        assert [n.strip() for n in named if "*" not in n and n.strip() != "socket"] == sockets


def test_sunlight_warms_the_side_towards_the_sun(blender):
    """From straight above, the sun 30 degrees high along +X: one half of a roof is lit, the other is in the shade."""
    v = np.array([(-1, -1, 0), (0, -1, 1), (0, 1, 1), (-1, 1, 0), (1, -1, 0), (1, 1, 0)], np.float64)
    west, east = [(0, 1, 2), (0, 2, 3)], [(1, 4, 5), (1, 5, 2)]
    mesh = make_mesh([("body", v, np.array(west + east, np.int32), False)])
    sun = Sun(0.0, np.radians(30), 800.0, 0.0)
    weather = dataclasses.replace(CLEAR, ground_k=AIR_K, cloud=1.0, cloud_base_k=AIR_K, dew_point_k=AIR_K, sun=sun)
    body = thing(yaw=0, kelvin=AIR_K, emissivity=1.0, ior=1.0, sun_k=20.0)
    spec = scene([body], samples=16, size_wh=(160, 128), **TOP)
    spec = dataclasses.replace(spec, weather=weather)
    seen, alpha = paste(blender.render(place(spec, [mesh])))
    columns = np.flatnonzero(alpha[64] > 0.999)
    halves = [np.median(seen[64, part]) for part in np.array_split(columns, 2)]
    level, tilt = 800 * np.sin(np.radians(30)), np.cos(np.radians(45))
    around = 0.2 * level * (1 - tilt) / 2
    expected = [AIR_K + 0.02 * around, AIR_K + 0.02 * (800 * np.cos(np.radians(15)) + around)]
    assert sorted(apparent_temperature(h) for h in halves) == pytest.approx(expected, abs=0.3)


@pytest.mark.parametrize("surface", [BARE, {"metal": False, "roughness": 0.1}])
def test_a_hollow_of_bare_metal_is_not_black(blender, surface):
    """A cup of bare metal in surroundings of its own temperature: light is followed until it leaves."""
    kelvin, box = 290.0, box_mesh((0.6, 0.6, 1.2))
    cup = make_mesh([("body", box.vertices_m, box.triangles[:-2, ::-1], False)])  # from inside, without its lid
    uniform = Weather(kelvin, 280.0, 1.0, kelvin, kelvin)
    seen = render(blender, kelvin, 0.05, 1.0, uniform, mesh=cup, surface=surface, pitch_rad=1.1)
    assert float(seen.mean()) / float(band_radiance(kelvin)) > 0.94


def test_only_scenes_with_low_emissivity_take_many_bounces(blender):
    for emissivity, metal, bounces in ((0.94, False, 2), (0.8, False, 2), (0.2, True, 16), (0.1, False, 16)):
        render(blender, AIR_K, emissivity, 1.0, surface={"metal": metal})
        code = "c = jobs._scenes._scene.cycles; answer = [c.max_bounces, c.glossy_bounces, c.diffuse_bounces]"
        assert blender.run(code) == [bounces] * 3
