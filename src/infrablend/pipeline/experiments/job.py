"""What the maker of a stage works with: the stage, its folder, and the finished stages that it needs."""

from __future__ import annotations

import logging
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from infrablend.core.output import Existing
from infrablend.core.tasks import OnProgress
from infrablend.errors import OtherSettingsError
from infrablend.pipeline.experiments.request import ExperimentRequest
from infrablend.pipeline.experiments.stage import FinishedStage, Stage

T = TypeVar("T")

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StageJob:
    """Everything a maker needs.

    Attributes:
        stage: Stage to make.
        out: Folder for its output, which belongs to this stage alone.
        needs: Finished stages that it needs, by role.
        request: Request of the experiment.
        on_progress: Called by makers that report progress.
    """

    stage: Stage
    out: Path
    needs: Mapping[str, FinishedStage]
    request: ExperimentRequest
    on_progress: OnProgress | None = None

    def empty_out(self) -> Path:
        """Remove what an interrupted run left in the output folder; return the folder."""
        if self.out.exists():
            shutil.rmtree(self.out)
        return self.out

    def resume_or_restart(self, make: Callable[[Existing], T]) -> T:
        """Call `make` to continue what an interrupted run left; start again if that had other settings.

        The settings differ although the stage is the same if an earlier version of InfraBlend started it.
        """
        if not (self.out.is_dir() and any(self.out.iterdir())):
            return make("refuse")
        try:
            return make("resume")
        except OtherSettingsError as error:
            log.warning("%s: an earlier run started it with other settings; it starts again", self.stage.id)
            log.info("%s", error)  # its advice (--overwrite) does not apply to experiments
            self.empty_out()
            return make("refuse")

    def relative(self, path: Path) -> str:
        """Return a path relative to the stage's folder, as records store it."""
        return os.path.relpath(path, self.out.parent)
