"""What a studio has open; shared by all pages."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING

from infrablend.errors import ArgumentError
from infrablend.studio.comparison import Comparison, RecipeComparison, RunComparison
from infrablend.studio.opened_detections import OpenedDetections
from infrablend.studio.opened_run import OpenedRun, RunFrames
from infrablend.studio.studio_request import StudioRequest

if TYPE_CHECKING:
    from infrablend.studio.tuning import Tuning


class Session:
    """An opened run, opened detections, and recipe and data to tune.

    Attributes:
        run: The opened run; None if there is none.
        detections: The opened detections; None if there are none.
        comparison: Two runs or two recipes to compare; None if there is nothing to compare with.
    """

    def __init__(self, request: StudioRequest) -> None:
        """Open what the request names.

        Raises:
            InfraBlendError: It cannot be opened.
        """
        if request.run is None and request.data is None and request.detections is None:
            raise ArgumentError(
                "neither --run nor --data nor --detections; expected the folder of a run or of detections to review, "
                "or of backgrounds to tune a recipe on"
            )
        self.request = request
        self.run = None if request.run is None else OpenedRun(request.run, request.results)
        self.detections = None if request.detections is None else OpenedDetections(request.detections)
        self._tuning: Tuning | None = None
        self._opening = threading.Lock()
        self.comparison: Comparison | None = None
        try:
            if request.data is not None:
                self.open_tuning()
            if request.compare is not None:
                self.comparison = self._compare(request.compare)
        except BaseException:
            self.close()
            raise

    def open_tuning(self) -> Tuning:
        """Return recipe and data to tune, opened when they are first asked for.

        Raises:
            InfraBlendError: The recipe or the data cannot be used.
        """
        with self._opening:
            if self._tuning is None:
                # Loaded here, since a run to review should not wait for it.
                from infrablend.studio.tuning import Tuning, tuning_request

                self._tuning = Tuning(tuning_request(self.request, self.run))
            return self._tuning

    def _compare(self, second: str) -> Comparison:
        folder = Path(second)
        if self.run is not None and folder.is_dir():
            if folder.samefile(self.run.layout.root):
                raise ArgumentError(f"--compare {second}: the run of --run itself; expected another run")
            return RunComparison(self.run, RunFrames(folder))
        if self._tuning is None:
            raise ArgumentError(
                f"--compare {second}: no such folder; expected that of a second run. To compare recipes, give the "
                "backgrounds with --data instead of --run"
            )
        return RecipeComparison(self._tuning, second)

    @property
    def title(self) -> str:
        """Name of what is open."""
        opened = self.request.run or self.request.data or self.request.detections
        return "" if opened is None else opened.resolve().name

    def close(self) -> None:
        """End the renderer."""
        if self._tuning is not None:
            self._tuning.close()
