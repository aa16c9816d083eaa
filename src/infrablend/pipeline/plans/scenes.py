"""The number of scenes per background of a recipe with `configurations: auto`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from infrablend.config.recipe import AUTO, Recipe
from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord

WANTED_OBJECTS = 2000
"""Objects of the first object's class that a run asks for to train on, at least: some find no place."""
MOST_SCENES = 16
"""Most scenes per background: more show the same few backgrounds again and again."""
CHOICE = "configurations"
"""Name of the choice in a run's request."""
_TRAIN = "train"


@dataclass(frozen=True)
class Scenes:
    """How many scenes a run makes of each background, and why.

    Attributes:
        number: Scenes per background.
        category: Class of the objects that were counted.
        per_scene: Mean number of them in one scene of each counted background, before places are looked for.
        backgrounds: Number of backgrounds that were counted.
        split: Split that these are all in; empty for all backgrounds of the dataset.
    """

    number: int
    category: str
    per_scene: float
    backgrounds: int
    split: str

    def describe(self) -> str:
        """Return the choice in words."""
        scenes = f"{self.number} scene{'s' if self.number > 1 else ''}"
        objects = f"about {self.number * self.per_scene:,.0f} objects of class {self.category}"
        text = f"{scenes} of each of {self.backgrounds:,} backgrounds, {objects}"
        if self.split:
            text = f"{scenes} of each background, {objects} in the {self.backgrounds:,} backgrounds of {self.split}"
        if self.number == MOST_SCENES and self.number * self.per_scene < WANTED_OBJECTS:
            text += f", fewer than {WANTED_OBJECTS:,}, as {MOST_SCENES} scenes are the most"
        return f"{text} (configurations: {AUTO})"


def scenes_fact(request: Mapping[str, object]) -> list[tuple[str, str]]:
    """Return what a run's request says of the choice (`RunPlan.request`), with its name; empty without `auto`."""
    return [("scenes", str(text)) for name, text in request.items() if name == CHOICE]


def choose_scenes(recipe: Recipe, classes: Sequence[str], usable: Sequence[ImageRecord]) -> Scenes:
    """Return the number of scenes per background that comes nearest to `WANTED_OBJECTS`.

    Args:
        recipe: Recipe with `configurations: auto`.
        classes: Class of each entry of the recipe's `objects`.
        usable: All backgrounds of the dataset that a run can use; those of train count where there are any.
    """
    of_train = [image for image in usable if image.split == _TRAIN]
    counted = of_train or usable
    per_scene = math.fsum(_mean_of_first(recipe, classes, image.capture) for image in counted)
    split = _TRAIN if of_train else ""
    return Scenes(_number(per_scene), classes[0], per_scene, len(counted), split)


def about_scenes(recipe: Recipe, pictures: int) -> int:
    """Return the scenes per background where no more is known of the backgrounds than the number of those to count."""
    if recipe.configurations != AUTO:
        return recipe.configurations
    return _number(pictures * _mean_of_first(recipe, [o.category or o.model for o in recipe.objects], Capture()))


def _mean_of_first(recipe: Recipe, classes: Sequence[str], picture: Capture) -> float:
    """Return the mean number of objects of the first object's class in a picture."""
    kinds = [kind for kind, name in zip(recipe.objects, classes, strict=True) if name == classes[0]]
    return (1 - recipe.empty_share) * math.fsum(kind.mean_count(picture) for kind in kinds)


def _number(per_scene: float) -> int:
    """Return the number of scenes for a mean number of objects in one scene of each background."""
    return min(MOST_SCENES, math.ceil(WANTED_OBJECTS / per_scene)) if per_scene else 1
