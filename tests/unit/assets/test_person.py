"""The procedural person: closed, oriented, on the ground, of the height asked for, and the same bytes every time."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from infrablend.assets import person
from infrablend.core.mesh import Mesh
from infrablend.core.rng import stream
from tests.meshes import areas, check_surface, signed_volume, vertices_of

pytestmark = pytest.mark.thinned

SHAPES = [(pose, variant) for pose in person.POSES for variant in person.VARIANTS[pose]]
STANDING = [s for s in SHAPES if s[0] == "standing"]


def check(mesh: Mesh) -> None:
    check_surface(mesh)
    assert areas(mesh).min() > 1e-9


@pytest.mark.parametrize(("pose", "variant"), SHAPES)
@pytest.mark.parametrize("top", person.TOPS)
def test_every_pose_in_every_top_is_closed_oriented_and_on_the_ground(pose: str, variant: str, top: str) -> None:
    for bottom, build in zip(person.BOTTOMS, ("slim", "heavy"), strict=True):
        mesh = person.build({"pose": pose, "variant": variant, "top": top, "bottom": bottom, "build": build})
        check(mesh)
        assert mesh.vertices_m[:, 2].min() == pytest.approx(0.0, abs=1e-12)
        assert vertices_of(mesh, "shoe")[:, 2].min() < 0.04
        assert len(mesh.triangles) < 20_000
        assert set(mesh.part_names) <= set(person.PARTS)
        assert np.bincount(mesh.part_of_triangle, minlength=len(mesh.part_names)).min() > 0
        body = [t for t in mesh.part_names if t != "seat"]
        # Clothed volume of 1.75 m: some 60-200 l with the air in the clothes; legs under a coat count twice.
        shown = np.isin(mesh.part_of_triangle, [mesh.part_names.index(n) for n in body])
        assert 0.06 < signed_volume(mesh.vertices_m, mesh.triangles[shown]) < (0.31 if top == "coat" else 0.26)


@pytest.mark.parametrize(("headwear", "hair"), list(product(person.HEADWEAR, person.HAIR)))
def test_every_head_shows_a_face_and_has_the_height_asked_for(headwear: str, hair: str) -> None:
    for height in (1.5, 1.95):
        mesh = person.build({"headwear": headwear, "hair": hair, "height_m": height})
        check(mesh)
        assert mesh.size_m[2] == pytest.approx(height, rel=0.01)
    names = set(mesh.part_names)
    assert {"face", "nose", "hand"} <= names
    assert ("hat" in names) == (headwear in ("beanie", "cap"))
    # The nose is in front, under the open sky of the face.
    face = vertices_of(mesh, "face", "nose")
    assert face[:, 0].max() > vertices_of(mesh, "jacket")[:, 0].mean() + 0.08


@pytest.mark.parametrize("pose", person.POSES)
def test_arms_of_every_pose(pose: str) -> None:
    for arms, top, build in product(person.ARMS[pose], person.TOPS, ("slim", "heavy")):
        mesh = person.build({"pose": pose, "arms": arms, "top": top, "build": build, "backpack": True})
        check(mesh)
        assert ("hand" in mesh.part_names) == (arms != "pockets")
        # Someone who lies on the back has taken it off.
        worn, found = {"backpack", "strap"}, set(mesh.part_names)
        assert ("laid_backpack" in found and not worn & found) if pose == "lying" else worn <= found
    phone = vertices_of(person.build({"arms": "phone"}), "hand")
    assert phone[:, 0].min() > 0.15
    assert phone[:, 2].min() > 1.0
    call = vertices_of(person.build({"arms": "call"}), "hand")
    assert call[:, 2].max() > 1.5


@pytest.mark.parametrize(("pose", "variant"), STANDING)
@pytest.mark.parametrize("build", person.BUILDS)
def test_height_is_what_was_asked_for(pose: str, variant: str, build: str) -> None:
    for height in (1.5, 1.75, 1.95):
        mesh = person.build({"pose": pose, "variant": variant, "build": build, "height_m": height})
        assert mesh.size_m[2] == pytest.approx(height, rel=0.02)


@pytest.mark.parametrize(("pose", "variant"), SHAPES)
def test_short_sleeves_and_trousers_leave_the_skin_below_elbows_and_knees_bare(pose: str, variant: str) -> None:
    given = {"pose": pose, "variant": variant, "clothing": "light"}
    dressed, bare = (person.build({**given, "sleeves": n, "legs": n}) for n in person.LENGTHS)
    check(bare)
    assert {*bare.part_names} - {*dressed.part_names} == {"forearm", "shin"}
    forearms, shins = vertices_of(bare, "forearm"), vertices_of(bare, "shin")
    assert 0.1 < np.ptp(np.vstack([forearms, vertices_of(bare, "hand")])[:, :3], axis=0).max() < 1.5
    knees = vertices_of(dressed, "trousers")[:, 2].max()
    assert shins[:, 2].min() < 0.4 * knees
    share = areas(bare)[np.isin(bare.part_of_triangle, [bare.part_names.index(n) for n in ("forearm", "shin")])]
    assert 0.08 < share.sum() / areas(bare).sum() < 0.25
    warm = person.parts_for({"clothing": "light"})
    assert warm["forearm"].delta_t_k[0] > warm["sleeve"].delta_t_k[1]


def test_coats_and_puffers_keep_their_sleeves() -> None:
    for top in ("coat", "puffer"):
        assert "forearm" not in person.build({"top": top, "sleeves": "short"}).part_names


def test_lengths_do_not_change_what_else_is_drawn() -> None:
    """Lengths are long unless an option names short ones, and of two about half the people have each."""
    found = []
    for k in range(200):
        plain, both = (
            dict(person.sample(stream(k, "a"), options))
            for options in ({}, {n: ["long", "short"] for n in ("sleeves", "legs")})
        )
        assert (plain["sleeves"], plain["legs"]) == ("long", "long")
        found.append((both.pop("sleeves"), both.pop("legs")))
        assert both == {n: v for n, v in plain.items() if n not in ("sleeves", "legs")}
    assert all(60 < sum(pair[n] == "short" for pair in found) < 140 for n in (0, 1))
    assert len({*found}) == 4


def test_walking_is_a_little_and_sitting_much_lower() -> None:
    heights = {s: person.build({"pose": s[0], "variant": s[1]}).size_m[2] / 1.75 for s in SHAPES}
    assert all(0.95 < h < 1.005 for (pose, _), h in heights.items() if pose == "walking")
    assert 0.7 < heights["sitting", "seat"] < 0.8
    assert all(0.5 < heights["sitting", v] < 0.58 for v in ("cross-legged", "knees-up"))


def test_person_proportions() -> None:
    mesh = person.build({"height_m": 1.75})
    assert 0.42 < np.ptp(vertices_of(mesh, "jacket", "sleeve")[:, 1]) < 0.68  # shoulders and arms in a winter jacket
    assert 0.22 < np.ptp(vertices_of(mesh, "jacket")[:, 0]) < 0.36
    head = vertices_of(mesh, "face", "hair")
    assert 0.21 < np.ptp(head[:, 2]) < 0.30
    assert head[:, 2].min() > 1.45
    assert 0.26 < np.ptp(vertices_of(mesh, "shoe")[:, 0]) < 0.36
    hands = vertices_of(mesh, "hand")
    left = hands[hands[:, 1] > 0]
    assert 0.15 < np.ptp(left[:, 2]) < 0.24
    assert 0.55 < left[:, 2].min() < 0.75
    slim, heavy = (np.ptp(vertices_of(person.build({"build": b}), "jacket"), axis=0) for b in ("slim", "heavy"))
    assert heavy[0] > slim[0] + 0.06
    assert heavy[1] > slim[1] + 0.06


@pytest.mark.parametrize(("pose", "variant"), [s for s in SHAPES if s[0] in (*person.DRAWN_POSES, "waving")])
def test_origin_lies_between_the_feet_or_below_the_hips(pose: str, variant: str) -> None:
    mesh = person.build({"pose": pose, "variant": variant})
    if pose == "sitting":
        seat = vertices_of(mesh, "trousers")
        back = seat[np.abs(seat[:, 1]) < 0.1]
        assert -0.2 < back[:, 0].min() < -0.06
    else:
        shoes = vertices_of(mesh, "shoe")
        feet = [shoes[shoes[:, 1] > 0], shoes[shoes[:, 1] < 0]]
        centre = np.mean([f[:, :2].mean(axis=0) for f in feet], axis=0)
        assert np.abs(centre).max() < 0.06
    # +X is where the person looks.
    nose = vertices_of(mesh, "nose").mean(axis=0)
    hair = vertices_of(mesh, "hair").mean(axis=0)
    assert nose[0] > hair[0] + 0.08
    assert abs(nose[1]) < 0.01


def test_seat_belongs_to_a_seated_person_only_and_is_not_labelled() -> None:
    seated = {"pose": "sitting", "variant": "seat"}
    mesh = person.build(seated)
    assert "seat" in mesh.part_names
    assert vertices_of(mesh, "seat")[:, 2].max() == pytest.approx(0.40, abs=0.06)
    assert "seat" not in person.build({**seated, "seat": False}).part_names
    assert "seat" not in person.build({"pose": "sitting", "variant": "knees-up"}).part_names
    assert [n for n, role in person.PARTS.items() if not role.label] == ["seat", "laid_backpack"]


def test_turning_the_head_moves_the_head_and_nothing_else() -> None:
    still, turned = person.build({}), person.build({"head_turn_rad": 0.8, "head_nod_rad": 0.2})
    for part in ("jacket", "sleeve", "hand", "trousers", "shoe"):
        assert vertices_of(turned, part) == pytest.approx(vertices_of(still, part), abs=1e-9)
    assert vertices_of(turned, "nose")[:, 1].mean() > vertices_of(still, "nose")[:, 1].mean() + 0.06
    assert vertices_of(turned, "nose")[:, 2].mean() < vertices_of(still, "nose")[:, 2].mean() - 0.01
    check(person.build({"head_turn_rad": -1.2, "head_nod_rad": 0.7, "arms": "phone", "hair": "long"}))


def test_draws_vary_and_build() -> None:
    drawn = [person.sample(stream(seed, "s"), {}) for seed in range(300)]
    for name, allowed in person._WORDS.items():
        assert {d[name] for d in drawn} == set(person._DRAWN.get(name, allowed))
    assert {d["arms"] for d in drawn} == set(person.ALL_ARMS)
    assert {d["backpack"] for d in drawn} == {True, False}
    heights = np.array([d["height_m"] for d in drawn])
    assert heights.min() >= 1.5
    assert heights.max() <= 1.95
    assert 1.66 < heights.mean() < 1.77
    assert 0.05 < heights.std() < 0.12
    for d in drawn[:15]:
        check(person.build(d))


def test_options_fix_what_they_name_and_nothing_else() -> None:
    for seed in range(20):
        free = person.sample(stream(seed, "o"), {})
        assert person.sample(stream(seed, "o"), {"headwear": "hood"}) == {**free, "headwear": "hood"}
        assert person.sample(stream(seed, "o"), {"height_m": 1.6}) == {**free, "height_m": 1.6}
        assert person.sample(stream(seed, "o"), {"backpack": True, "seat": False}) == {
            **free,
            "backpack": True,
            "seat": False,
        }
    rng = stream(0, "p")
    assert {person.sample(rng, {"pose": "sitting"})["pose"] for _ in range(20)} == {"sitting"}
    assert {person.sample(rng, {"top": ["coat", "puffer"]})["top"] for _ in range(40)} == {"coat", "puffer"}
    knees = person.sample(rng, {"variant": "knees-up"})
    assert (knees["pose"], knees["variant"]) == ("sitting", "knees-up")
    assert person.sample(rng, {"bottom": "skirt"})["bottom"] == "skirt"
    heights = [person.sample(rng, {"height_m": [1.6, 1.7]})["height_m"] for _ in range(40)]
    assert 1.6 <= min(heights) < 1.63
    assert 1.67 < max(heights) <= 1.7
    assert set(person.OPTIONS) < set(person.DEFAULTS)


def test_thermal_roles_follow_the_facts_table() -> None:
    mean = {name: sum(role.delta_t_k) / 2 for name, role in person.PARTS.items()}
    cloth = ("jacket", "sleeve", "trousers", "hood", "hat", "coat_skirt")
    assert all(2 <= mean[n] <= 8 for n in cloth)
    assert min(mean["face"], mean["neck"], mean["hand"]) > max(mean[n] for n in cloth) + 6
    assert max(mean[n] for n in cloth) < mean["hair"] < mean["hand"]
    assert mean["hood"] < mean["jacket"] < mean["collar"] < mean["neck"]
    assert mean["hat"] < mean["hair"]
    assert abs(mean["seat"]) < 0.5
    for role in person.PARTS.values():
        assert role.delta_t_k[0] < role.delta_t_k[1]
        assert 0.9 <= role.emissivity[0] <= role.emissivity[1] <= 1
        assert role.ior == 1.0
        assert role.what
