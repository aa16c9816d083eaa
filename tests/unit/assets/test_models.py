"""Promises of every procedural model: repeatable draws and meshes, errors that name the field."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from infrablend.assets import boar, camera_quad, car, deer, drone, person
from infrablend.assets.catalogue import list_models, load_model
from infrablend.assets.params import Choice, Number
from infrablend.core.rng import stream
from infrablend.errors import ModelError
from tests.meshes import digest, signed_volume

MODELS = {name: load_model(name) for name in list_models()}
# Parameters that a build needs; deer and person have a default for each.
BASE: dict[str, Mapping[str, Any]] = {"car": car.NOMINAL, "deer": {}, "drone": drone.NOMINAL, "person": {}}
DRAWS = {
    "car": [car.MODEL.sample(stream(7, "car", k), {}) for k in range(4)],
    "drone": [drone.MODEL.sample(stream(7, "drone", k), {}) for k in range(4)],
    "deer": [deer.sample(stream(3, "deer"), {"pose": "walking", "antlers": True})],
    "person": [person.sample(stream(3, "person"), {"pose": "walking", "backpack": True, "top": "coat"})],
}
OTHERS = (
    "airplane", "bird", "boar", "camera-quad", "drones", "fixed-wing", "helicopter", "hexacopter", "racer"
)  # fmt: skip
STANDING = ("boar", "car", "deer", "person")
DRAWS |= {name: [MODELS[name].sample(stream(7, name, 5), {})] for name in OTHERS}
BASE["boar"] = DRAWS["boar"][0]
CACHED_PIECES = {
    "boar": (boar._shape,),
    "camera-quad": (camera_quad._skin,),
    "deer": (deer._body,),
    "person": (person._upper, person._legs, person._skirt, person._shoes, person._head, person._hands,
               person._backpack),
}  # fmt: skip


def test_the_catalogue_ships_them() -> None:
    assert list_models() == sorted(list_models())
    for name, model in MODELS.items():
        assert load_model(name) is model
        category = name if name in (*STANDING, "airplane", "bird", "helicopter") else "drone"
        assert (model.name, model.category, model.stands) == (name, category, name in STANDING)


@pytest.mark.parametrize("name", MODELS)
def test_same_params_same_bytes_cached_or_not(name: str) -> None:
    model = MODELS[name]
    for params in DRAWS[name]:
        first = digest(model.build(params))
        assert digest(model.build(json.loads(json.dumps(params)))) == first
        for piece in CACHED_PIECES.get(name, ()):
            piece.cache_clear()
        assert digest(model.build(params)) == first


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("boar", {"mirror": True, "bend_rad": 0.3, "head_turn_rad": 0.4, "length_factor": 1.2}),
        ("deer", {"mirror": True, "neck_turn_rad": 0.5, "length_factor": 1.2}),
        (
            "person",
            {"mirror": True, "head_turn_rad": 0.5, "width_factor": 1.1, "lean_rad": 0.2, "head_nod_rad": 0.3},
        ),
    ],
)
def test_a_build_leaves_the_cached_pieces_alone(name: str, other: dict[str, object]) -> None:
    build, base = MODELS[name].build, BASE[name]
    plain = digest(build(base))
    build({**base, **other})
    assert digest(build(base)) == plain


@pytest.mark.parametrize(
    ("name", "params"),
    [
        ("boar", {"bend_rad": 0.6, "head_turn_rad": 0.4, "mirror": False}),
        ("deer", {"pose": "walking", "neck_turn_rad": 0.3}),
        ("person", {"pose": "walking", "head_turn_rad": 0.3, "arms": "call"}),
    ],
)
def test_mirror_is_a_mirror(name: str, params: dict[str, object]) -> None:
    build = MODELS[name].build
    a, b = (build({**BASE[name], **params, **turned}) for turned in ({}, {"mirror": True}))
    assert (b.vertices_m == a.vertices_m * [1, -1, 1]).all()
    assert signed_volume(b.vertices_m, b.triangles) == pytest.approx(signed_volume(a.vertices_m, a.triangles))


CAR_RANGES = {name: dial.drawn for name, dial in car.DIALS.table.items() if isinstance(dial, Number)}
CAR_CHOICES = {name: dial.values for name, dial in car.DIALS.table.items() if isinstance(dial, Choice)}


@pytest.mark.parametrize(
    ("name", "drawn", "choices"), [("car", CAR_RANGES, CAR_CHOICES), ("drone", drone.DRAWN, drone.CHOICES)]
)
def test_draws_are_in_range_varied_and_repeatable(name: str, drawn: Any, choices: Any) -> None:
    sample = MODELS[name].sample
    draws = [sample(stream(3, "many", k), {}) for k in range(400)]
    assert draws[5] == sample(stream(3, "many", 5), {})
    for field, (low, high) in drawn.items():
        values = np.array([d[field] for d in draws])
        assert low <= values.min() and values.max() <= high
        assert np.ptp(values) > 0.9 * (high - low)
    for field, allowed in choices.items():
        assert {d[field] for d in draws} == set(allowed)


@pytest.mark.parametrize(("name", "module"), [("deer", deer), ("person", person)])
def test_draws_show_every_shape_and_are_json_and_repeatable(name: str, module: Any) -> None:
    sample = MODELS[name].sample
    draws = [sample(stream(k, "s"), {}) for k in range(200)]
    shapes = {(pose, variant) for pose in module.DRAWN_POSES for variant in module.VARIANTS[pose]}
    assert {(d["pose"], d["variant"]) for d in draws} == shapes
    assert json.loads(json.dumps(draws)) == draws
    assert sample(stream(1, "s"), {}) == draws[1]


BAD_OPTIONS: dict[str, list[tuple[dict[str, object], str]]] = {
    "boar": [
        ({"pose": "sitting"}, "boar model, option pose: found 'sitting'; expected one of standing, walking, rooting"),
        ({"shoulder_height_m": 9}, "option shoulder_height_m: found 9; expected a number from 0.2 to 1.3"),
        ({"colour": "grey"}, "option colour: found 'grey'; expected options pose, variant"),
    ],
    "car": [
        ({"length": 4.4}, r"option length: found 4.4; expected options .*length_m"),
        ({"length_m": -1}, r"option length_m: found -1; expected a number from 3 to 6.5"),
        ({"body": "coupe"}, r"option body: found 'coupe'; expected one of saloon, hatchback, suv, estate, van"),
        ({"exhausts": True}, r"option exhausts: found True"),
        ({"colour": 3}, r"option colour: found 3"),
        ({"time_of_day": "noon"}, r"option time_of_day: found 'noon'; expected one of night, day, dusk, dawn"),
    ],
    "deer": [
        ({"pose": "sitting"}, r"option pose: found 'sitting'; expected one of standing, walking, grazing, lying"),
        ({"antlers": "big"}, r"option antlers: found 'big'; expected true, false"),
        ({"antlers": 1}, r"option antlers: found 1"),
        ({"shoulder_height_m": 9}, r"option shoulder_height_m: found 9; expected a number from 0.4 to 1.6"),
        (
            {"shoulder_height_m": 1, "age": "young"},
            r"option shoulder_height_m: found 1; expected a number from 0.25 to",
        ),
        ({"pose": {"lying": 1, "digging": 1}}, r"option pose: found 'digging'; expected one of standing, walking"),
        ({"colour": "red"}, r"option colour: found 'red'; expected options pose, antlers"),
    ],
    "drone": [
        ({"size": 0.4}, r"option size: found 0.4; expected options size_m"),
        ({"size_m": -1}, r"option size_m: found -1; expected a number from 0.05 to 5"),
        ({"layout": "y"}, r"option layout: found 'y'; expected one of x, h, plus, deadcat"),
        ({"body": 3}, r"option body: found 3"),
        ({"blades": True}, r"option blades: found True"),
        ({"propellers": "fast"}, r"option propellers: found 'fast'; expected one of still, spinning"),
        ({"propeller_angle_deg": "fast"}, r"option propeller_angle_deg: found 'fast'; expected an angle"),
        ({"propeller_angle_deg": [1, 2, 3]}, r"option propeller_angle_deg: found \[1, 2, 3\]"),
    ],
    "person": [
        (
            {"pose": "flying"},
            r"person model, option pose: found 'flying'; expected one of standing, walking, sitting, lying",
        ),
        (
            {"pose": "walking", "variant": "knees-up"},
            r"option variant: found 'knees-up'; expected variants of the pose",
        ),
        ({"pose": "sitting", "arms": "pockets"}, r"option arms: found 'pockets'; expected for a sitting person one of"),
        ({"headwear": "crown"}, r"option headwear: found 'crown'; expected one of none, beanie, cap, hood, helmet"),
        ({"backpack": 1}, r"option backpack: found 1; expected true or false"),
        ({"height_m": 3}, r"option height_m: found 3; expected a number from 1.4 to 2.1"),
        ({"height_m": 3, "age": "child"}, r"option height_m: found 3; expected a number from 0.8 to 1.5"),
        ({"age": "old"}, r"option age: found 'old'; expected one of adult, child"),
        ({"pose": {"lying": 1, "flying": 2}}, r"option pose: found 'flying'; expected one of standing"),
        ({"pose": {"lying": -1}}, r"option pose.lying: found -1; expected a number from 0"),
        ({"pose": {"lying": 0}}, r"option pose: found \{'lying': 0\}; expected a weight above 0"),
        ({"pose": "lying", "arms": "phone"}, r"option arms: found 'phone'; expected for a lying person one of natural"),
        ({"colour": "red"}, r"option colour: .*expected options pose, variant"),
    ],
}


@pytest.mark.parametrize(
    ("name", "options", "match"), [(n, *case) for n, cases in BAD_OPTIONS.items() for case in cases]
)
def test_bad_options_name_the_option_and_what_was_expected(name: str, options: dict[str, object], match: str) -> None:
    with pytest.raises(ModelError, match=match):
        MODELS[name].sample(stream(0, "b"), options)


@pytest.mark.parametrize(
    ("name", "number", "size", "choice"),
    [
        ("boar", "shoulder_height_m", 0.7, "pose"),
        ("car", "length_m", 4.5, "state"),
        ("deer", "shoulder_height_m", 0.7, "pose"),
        ("drone", "size_m", 0.5, "layout"),
        ("person", "height_m", 1.6, "pose"),
    ],
)
def test_no_model_takes_what_is_neither_number_nor_range_nor_choice(
    name: str, number: str, size: float, choice: str
) -> None:
    wrong = [(number, value) for value in (float("nan"), True, [size, 0.99 * size], [size])]
    for option, value in [*wrong, (choice, [])]:
        with pytest.raises(ModelError, match=rf"option {option}: found {re.escape(repr(value))}; expected"):
            MODELS[name].sample(stream(0, "b"), {option: value})


BAD_PARAMS: dict[str, list[tuple[dict[str, object], str]]] = {
    "boar": [
        ({"build": "calf"}, "parameter build: found 'calf'; expected one of yearling"),
        ({"phase": 2.0, "pose": "walking"}, r"parameter phase: found 2\.0; expected a number from 0 to 1"),
    ],
    "car": [
        ({"length_m": 0.0}, "parameter length_m: found 0.0"),
        ({"body": None}, "parameter body: found None"),
        ({"sunroof": 1}, "parameter sunroof: found 1"),
        ({"wheels": 4}, "parameter wheels: found 4; expected parameters"),
    ],
    "deer": [
        ({"pose": "flying"}, "parameter pose"),
        ({"pose": "lying", "variant": "left-fore"}, "parameter variant: found 'left-fore'; expected one of alert"),
        ({"antlers": True}, "parameter antlers"),
        ({"shoulder_height_m": float("nan")}, "parameter shoulder_height_m: found nan"),
        ({"neck_turn_rad": 3.0}, "parameter neck_turn_rad"),
        ({"mirror": 1}, "parameter mirror"),
        ({"legs": 5}, "parameter legs"),
    ],
    "drone": [
        ({"size_m": 0.0}, "parameter size_m: found 0.0"),
        ({"layout": None}, "parameter layout: found None"),
        ({"propeller_angle_deg": [0, 0, 0]}, "four angles"),
        ({"colour": 1}, "parameter colour: found 1; expected parameters size_m"),
        ({"propellers": "off"}, "parameter propellers: found 'off'"),
    ],
    "person": [
        ({"pose": "flying"}, "parameter pose"),
        ({"pose": "sitting", "variant": "contact"}, "parameter variant: found 'contact'; expected one of seat"),
        ({"pose": "sitting", "arms": "pockets"}, "parameter arms"),
        ({"height_m": float("nan")}, "parameter height_m: found nan"),
        ({"height_m": 1.7, "age": "child"}, "parameter height_m: found 1.7; expected a number from 0.8 to 1.5"),
        ({"phase": 0.5}, "parameter phase: found 0.5; expected none for a standing person"),
        ({"pose": "walking", "phase": 1.5}, "parameter phase: found 1.5"),
        ({"head_turn_rad": 3.0}, "parameter head_turn_rad"),
        ({"mirror": 1}, "parameter mirror"),
        ({"legs": 3}, "parameter legs"),
    ],
}


@pytest.mark.parametrize(("name", "params", "match"), [(n, *case) for n, cases in BAD_PARAMS.items() for case in cases])
def test_bad_params_name_the_parameter(name: str, params: dict[str, object], match: str) -> None:
    with pytest.raises(ModelError, match=match):
        MODELS[name].build({**BASE[name], **params})


@pytest.mark.parametrize(("name", "missing"), [("car", "body"), ("drone", "legs")])
def test_missing_params_are_named(name: str, missing: str) -> None:
    with pytest.raises(ModelError, match=f"parameter {missing}: is missing"):
        MODELS[name].build({k: v for k, v in BASE[name].items() if k != missing})
