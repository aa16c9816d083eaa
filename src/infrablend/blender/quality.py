"""How many samples a pixel gets. No Blender needed to read this."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Sampling:
    """How Cycles samples a pixel.

    Attributes:
        samples: Per pixel; with a threshold, at most.
        adaptive_threshold: Noise at which a pixel is left alone; 0 switches adaptive sampling off.
        adaptive_min_samples: Before the first look at the noise; Cycles looks at every 16th sample only.
        pattern: Cycles' name of the sample sequence; AUTOMATIC is Blender's own choice.
    """

    samples: int
    adaptive_threshold: float = 0.0
    adaptive_min_samples: int = 0
    pattern: str = "AUTOMATIC"


# `quality: matched`. The inside of a body is smooth and done after 16 samples, its outline is not. `make bench` holds
# this against 2,048 samples; docs/explanation/quality.md lists what was tried.
MATCHED = Sampling(128, 0.006, 8, "TABULATED_SOBOL")


def sampling_for(samples: int) -> Sampling:
    """Return the sampling of a scene: a fixed number, or for 0 the fewest within the error bars."""
    return Sampling(samples) if samples else MATCHED
