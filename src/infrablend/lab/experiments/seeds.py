"""Repeats the trainings of an experiment that have several seeds, with their data, evaluations and references.

`NAME` with three seeds becomes `NAME`, `NAME-1` and `NAME-2`, as if the file had spelled them out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from infrablend.lab.experiments.definition import Check, Comparison, Experiment, Merge, Row, Table, seed_names
from infrablend.lab.experiments.scales import SCALES, Scale


def repeat_seeds(experiment: Experiment, scale: Scale) -> Experiment:
    """Return the experiment with every training, evaluation and redrawn data item once per seed.

    A seed that only some scales have is limited to them. A name in a row of a table stands for the evaluations of all
    seeds. The two sides of a comparison or ratio have as many seeds as the evaluation with the fewest at the scale.
    """
    of_training = experiment.seeds_of_trainings()
    of_evaluation = experiment.seeds_of_evaluations()
    of_data = experiment.seeds_of_data()
    here = {n: experiment.trainings[e.training].seeds_at(scale) for n, e in experiment.evaluations.items()
            if e.training in experiment.trainings}  # fmt: skip
    data = {
        one: item.model_copy(update={"reseed": item.reseed + k}) if isinstance(item, Merge) else item
        for name, item in experiment.data.items()
        for k, one in enumerate(of_data[name])
    }
    trainings = {
        one: training.model_copy(update={"reseed": training.reseed + k, "data": _of_seed(training.data, k, of_data)})
        for name, training in experiment.trainings.items()
        for k, one in enumerate(of_training[name])
    }
    evaluations = {
        one: evaluation.model_copy(update={"training": _of_seed(evaluation.training, k, of_training)})
        for name, evaluation in experiment.evaluations.items()
        for k, one in enumerate(of_evaluation[name])
    }
    update = {
        "data": data,
        "trainings": trainings,
        "evaluations": evaluations,
        "comparisons": {n: _comparison(c, here) for n, c in experiment.comparisons.items()},
        "tables": tuple(_table(t, of_evaluation) for t in experiment.tables),
        "checks": tuple(_check(c, here) for c in experiment.checks),
        "only_at": _scales_of_seeds(experiment, of_training),
    }
    return experiment.model_copy(update=update)


def _scales_of_seeds(experiment: Experiment, of_training: Mapping[str, Sequence[str]]) -> dict[str, tuple[Scale, ...]]:
    """Return the scales of entries, with those of the trainings of further seeds.

    What needs a training that the scale lacks is left out with it.
    """
    only_at = dict(experiment.only_at)
    for name, training in experiment.trainings.items():
        for k, one in enumerate(of_training[name][1:], 1):
            scales = experiment.only_at.get(name, SCALES)
            only_at.setdefault(one, tuple(s for s in scales if training.seeds_at(s) > k))
    return only_at


def _of_seed(name: str, number: int, seeds: Mapping[str, Sequence[str]]) -> str:
    """Return the name of one seed of a training or data item; its own name if it has one seed."""
    names = seeds.get(name, (name,))
    return names[number] if len(names) > 1 else name


def _comparison(comparison: Comparison, seeds: Mapping[str, int]) -> Comparison:
    fewest = _fewest((*comparison.a, *comparison.b), seeds)
    count = fewest if comparison.seeds is None else min(fewest, comparison.seeds)
    return comparison.model_copy(update={"a": _names(comparison.a, count), "b": _names(comparison.b, count)})


def _table(table: Table, seeds: Mapping[str, Sequence[str]]) -> Table:
    return table.model_copy(update={"rows": tuple(_row(row, seeds) for row in table.rows)})


def _row(row: Row, seeds: Mapping[str, Sequence[str]]) -> Row:
    if row.evaluation is None:
        return row
    names = tuple(one for name in row.evaluation for one in seeds.get(name, (name,)))
    return row.model_copy(update={"evaluation": names})


def _check(check: Check, seeds: Mapping[str, int]) -> Check:
    if check.ratio is None:
        return check
    a, b = check.ratio
    count = _fewest((*a, *b), seeds)
    return check.model_copy(update={"ratio": (_names(a, count), _names(b, count))})


def _fewest(names: Iterable[str], seeds: Mapping[str, int]) -> int:
    return min(seeds.get(name, 1) for name in names)


def _names(names: Iterable[str], count: int) -> tuple[str, ...]:
    return tuple(one for name in names for one in seed_names(name, count))
