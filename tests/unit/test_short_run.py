"""Which cases of thinned tests the short run keeps."""

from __future__ import annotations

import itertools

from tests.short_run import covering


def test_cases_of_two_parameters_cover_every_value() -> None:
    cases = [{"format": f, "split": s} for f, s in itertools.product(range(12), "abc")]
    kept = [cases[n] for n in covering(cases)]
    assert len(kept) == 12
    assert {c["format"] for c in kept} == {*range(12)}
    assert {c["split"] for c in kept} == {*"abc"}


def test_cases_of_three_parameters_cover_every_pair() -> None:
    cases = [{"pose": p, "top": t, "size": s} for p, t, s in itertools.product("abcd", "xyz", (1, 2))]
    kept = [cases[n] for n in covering(cases)]
    assert len(kept) < len(cases) * 0.75
    for one, other in itertools.combinations(("pose", "top", "size"), 2):
        assert {(c[one], c[other]) for c in kept} == {(c[one], c[other]) for c in cases}


def test_a_single_parameter_is_not_thinned() -> None:
    cases = [{"pose": p} for p in range(9)]
    assert covering(cases) == {*range(9)}
