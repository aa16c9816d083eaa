"""What a studio has open; shared by all pages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from infrablend.errors import ArgumentError
from infrablend.studio.opened_run import OpenedRun

if TYPE_CHECKING:
    from infrablend.studio.server import StudioRequest


class Session:
    """An opened run, and recipe and data to tune.

    Attributes:
        run: The opened run; None if there is none.
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

    @property
    def title(self) -> str:
        """Name of what is open."""
        opened = self.request.run or self.request.data
        return "" if opened is None else Path(opened).resolve().name

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        if self.run is not None:
            self.run.close()
