"""Conclusions of an experiment: whether a claim holds, computed from intervals and ratios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from infrablend.config.experiment import Check
from infrablend.pipeline.experiments.dataset_facts import class_key


def find_class(figures: Mapping[str, Any], category: str) -> str | None:
    """Return the name under which an evaluation lists a class, whatever its case and blanks, or None."""
    return next((n for n in figures if class_key(n) == class_key(category)), None)


def check_claim(
    check: Check,
    evaluations: Mapping[str, Any],
    comparisons: Mapping[str, Any],
    left_out: Mapping[str, str],
    *,
    verdict: bool = True,
) -> dict[str, Any]:
    """Return a claim with the numbers it rests on and `holds`: True, False, or None where that cannot be decided.

    Without `verdict` (a smoke run trains only a few steps) `holds` is always None.
    """
    claim: dict[str, Any] = {
        "text": check.text,
        "class": check.category,
        "metric": check.metric,
        "expect": check.expect,
        "holds": None,
    }
    if check.comparison is not None:
        return claim | _check_interval(check, comparisons, left_out, verdict)
    return claim | _check_ratio(check, evaluations, left_out, verdict)


def _check_interval(
    check: Check, comparisons: Mapping[str, Any], left_out: Mapping[str, str], verdict: bool
) -> dict[str, Any]:
    assert check.comparison is not None
    classes = comparisons.get(check.comparison, {}).get("classes", {})
    name = find_class(classes, check.category)
    found = None if name is None else classes[name].get(check.metric)
    if found is None or found.get("ci") is None:
        why = left_out.get(check.comparison, "not run yet, or no such class or figure")
        return {"comparison": check.comparison, "missing": why}
    low, high = found["ci"]
    holds = {
        "below": high < 0,
        "above": low > 0,
        "within": low <= 0 <= high,
        "not_below": high >= 0,
        "report": None,
    }[check.expect]
    return {
        "comparison": check.comparison,
        "difference": found["difference"],
        "ci": [low, high],
        "same_sign": found.get("same_sign"),
        "holds": holds if verdict else None,
    }


def _check_ratio(
    check: Check, evaluations: Mapping[str, Any], left_out: Mapping[str, str], verdict: bool
) -> dict[str, Any]:
    assert check.ratio is not None
    names = [e for side in check.ratio for e in side]
    found = {e: _figure(evaluations.get(e, {}), check) for e in names}
    means = [_mean([found[e] for e in side]) for side in check.ratio]
    head = {"ratio_of": [", ".join(side) for side in check.ratio], "least": check.least}
    if means[0] is None or means[1] is None:
        lacking = [e for e in names if found[e] is None]
        there = all(e in evaluations for e in lacking)
        why = "no such figure in the evaluation" if there else "not run yet"
        return {**head, "missing": next((left_out[e] for e in names if e in left_out), why)}
    if means[1] == 0:
        return {**head, "missing": "the second figure is 0"}
    ratio = means[0] / means[1]
    holds = None if check.least is None or not verdict else ratio >= check.least
    return {**head, "values": means, "ratio": round(ratio, 6), "holds": holds}


def _figure(evaluation: Mapping[str, Any], check: Check) -> float | None:
    if check.time is not None:
        evaluation = evaluation.get("strata", {}).get("time", {}).get(check.time, {})
    classes = evaluation.get("classes", {})
    name = find_class(classes, check.category)
    found: float | None = None if name is None else classes[name].get(check.metric)
    return found


def _mean(values: Sequence[float | None]) -> float | None:
    """Return the mean, or None if a value is missing."""
    known = [v for v in values if v is not None]
    return sum(known) / len(values) if len(known) == len(values) else None
