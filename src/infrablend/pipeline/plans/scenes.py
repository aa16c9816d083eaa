"""The number of scenes per background of a recipe with `configurations: auto`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from infrablend.config.recipe import AUTO, Recipe
from infrablend.core.capture import Capture
from infrablend.core.dataset import ImageRecord

WANTED_OBJECTS = 2000
"""Objects to train on that a run asks for, at least, of each entry with the first entry's class: some find no place."""
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
        rarest: The same for the entry of `objects` that adds the fewest: entries differ in look, and a detector has to
            see enough of each.
        backgrounds: Number of backgrounds that were counted.
        split: Split that these are all in; empty for all backgrounds of the dataset.
    """

    number: int
    category: str
    per_scene: float
    rarest: float
    backgrounds: int
    split: str

    def describe(self) -> str:
        """Return the choice in words."""
        scenes = f"{self.number} scene{'s' if self.number > 1 else ''}"
        objects = f"about {self.number * self.per_scene:,.0f} objects of class {self.category}"
        text = f"{scenes} of each of {self.backgrounds:,} backgrounds, {objects}"
        if self.split:
            text = f"{scenes} of each background, {objects} in the {self.backgrounds:,} backgrounds of {self.split}"
        if self.rarest < self.per_scene:
            text += f", {self.number * self.rarest:,.0f} or more by each of their entries"
        if self.number == MOST_SCENES and self.number * self.rarest < WANTED_OBJECTS:
            text += f", fewer than {WANTED_OBJECTS:,}, as {MOST_SCENES} scenes are the most"
        return f"{text} (configurations: {AUTO})"


def scenes_fact(request: Mapping[str, object]) -> list[tuple[str, str]]:
    """Return what a run's request says of the choice (`RunPlan.request`), with its name; empty without `auto`."""
    return [("scenes", str(text)) for name, text in request.items() if name == CHOICE]


def choose_scenes(recipe: Recipe, classes: Sequence[str], usable: Sequence[ImageRecord]) -> Scenes:
    """Return the smallest number of scenes per background that asks for `WANTED_OBJECTS`.

    Args:
        recipe: Recipe with `configurations: auto`.
        classes: Class of each entry of the recipe's `objects`.
        usable: All backgrounds of the dataset that a run can use; those of train count where there are any.
    """
    of_train = [image for image in usable if image.split == _TRAIN]
    counted = of_train or usable
    by_entry = _means_of_first(recipe, classes, [image.capture for image in counted])
    split = _TRAIN if of_train else ""
    return Scenes(_number(by_entry), classes[0], math.fsum(by_entry), _rarest(by_entry), len(counted), split)


def about_scenes(recipe: Recipe, pictures: int) -> int:
    """Return the scenes per background where no more is known of the backgrounds than the number of those to count."""
    if recipe.configurations != AUTO:
        return recipe.configurations
    classes = [o.category or o.model for o in recipe.objects]
    return _number(_means_of_first(recipe, classes, [Capture()] * pictures))


def _means_of_first(recipe: Recipe, classes: Sequence[str], pictures: Sequence[Capture]) -> list[float]:
    """Return, for each entry with the first entry's class, the mean number of its objects in one scene of pictures."""
    kinds = [kind for kind, name in zip(recipe.objects, classes, strict=True) if name == classes[0]]
    return [(1 - recipe.empty_share) * math.fsum(map(kind.mean_count, pictures)) for kind in kinds]


def _rarest(by_entry: Sequence[float]) -> float:
    return min((mean for mean in by_entry if mean), default=0.0)


def _number(by_entry: Sequence[float]) -> int:
    """Return the number of scenes for the mean numbers of objects in one scene of each background, by entry."""
    rarest = _rarest(by_entry)
    return min(MOST_SCENES, math.ceil(WANTED_OBJECTS / rarest)) if rarest else 1
