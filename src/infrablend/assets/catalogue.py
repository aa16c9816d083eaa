"""Loads object models: built-in ones by name, a user's own by the path of its YAML."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from infrablend.core.lazy_names import resolve
from infrablend.errors import ModelError

if TYPE_CHECKING:
    from infrablend.assets.model import ObjectModel

# name -> module and name of its ObjectModel; one file per model.
MODELS = {
    "airplane": "infrablend.assets.airplane:MODEL",
    "bird": "infrablend.assets.bird:MODEL",
    "boar": "infrablend.assets.boar:MODEL",
    "camera-quad": "infrablend.assets.camera_quad:MODEL",
    "car": "infrablend.assets.car:MODEL",
    "deer": "infrablend.assets.deer:MODEL",
    "drone": "infrablend.assets.drone:MODEL",
    "drones": "infrablend.assets.drones:MODEL",
    "fixed-wing": "infrablend.assets.fixed_wing:MODEL",
    "helicopter": "infrablend.assets.helicopter:MODEL",
    "hexacopter": "infrablend.assets.hexacopter:MODEL",
    "person": "infrablend.assets.person:MODEL",
    "racer": "infrablend.assets.racer:MODEL",
}


def list_models() -> list[str]:
    """Return the sorted names of the models that come with InfraBlend."""
    return sorted(MODELS)


def load_model(name: str) -> ObjectModel:
    """Return the model with a given name, or the one that a YAML file describes.

    Raises:
        ModelError: There is no such model, or its description is invalid.
    """
    # Imported here: shell completion lists the names without loading numpy.
    from infrablend.assets.model import ObjectModel
    from infrablend.assets.user_model import SUFFIXES, load_user_model

    if name in MODELS:
        model = resolve(MODELS[name])
        assert isinstance(model, ObjectModel)
        return model
    if name.lower().endswith((".yaml", ".yml")):
        return load_user_model(Path(name))
    if Path(name).suffix.lower() in SUFFIXES:
        raise ModelError(
            f"model {name!r}: is a 3D file; expected a .yaml beside it that gives each part its temperature. Write it "
            f"with infrablend models add {shlex.quote(name)} --category NAME --size-m METRES, then give the .yaml "
            "(docs/how_to/own_model.md)"
        )
    raise ModelError(
        f"model {name!r}: no such model; expected one of {', '.join(list_models())}. "
        "Use one of these names, or the path of a .yaml that describes your own (docs/how_to/own_model.md)."
    )
