"""Skeletons of the person: joints within human limits, bodies on the ground, children's proportions, weights."""

from __future__ import annotations

import math

import numpy as np
import pytest

from infrablend.assets import person
from infrablend.assets.person_poses import (
    DRAWN_POSES,
    FOREARM,
    SHANK,
    STRIDES,
    THIGH,
    UPPER_ARM,
    VARIANTS,
    child_factors,
    leg_lines,
    skeleton,
)
from infrablend.core.mesh import FloatArray
from infrablend.core.rng import stream
from tests.meshes import share_inside, vertices_of

pytestmark = pytest.mark.thinned

NEW = [(pose, variant) for pose in VARIANTS if pose not in DRAWN_POSES for variant in VARIANTS[pose]]
LYING = [s for s in NEW if s[0] == "lying"]
CLOTHES = ("jacket", "sleeve", "collar", "hood")


def bend_deg(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    """Return by how much the joint b between a and c is bent."""
    u, v = b - a, c - b
    return math.degrees(math.acos(float(u @ v) / float(np.linalg.norm(u) * np.linalg.norm(v))))


@pytest.mark.parametrize(("pose", "variant"), NEW)
def test_joints_stay_within_human_limits(pose: str, variant: str) -> None:
    pose_of = skeleton(pose, variant)
    for hip, knee, ankle in leg_lines(pose_of):
        assert np.linalg.norm(ankle - hip) < 1.005 * (THIGH + SHANK)
        assert bend_deg(hip, knee, ankle) < 150
    for sign, arm in zip((1, -1), pose_of.arms, strict=True):
        shoulder, elbow, wrist = person._arm_line(arm, sign, 0.011, "average")
        assert np.linalg.norm(wrist - shoulder) < 1.01 * (UPPER_ARM + FOREARM)
        assert bend_deg(shoulder, elbow, wrist) < 145
    assert abs(pose_of.turn_rad) < math.radians(70) and abs(pose_of.tilt_rad[1]) < math.radians(45)


@pytest.mark.parametrize(("pose", "variant"), NEW)
@pytest.mark.parametrize("given", [{}, {"age": "child", "height_m": 0.9}, {"build": "heavy", "top": "puffer"}])
def test_bodies_rest_on_the_ground(pose: str, variant: str, given: dict[str, object]) -> None:
    mesh = person.build({"pose": pose, "variant": variant, **given})
    assert mesh.vertices_m[:, 2].min() == pytest.approx(0, abs=0.01)
    touching = {
        "lying": ("shoe",),
        "crouching": ("shoe",),
        "crawling": ("hand", "shoe", "trousers"),
        "waving": ("shoe",),
        "running": ("shoe",),
    }[pose]
    for part in touching:
        v = vertices_of(mesh, part)
        sides = [v[v[:, 1] > 0], v[v[:, 1] < 0]] if pose == "crawling" else [v]
        assert all(side[:, 2].min() < 0.04 for side in sides), part


@pytest.mark.parametrize(("pose", "variant"), LYING)
def test_lying_people_are_long_and_flat_with_the_head_ahead(pose: str, variant: str) -> None:
    mesh = person.build({"pose": pose, "variant": variant, "height_m": 1.75})
    length = mesh.size_m[0]
    assert (1.3 < length < 1.6) if variant == "side-curled" else (1.75 < length < 2.05)
    assert mesh.size_m[2] < 0.6
    face = vertices_of(mesh, "face", "hair").mean(axis=0)
    assert 0.35 < face[0] < 0.9 and face[2] < 0.3
    assert vertices_of(mesh, "shoe")[:, 0].max() < -0.25
    nose, hair = (vertices_of(mesh, n).mean(axis=0) for n in ("nose", "hair"))
    if variant.startswith("back"):
        assert nose[2] > hair[2] + 0.05
    else:
        assert abs(nose[1] - hair[1]) > 0.05


@pytest.mark.parametrize(("pose", "variant"), NEW)
def test_no_hand_foot_or_head_goes_through_the_body(pose: str, variant: str) -> None:
    mesh = person.build({"pose": pose, "variant": variant})
    # Wrists are in sleeves and ankles in trousers.
    assert share_inside(mesh, "hand", CLOTHES) < 0.2
    assert share_inside(mesh, "hand", ("trousers",)) < 0.1
    assert share_inside(mesh, "shoe", ("trousers",)) < 0.25
    assert share_inside(mesh, "face", CLOTHES) < 0.05


def test_someone_who_lies_on_the_back_has_put_the_backpack_down() -> None:
    params = {"pose": "lying", "variant": "back", "backpack": True}
    mesh = person.build(params)
    laid = vertices_of(mesh, "laid_backpack")
    assert laid[:, 0].min() > vertices_of(mesh, "hair")[:, 0].max()
    assert laid[:, 2].min() < 0.04
    assert not person.parts_for(params)["laid_backpack"].label
    assert all(
        "laid_backpack" not in person.parts_for({**params, **o}) for o in ({"variant": "side"}, {"backpack": False})
    )
    front = person.build({"pose": "lying", "variant": "front", "backpack": True})
    assert vertices_of(front, "backpack")[:, 2].min() > 0.15


@pytest.mark.parametrize("height", [0.8, 1.0, 1.2, 1.5])
def test_children_have_their_height_and_proportions(height: float) -> None:
    child = person.build({"age": "child", "height_m": height})
    assert child.size_m[2] == pytest.approx(height, rel=0.02)
    adult = person.build({"height_m": 1.75})
    head, leg = (
        tuple(float(np.ptp(vertices_of(mesh, *parts)[:, 2])) / mesh.size_m[2] for mesh in (child, adult))
        for parts in (("face", "hair"), ("trousers",))
    )
    legs_factor, head_factor = child_factors(height)
    assert legs_factor <= 1.0 <= head_factor
    if height < 1.5:
        assert head[0] > head[1] and leg[0] < leg[1]
    if height == 0.8:
        assert 0.2 < head[0] < 0.27 and head[1] < 0.17


def test_ages_are_drawn_by_weight_and_heights_suit_them() -> None:
    drawn = [person.sample(stream(k, "age"), {"age": {"child": 1, "adult": 3}}) for k in range(200)]
    children = [d for d in drawn if d.get("age") == "child"]
    assert 30 < len(children) < 75
    assert all(0.8 <= d["height_m"] <= 1.5 for d in children)
    assert min(d["height_m"] for d in children) < 0.9
    assert all(d["height_m"] >= 1.5 for d in drawn if "age" not in d)
    mixed = [person.sample(stream(k, "age"), {"age": ["child", "adult"], "height_m": [0.9, 1.8]}) for k in range(60)]
    assert {d.get("age", "adult") for d in mixed} == {"child", "adult"}
    for d in mixed[:6]:
        assert person.build(d).size_m[2] < 1.9


def test_poses_are_drawn_by_weight_and_new_ones_only_where_named() -> None:
    plain = [person.sample(stream(k, "w"), {}) for k in range(100)]
    assert {d["pose"] for d in plain} == set(DRAWN_POSES)
    weighted = [person.sample(stream(k, "w"), {"pose": {"lying": 3, "waving": 1}})["pose"] for k in range(200)]
    assert set(weighted) == {"lying", "waving"}
    assert 125 < weighted.count("lying") < 175
    on_back = {person.sample(stream(k, "w"), {"variant": ["back", "front"]})["variant"] for k in range(20)}
    assert on_back == {"back", "front"}
    assert person.sample(stream(1, "w"), {"variant": "squat"})["pose"] == "crouching"


def test_layers_make_people_thicker_and_colder_outside() -> None:
    plain, bundled = (person.build({"clothing": c, "top": "puffer"}) for c in ("winter", "bundled"))
    chests = [np.ptp(vertices_of(mesh, "jacket"), axis=0)[:2] for mesh in (plain, bundled)]
    assert (chests[1] > chests[0] + 0.03).all()
    light, winter, thick = (person.parts_for({"clothing": c}) for c in ("light", "winter", "bundled"))
    for part in ("jacket", "trousers", "hand", "shoe"):
        assert sum(light[part].delta_t_k) > sum(winter[part].delta_t_k) > sum(thick[part].delta_t_k)
    drawn = {person.sample(stream(k, "c"), {"clothing": ["light", "bundled"]})["clothing"] for k in range(20)}
    assert drawn == {"light", "bundled"}


def test_only_who_wears_a_helmet_has_its_part() -> None:
    mesh = person.build({"headwear": "helmet"})
    assert {"helmet", "face"} <= set(mesh.part_names)
    assert vertices_of(mesh, "helmet")[:, 2].max() == pytest.approx(1.75, rel=0.01)
    assert "helmet" in person.parts_for({"headwear": "helmet"})
    assert "helmet" not in person.parts_for({"headwear": "cap"})


@pytest.mark.parametrize("gait", STRIDES)
def test_legs_of_a_gait_reach_the_ground_at_every_moment(gait: str) -> None:
    for k in range(48):
        for hip, knee, ankle in leg_lines(skeleton(gait, "", k / 48)):
            assert np.linalg.norm(ankle - hip) < 1.005 * (THIGH + SHANK)
            assert bend_deg(hip, knee, ankle) < 135
