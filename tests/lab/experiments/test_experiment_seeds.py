"""Several seeds of a training are spelled out: data, trainings, evaluations, comparisons, rows, ratios, scales."""

from __future__ import annotations

import pytest

from infrablend.errors import RecipeError
from infrablend.lab.experiments.definition import Experiment, Merge, Scale, parse_experiment
from infrablend.lab.experiments.prepare import repeat_seeds

TEXT = """
name: mine
title: t
description: d
sources: {real: {format: coco, title: Real}}
data: {few: {kind: merge, redraw: true, parts: [{of: real}]}, all: {kind: merge, parts: [{of: real}]}}
trainings:
  many: {data: few, seeds: {small: 3}}
  fixed: {data: all, seeds: {small: 3}, reseed: 5}
  control: {data: all}
evaluations:
  many: {training: many, data: real}
  other: {training: fixed, data: real}
  control: {training: control, data: real}
comparisons:
  means: {a: many, b: other}
  first: {a: many, b: other, seeds: 1}
  uneven: {a: control, b: many}
  spread: {a: many-1, b: many}
tables: [{title: T, evaluation: many, rows: [{title: One}, {title: All, evaluation: [many, control]}]}]
checks: [{text: C, ratio: [many, control], expect: report}, {text: D, ratio: [many, other], expect: report}]
only_at: {spread: [small], control: [small]}
"""


def at(scale: Scale) -> Experiment:
    return repeat_seeds(parse_experiment(TEXT, "mine.yaml"), scale)


def test_each_seed_has_its_training_evaluation_and_draw() -> None:
    spelled = at("small")
    assert list(spelled.trainings) == ["many", "many-1", "many-2", "fixed", "fixed-1", "fixed-2", "control"]
    assert [t.reseed for t in spelled.trainings.values()] == [0, 1, 2, 5, 6, 7, 0]
    assert [spelled.trainings[n].data for n in ("many", "many-2", "fixed-2")] == ["few", "few-2", "all"]
    redrawn = spelled.data["few-2"]
    assert isinstance(redrawn, Merge) and redrawn.reseed == 2 and list(spelled.data) == ["few", "few-1", "few-2", "all"]
    assert spelled.evaluations["other-1"].training == "fixed-1" and len(spelled.evaluations) == 7


def test_what_is_made_from_a_redrawn_item_is_redrawn_with_it() -> None:
    made = ", inserted: {kind: generate, of: few, recipe: hit-uav-people}"
    made += ", both: {kind: merge, parts: [{of: inserted}, {of: all}, {of: few}]}"
    made += ", halves: {kind: split, of: few, by: gap}, later: {kind: generate, of: few, recipe: hit-uav-cars}}"
    text = TEXT.replace("parts: [{of: real}]}}", "parts: [{of: real}]}" + made)
    trainings = "\n  chained: {data: both, seeds: {small: 3, smoke: 2}}"
    trainings += "\n  split: {data: halves, seeds: {small: 3}}\n  later: {data: later, seeds: 3}"
    text = text.replace("trainings:", "trainings:" + trainings)
    text = text.replace("only_at: {", "only_at: {later: [paper], ")
    experiment = parse_experiment(text, "mine.yaml")
    spelled = repeat_seeds(experiment, "small")
    assert spelled.inputs_of("inserted-1") == {"of": "few-1"}
    assert spelled.inputs_of("both-2") == {"part0": "inserted-2", "part1": "all", "part2": "few-2"}
    assert spelled.trainings["chained-2"].data == "both-2" and "all-1" not in spelled.data
    assert spelled.trainings["split-2"].data == "halves" and "halves-1" not in spelled.data
    assert "later-1" not in spelled.data, "no training at this scale needs it"
    paper = repeat_seeds(experiment, "paper")
    assert set(paper.data) == {*experiment.data, "few-1", "few-2", "later-1", "later-2"}
    assert not paper.at("later-1", "small") and paper.at("later-1", "paper")
    fewer = repeat_seeds(experiment, "smoke")
    assert "both-1" in fewer.data and "both-2" not in fewer.data and not fewer.at("chained-2", "smoke")


def test_both_sides_of_a_comparison_or_ratio_have_as_many_seeds() -> None:
    spelled = at("small")
    found = {n: (c.a, c.b) for n, c in spelled.comparisons.items()}
    assert found["means"] == (("many", "many-1", "many-2"), ("other", "other-1", "other-2"))
    assert found["first"] == (("many",), ("other",))
    assert found["uneven"] == (("control",), ("many",))
    assert found["spread"] == (("many-1",), ("many",))
    assert [c.ratio for c in spelled.checks] == [(("many",), ("control",)), found["means"]]
    assert [r.evaluation for r in spelled.tables[0].rows] == [None, ("many", "many-1", "many-2", "control")]


def test_seeds_of_other_scales_are_left_out() -> None:
    spelled = at("smoke")
    assert not spelled.at("many-1", "smoke") and spelled.at("many-1", "small") and spelled.at("many", "smoke")
    assert spelled.comparisons["means"].a == ("many",) and spelled.only_at["control"] == ("small",)


def test_more_seeds_than_anybody_trains_are_refused() -> None:
    """Each is spelled out, so a slip of the finger would fill the memory."""
    with pytest.raises(RecipeError, match="1000"):
        parse_experiment(TEXT.replace("small: 3", "small: 2000000000", 1), "mine.yaml")
