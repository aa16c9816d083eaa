"""A sampler, a source of backgrounds and a look of your own; `use_them.py` uses them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from infrablend.api import LookRequest, SceneRequest
from infrablend.core.capture import Capture
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.render import PlacedScene


@dataclass(frozen=True)
class OneObject:
    """A sampler: the scene of the recipe, with the object nearest to the middle of the picture only."""

    def sample(self, request: SceneRequest) -> PlacedScene:
        """Return the scene of a frame."""
        scene = request.by_recipe()
        middle = np.array(scene.spec.camera.size_wh) / 2
        distances = [np.linalg.norm(o.xy.mean(axis=0) - middle) for o in scene.objects]
        others = [k for k, d in enumerate(distances) if d > min(distances)]
        return scene.without(others, "not_in_the_middle")


@dataclass(frozen=True)
class Gradients:
    """A source of backgrounds: made-up pictures, which are nowhere on the disk."""

    count: int = 6

    def dataset(self) -> Dataset:
        """Return the metadata of the backgrounds."""
        images = [
            ImageRecord(
                id=f"gradient_{k}", path=Path(f"gradient_{k}.png"), split="train", size_wh=(320, 256),
                instances=(), capture=Capture(pitch_deg=60.0, altitude_m=50.0, time_of_day="night"),
            )
            for k in range(self.count)
        ]  # fmt: skip
        return Dataset(Path("gradients"), "gradients", (), tuple(images))

    def load(self, image: ImageRecord) -> np.ndarray:
        """Return the grey levels of a background."""
        number = int(image.id.rpartition("_")[2])
        rng = np.random.default_rng(number)
        ramp = np.linspace(60 + 10 * number, 160, 256)[:, None]
        return np.clip(ramp + rng.normal(0, 2, (256, 320)), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class DeadPixels:
    """A look: the same pixels of a worn sensor are black in every picture."""

    share: float = 0.001
    seed: int = 0

    def apply(self, request: LookRequest) -> np.ndarray:
        """Return the changed picture."""
        dead = np.random.default_rng(self.seed).random(request.picture.shape) < self.share
        return np.where(dead, 0, request.picture).astype(request.picture.dtype)
