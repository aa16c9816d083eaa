"""The procedural wild boar: closed, oriented, on its feet, shaped like a boar, and the same bytes every time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from infrablend.assets import boar
from infrablend.assets.implicit import is_closed
from infrablend.core.mesh import Mesh
from infrablend.core.rng import stream
from tests.meshes import areas, share_inside, signed_volume, vertices_of

pytestmark = pytest.mark.thinned

SHAPES = [(pose, k + 1) for pose in boar.POSES for k in range(len(boar.VARIANTS[pose]))]
PLAIN: dict[str, Any] = {
    "pose": "standing",
    "variant": 1,
    "build": "sow",
    "shoulder_height_m": 1.0,
    "length_factor": 1.0,
    "width_factor": 1.0,
    "bend_rad": 0.0,
    "head_turn_rad": 0.0,
    "mirror": False,
    "time_of_day": "night",
}


def build(**changes: object) -> Mesh:
    return boar.build({**PLAIN, **changes})


def drawn(k: int, **options: object) -> dict[str, Any]:
    return boar.sample(stream(7, "boar", k), options)


@pytest.mark.parametrize(("pose", "variant"), SHAPES)
@pytest.mark.parametrize("kind", boar.BUILDS)
def test_every_shape_is_closed_oriented_and_on_the_ground(pose: str, variant: int, kind: str) -> None:
    mesh = build(pose=pose, variant=variant, build=kind)
    assert is_closed(mesh.triangles)
    # Scaled to 1 m at the withers; a sow of 0.75 m would weigh 75 to 110 kg at 1000 kg/m3.
    assert 0.16 < signed_volume(mesh.vertices_m, mesh.triangles) < 0.36
    assert areas(mesh).min() > 1e-9
    assert abs(mesh.vertices_m[:, 2].min()) <= 0.005
    assert 10_000 <= len(mesh.triangles) <= 30_000
    assert set(mesh.part_names) == set(boar.PART_NAMES) - (set() if kind == "tusker" else {"tusk"})
    assert np.bincount(mesh.part_of_triangle, minlength=len(mesh.part_names)).min() > 0
    if pose != "sleeping":
        assert abs(mesh.vertices_m[:, 1].max() + mesh.vertices_m[:, 1].min()) < 0.05


@pytest.mark.parametrize(("pose", "variant"), [s for s in SHAPES if s[0] not in ("lying", "running", "sleeping")])
def test_origin_is_between_the_feet_and_the_withers_have_the_height_asked_for(pose: str, variant: int) -> None:
    mesh = build(pose=pose, variant=variant, shoulder_height_m=0.8)
    hooves = vertices_of(mesh, "hoof")
    feet = [hooves[((hooves[:, 0] > 0) == fore) & ((hooves[:, 1] > 0) == left)] for fore in (1, 0) for left in (1, 0)]
    assert sum(f[:, 2].min() < 0.005 for f in feet) >= 3  # walking lifts one
    assert np.abs(np.mean([f[:, :2].mean(axis=0) for f in feet], axis=0)).max() < 0.06
    trunk = vertices_of(mesh, "back", "flank", "mane")
    assert trunk[:, 2].max() == pytest.approx(0.8, abs=0.04)


def test_it_is_built_like_a_boar() -> None:
    mesh = build()
    # Longer than high, legs less than half of the height, highest and broadest at the shoulders.
    assert 1.6 < mesh.size_m[0] < 1.95
    trunk = vertices_of(mesh, "back", "flank", "belly", "mane", "shoulder", "haunch")
    assert 0.33 < trunk[np.abs(trunk[:, 0] - 0.2) < 0.1, 2].min() < 0.45

    def section(low: float, high: float) -> np.ndarray:
        body = vertices_of(mesh, "back", "flank", "belly", "mane", "neck", "head", "snout")
        return body[(body[:, 0] > low) & (body[:, 0] < high)]

    shoulders, loins, snout = section(0.25, 0.45), section(-0.5, -0.3), section(0.95, 1.2)
    assert shoulders[:, 2].max() > loins[:, 2].max() + 0.05
    assert np.ptp(shoulders[:, 1]) > np.ptp(loins[:, 1]) > 2 * np.ptp(snout[:, 1])
    head = vertices_of(mesh, "head", "snout", "nose")
    assert 0.45 < np.ptp(head[:, 0]) < 0.65  # a third of head and body
    assert vertices_of(mesh, "nose")[:, 0].max() == pytest.approx(mesh.vertices_m[:, 0].max())  # +X is the heading
    assert vertices_of(build(pose="rooting"), "nose")[:, 2].min() < 0.12
    assert vertices_of(build(pose="lying"), "back")[:, 2].max() < 0.65
    yearling, tusker = (vertices_of(build(build=kind), "mane", "back") for kind in ("yearling", "tusker"))
    assert np.ptp(tusker[:, 1]) > np.ptp(yearling[:, 1])


def test_factors_and_height_scale() -> None:
    plain, other = build(), build(length_factor=1.1, width_factor=0.9, shoulder_height_m=0.5)
    assert other.size_m / plain.size_m == pytest.approx([0.55, 0.45, 0.5], rel=1e-9)


def test_spine_bends_and_keeps_its_length() -> None:
    straight, bent = build(), build(bend_rad=0.6, head_turn_rad=0.4)
    assert is_closed(bent.triangles) and areas(bent).min() > 1e-9
    assert vertices_of(bent, "nose")[:, 1].mean() > vertices_of(straight, "nose")[:, 1].mean() + 0.3
    assert vertices_of(bent, "tail")[:, 1].mean() > vertices_of(straight, "tail")[:, 1].mean() + 0.04
    spine = [vertices_of(m, "mane") for m in (straight, bent)]
    length = [np.abs(np.diff(v[np.argsort(v[:, 0])][::20, :2], axis=0)).sum() for v in spine]
    assert length[0] > 0.6
    volume = [signed_volume(m.vertices_m, m.triangles) for m in (straight, bent)]
    assert volume[1] == pytest.approx(volume[0], rel=0.03)


def test_draws_vary_and_heights_follow_the_build() -> None:
    draws = [drawn(k) for k in range(300)]
    assert {d["pose"] for d in draws} == set(boar.DRAWN_POSES)
    for kind in boar.DRAWN_BUILDS:
        low, high = boar.HEIGHTS_M[kind]
        heights = [d["shoulder_height_m"] for d in draws if d["build"] == kind]
        assert low <= min(heights) < low + 0.03 and high - 0.03 < max(heights) <= high
    for d in draws[:8]:
        boar.build(d)
    free, fixed = drawn(5), drawn(5, pose="lying", shoulder_height_m=[0.6, 0.61])
    assert fixed == {**free, "pose": "lying", "shoulder_height_m": fixed["shoulder_height_m"]}
    assert 0.6 <= fixed["shoulder_height_m"] <= 0.61
    assert set(boar.OPTIONS) == {*free, "warm_ground"}


def test_thermal_roles() -> None:
    mean = {name: sum(role.delta_t_k) / 2 for name, role in boar.PARTS.items()}
    assert mean["mane"] < mean["back"] < mean["flank"] < mean["belly"]
    assert min(mean[n] for n in ("eye", "ear", "snout", "nose")) > mean["flank"]
    assert mean["eye"] == max(mean.values())
    assert mean["hoof"] == min(mean.values()) or mean["tusk"] == min(mean.values())
    night, day = (boar.parts_for({"time_of_day": t}) for t in ("night", "day"))
    assert night == boar.PARTS
    assert day["back"].delta_t_k == (night["back"].delta_t_k[0] + 5, night["back"].delta_t_k[1] + 20)
    assert day["eye"] == night["eye"]


@pytest.mark.parametrize("kind", boar.BUILDS)
def test_a_sleeping_boar_lies_curled_or_on_its_side(kind: str) -> None:
    curled, on_side = (build(pose="sleeping", variant=k, build=kind) for k in (1, 2))
    for mesh in (curled, on_side):
        assert vertices_of(mesh, "head", "snout", "nose")[:, 2].min() < 0.03
        trunk = ("mane", "back", "flank", "belly", "haunch", "shoulder", "neck", "upper_leg", "tail")
        assert all(share_inside(mesh, part, trunk) < 0.1 for part in ("snout", "nose", "hoof"))
    assert curled.size_m[0] < 0.95 * build(pose="lying", build=kind).size_m[0]
    assert vertices_of(curled, "nose")[:, 1].mean() > 0.2
    # On its right side: legs to the left, all four near the ground, the spine to the right.
    assert on_side.size_m[2] < 0.5
    hooves = vertices_of(on_side, "hoof")
    assert hooves[:, 1].min() > 0.35 and hooves[:, 2].max() < 0.25
    assert vertices_of(on_side, "mane")[:, 1].mean() < -0.2


def test_piglets_are_small_with_short_snouts_and_drawn_only_where_named() -> None:
    piglet, sow = build(build="piglet"), build(build="sow")
    snouts = [np.ptp(vertices_of(m, "snout", "nose")[:, 0]) for m in (piglet, sow)]
    assert snouts[0] < 0.8 * snouts[1]
    assert np.ptp(vertices_of(piglet, "head")[:, 1]) > np.ptp(vertices_of(sow, "head")[:, 1])
    herd = [drawn(k, build={"piglet": 3, "sow": 1}) for k in range(60)]
    young = [d for d in herd if d["build"] == "piglet"]
    assert 35 < len(young) < 55 and all(0.2 <= d["shoulder_height_m"] <= 0.42 for d in young)
    assert {drawn(k)["build"] for k in range(60)} == set(boar.DRAWN_BUILDS)
