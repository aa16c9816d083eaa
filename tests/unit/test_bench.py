"""The arithmetic of the benchmark."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from infrablend.compositing.mapping import GreyMapping
from infrablend.core.render import RenderResult

BENCH = Path(__file__).parents[2] / "bench"


@pytest.fixture(autouse=True)
def bench_modules(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCH))


def render(radiance: list[list[float]], alpha: list[list[float]]) -> RenderResult:
    a = np.array(alpha, np.float32)
    return RenderResult((3, 2), (10, 8), np.array(radiance, np.float32), a, a[None].copy())


def test_mapping_is_stretched_until_the_object_spans_120_levels() -> None:
    from quality import stretched

    # Straight levels 0.2 and 0.6: the half-covered pixel's radiance is premultiplied.
    result = render([[0.2, 0.36, 0.0]], [[1.0, 0.6, 0.0]])
    wide, span = stretched(GreyMapping(50, 150), result)
    assert span == pytest.approx(120)
    assert (wide.bright - wide.dark) * 0.4 == pytest.approx(120)
    same, span = stretched(GreyMapping(0, 400), result)
    assert same == GreyMapping(0, 400)
    assert span == pytest.approx(160)


def test_covered_counts_every_pixel_with_any_coverage() -> None:
    from quality import covered

    where = covered(render([[0.1, 0.0]], [[1e-4, 0.0]]))
    assert where.shape == (8, 10)
    assert [tuple(p) for p in np.argwhere(where)] == [(2, 3)]


def test_extent_is_half_open() -> None:
    from boxes import extent

    mask = np.zeros((5, 6), np.bool_)
    mask[1:3, 2:5] = True
    assert extent(mask, (10, 20)).tolist() == [12, 21, 15, 23]
    assert extent(np.zeros((2, 2), np.bool_), (1, 1)).tolist() == [0, 0, 0, 0]


def test_memory_slope_is_per_100_frames_after_settling() -> None:
    from memory import SETTLING_FRAMES, Memory

    climbing = [1000.0] * SETTLING_FRAMES + [300 + 0.05 * n for n in range(450)]
    assert Memory(climbing, 0).slope_mb_per_100_frames == pytest.approx(5.0)


def test_bars_fail_on_missed_targets_and_non_numbers() -> None:
    from bench import BARS  # type: ignore[attr-defined]  # the module beside this one, not the folder

    bars = {bar.key: bar for bar in BARS}
    assert bars["speedup"].met(100.0)
    assert not bars["speedup"].met(99.9)
    assert bars["p99_error_grey"].met(4.0)
    assert not bars["p99_error_grey"].met(4.01)
    assert not any(bar.met(float("nan")) for bar in BARS)
