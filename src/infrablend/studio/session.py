"""What a studio has open; shared by all pages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from infrablend.errors import ArgumentError
from infrablend.pipeline.trial import TrialRequest
from infrablend.studio.opened_run import OpenedRun
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
        self.run = None if request.run is None else OpenedRun(request.run)
        self.tuning: Tuning | None = None
        if request.data is not None:
            recipe = request.recipe or FIRST_RECIPE
            self.tuning = Tuning(
                TrialRequest(
                    recipe, request.data, seed=request.seed, reading=request.reading, execution=request.execution
                )
            )

    @property
    def title(self) -> str:
        """Name of what is open."""
        opened = self.request.run or self.request.data
        return "" if opened is None else Path(opened).resolve().name

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        if self.tuning is not None:
            self.tuning.close()
        if self.run is not None:
            self.run.close()
