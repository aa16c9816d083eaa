"""The car: a valid mesh on its tyres with the requested length; temperatures follow its state."""

import itertools
import sys
from types import FrameType

import numpy as np
import pytest

from infrablend.assets import car
from infrablend.assets.car import MODEL, NOMINAL
from infrablend.assets.catalogue import load_model
from infrablend.assets.cool_ground import SHADE_RINGS
from infrablend.config.loading import load_recipe
from infrablend.core.capture import Capture
from infrablend.core.mesh import Mesh
from infrablend.core.rng import stream
from infrablend.errors import ModelError
from infrablend.sampling.scene_sampler import sample_scene
from infrablend.sampling.site import FrameKey
from tests.meshes import areas, check_pieces, vertices_of

BODIES = ("hatchback", "saloon", "suv", "estate", "van")
STATES = ("parked_cold", "driven", "day_sun", "day_driven")
COLOURS = ("black", "grey", "silver", "white")
DRAWS = [MODEL.sample(stream(7, "car", k), {}) for k in range(24)]
CORNERS = [
    {**NOMINAL, "body": body, "length_m": length, "rails": True, "sunroof": True, "exhausts": 2, "wheel_radius": wheel}
    for body, length, wheel in itertools.product(BODIES, (3.0, 4.6, 6.5), (0.95, 1.06))
]


def extent(mesh: Mesh, *parts: str) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest corner of the box about these parts."""
    v = vertices_of(mesh, *parts)
    return v.min(axis=0), v.max(axis=0)


@pytest.mark.parametrize("params", DRAWS + CORNERS)
def test_car_is_sound(params: dict[str, object]) -> None:
    mesh = MODEL.build(params)
    assert 5_000 <= len(mesh.triangles) <= 15_000
    assert set(mesh.part_names) <= set(MODEL.parts)
    assert (np.bincount(mesh.part_of_triangle, minlength=len(mesh.part_names)) > 0).all()

    assert areas(mesh).min() > 1e-8

    assert mesh.size_m[0] == pytest.approx(params["length_m"], rel=0.01)
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    assert low[:2] + high[:2] == pytest.approx([0, 0], abs=1e-9)
    # Only its tyres touch the ground.
    assert low[2] == pytest.approx(0.0, abs=1e-9)
    assert extent(mesh, "tyre")[0][2] == pytest.approx(0.0, abs=1e-9)
    assert extent(mesh, *(set(mesh.part_names) - {"tyre"}))[0][2] > 0.08


@pytest.mark.parametrize("params", CORNERS[::4])
def test_every_piece_of_extreme_cars_is_closed_and_faces_outward(params: dict[str, object]) -> None:
    check_pieces(car._build_pieces(params))


@pytest.mark.parametrize("body", BODIES)
def test_body_has_a_cars_proportions(body: str) -> None:
    plan = {**NOMINAL, "body": body, "length_m": car._BODIES[body].length_m}
    mesh = MODEL.build(plan)
    low, high = extent(mesh, "side", "front", "rear")
    assert 1.7 < high[1] - low[1] < 2.0
    assert 1.4 < mesh.size_m[2] < 2.0
    # Nose ahead of windscreen ahead of roof ahead of rear screen; bonnet below the windscreen's head.
    middle = {part: sum(extent(mesh, part)) / 2 for part in mesh.part_names}
    order = [middle[part][0] for part in ("grille", "bonnet", "windscreen", "roof", "rear_window")]
    assert order == sorted(order, reverse=True)
    assert extent(mesh, "bonnet")[1][2] < extent(mesh, "windscreen")[1][2] < extent(mesh, "roof")[1][2]
    assert middle["exhaust"][0] < 0 < middle["headlamp"][0]
    assert ("boot" in mesh.part_names) == (body == "saloon")
    # Tyres stay within the body's width and do not stick through the bonnet.
    assert extent(mesh, "tyre")[1][1] <= high[1]
    assert extent(mesh, "tyre")[1][2] < extent(mesh, "wing")[1][2]


@pytest.mark.parametrize("body", BODIES)
def test_left_and_right_are_alike(body: str) -> None:
    v = MODEL.build({**NOMINAL, "body": body, "exhausts": 2}).vertices_m
    a = np.unique(v.round(6), axis=0)
    b = np.unique((v * (1, -1, 1)).round(6) + 0.0, axis=0)
    assert a == pytest.approx(b, abs=2e-6)


def test_visible_options() -> None:
    bare = MODEL.build({**NOMINAL, "body": "van", "exhausts": 0})
    full = MODEL.build({**NOMINAL, "body": "van", "exhausts": 2, "sunroof": True, "rails": True})
    panel = MODEL.build({**NOMINAL, "body": "van", "panelled": True})
    assert "exhaust" not in bare.part_names and "sunroof" not in bare.part_names
    assert {"exhaust", "sunroof"} <= set(full.part_names)
    assert full.size_m[2] >= bare.size_m[2]

    def glass(mesh: Mesh) -> int:
        return int((mesh.part_of_triangle == mesh.part_names.index("window")).sum())

    assert glass(panel) < glass(bare) and "rear_window" not in panel.part_names


@pytest.mark.parametrize("state", STATES)
def test_roles_cover_the_same_parts_in_every_state(state: str) -> None:
    for colour in COLOURS:
        roles = MODEL.roles({**NOMINAL, "state": state, "colour": colour})
        assert [*roles, *SHADE_RINGS] == list(MODEL.parts)
        shadowed = MODEL.roles({**NOMINAL, "state": state, "colour": colour, "shadow_xy": [1.0, 0.5]})
        assert set(shadowed) == set(MODEL.parts) and not any(shadowed[ring].label for ring in SHADE_RINGS)
        for part, role in roles.items():
            assert role.delta_t_k[0] <= role.delta_t_k[1] <= 250, part
            assert 0.8 <= role.emissivity[0] <= role.emissivity[1] <= 1
            assert role.what and role.label == MODEL.parts[part].label


def test_temperatures_follow_the_state() -> None:
    cold, driven = (MODEL.roles({**NOMINAL, "state": s}) for s in ("parked_cold", "driven"))
    assert cold["roof"].delta_t_k == (-7.0, -4.5)
    assert driven["bonnet"].delta_t_k == (-3.0, 18.0)
    for part in ("wing", "front"):
        assert all(rim > lid + 5 for rim, lid in zip(driven[part].delta_t_k, driven["bonnet"].delta_t_k, strict=True))
    assert driven["tyre"].delta_t_k == (8.0, 11.0)
    assert driven["exhaust"].delta_t_k == (50.0, 250.0)
    assert driven["roof"].delta_t_k[1] < 0 < driven["front"].delta_t_k[0]
    roofs = [
        MODEL.roles({**NOMINAL, "state": "day_sun", "colour": c})["roof"].delta_t_k[1]
        for c in ("black", "grey", "silver", "white")
    ]
    assert roofs == sorted(roofs, reverse=True) and roofs[-1] < 15 < 38 < roofs[0]
    sun, both = (MODEL.roles({**NOMINAL, "state": s, "colour": "black"}) for s in ("day_sun", "day_driven"))
    assert both["roof"].delta_t_k == sun["roof"].delta_t_k
    assert both["grille"].delta_t_k == driven["grille"].delta_t_k
    for part, role in both.items():
        assert role.delta_t_k[0] >= max(sun[part].delta_t_k[0], driven[part].delta_t_k[0])


def test_the_time_of_day_decides_which_states_come_up() -> None:
    for when, parked, driven in (("night", "parked_cold", "driven"), ("day", "day_sun", "day_driven")):
        draws = [MODEL.sample(stream(k, "when"), {"time_of_day": when}) for k in range(400)]
        assert {d["state"] for d in draws} == {parked, driven}
        share = 0.2 if when == "night" else 0.25
        assert np.mean([d["state"] == driven for d in draws]) == pytest.approx(share, abs=0.06)
        assert all("time_of_day" not in d for d in draws)
        fixed = MODEL.sample(stream(0, "when"), {"time_of_day": when, "state": "day_sun"})
        assert fixed["state"] == "day_sun"
    night, day = (MODEL.sample(stream(3, "when"), {"time_of_day": w}) for w in ("night", "day"))
    free = {"state": 0, "sheltered": 0}
    assert {**night, **free} == {**day, **free}
    assert night["sheltered"] == (night["state"] == "parked_cold") and not day["sheltered"]


@pytest.mark.parametrize("state", STATES)
def test_a_scene_draws_from_the_individuals_own_ranges(state: str) -> None:
    assert load_model("car") is MODEL
    recipe = load_recipe(
        "hit-uav-drone", ["objects.0.model=car", f"objects.0.options={{state: {state}}}", "placement.on_miss=keep"]
    )
    for k in range(8):
        spec = sample_scene(
            FrameKey(f"f{k}", "train", 0, (640, 512), Capture(pitch_deg=60.0)), recipe, {"car": MODEL}, 0
        ).spec
        (placed,) = spec.objects
        assert placed.category == "car" and placed.params["state"] == state
        for part, found in placed.parts.items():
            low, high = MODEL.roles(placed.params)[part].delta_t_k
            assert low - 1e-9 <= found.temperature_k - spec.ambient_k <= high + 1e-9, part


def test_draws_fit_their_body_and_show_every_part() -> None:
    draws = [MODEL.sample(stream(3, "many", k), {}) for k in range(400)]
    for d in draws:
        low, high = car._BODIES[d["body"]].lengths_m
        assert low <= d["length_m"] <= high
        assert not d["panelled"] or d["body"] == "van"
    built = {p for d in draws[:60] for p in MODEL.build(d).part_names}
    assert built == set(MODEL.parts) - set(car.GROUND_RINGS) - set(SHADE_RINGS)


def test_sheltered_ground_is_no_part_of_the_cars_label() -> None:
    alone, glowing = (MODEL.build({**NOMINAL, "sheltered": s}) for s in (False, True))
    assert set(glowing.part_names) - set(alone.part_names) == set(car.GROUND_RINGS)
    n = len(alone.vertices_m)
    assert np.array_equal(glowing.vertices_m[:n], alone.vertices_m)
    rings = glowing.vertices_m[n:]
    assert np.ptp(rings[:, 2]) == 0 and 0 < rings[0, 2] < 0.02
    roles = MODEL.roles({**NOMINAL, "sheltered": True})
    opacities = [roles[p].opacity for p in car.GROUND_RINGS]
    assert opacities == sorted(opacities, reverse=True) and max(opacities) < 0.5
    assert not any(roles[p].label for p in car.GROUND_RINGS)
    # It adds to whatever ground there is, at most as much as beside real cars.
    assert all(
        roles[p].glow and roles[p].emissivity == (1, 1) and roles[p].delta_t_k == (0, 4) for p in car.GROUND_RINGS
    )
    assert not any(r.glow for p, r in roles.items() if p not in car.GROUND_RINGS)
    assert MODEL.sample(stream(0, "x"), {"sheltered": True})["sheltered"]
    with pytest.raises(ModelError, match="sheltered"):
        MODEL.sample(stream(0, "x"), {"sheltered": 1})


def test_options_are_honoured_and_leave_other_draws_alone() -> None:
    options = {"length_m": [4.5, 4.6], "body": ["suv", "van"], "state": "driven", "rails": True}
    for k in range(30):
        drawn = MODEL.sample(stream(k, "o"), options)
        assert 4.5 <= drawn["length_m"] <= 4.6
        assert drawn["body"] in ("suv", "van") and drawn["state"] == "driven" and drawn["rails"] is True
    free, fixed = (MODEL.sample(stream(1, "o"), o) for o in ({}, {"state": "day_sun", "colour": "white", "width": 1}))
    assert {**free, "state": "day_sun", "colour": "white", "width": 1.0} == fixed


def test_a_build_takes_few_steps() -> None:
    """The time of a build, about 10 ms, grows with the calls into Python and numpy, which no other load changes."""
    MODEL.build(NOMINAL)
    calls = 0

    def count(frame: FrameType, event: str, arg: object) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        MODEL.build({**NOMINAL, "width": 1.001})  # pieces of the same car would be kept
    finally:
        sys.setprofile(before)
    assert 1_000 < calls < 30_000  # 9,064 with Python 3.11 and numpy 2


def test_the_sun_took_the_shade_around_the_car_and_left_a_soft_edge() -> None:
    params = {**NOMINAL, "state": "day_sun"}
    bare, shaded = MODEL.build(params), MODEL.build({**params, "shadow_xy": [0.0, -1.5]})
    sheet = shaded.vertices_m[len(bare.vertices_m) :]
    width = float(vertices_of(bare, "side")[:, 1].max())
    height = float(vertices_of(bare, "roof")[:, 2].max())
    # To the right, the way of the rays, as far as the roof's shadow now and two hours ago; to the left a rim.
    assert -sheet[:, 1].min() == pytest.approx(width + 1.5 * height, abs=0.6)
    assert 0.1 < sheet[:, 1].max() - width < 0.5
    # From inside to outside, the rings take less and less light, and the middle most: always cool, never warm.
    roles = MODEL.roles({**params, "shadow_xy": [0.0, -1.5]})
    opacities = [roles[ring].opacity for ring in SHADE_RINGS]
    assert opacities == sorted(opacities) and max(np.diff(opacities)) <= 0.25 and opacities[0] < 0.05
    assert all(roles[ring].glow and roles[ring].delta_t_k[1] < 0 for ring in SHADE_RINGS)
    # The sun has turned clockwise: two hours ago the shadow lay further counter-clockwise, beside the nose.
    assert sheet[:, 0].max() > 0.3 - sheet[:, 0].min()


def test_panels_of_a_moving_car_keep_less_of_the_sun() -> None:
    parked, moving = (MODEL.roles({**NOMINAL, "state": s})["roof"].sun for s in ("day_sun", "day_driven"))
    assert parked is not None and moving is not None
    assert moving.rise_k[1] < 0.5 * parked.rise_k[1] and moving.shade_k[1] <= parked.shade_k[1]
