"""The parts of a run's record that reproduce it: recipe, data, seed, choice of frames and machine, each verified."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from infrablend import __version__
from infrablend.config.modes import recipe_from_json
from infrablend.config.recipe import Recipe
from infrablend.core.machine import Device
from infrablend.core.run_folder import RunFolder
from infrablend.errors import ArgumentError, OutputError, Problem
from infrablend.formats.read_write import Reading
from infrablend.pipeline.plans.plan import RunPlan
from infrablend.pipeline.plans.planning import plan_folder
from infrablend.pipeline.plans.selection import FrameSelection


@dataclass(frozen=True)
class RecordedRun:
    """What a run was made from, read from its record.

    Attributes:
        recipe: Recipe, with the formats of the run.
        seed: Seed.
        data: Folder of the backgrounds.
        request: Choices of the user, as recorded.
        reading: How the backgrounds were read.
        selection: Choice of frames.
        warnings: Problems of the recipe that were reported.
        machine: Machine of the run, as recorded, with `renderer` and `device`.
        packages: Versions of the packages.
    """

    recipe: Recipe
    seed: int
    data: Path
    request: Mapping[str, Any]
    reading: Reading
    selection: FrameSelection
    warnings: tuple[Problem, ...]
    machine: Mapping[str, Any]
    packages: Mapping[str, str]

    @property
    def renderer(self) -> str:
        """Name of the renderer."""
        return str(self.machine["renderer"])

    @property
    def device(self) -> Device:
        """Device that it rendered on."""
        device: Device = self.machine["device"]
        return device

    @property
    def workers(self) -> int | None:
        """Number of worker processes; None for the default."""
        found: int | None = self.machine.get("workers")
        return found

    @classmethod
    def read(cls, folder: RunFolder) -> RecordedRun:
        """Return what a folder's run was made from.

        Raises:
            OutputError: There is no run, or its record is damaged.
        """
        return cls.from_record(folder.read_run(), folder.run_file)

    @classmethod
    def from_record(cls, record: Mapping[str, Any], file: Path) -> RecordedRun:
        """Return what a run was made from; `file` contains the record.

        Raises:
            OutputError: The record is damaged.
        """
        try:
            request = dict(record.get("request") or {})
            return cls(
                recipe=recorded_recipe(record),
                seed=record["seed"],
                data=Path(record["data"]["root"]),
                request=request,
                reading=Reading(**request.get("reading", {})),
                selection=FrameSelection(**request.get("selection", {})),
                warnings=tuple(Problem(**p) for p in request.get("warnings", ())),
                machine=record["machine"],
                packages=record["packages"],
            )
        except (LookupError, TypeError, ValueError, AttributeError, ArgumentError) as error:
            raise OutputError(
                f"{file}: cannot be read ({type(error).__name__}: {error}); expected the record of a run as "
                f"`infrablend generate` {__version__} writes it. Make the run again with --overwrite."
            ) from error

    def select(self, frames: tuple[str, ...]) -> RecordedRun:
        """Return the same run with these frames only."""
        chosen = {**self.request, "selection": {"frames": list(frames)}}
        return replace(self, request=chosen, selection=FrameSelection(frames=frames))

    def plan(self, data: Path | None) -> RunPlan:
        """Return the plan of the run, made again from its backgrounds.

        Args:
            data: Folder of the backgrounds, if it has moved.

        Raises:
            InfraBlendError: The backgrounds cannot be read.
        """
        plan = plan_folder(self.recipe, data or self.data, self.seed, self.reading, self.selection, self.warnings)
        return replace(plan, request=self.request)


def recorded_recipe(record: Mapping[str, Any]) -> Recipe:
    """Return the recipe of a run with this record, with the formats of the run.

    Raises:
        LookupError, TypeError, ValueError: The record is that of another version, or damaged.
    """
    recipe = dict(record["recipe"])
    recipe["output"] = {**recipe["output"], "formats": record["formats"]}
    return recipe_from_json(json.dumps(recipe))
