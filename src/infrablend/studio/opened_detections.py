"""Detections that the studio has opened: their pictures, and the verdicts on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from infrablend.core.dataset import Instance
from infrablend.errors import DatasetError
from infrablend.formats.pictures.images import load_background
from infrablend.pipeline.flights.reviewed_detections import StoredDetection, open_detections
from infrablend.report.preview import Rgb, draw_labels, to_rgb
from infrablend.studio.page_pictures import enlarged, to_png
from infrablend.studio.verdicts import Review

_ZOOM = 4


class OpenedDetections:
    """Detections to review.

    Attributes:
        stored: The detections, highest score first, and their pictures.
        review: Verdicts on them.
    """

    def __init__(self, folder: Path) -> None:
        """Read the detections and list their pictures.

        Raises:
            DatasetError: The folder is none of `detect`, has nothing to judge, or its pictures are gone.
            OutputError: Its review is damaged.
        """
        self.stored = open_detections(folder)
        self.review = Review(self.stored.review_file)

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the classes that a detection may be given."""
        return self.stored.predictions.classes

    def object(self, number: int) -> StoredDetection:
        """Return a detection by its number.

        Raises:
            DatasetError: There is no such detection.
        """
        if not 0 <= number < len(self.stored.objects):
            raise DatasetError(f"detection {number}: no such detection; there are {len(self.stored.objects)}")
        return self.stored.objects[number]

    def shown(self, category: str, verdict: str) -> list[int]:
        """Return the numbers of the detections of a class with a verdict, `open` for none; empty texts are for any."""
        words = self.review.words
        return [
            n
            for n, o in enumerate(self.stored.objects)
            if category in ("", o.category) and verdict in ("", words.get(o.id, "open"))
        ]

    def picture(self, number: int) -> bytes:
        """Return the PNG of the picture of a detection, with its box.

        Raises:
            DatasetError: There is no such detection, or the picture cannot be read.
        """
        return to_png(draw_labels(self._pixels(number), [self._label(number)], ["boxes"], names=False))

    def crop(self, number: int) -> bytes:
        """Return the PNG of a detection, enlarged without smoothing; errors as for `picture`."""
        return to_png(enlarged(self._pixels(number), self.object(number).box_xyxy, _ZOOM))

    def _pixels(self, number: int) -> Rgb:
        return to_rgb(load_background(self.object(number).image.path).pixels)

    def _label(self, number: int) -> Instance:
        found = self.object(number)
        return Instance(found.category, np.array(found.box_xyxy), inserted=True)
