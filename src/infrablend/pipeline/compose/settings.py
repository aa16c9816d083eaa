"""Settings of frame workers: what a run hands to each of them, and what each step takes from the recipe."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from infrablend.annotation.merge import MergeSettings
from infrablend.config.recipe import Recipe
from infrablend.pipeline.compose.extensions import NO_EXTENSIONS, Extensions


@dataclass(frozen=True)
class FrameSettings:
    """Settings that all workers of a run share; picklable.

    Attributes:
        out: Folder of the run; None for frames in memory.
        data_root: Folder of the backgrounds as it was given; their paths are recorded relative to it.
        recipe_json: The recipe.
        seed: The run's seed.
        renderer: Name in `rendering.RENDERERS`.
        device: Device that Cycles computes on.
        pin_cores: Whether each worker keeps to a processor core of its own.
        levels: Darkest and brightest level that the dataset uses; for `appearance.mode: physical` and the sensor.
        ignored: The source's own names of the categories that mark ignore regions.
        extensions: The caller's own sampler, backgrounds and look.
        run: Identity of the run, for the records of its frames.
    """

    out: Path | None
    data_root: Path
    recipe_json: str
    seed: int
    renderer: str = "blender"
    device: str = "cpu"
    pin_cores: bool = True
    levels: tuple[float, float] | None = None
    ignored: tuple[str, ...] = ()
    extensions: Extensions = NO_EXTENSIONS
    run: str = ""


def merge_settings(recipe: Recipe) -> MergeSettings:
    """Return the kinds of labels on an image.

    Ignore regions stay in the record: each format leaves them out, or not, when it is written.
    """
    return MergeSettings(recipe.labels.mode, recipe.labels.keep_categories, recipe.labels.remove_covered)
