"""The procedural deer: closed, oriented, on its feet, of the size asked for, and the same bytes every time."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest

from infrablend.assets import deer, implicit
from infrablend.assets.implicit import Body, ellipsoid, is_closed, surface, tube
from infrablend.core.rng import stream
from tests.meshes import areas, share_inside, signed_volume, vertices_of

pytestmark = pytest.mark.thinned

SHAPES = [(pose, variant) for pose in deer.POSES for variant in deer.VARIANTS[pose]]
DOWN = ("lying", "sleeping")
UP = [s for s in SHAPES if s[0] not in DOWN]
STANDING = [s for s in UP if s[0] != "running"]


@pytest.mark.parametrize(("pose", "variant"), SHAPES)
@pytest.mark.parametrize("build", deer.BUILDS)
def test_every_shape_is_closed_oriented_and_on_the_ground(pose: str, variant: str, build: str) -> None:
    mesh = deer.build({"pose": pose, "variant": variant, "build": build, "shoulder_height_m": 1.0})
    assert is_closed(mesh.triangles)
    # A deer of 1 m at the withers weighs some 60-110 kg, at about 1000 kg/m3.
    assert (
        0.05 < signed_volume(mesh.vertices_m, mesh.triangles) < (0.13 if pose in DOWN else 0.125)
    )  # a folded leg counts twice where it sinks into the belly
    assert areas(mesh).min() > 1e-9
    assert abs(mesh.vertices_m[:, 2].min()) <= 0.005
    assert 8_000 <= len(mesh.triangles) <= 25_000
    assert set(mesh.part_names) == set(deer.PART_NAMES) - {"antler", "antler_velvet"}
    counts = np.bincount(mesh.part_of_triangle, minlength=len(mesh.part_names))
    assert counts.min() > 0
    assert abs(mesh.vertices_m[:, 1].max() + mesh.vertices_m[:, 1].min()) < (0.6 if pose == "sleeping" else 0.35)


@pytest.mark.parametrize(("pose", "antlers", "form"), list(product(deer.POSES, ("hard", "velvet"), deer.ANTLER_FORMS)))
def test_antlers_of_every_form_in_every_pose(pose: str, antlers: str, form: str) -> None:
    bare = deer.build({"pose": pose})
    mesh = deer.build({"pose": pose, "antlers": antlers, "antler_form": form})
    name = "antler" if antlers == "hard" else "antler_velvet"
    assert set(mesh.part_names) - set(bare.part_names) == {name}
    assert is_closed(mesh.triangles)
    assert areas(mesh).min() > 1e-10
    crown = vertices_of(mesh, name)
    assert np.ptp(crown[:, 1]) > 0.08  # two antlers, apart
    # Symmetric: each antler mirrors the other.
    if pose != "sleeping":
        assert crown[:, 1].max() == pytest.approx(-crown[:, 1].min(), abs=1e-9)


@pytest.mark.parametrize(("pose", "variant"), UP)
@pytest.mark.parametrize("height", [0.7, 1.2])
def test_shoulder_height_is_what_was_asked_for(pose: str, variant: str, height: float) -> None:
    mesh = deer.build({"pose": pose, "variant": variant, "build": "sturdy", "shoulder_height_m": height})
    trunk = vertices_of(mesh, "back", "upper_flank", "flank") / height
    # Measured as on an animal: the trunk's top above the elbows.
    elbows = vertices_of(mesh, "mid_leg") / height
    fore = elbows[elbows[:, 0] > 0, 0].mean()
    top = trunk[np.abs(trunk[:, 0] - fore) < 0.08, 2].max()
    assert top == pytest.approx(1.0, rel=0.02)


def test_factors_scale_length_and_width() -> None:
    plain = deer.build({"pose": "grazing"})
    other = deer.build({"pose": "grazing", "length_factor": 1.1, "width_factor": 0.9})
    assert other.size_m / plain.size_m == pytest.approx([1.1, 0.9, 1.0], rel=1e-9)
    double = deer.build({"pose": "grazing", "shoulder_height_m": 1.5})
    half = deer.build({"pose": "grazing", "shoulder_height_m": 0.75})
    assert double.vertices_m == pytest.approx(2 * half.vertices_m)


@pytest.mark.parametrize(("pose", "variant"), STANDING)
def test_origin_lies_between_the_feet_and_all_hooves_are_found(pose: str, variant: str) -> None:
    mesh = deer.build({"pose": pose, "variant": variant, "shoulder_height_m": 1.0})
    hooves = vertices_of(mesh, "hoof")
    feet = [hooves[(hooves[:, 0] > 0) == fore] for fore in (True, False)]
    feet = [f[(f[:, 1] > 0) == left] for f in feet for left in (True, False)]
    assert all(len(f) for f in feet)
    standing = [f for f in feet if f[:, 2].min() < 0.005]
    assert len(standing) >= 3  # walking lifts one
    centre = np.mean([f[:, :2].mean(axis=0) for f in feet], axis=0)
    assert np.abs(centre).max() < 0.06


def test_deer_proportions() -> None:
    mesh = deer.build({"pose": "standing", "variant": "alert", "shoulder_height_m": 1.0})
    trunk = vertices_of(mesh, "back", "upper_flank", "flank", "belly")
    # Legs take about half the height below the chest; the trunk is about as long as the animal is high and slim.
    chest = trunk[np.abs(trunk[:, 0] - trunk[:, 0].max() + 0.25) < 0.05, 2].min()
    assert 0.45 < chest < 0.58
    assert 0.9 < np.ptp(trunk[:, 0]) < 1.15
    assert 0.22 < np.ptp(trunk[:, 1]) < 0.34
    head = vertices_of(mesh, "head", "muzzle", "nose")
    assert 0.22 < np.ptp(head[:, 0]) < 0.40
    assert head[:, 2].min() > 1.0  # carried above the back
    assert vertices_of(mesh, "nose")[:, 0].max() == pytest.approx(mesh.vertices_m[:, 0].max())  # +X is the heading
    grazing = deer.build({"pose": "grazing", "variant": "ground", "shoulder_height_m": 1.0})
    assert vertices_of(grazing, "nose")[:, 2].min() < 0.12
    lying = deer.build({"pose": "lying", "shoulder_height_m": 1.0})
    assert vertices_of(lying, "back")[:, 2].max() < 0.6


def test_turning_the_neck_moves_the_head_and_nothing_behind() -> None:
    still = deer.build({"antlers": "hard"})
    turned = deer.build({"antlers": "hard", "neck_turn_rad": 0.5, "head_turn_rad": 0.2})
    assert (still.part_of_triangle == turned.part_of_triangle).all()
    for part in ("flank", "hoof", "tail", "lower_leg"):
        assert vertices_of(turned, part) == pytest.approx(vertices_of(still, part), abs=0.02)
    assert vertices_of(turned, "nose")[:, 1].mean() > vertices_of(still, "nose")[:, 1].mean() + 0.15
    assert vertices_of(turned, "antler")[:, 1].mean() > 0.03
    assert areas(turned).min() > 1e-10


def test_a_bent_spine_keeps_heights_and_turns_hips_against_shoulders() -> None:
    straight, bent = deer.build({}), deer.build({"spine_bend_rad": 1.0})
    assert np.array_equal(straight.vertices_m[:, 2], bent.vertices_m[:, 2])
    nose, tail = np.argmax(straight.vertices_m[:, 0]), np.argmin(straight.vertices_m[:, 0])
    for end, side in ((nose, 1), (tail, 1)):
        assert side * (bent.vertices_m[end, 1] - straight.vertices_m[end, 1]) > 0.1
    length = np.ptp(straight.vertices_m[:, 0])
    assert 0.75 * length < np.ptp(bent.vertices_m[:, 0]) < length
    drawn = [deer.sample(np.random.default_rng(k), {"bend_deg": [20, 60]}) for k in range(30)]
    angles = [np.degrees(abs(p["spine_bend_rad"])) for p in drawn]
    assert 20 <= min(angles) < 30 and 50 < max(angles) <= 60
    assert all(p["spine_bend_rad"] * p["neck_turn_rad"] > 0 for p in drawn)
    plain = deer.sample(np.random.default_rng(3), {})
    assert {k: v for k, v in drawn[3].items() if k != "spine_bend_rad"} == plain


def test_draws_vary_and_build() -> None:
    drawn = [deer.sample(stream(seed, "s"), {}) for seed in range(200)]
    assert {d["pose"] for d in drawn} == set(deer.DRAWN_POSES)
    assert {d["antlers"] for d in drawn} == set(deer.ANTLERS)
    assert {d["antler_form"] for d in drawn} == set(deer.ANTLER_FORMS)
    heights = [d["shoulder_height_m"] for d in drawn]
    assert deer.DRAWN_HEIGHT_M[0] <= min(heights) < 0.75
    assert 1.15 < max(heights) <= deer.DRAWN_HEIGHT_M[1]
    for d in drawn[:12]:
        deer.build(d)


def test_options_fix_what_they_name_and_nothing_else() -> None:
    for seed in range(20):
        free = deer.sample(stream(seed, "o"), {})
        fixed = deer.sample(stream(seed, "o"), {"antlers": "velvet"})
        assert fixed == {**free, "antlers": "velvet"}
    rng = stream(0, "p")
    assert {deer.sample(rng, {"pose": "lying"})["pose"] for _ in range(20)} == {"lying"}
    assert {deer.sample(rng, {"pose": ["lying", "grazing"]})["pose"] for _ in range(40)} == {"lying", "grazing"}
    assert deer.sample(rng, {"antlers": True})["antlers"] == "hard"
    assert deer.sample(rng, {"antlers": False})["antlers"] == "none"
    assert deer.sample(rng, {"shoulder_height_m": 0.8})["shoulder_height_m"] == 0.8
    heights = [deer.sample(rng, {"shoulder_height_m": [0.6, 0.7]})["shoulder_height_m"] for _ in range(40)]
    assert 0.6 <= min(heights) < 0.63
    assert 0.67 < max(heights) <= 0.7


def test_thermal_roles_have_specified_values() -> None:
    mean = {name: sum(role.delta_t_k) / 2 for name, role in deer.PARTS.items()}
    trunk = [mean[n] for n in ("back", "upper_flank", "flank", "belly", "neck_base", "neck")]
    assert max(trunk) - min(trunk) < 2.5  # nearly uniform
    assert all(mean[n] < min(trunk) for n in ("ear", "mid_leg", "lower_leg", "hoof", "antler"))
    assert mean["eye"] == max(mean.values())
    for role in deer.PARTS.values():
        assert role.delta_t_k[0] < role.delta_t_k[1]
        assert 0.9 <= role.emissivity[0] <= role.emissivity[1] <= 1
    chain = ("back", "upper_flank", "flank", "haunch", "upper_leg", "mid_leg", "lower_leg")
    assert all(abs(mean[a] - mean[b]) <= 1.5 for a, b in pairwise(chain))


def test_surface_of_a_sphere_is_a_sphere() -> None:
    body = Body((ellipsoid("ball", (0.1, 0.2, 0.3), (0.5, 0.5, 0.5)),))
    vertices, triangles = surface(body, 0.04)
    assert is_closed(triangles)
    radius = np.linalg.norm(vertices - [0.1, 0.2, 0.3], axis=1)
    assert np.abs(radius - 0.5).max() < 0.002
    assert signed_volume(vertices, triangles) == pytest.approx(4 / 3 * np.pi * 0.125, rel=0.01)


def test_sparse_grid_equals_the_full_distance_near_the_surface() -> None:
    body = Body(
        (
            ellipsoid("a", (0, 0, 0), (0.4, 0.2, 0.15)),
            tube("b", [(0.2, 0, 0), (0.5, 0.1, 0.3), (0.6, 0, 0.6)], [0.1, 0.06, 0.03], blend=0.08, steps=3),
        )
    )
    cell = 0.03
    grid, low = body.sample_grid(cell, 0.0)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij"), axis=-1).reshape(-1, 3)
    full = np.full(len(index), implicit.FAR)
    for primitive in body.primitives:
        full = implicit.smooth_minimum(full, primitive.distance(low + index * cell), primitive.blend)
    assert (np.sign(grid.ravel()) == np.sign(full)).all()
    near = np.abs(full) < 1.5 * cell
    assert np.abs(grid.ravel() - full)[near].max() < 1e-12


def test_sheets_that_share_cells_do_not_pinch() -> None:
    # Random values cross most of the 256 patterns of a cell; every edge still has an even, balanced number of sides.
    rng = stream(5, "grid")
    grid = np.pad(rng.normal(size=(12, 12, 12)), 2, constant_values=1.0)
    vertices, triangles = implicit.surface_nets(grid, 1.0, np.zeros(3))
    a, b = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    forward = np.sort(a.astype(np.int64) * len(vertices) + b)
    backward = np.sort(b.astype(np.int64) * len(vertices) + a)
    assert (forward == backward).all()
    assert signed_volume(vertices, triangles) > 0


def test_two_touching_corners_stay_apart() -> None:
    # Two inside nodes diagonal on a face: one vertex per sheet instead of one shared by both.
    grid = np.ones((6, 6, 6))
    grid[2, 2, 2] = grid[3, 3, 2] = -1
    vertices, triangles = implicit.surface_nets(grid, 1.0, np.zeros(3))
    assert is_closed(triangles)
    assert len(vertices) == 16


@pytest.mark.parametrize("variant", deer.VARIANTS["sleeping"])
@pytest.mark.parametrize("age", deer.AGES)
def test_a_sleeping_deer_is_curled_up_with_its_head_on_the_ground(variant: str, age: str) -> None:
    given = {"age": age, "shoulder_height_m": 0.8}
    asleep, awake = (deer.build({**given, **p}) for p in ({"pose": "sleeping", "variant": variant}, {"pose": "lying"}))
    assert vertices_of(asleep, "head", "muzzle", "nose")[:, 2].min() < 0.02
    assert asleep.size_m[2] < 0.65 * awake.size_m[2]
    assert asleep.size_m[0] < awake.size_m[0]
    head, trunk = (vertices_of(asleep, n).mean(axis=0) for n in ("head", "flank"))
    assert head[1] > trunk[1] + 0.15  # beside the trunk
    body = ("back", "upper_flank", "flank", "belly", "haunch", "shoulder", "neck_base", "neck", "upper_leg", "mid_leg")
    for part in ("head", "muzzle", "nose", "hoof"):
        assert share_inside(asleep, part, (*body, "tail")) < 0.05, part


def test_the_young_are_small_with_long_legs_and_no_antlers() -> None:
    fawn, doe = (deer.build({"age": age, "shoulder_height_m": 0.6}) for age in deer.AGES[::-1])
    trunks = [vertices_of(m, "back", "upper_flank", "flank", "belly") for m in (fawn, doe)]
    assert np.ptp(trunks[0][:, 0]) < 0.92 * np.ptp(trunks[1][:, 0])
    heads = [np.ptp(vertices_of(m, "head")[:, 1]) for m in (fawn, doe)]
    assert heads[0] > 1.1 * heads[1]
    drawn = [deer.sample(stream(k, "y"), {"age": {"young": 1, "adult": 1}, "antlers": True}) for k in range(60)]
    young = [d for d in drawn if d.get("age") == "young"]
    assert 18 < len(young) < 42
    assert all(d["antlers"] == "none" and 0.35 <= d["shoulder_height_m"] <= 0.7 for d in young)
    assert all(d["antlers"] == "hard" and d["shoulder_height_m"] >= 0.7 for d in drawn if "age" not in d)
    for pose in deer.POSES:
        assert is_closed(deer.build({"pose": pose, "age": "young", "shoulder_height_m": 0.4}).triangles)
    weights = [deer.sample(stream(k, "y"), {"pose": {"sleeping": 3, "grazing": 1}})["pose"] for k in range(80)]
    assert 45 < weights.count("sleeping") < 75 and set(weights) == {"sleeping", "grazing"}
