"""How well classifiers tell two sets of objects apart."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.rng import stream
from infrablend.errors import MissingDependencyError
from infrablend.realism.features import FEATURES, Measured

Kind = Literal["logistic", "boosting"]
FOLDS = 5
BOOTSTRAPS = 500


@dataclass(frozen=True, eq=False)
class Score:
    """One comparison.

    Attributes:
        auc: 0.5 if the two cannot be told apart, 1 if always; of predictions by models that have not seen the fold.
        interval: 2.5 and 97.5 % quantile over resampled backgrounds.
        predictions: (2n,) log odds of being the second kind, real ones first.
        n: Pairs.
    """

    auc: float
    interval: tuple[float, float]
    predictions: NDArray[np.float64]
    n: int

    def __str__(self) -> str:
        return f"{self.auc:.3f} [{self.interval[0]:.3f}, {self.interval[1]:.3f}]"


def require_sklearn() -> None:
    """Refuse early and clearly where the extra is missing.

    Raises:
        MissingDependencyError: scikit-learn is not installed.
    """
    try:
        importlib.import_module("sklearn")
    except ImportError as error:
        raise MissingDependencyError(
            "scikit-learn is not installed, and the classifiers of `infrablend realism` are made with it. "
            'Install the extra: pip install "infrablend[realism]"'
        ) from error


def score(real: Sequence[Measured], other: Sequence[Measured], kind: Kind) -> Score:
    """AUC of five folds over whole backgrounds."""
    x = np.array([m.features for m in (*real, *other)], np.float64)
    y = np.repeat([0, 1], [len(real), len(other)])
    groups = group_numbers([*real, *other])
    predictions = out_of_fold(x, y, groups, kind)
    return Score(auc(y, predictions), bootstrap(y, predictions, groups), predictions, len(real))


def group_numbers(objects: Sequence[Measured]) -> NDArray[np.int64]:
    """(n,) the background of each object, counted from 0."""
    names = {g: i for i, g in enumerate(sorted({m.group for m in objects}))}
    return np.array([names[m.group] for m in objects], np.int64)


def group_folds(groups: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Return (indices to train on, indices to test on), five times, no group on both sides."""
    from sklearn.model_selection import GroupKFold

    yield from GroupKFold(FOLDS).split(groups, groups=groups)


def out_of_fold(
    x: NDArray[np.float64], y: NDArray[np.int64], groups: NDArray[np.int64], kind: Kind
) -> NDArray[np.float64]:
    """(n,) log odds of class 1, each by a model that saw no object of the same group."""
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
    """Area under the receiver operating characteristic: how often a 1 is above a 0, ties counting half."""
    _, place = np.unique(predictions, return_inverse=True)
    return _auc_by_place(y, place, np.ones(len(y)) if weight is None else weight)


def _auc_by_place(y: NDArray[np.int64], place: NDArray[np.int64], weight: NDArray[np.float64]) -> float:
    ones, zeros = np.bincount(place, weight * y), np.bincount(place, weight * (1 - y))
    below = np.cumsum(zeros) - zeros / 2
    return float((ones * below).sum() / (ones.sum() * zeros.sum()))


def bootstrap(y: NDArray[np.int64], predictions: NDArray[np.float64], groups: NDArray[np.int64]) -> tuple[float, float]:
    """2.5 and 97.5 % quantile of the AUC over backgrounds drawn with replacement."""
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
    """Return the logistic classifier's coefficients for standardised features, fitted on all pairs."""
    from sklearn.linear_model import LogisticRegression
    from sklearn.preprocessing import StandardScaler

    x = StandardScaler().fit_transform(np.array([m.features for m in (*real, *other)], np.float64))
    model = LogisticRegression(max_iter=2000).fit(x, np.repeat([0, 1], [len(real), len(other)]))
    return dict(zip(FEATURES, (float(w) for w in model.coef_[0]), strict=True))
