"""Movement of models: cycles that close, feet that stay where they stand, bodies that do not jump."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from infrablend.assets import bird, boar, deer
from infrablend.assets.catalogue import list_models, load_model
from infrablend.assets.model import MOMENTS, ObjectModel
from infrablend.core.mesh import Mesh
from infrablend.core.rng import stream
from infrablend.errors import ModelError
from tests.meshes import check_surface, digest, vertices_of

# Model, what moves, and the phase in the middle of the stance of its left (fore) foot.
STEPS: list[tuple[str, dict[str, Any], float]] = [
    ("person", {"pose": "walking"}, 0.27),
    ("person", {"pose": "running"}, 0.15),
    ("person", {"pose": "walking", "age": "child", "height_m": 0.9}, 0.27),
    ("person", {"pose": "crawling"}, 0.31),
    ("deer", {"pose": "walking"}, 0.57),
    ("deer", {"pose": "running"}, 0.20),
    ("boar", {"pose": "walking"}, 0.57),
    ("boar", {"pose": "running"}, 0.21),
]
OTHERS: list[tuple[str, dict[str, Any]]] = [
    ("person", {"pose": "waving"}),
    ("bird", {"flight": "flapping"}),
]
MOVING = [*((name, options) for name, options, _ in STEPS), *OTHERS]
STILL = [
    ("person", {"pose": "lying"}),
    ("person", {"pose": "standing"}),
    ("deer", {"pose": "grazing"}),
    ("boar", {"pose": "lying"}),
]


def individual(name: str, options: dict[str, Any]) -> tuple[ObjectModel, dict[str, Any]]:
    model = load_model(name)
    params = {**model.sample(stream(3, name), options), "mirror": False}
    for turned in ("head_turn_rad", "neck_turn_rad", "bend_rad"):
        params |= {turned: 0.0} if turned in params else {}
    if name == "bird":
        del params["mirror"]
    return model, params


def at(model: ObjectModel, params: dict[str, Any], phase: float) -> Mesh:
    assert model.animate is not None
    return model.build(model.animate(params, phase))


def test_models_that_move_say_how() -> None:
    models = {name: load_model(name) for name in list_models()}
    assert {n for n, m in models.items() if m.animate is not None} == {"bird", "boar", "deer", "person"}
    for model in models.values():
        assert (model.animate is None) == (model.stride_m is None and model.cycle_hz is None)


@pytest.mark.parametrize(("name", "options"), MOVING)
def test_a_cycle_closes_and_moves(name: str, options: dict[str, Any]) -> None:
    model, params = individual(name, options)
    before = dict(params)
    first, later = at(model, params, 0.0), at(model, params, 0.25)
    assert digest(at(model, params, 1.0)) == digest(at(model, params, -1.0)) == digest(first)
    assert params == before
    assert model.animate is not None and json.loads(json.dumps(model.animate(params, 0.3))) == model.animate(
        params, 0.3
    )
    assert set(later.part_names) == set(first.part_names)
    assert digest(later) != digest(first)
    check_surface(later)
    # From one moment to the next nothing jumps.
    boxes = [np.concatenate([m.vertices_m.min(axis=0), m.vertices_m.max(axis=0)])
             for m in (at(model, params, k / MOMENTS) for k in range(0, MOMENTS + 1, 4))]  # fmt: skip
    assert np.abs(np.diff(boxes, axis=0)).max() < 0.25 * first.size_m.max()


@pytest.mark.parametrize(("name", "options"), STILL)
def test_those_that_keep_still_stay_as_they_are(name: str, options: dict[str, Any]) -> None:
    model, params = individual(name, options)
    assert model.animate is not None and model.animate(params, 0.4) == params
    assert model.stride_m is not None and model.stride_m(params) == 0.0
    assert model.cycle_hz is None or model.cycle_hz(params) == 0.0
    with pytest.raises(ModelError, match=r"parameter phase: found 0\.4; expected none"):
        model.build({**params, "phase": 0.4})


@pytest.mark.parametrize(("name", "options", "stance"), STEPS)
def test_feet_stay_where_they_stand(name: str, options: dict[str, Any], stance: float) -> None:
    model, params = individual(name, options)
    assert model.stride_m is not None
    stride, size = model.stride_m(params), params.get("shoulder_height_m") or params["height_m"]
    assert (0.25 if options["pose"] == "crawling" else 0.5) * size < stride < 1.7 * size
    places = []
    for k in range(-3, 4):
        phase = round(stance * MOMENTS + k) / MOMENTS
        mesh = at(model, params, phase)
        foot = vertices_of(mesh, {"crawling": "hand"}.get(options["pose"], "shoe") if name == "person" else "hoof")
        foot = foot[foot[:, 1] > 0.0]
        if name != "person":
            foot = foot[foot[:, 0] > 0.0]
        sole = foot[foot[:, 2] < foot[:, 2].min() + 0.02 * size]
        assert mesh.vertices_m[:, 2].min() == pytest.approx(0, abs=0.01)
        assert sole[:, 2].min() < 0.01
        places.append(0.5 * (sole[:, 0].max() + sole[:, 0].min()) + stride * phase)
    # Six moments are an eighth of the stride; a foot that rolls shifts its middle a little.
    assert np.ptp(places) < 0.25 * stride / 8, np.round(places, 3)


@pytest.mark.parametrize(("name", "options", "stance"), STEPS)
def test_bodies_stay_over_their_origin(name: str, options: dict[str, Any], stance: float) -> None:
    model, params = individual(name, options)
    size = params.get("shoulder_height_m") or params["height_m"]
    part = "jacket" if name == "person" else "back"
    params |= {"top": "jacket"} if name == "person" else {}
    heads = [vertices_of(at(model, params, k / 8), part).mean(axis=0) for k in range(8)]
    assert np.ptp(heads, axis=0).max() < 0.06 * size
    if options["pose"] == "crawling":  # shoes are behind
        return
    soles = [vertices_of(at(model, params, k / 8), "shoe" if name == "person" else "hoof")[:, :2] for k in range(8)]
    middle = np.mean([0.5 * (s.min(axis=0) + s.max(axis=0)) for s in soles], axis=0)
    assert np.abs(middle).max() < 0.08 * size


def test_strides_fit_the_speed_of_people_and_animals() -> None:
    """At their usual speeds, cycles per second are those of real ones."""
    for name, options, speed_m_s, hz in (
        ("person", {"pose": "walking", "height_m": 1.75}, 1.3, (0.85, 1.15)),
        ("person", {"pose": "running", "height_m": 1.75}, 2.7, (1.2, 1.6)),
        ("deer", {"pose": "walking", "shoulder_height_m": 1.1}, 1.0, (0.8, 1.4)),
        ("boar", {"pose": "walking", "shoulder_height_m": 0.8}, 0.8, (1.0, 1.7)),
    ):
        model, params = individual(name, options)
        assert model.stride_m is not None
        assert hz[0] < speed_m_s / model.stride_m(params) < hz[1], name
    walker, child = (individual("person", {"pose": "walking", **o})[1] for o in ({}, {"age": "child", "height_m": 0.9}))
    stride = load_model("person").stride_m
    assert stride is not None and stride(child) < 0.55 * stride(walker)


@pytest.mark.parametrize("gait", ["walking", "running"])
@pytest.mark.parametrize("fore", [True, False])
@pytest.mark.parametrize("module", [boar, deer], ids=["boar", "deer"])
def test_bones_of_animals_keep_their_length(module: Any, fore: bool, gait: str) -> None:
    lengths = []
    for k in range(24):
        if module is deer:
            pose = deer._skeleton(gait, "", k / 24)
        else:
            pose = boar._skeleton({"pose": gait, "variant": 1, "phase": k / 24})
        leg = pose.legs[0 if fore else 2]
        upper, lower = (module._fore_leg if fore else module._hind_leg)(pose, leg, 1, False)
        (top,) = (p.path[0] for p in upper if p.part == "upper_leg")
        knee, fetlock = lower[0].path[1], lower[0].path[-1]
        lengths.append([np.linalg.norm(knee - top), np.linalg.norm(fetlock - knee)])
    assert (np.max(lengths, axis=0) < 1.05 * np.min(lengths, axis=0)).all()


def test_birds_beat_their_wings_about_their_body() -> None:
    model, params = individual("bird", {"flight": "flapping", "kind": "crow", "climb_deg": 0, "bank_deg": 0})
    top, bottom = at(model, params, 0.0), at(model, params, 0.5)
    assert vertices_of(top, "body") == pytest.approx(vertices_of(bottom, "body"))
    tips = [vertices_of(m, "wing") for m in (top, bottom)]
    assert tips[0][:, 2].max() > tips[1][:, 2].max() + 0.1 * params["size_m"]
    assert model.cycle_hz is not None and 3.5 < model.cycle_hz({**params, "size_m": 0.95}) < 5
    soaring = {**params, "flight": "soaring"}
    assert bird.animate(soaring, 0.1) == bird.animate(soaring, 0.6)
    assert bird.cycle_hz(soaring) == 0.0
