"""Protocols for the caller's own code in frames in memory: a sampler of scenes, a source of backgrounds, a look.

Worker processes import the classes of these objects by name, so they have to be defined in a module that can be
imported, not in a script or notebook. docs/how_to/in_memory.md has an example of each.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from infrablend.assets.model import ObjectModel
from infrablend.config.recipe import Recipe
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.render import PlacedScene, RenderResult
from infrablend.errors import ArgumentError
from infrablend.formats.pictures.images import Background, load_background
from infrablend.sampling.scene_sampler import RecipeSampler, sample_scene
from infrablend.sampling.site import FrameKey, Site

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class SceneRequest:
    """Everything that a sampler may use for the scene of a frame.

    Attributes:
        frame: Key of the frame: background, split, size, camera pitch, time.
        recipe: The recipe.
        models: The recipe's models, by the names used in the recipe.
        seed: Seed of the frame's random streams; `core.rng.stream(seed, frame.frame_id, "...")` makes one.
        site: The background: grey levels, labels and camera height.
    """

    frame: FrameKey
    recipe: Recipe
    models: Mapping[str, ObjectModel]
    seed: int
    site: Site

    def by_recipe(self) -> PlacedScene:
        """Return the scene that the recipe's distributions give."""
        return sample_scene(self.frame, self.recipe, self.models, self.seed, self.site)


@runtime_checkable
class SceneSampler(Protocol):
    """A sampler that decides what is where in a frame. The same request must give the same scene."""

    def sample(self, request: SceneRequest) -> PlacedScene:
        """Return the scene; `request.by_recipe()` returns the usual one, and `core.render.place` builds another."""
        ...


@runtime_checkable
class BackgroundSource(Protocol):
    """A source of backgrounds that are not a folder of a known format."""

    def dataset(self) -> Dataset:
        """Return the backgrounds with their metadata and labels. Called once, in the caller's process."""
        ...

    def load(self, image: ImageRecord) -> Pixels:
        """Return the (h, w) grey levels of a background, uint8 or uint16. Called in the workers."""
        ...


@dataclass(frozen=True, eq=False)
class LookRequest:
    """Everything that a look may use for the picture of a frame.

    Attributes:
        picture: (h, w) picture as the recipe composes it, uint8 or uint16.
        background: (h, w) background, of the same type.
        rendered: Radiance, alpha and coverage of the inserted objects, cropped to them.
        scene: The scene.
    """

    picture: Pixels
    background: Pixels
    rendered: RenderResult
    scene: PlacedScene


@runtime_checkable
class Look(Protocol):
    """A look that changes the finished picture. The same request must give the same picture."""

    def apply(self, request: LookRequest) -> Pixels:
        """Return the (h, w) picture, of the size and type of `request.picture`."""
        ...


@dataclass(frozen=True)
class Extensions:
    """The caller's own code; None for the recipe's way.

    Attributes:
        sampler: Decides what is where.
        backgrounds: Loads backgrounds.
        look: Changes the finished picture.
    """

    sampler: SceneSampler | None = None
    backgrounds: BackgroundSource | None = None
    look: Look | None = None

    def require_importable(self) -> None:
        """Check that worker processes can import the classes.

        Raises:
            ArgumentError: A class is defined in the script itself, or an object cannot be pickled.
        """
        for name in ("sampler", "backgrounds", "look"):
            value = getattr(self, name)
            if value is None:
                continue
            if type(value).__module__ == "__main__":
                raise ArgumentError(
                    f"{name}: {type(value).__name__} is defined in the script itself, which worker processes do not "
                    "import. Move the class to a module of its own and import it"
                )
            try:
                pickle.dumps(value)
            except Exception as error:
                raise ArgumentError(
                    f"{name}: {type(value).__name__} cannot be pickled ({error}), as worker processes need. Define the "
                    "class at the top level of a module, and keep open files and locks out of the object"
                ) from error

    def load(self, image: ImageRecord) -> Background:
        """Return the background of an image."""
        if self.backgrounds is None:
            return load_background(image.path, image.size_wh)
        pixels = self.backgrounds.load(image)
        if pixels.ndim != 2 or pixels.dtype not in (np.uint8, np.uint16):
            raise ArgumentError(
                f"{image.id}: load returned {pixels.shape} {pixels.dtype}, expected (h, w) uint8 or uint16"
            )
        deep = pixels.dtype == np.uint16
        return Background(Path(image.path), pixels, "I;16" if deep else "L", 16 if deep else 8, "PNG")

    def make_sampler(self, recipe: Recipe, models: Mapping[str, ObjectModel], seed: int) -> RecipeSampler:
        """Return what draws the scenes of a recipe."""
        if self.sampler is None:
            return RecipeSampler(recipe, models, seed)
        return _OwnSampler(self.sampler, recipe, models, seed)


class _OwnSampler(RecipeSampler):
    """The caller's own sampler of scenes; objects that nobody can see are moved as the recipe says."""

    def __init__(self, own: SceneSampler, recipe: Recipe, models: Mapping[str, ObjectModel], seed: int) -> None:
        super().__init__(recipe, models, seed)
        self._own = own

    def sample(self, frame: FrameKey, site: Site | None = None) -> PlacedScene:
        assert site is not None
        return self._own.sample(SceneRequest(frame, self._recipe, self._models, self._seed, site))


NO_EXTENSIONS: Extensions = Extensions()
