"""The options and parts of models as a form, without a browser."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from infrablend.assets.catalogue import list_models, load_model
from infrablend.config.loading import list_recipes, load_recipe
from infrablend.core.rng import stream
from infrablend.errors import RecipeError
from infrablend.studio.object_form import (
    OptionField,
    choice_of,
    chosen_of,
    count_of,
    fits_choice,
    model_problems,
    options_of,
    parts_of,
    range_of_ends,
    weights_of,
    with_temperature,
    with_value,
)


@pytest.mark.parametrize("name", list_models())
def test_every_value_that_the_form_offers_is_one_of_the_model(name: str) -> None:
    model, options = load_model(name), options_of(name)
    assert {o.name for o in options} == set(model.options)
    for option in options:
        given = [option.values[:1], [option.values[0], option.values[-1]]] if option.kind == "choice" else []
        for value in option.values:
            if option.name != "exhausts":
                model.sample(stream(0, "x"), {option.name: value})
        if option.several:
            model.sample(stream(0, "x"), {option.name: list(option.values)})
        if option.weighted:
            model.sample(stream(0, "x"), {option.name: dict.fromkeys(option.values, 1.0)})
        assert given or option.kind != "choice"


def test_the_kinds_of_options_follow_from_their_words() -> None:
    deer = {o.name: o for o in options_of("deer")}
    pose = deer["pose"]
    assert pose.values == ("standing", "walking", "grazing", "lying", "running", "sleeping")
    assert (pose.several, pose.weighted) == (True, True)
    assert deer["antlers"].values == (True, False, "none", "hard", "velvet")
    assert not deer["antlers"].several
    assert deer["bend_deg"].kind == "range"
    person = {o.name: o for o in options_of("person")}
    variant = person["variant"]
    assert variant.weighted and {"upright", "back-spread", "heels", "recovery"} < set(variant.values)
    assert person["warm_ground"].kind == "yaml"
    assert person["age"].weighted
    assert {o.name: o for o in options_of("drone")}["blades"].values == (2, 3)


@pytest.mark.parametrize(
    ("given", "chosen"),
    [
        ("walking", {"walking": None}),
        (["walking", "lying"], {"walking": None, "lying": None}),
        ({"walking": 2.0, "lying": 1.0}, {"walking": 2.0, "lying": 1.0}),
    ],
)
def test_choices_are_read_and_written(given: Any, chosen: dict[str, float | None]) -> None:
    assert chosen_of(given) == chosen
    assert choice_of(chosen) == given


def test_numbers_of_objects_have_weights() -> None:
    assert weights_of({"values": [0, 0, 2], "weights": None}) == {0: 2.0, 1: 0.0, 2: 1.0, 3: 0.0, 4: 0.0}
    assert weights_of({"values": [1], "weights": [0.5]}) == {0: 0.0, 1: 0.5, 2: 0.0, 3: 0.0}
    assert count_of({0: 2.0, 1: None, 2: 1.0, 3: 0.0}) == {"values": [0, 2], "weights": [2.0, 1.0]}
    with pytest.raises(RecipeError, match="not all 0"):
        load_recipe("drone-sky", {"objects.0.count": count_of({0: None, 1: 0.0})})


def test_half_given_weights_and_ends_are_completed() -> None:
    assert choice_of({"a": 2.0, "b": None}) == {"a": 2.0, "b": 1.0}
    assert choice_of({}) is None
    assert range_of_ends(None, None) is None
    assert range_of_ends(1.0, None) == range_of_ends(1.0, 1.0) == range_of_ends(None, 1.0) == 1.0
    assert range_of_ends(1.0, 2.0) == [1.0, 2.0]


def test_the_inputs_show_only_values_that_they_have() -> None:
    option = OptionField("antlers", "choice", "", (True, "hard"))
    assert fits_choice(option, True) and fits_choice(option, ["hard"])
    assert not fits_choice(option, 1) and not fits_choice(option, ["soft"]) and not fits_choice(option, None)


def test_a_temperature_leaves_the_rest_of_a_part() -> None:
    parts = {"motor": {"delta_t_k": [1, 2], "emissivity": [0.9, 0.9]}, "arm": {"delta_t_k": [1, 2], "emissivity": None}}
    assert with_temperature(parts, "motor", None)["motor"] == {"emissivity": [0.9, 0.9]}
    assert "arm" not in with_temperature(parts, "arm", None)
    assert with_temperature({}, "esc", (3, 4)) == {"esc": {"delta_t_k": [3, 4]}}
    assert with_value({"a": 1}, "a", None) == {}
    assert next(p.name for p in parts_of("bird")) == "*"


@pytest.mark.parametrize("name", list_recipes())
def test_shipped_recipes_have_no_problem_with_their_models(name: str) -> None:
    assert model_problems(load_recipe(name)) == []


def test_every_wrong_option_and_part_is_named_in_its_field(tmp_path: Path) -> None:
    settings = {"objects.0.options": {"layout": "z", "size_m": 900}, "objects.0.parts": {"tail": {"delta_t_k": 3}}}
    problems = model_problems(load_recipe("hit-uav-drone", settings))
    assert [p.where for p in problems] == [
        "objects.0.options.layout",
        "objects.0.options.size_m",
        "objects.0.parts.tail",
    ]
    nothing = load_recipe("hit-uav-drone", {"objects.0.model": str(tmp_path / "none.yaml")})
    assert [p.where for p in model_problems(nothing)] == ["objects.0.model"]
    assert json.dumps([p.to_json() for p in problems])
