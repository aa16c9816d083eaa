"""Random streams keyed by run seed, frame and stage, independent of workers and order."""

from __future__ import annotations

import hashlib

import numpy as np


def stream(seed: int, *key: str | int) -> np.random.Generator:
    """Return the generator of one (run seed, frame id, stage, ...).

    The same seed and key give the same numbers on every machine, for any worker count and order.

    Args:
        seed: The run's seed, any integer; 0 is a seed like any other.
        key: Purpose of the numbers, e.g. `("train/0_60_30_0_00001_c0", "placement")`.
    """
    text = "\x1f".join([str(int(seed)), *(f"{type(k).__name__}:{k}" for k in key)])
    digest = hashlib.sha256(text.encode()).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "big")))


def integer_seed(seed: int, *key: str | int) -> int:
    """Return a non-negative integer below 2**31, derived as in `stream`."""
    return int(stream(seed, *key).integers(0, 2**31))
