"""Sampling settings of Cycles."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Sampling:
    """Sampling settings of Cycles.

    Attributes:
        samples: Samples per pixel; the maximum if sampling is adaptive.
        adaptive_threshold: Noise level at which sampling of a pixel stops; 0 switches adaptive sampling off.
        adaptive_min_samples: Samples before the first noise check; Cycles checks at every 16th sample only.
        pattern: Sample sequence as Cycles names it; AUTOMATIC is Blender's own choice.
    """

    samples: int
    adaptive_threshold: float = 0.0
    adaptive_min_samples: int = 0
    pattern: str = "AUTOMATIC"


# `quality: matched` for what `rendering.lattice` does not draw. The inside of a body is smooth and needs 16 samples,
# its outline needs more: docs/explanation/quality.md lists the alternatives.
MATCHED = Sampling(64, 0.006, 8, "TABULATED_SOBOL")


def sampling_for(samples: int) -> Sampling:
    """Return the sampling for a fixed number of samples; 0 selects `MATCHED`."""
    return Sampling(samples) if samples else MATCHED
