"""InfraBlend: insert rendered thermal objects into real thermal aerial images, with labels.

    import infrablend

    report = infrablend.generate("hit-uav-drone", data="hit-uav", out="runs/first", limit=10)

`infrablend.api` has the other functions. Importing this package loads neither Blender nor NumPy: each name is loaded
on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from infrablend.api import (
        ClassChanges,
        ConvertReport,
        Execution,
        FetchReport,
        PlanReport,
        Reading,
        RealismReport,
        RunReport,
        Selection,
        SplitReport,
        SplitRule,
        TrainReport,
        WriteSettings,
        generate,
    )
    from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
    from infrablend.errors import (
        DatasetError,
        FetchError,
        InfraBlendError,
        Interrupted,
        MissingDependencyError,
        ModelError,
        OutputError,
        Problem,
        RecipeError,
        RenderError,
        UnknownFormatError,
        WorkerDiedError,
    )

__version__ = "0.2.0"

__all__ = [
    "Category",
    "ClassChanges",
    "ConvertReport",
    "Dataset",
    "DatasetError",
    "Execution",
    "FetchError",
    "FetchReport",
    "ImageRecord",
    "InfraBlendError",
    "Instance",
    "Interrupted",
    "MissingDependencyError",
    "ModelError",
    "OutputError",
    "PlanReport",
    "Problem",
    "Reading",
    "RealismReport",
    "RecipeError",
    "RenderError",
    "RunReport",
    "Selection",
    "SplitReport",
    "SplitRule",
    "TrainReport",
    "UnknownFormatError",
    "WorkerDiedError",
    "WriteSettings",
    "__version__",
    "generate",
]

_DATASET = {"Category", "Dataset", "ImageRecord", "Instance"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    is_error = name.endswith("Error") or name in {"Interrupted", "Problem"}
    module = "core.dataset" if name in _DATASET else "errors" if is_error else "api"
    return getattr(import_module(f"infrablend.{module}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
