"""Measure how far pictures of the lattice are from converged renders of Cycles, for shipped recipes.

    python bench/lattice.py --data HIT-UAV [--recipe hit-uav-cars ...] [--frames 12]

Prints a line per recipe and way: the lattice, and Cycles with 64 samples. In the physical look the lattice lacks the
light that surfaces send to each other, so its error does not fall with more samples. Errors are in levels of a picture
in which the objects of the frame span 120 levels, at all pixels that they cover, over even ground.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from quality import LEAST_SPAN_GREY, summary
from scenes import plan_of, spread
from variants import with_samples

from infrablend.core.render import PlacedScene, RenderResult
from infrablend.core.scene import SceneSpec
from infrablend.pipeline.compose.frame import FrameComposer
from infrablend.rendering.engine.renderer import BlenderRenderer
from infrablend.thermal.radiometry import band_radiance

RECIPES = ("hit-uav-drone", "hit-uav-drone-physical", "hit-uav-people", "hit-uav-cars", "deer-above")
REFERENCE_SAMPLES, CYCLES_SAMPLES = 1024, 64


def main() -> None:
    """Measure, and print a line per recipe and way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="HIT-UAV")
    parser.add_argument("--recipe", action="append", help="only this recipe; repeatable")
    parser.add_argument("--frames", type=int, default=12)
    given = parser.parse_args()
    for recipe in given.recipe or RECIPES:
        for way, found in errors_of(recipe, given.data, given.frames).items():
            shown = {k: round(v, 3) for k, v in {**summary(np.abs(found)), "bias": float(found.mean())}.items()}
            print(json.dumps({"recipe": recipe, "way": way, **shown}), flush=True)


def errors_of(recipe_name: str, data: Path, frames: int) -> dict[str, NDArray[np.float32]]:
    """Return the differences from the reference at all pixels of all frames, by the way of rendering."""
    with tempfile.TemporaryDirectory() as folder:
        work = spread(plan_of(data, recipe_name), frames, Path(folder))
    renderer = Recorder()
    composer = FrameComposer(work.settings, renderer)
    found: dict[str, list[NDArray[np.float32]]] = {"lattice": [], "cycles": []}
    for frame in work.frames:
        renderer.last = None
        composer.compose(frame)
        if (scene := renderer.last) is None:
            continue
        reference = renderer.render(with_samples(scene, REFERENCE_SAMPLES))
        where = reference.alpha > 0
        if not where.any():
            continue
        truth = over_ground(reference, scene.spec)
        scale = LEAST_SPAN_GREY / float(np.ptp(truth[where]))
        for way, samples in (("lattice", 0), ("cycles", CYCLES_SAMPLES)):
            made = over_ground(renderer.render(with_samples(scene, samples)), scene.spec)
            found[way].append((made - truth)[where] * scale)
    renderer.close()
    return {way: np.concatenate([np.zeros(0, np.float32), *values]) for way, values in found.items()}


class Recorder(BlenderRenderer):
    """Remembers the last scene."""

    last: PlacedScene | None = None

    def render(self, scene: PlacedScene) -> RenderResult:
        """Render a scene, see `BlenderRenderer`."""
        self.last = scene
        return super().render(scene)


def over_ground(result: RenderResult, spec: SceneSpec) -> NDArray[np.float32]:
    """Return the picture over even ground."""
    ground = 0.3 if spec.weather is None else float(band_radiance(spec.weather.ground_k))
    return np.asarray(result.radiance + (1 - result.alpha) * ground, np.float32)


if __name__ == "__main__":
    main()
