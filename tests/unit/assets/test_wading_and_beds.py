"""People in water, and the ground that lying bodies have warmed."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from infrablend.assets import boar, deer, person, warm_ground
from infrablend.core.rng import stream
from infrablend.errors import ModelError
from tests.meshes import check_surface, digest, vertices_of


def of(model: ModuleType, n: int, **options: Any) -> dict[str, Any]:
    """Draw the n-th individual."""
    params: dict[str, Any] = model.sample(stream(7, f"object/{n}"), options)
    return params


@pytest.mark.parametrize("pose", ["standing", "walking", "waving"])
def test_what_is_above_the_water_is_closed_and_as_high_as_the_rest_of_the_body(pose: str) -> None:
    for n in range(6):
        dry = of(person, n, pose=pose)
        height = person.build(dry).vertices_m[:, 2].max()
        emerged = []
        for water in ("knees", "waist", "chest"):
            wet = of(person, n, pose=pose, water=water)
            assert wet == {**dry, "water": water}
            for moving in [wet, *([] if pose == "standing" else [person.animate(wet, 0.3)])]:
                mesh = person.build(moving)
                check_surface(mesh)
                assert mesh.vertices_m[:, 2].min() == 0 and {"face", "jacket"} & set(mesh.part_names)
                assert "shoe" not in mesh.part_names
            emerged.append(float(person.build(wet).vertices_m[:, 2].max()) / height)
        assert 0.62 < emerged[0] < 0.80 and 0.25 < emerged[2] < emerged[1] < 0.55


def test_the_shape_above_the_water_is_that_of_the_dry_person() -> None:
    dry, wet = (person.build(of(person, 3, pose="standing", water=w)) for w in ("none", "waist"))
    head = [vertices_of(m, "face") for m in (dry, wet)]
    sunk = head[0][:, 2].max() - head[1][:, 2].max()
    assert np.allclose(np.sort(head[0], axis=0) - [0, 0, sunk], np.sort(head[1], axis=0), atol=1e-9)


def test_who_may_be_in_water() -> None:
    mixed = [of(person, n, pose={"lying": 1, "standing": 1}, water={"waist": 3, "none": 1}) for n in range(40)]
    assert {(p["pose"], p.get("water", "none")) for p in mixed} == {
        ("lying", "none"), ("standing", "none"), ("standing", "waist"),
    }  # fmt: skip
    assert all((person.needs(p) == {"water": 1.0}) == ("water" in p) for p in mixed)
    with pytest.raises(ModelError, match="in water are standing, walking, waving"):
        of(person, 0, pose="lying", water="waist")
    with pytest.raises(ModelError, match="one of none, knees, waist, chest"):
        of(person, 0, water="neck")


@pytest.mark.parametrize(("model", "poses"), [(person, ["lying"]), (deer, ["lying", "sleeping"]), (boar, ["sleeping"])])
def test_warm_ground_is_a_sheet_around_the_body_without_label(model: ModuleType, poses: list[str]) -> None:
    for n in range(8):
        plain, lain = of(model, n, pose=poses), of(model, n, pose=poses, warm_ground=1)
        shift = lain.pop("warm_ground", None)
        assert lain == plain
        if shift is None:  # with a backpack on the ground beside them
            assert model is person and plain["backpack"]
            continue
        body, mesh = model.build(plain), model.build({**plain, "warm_ground": shift})
        assert np.array_equal(mesh.vertices_m[: len(body.vertices_m)], body.vertices_m)
        beds = set(mesh.part_names) - set(body.part_names)
        assert beds == set(warm_ground.PARTS) and not beds & mesh.closed_parts
        roles = model.MODEL.roles({**plain, "warm_ground": shift})
        assert all(roles[b].glow and roles[b].ground and not roles[b].label for b in beds)
        sheet = vertices_of(mesh, *beds)
        assert 0 < sheet[:, 2].max() < 0.01
        # The whole body, moved as far, lies within it.
        outline = body.vertices_m[body.vertices_m[:, 2] < 0.1, :2] + shift
        assert (sheet[:, :2].min(axis=0) < outline.min(axis=0)).all()
        assert (sheet[:, :2].max(axis=0) > outline.max(axis=0)).all()
        # Seen from above: all triangles face up.
        t = mesh.vertices_m[mesh.triangles[len(body.triangles) :]]
        assert (np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])[:, 2] > 0).all()


def test_beds_are_drawn_by_share_and_for_those_who_lie_alone() -> None:
    share = np.mean(["warm_ground" in of(deer, n, pose="lying", warm_ground=0.3) for n in range(400)])
    assert abs(share - 0.3) < 5 * np.sqrt(0.3 * 0.7 / 400)
    assert not any("warm_ground" in of(deer, n, pose="standing", warm_ground=1) for n in range(5))
    with pytest.raises(ModelError, match="a number from 0 to 1"):
        of(boar, 0, warm_ground=2)
    with pytest.raises(ModelError, match="in metres"):
        deer.build(
            {"pose": "lying", "variant": "resting", "warm_ground": 3} | of(deer, 0, pose="lying") | {"warm_ground": 3}
        )


@pytest.mark.parametrize("model", [person, deer, boar])
def test_bodies_without_the_options_are_as_before(model: ModuleType) -> None:
    plain = of(model, 4)
    assert digest(model.build(plain)) == digest(model.build({**plain, "warm_ground": None}))
    assert not set(warm_ground.PARTS) & set(model.MODEL.roles(plain))
