"""The models that come with InfraBlend, by name, and the way to a user's own."""

from __future__ import annotations

from pathlib import Path

from infrablend.assets.model import ObjectModel
from infrablend.assets.user_model import SUFFIXES, load_user_model
from infrablend.core.registry import resolve
from infrablend.errors import ModelError

# name -> where its ObjectModel lives; one file per model.
MODELS = {
    "car": "infrablend.assets.car:MODEL",
    "deer": "infrablend.assets.deer:MODEL",
    "drone": "infrablend.assets.drone:MODEL",
    "person": "infrablend.assets.person:MODEL",
}


def list_models() -> list[str]:
    """Names of the models that come with InfraBlend, sorted."""
    return sorted(MODELS)


def load_model(name: str) -> ObjectModel:
    """The model of that name, or the one a user's YAML describes.

    Raises:
        ModelError: If there is no such model or its description is wrong.
    """
    if name in MODELS:
        model = resolve(MODELS[name])
        assert isinstance(model, ObjectModel)
        return model
    if name.lower().endswith((".yaml", ".yml")):
        return load_user_model(Path(name))
    if Path(name).suffix.lower() in SUFFIXES:
        raise ModelError(
            f"model {name!r}: is a 3D file; expected a .yaml beside it that says which part is how warm "
            "(docs/how_to/own_model.md)"
        )
    raise ModelError(
        f"model {name!r}: no such model; shipped are {', '.join(list_models())}. "
        "Give one of these names, or the path of a .yaml that describes your own (docs/how_to/own_model.md)."
    )
