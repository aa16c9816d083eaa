"""From any damaged radiometric JPEG, readers return facts or raise one of our errors: no crash, no hang, no bomb."""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.flight_fuzzing import damage, exercise
from tests.flights import shot
from tests.fuzzing import make_outside

from infrablend.lab.world.rjpeg_writing import MAKERS, Maker


@pytest.mark.parametrize("maker", MAKERS)
@settings(max_examples=60)
@given(st.integers(0, 2**32))
def test_damaged_radiometric_files_are_read_or_named(maker: Maker, seed: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = shot(Path(folder) / "data" / "a.jpg", maker, elements=bool(seed % 2))
        data, done = damage(path.read_bytes(), seed)
        path.write_bytes(data)
        outcomes: Counter[str] = Counter()
        exercise(path, make_outside(Path(folder) / "outside"), outcomes)
        assert sum(outcomes.values()) == 4, done
