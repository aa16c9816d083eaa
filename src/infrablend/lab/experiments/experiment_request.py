"""A request to run or plan an experiment: made once by the caller and passed on whole."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from infrablend.core.arguments import require_choice, require_names, require_whole
from infrablend.core.files import ShippedFiles
from infrablend.errors import DatasetError
from infrablend.rendering import RENDERERS

EXPERIMENTS = ShippedFiles("experiment", "lab/experiments/shipped")

Scale = Literal["smoke", "small", "medium", "paper"]
"""Scale of an experiment."""

SCALES: tuple[Scale, ...] = ("smoke", "small", "medium", "paper")
NAME_PATTERN = r"^[a-z0-9][a-z0-9-]*$"
"""Names of experiments, and of what is in them."""


DEFAULT_RESULTS = Path("results")


@dataclass(frozen=True)
class ExperimentRequest:
    """A request to run or plan an experiment. Texts become paths, and a single folder of data becomes a list.

    Attributes:
        experiment: Name of a shipped experiment, or the path of a YAML file.
        data: Folder of a dataset it needs, recognised by format and labelled classes, or named; repeatable.
        work: Folder of the stages. Experiments in one folder share equal stages.
        results: Folder of the page [default: results; WORK/results at the scale smoke].
        scale: paper: as published, needs a GPU; medium: hours per training on two cores, from `weights`; small:
            minutes; smoke: a test.
        seed: The same seed gives the same bytes.
        device: Device to train on: auto, cpu, cuda, or the number of a GPU.
        weights: Start weights of every training that names none: `scratch`, a name, or a file.
        training: Setting of every training, e.g. passes=4000; repeatable.
        only: Make only these stages and what they need: a kind (generate), name or id (train:fixed); repeatable.
        adopt: Use a training (train:fixed=DIR), run or dataset made by another command; repeatable.
        workers: Number of worker processes [default: one per core].
        renderer: `blender`, or `flat`, which shades flatly and needs no Blender.

    Raises:
        ArgumentError: `only` is no list of names, or another value is not one of these.
        DatasetError: There is no such scale.
    """

    experiment: str | Path
    data: Sequence[str | Path] | Mapping[str, str | Path] = ()
    work: Path = Path("experiments")
    results: Path | None = None
    scale: Scale = "small"
    seed: int = 0
    device: str = "auto"
    weights: str = "auto"
    training: Mapping[str, Any] = field(default_factory=dict)
    only: Sequence[str] = ()
    adopt: Mapping[str, Path] = field(default_factory=dict)
    workers: int | None = None
    renderer: str = "blender"

    def __post_init__(self) -> None:
        if self.scale not in SCALES:
            raise DatasetError(f"scale: found {self.scale!r}, expected one of {', '.join(SCALES)}")
        require_names("only", self.only)
        if self.workers is not None:
            require_whole("workers", self.workers, 1)
        require_choice("renderer", self.renderer, RENDERERS)
        paths = {
            "data": _as_paths(self.data),
            "work": Path(self.work),
            "results": None if self.results is None else Path(self.results),
            "adopt": {stage: Path(folder) for stage, folder in self.adopt.items()},
        }
        for name, value in paths.items():
            object.__setattr__(self, name, value)

    @property
    def folders(self) -> list[tuple[str | None, Path]]:
        """Folders of the datasets, with the name of their source where it is given."""
        if isinstance(self.data, Mapping):
            return [(name, Path(folder)) for name, folder in self.data.items()]
        return [_named_folder(str(folder)) for folder in self.data]

    @property
    def results_folder(self) -> Path:
        """Folder of the page. It never depends on where the command is run, except through a relative path."""
        if self.results is not None:
            return self.results
        return self.work / "results" if self.scale == "smoke" else DEFAULT_RESULTS


def _as_paths(data: str | Path | Sequence[str | Path] | Mapping[str, str | Path]) -> list[Path] | dict[str, Path]:
    if isinstance(data, Mapping):
        return {name: Path(folder) for name, folder in data.items()}
    return [Path(folder) for folder in ([data] if isinstance(data, str | Path) else data)]


def _named_folder(text: str) -> tuple[str | None, Path]:
    """Return source and folder of `NAME=DIR`; a text without a name, or the path of an existing folder, is a folder."""
    name, equals, folder = text.partition("=")
    named = equals and folder and re.fullmatch(NAME_PATTERN, name) and not Path(text).exists()
    return (name, Path(folder)) if named else (None, Path(text))
