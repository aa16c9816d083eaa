"""What a studio has open; shared by all pages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from infrablend.errors import ArgumentError
from infrablend.pipeline.trial import TrialRequest
from infrablend.studio.comparison import Comparison, RecipeComparison, RunComparison
from infrablend.studio.opened_run import OpenedRun, RunFrames
from infrablend.studio.tuning import Tuning

if TYPE_CHECKING:
    from infrablend.studio.server import StudioRequest


FIRST_RECIPE = "hit-uav-drone-physical"
"""Recipe to tune where none is given."""


class Session:
    """An opened run, and recipe and data to tune.

    Attributes:
        run: The opened run; None if there is none.
        tuning: Recipe and data to tune; None without data.
        comparison: Two runs or two recipes to compare; None if there is nothing to compare with.
    """

    def __init__(self, request: StudioRequest) -> None:
        """Open what the request names.

        Raises:
            InfraBlendError: It cannot be opened.
        """
        if request.run is None and request.data is None:
            raise ArgumentError(
                "neither --run nor --data; expected the folder of a run to review, or of backgrounds to "
                "tune a recipe on"
            )
        self.request = request
        self.run = None if request.run is None else OpenedRun(request.run, request.results)
        self.tuning: Tuning | None = None
        if request.data is not None:
            recipe = request.recipe or FIRST_RECIPE
            self.tuning = Tuning(
                TrialRequest(
                    recipe, request.data, seed=request.seed, reading=request.reading, execution=request.execution
                )
            )
        self.comparison: Comparison | None = None
        self._second: RunFrames | None = None
        if request.compare is not None:
            try:
                self.comparison = self._compare(request.compare)
            except BaseException:
                self.close()
                raise

    def _compare(self, second: str) -> Comparison:
        folder = Path(second)
        if self.run is not None and folder.is_dir():
            if folder.samefile(self.run.layout.root):
                raise ArgumentError(f"--compare {second}: the run of --run itself; expected another run")
            self._second = RunFrames(folder)
            return RunComparison(self.run, self._second)
        if self.tuning is None:
            raise ArgumentError(
                f"--compare {second}: no such folder; expected that of a second run. To compare recipes, give the "
                "backgrounds with --data instead of --run"
            )
        return RecipeComparison(self.tuning, second)

    @property
    def title(self) -> str:
        """Name of what is open."""
        opened = self.request.run or self.request.data
        return "" if opened is None else Path(opened).resolve().name

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the run, and end the renderer."""
        if self.tuning is not None:
            self.tuning.close()
        if self.run is not None:
            self.run.close()
