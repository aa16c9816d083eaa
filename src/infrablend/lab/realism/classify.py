"""Classifiers that separate two populations of objects, scored by cross-validated AUC."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.rng import stream
from infrablend.errors import MissingDependencyError
from infrablend.lab.realism.features import FEATURES, Measured

Kind = Literal["logistic", "boosting"]
FOLDS = 5
BOOTSTRAPS = 500


@dataclass(frozen=True, eq=False)
class Score:
    """Score of one comparison.

    Attributes:
        auc: AUC of the out-of-fold predictions; 0.5 is chance, 1 perfect separation.
        interval: 2.5 and 97.5 % quantile of the AUC over resampled backgrounds.
        predictions: (2n,) log odds of belonging to the second population; the real objects come first.
    """

    auc: float
    interval: tuple[float, float]
    predictions: NDArray[np.float64]


def require_sklearn() -> None:
    """Check that scikit-learn can be imported.

    Raises:
        MissingDependencyError: scikit-learn is not installed.
    """
    try:
        importlib.import_module("sklearn")
    except ImportError as error:
        raise MissingDependencyError(
            "scikit-learn is not installed; the classifiers of `infrablend realism` need it. "
            'Install the extra: pip install "infrablend[realism]"'
        ) from error


def score(real: Sequence[Measured], other: Sequence[Measured], kind: Kind) -> Score:
    """Score a classifier in five folds; objects on one background share a fold."""
    x = np.array([m.features for m in (*real, *other)], np.float64)
    y = np.repeat([0, 1], [len(real), len(other)])
    groups = group_numbers([*real, *other])
    predictions = out_of_fold(x, y, groups, kind)
    return Score(auc(y, predictions), bootstrap(y, predictions, groups), predictions)


def group_numbers(objects: Sequence[Measured]) -> NDArray[np.int64]:
    """Return the (n,) numbers of the objects' backgrounds, from 0."""
    names = {g: i for i, g in enumerate(sorted({m.group for m in objects}))}
    return np.array([names[m.group] for m in objects], np.int64)


def group_folds(groups: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield (training indices, test indices) of five folds; no group is on both sides."""
    from sklearn.model_selection import GroupKFold

    yield from GroupKFold(FOLDS).split(groups, groups=groups)


def out_of_fold(
    x: NDArray[np.float64], y: NDArray[np.int64], groups: NDArray[np.int64], kind: Kind
) -> NDArray[np.float64]:
    """Return the (n,) log odds of class 1, each from a model trained without the object's group."""
    from sklearn.ensemble import GradientBoostingClassifier
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    predictions = np.zeros(len(y))
    for train, test in group_folds(groups):
        model = (
            make_pipeline(StandardScaler(), LogisticRegression(max_iter=2000))
            if kind == "logistic"
            else GradientBoostingClassifier(random_state=0)
        )
        model.fit(x[train], y[train])
        predictions[test] = model.decision_function(x[test])
    return predictions


def auc(y: NDArray[np.int64], predictions: NDArray[np.float64], weight: NDArray[np.float64] | None = None) -> float:
    """Return the area under the ROC curve: the probability that a 1 ranks above a 0, ties counting half."""
    _, place = np.unique(predictions, return_inverse=True)
    return _auc_by_place(y, place, np.ones(len(y)) if weight is None else weight)


def _auc_by_place(y: NDArray[np.int64], place: NDArray[np.int64], weight: NDArray[np.float64]) -> float:
    ones = np.bincount(place, weight * y)
    zeros = np.bincount(place, weight * (1 - y))
    below = np.cumsum(zeros) - zeros / 2
    return float((ones * below).sum() / (ones.sum() * zeros.sum()))


def bootstrap(y: NDArray[np.int64], predictions: NDArray[np.float64], groups: NDArray[np.int64]) -> tuple[float, float]:
    """Return the 2.5 and 97.5 % quantiles of the AUC over backgrounds drawn with replacement."""
    rng = stream(0, "bootstrap")
    count = int(groups.max()) + 1
    _, place = np.unique(predictions, return_inverse=True)
    found = []
    for _ in range(BOOTSTRAPS):
        weight = np.bincount(rng.integers(0, count, count), minlength=count)[groups].astype(np.float64)
        if weight[y == 0].any() and weight[y == 1].any():
            found.append(_auc_by_place(y, place, weight))
    low, high = np.percentile(found, [2.5, 97.5])
    return float(low), float(high)


def weights(real: Sequence[Measured], other: Sequence[Measured]) -> Mapping[str, float]:
    """Return the coefficients of a logistic regression on standardised features, fitted to all pairs."""
    from sklearn.linear_model import LogisticRegression
    from sklearn.preprocessing import StandardScaler

    x = StandardScaler().fit_transform(np.array([m.features for m in (*real, *other)], np.float64))
    model = LogisticRegression(max_iter=2000).fit(x, np.repeat([0, 1], [len(real), len(other)]))
    return dict(zip(FEATURES, (float(w) for w in model.coef_[0]), strict=True))
