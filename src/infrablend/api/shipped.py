"""What the package ships: models, recipes and the shader."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from infrablend.assets import catalogue
from infrablend.assets.model import ObjectModel
from infrablend.config import loading
from infrablend.pipeline.plans import add_model as adding
from infrablend.pipeline.plans.add_model import ModelAnswers, ModelSurvey
from infrablend.pipeline.plans.models import ready_model, run_once
from infrablend.rendering.engine import process


def list_models() -> dict[str, str]:
    """Return the shipped models and their descriptions."""
    return {name: catalogue.load_model(name).description for name in catalogue.list_models()}


def describe_model(name: str) -> ObjectModel:
    """Return a model, shipped or your own .yaml: description, options, and the temperatures of its parts.

    >>> describe_model("drone").options["layout"]
    'one of x, h, plus, deadcat, or a list of several'
    """
    return ready_model(name)


def show_model(name: str, out: str | Path, seed: int = 0, options: Mapping[str, object] | None = None) -> Path:
    """Render a model from below, level and above onto one sheet, a PNG; return its path.

    The options are those of a recipe (`objects.N.options`).
    """
    ready_model(name)
    payload = (name, str(out), seed, dict(options or {}))
    return Path(run_once("infrablend.rendering.engine.turntable:make_turntable", payload, f"show {name}"))


def survey_model(file: str | Path, answers: ModelAnswers | None = None) -> ModelSurvey:
    """Read a 3D file and guess what its parts are; `missing` of the result lists what only you can know."""
    return adding.survey_model(Path(file), answers or ModelAnswers())


def add_model(file: str | Path, answers: ModelAnswers, out: str | Path | None = None) -> Path:
    """Describe a 3D file of your own as a model; return the path of the YAML, in `out` or beside the file."""
    return adding.add_model(Path(file), None if out is None else Path(out), answers)


def list_recipes() -> dict[str, str]:
    """Return the shipped recipes and their descriptions."""
    return {name: loading.load_recipe(name).description for name in loading.list_recipes()}


def show_recipe(name: str) -> str:
    """Return the YAML text of a shipped recipe."""
    return loading.recipe_text(name)


def write_infrared_effect(path: str | Path) -> Path:
    """Write the InfraredEffect node group as a .blend file to append from; return its path."""
    return process.write_infrared_effect(Path(path))
