"""The page of `detect`: how much a confidence costs, crops by score, and the flight picture by picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any, Final

import numpy as np

from infrablend.core.dataset import ImageRecord
from infrablend.core.frame_row import Box
from infrablend.detection.detections import Predictions
from infrablend.detection.truth import image_key
from infrablend.errors import Problem, format_problems
from infrablend.report.charts import COLOURS, legend, panels, plot_text, png_bytes
from infrablend.report.page import Table, render_page
from infrablend.report.preview import spread
from infrablend.report.run_page import Crop, crop, read_levels, thumbnail

PAGE: Final = "report.html"
LEVELS = (0.05, 0.1, 0.25, 0.4, 0.6, 0.8)
_CROPS = 150
_PICTURES = 60


@dataclass(frozen=True)
class FoundObject:
    """A detection that the page may show.

    Attributes:
        picture: `<split>/<name>` of its picture.
        category: Its class.
        score: Its score.
        box: Left, top, right and bottom edge, px.
    """

    picture: str
    category: str
    score: float
    box: Box

    @property
    def rectangle(self) -> tuple[float, float, float, float]:
        """Left, top, width and height, px."""
        x0, y0, x1, y1 = self.box
        return x0, y0, round(x1 - x0, 3), round(y1 - y0, 3)


def detections_page(
    facts: Mapping[str, Any],
    images: Sequence[ImageRecord],
    predictions: Predictions,
    confidence: float,
    maps: Sequence[bytes] = (),
) -> str:
    """Return the HTML page; the same detections and pictures give the same bytes.

    Args:
        facts: Content of `detect.json`.
        images: All pictures of the data, in order.
        predictions: Detections on those that were searched.
        confidence: Lowest score of what is shown.
        maps: Maps as SVG files.
    """
    shown = _shown(predictions, confidence)
    ranked = sorted((o for of in shown.values() for o in of), key=lambda o: (-o.score, o.picture, o.box))
    picked = [ranked[k] for k in spread(len(ranked), _CROPS)]
    with_some = [i for i in images if shown.get(image_key(i))]
    kept = [with_some[k] for k in spread(len(with_some), _PICTURES)]
    crops, thumbnails = _cut(images, picked, {image_key(i) for i in kept})
    return render_page(
        "detections",
        title=f"Detections in {facts['data_name']}",
        facts=facts,
        problems=format_problems(Problem(**p) for p in facts["problems"]),
        level=f"{confidence:g}",
        by_class=_class_table(shown, predictions.classes),
        by_confidence=_confidence_table(predictions),
        maps=maps,
        chart=_chart([shown[image_key(i)] for i in images if image_key(i) in shown], predictions.classes),
        found=len(ranked),
        crops=[(o, crops[o]) for o in picked if o in crops],
        with_some=len(with_some),
        pictures=[
            (key, thumbnails[key], predictions.sizes_wh[key], shown[key])
            for key in map(image_key, kept)
            if key in thumbnails
        ],
    )


def _shown(predictions: Predictions, confidence: float) -> dict[str, list[FoundObject]]:
    """Return the detections from a score on, by picture."""
    return {
        key: [
            FoundObject(key, predictions.classes[of], score, (box[0], box[1], box[2], box[3]))
            for box, score, of in zip(d.boxes_xyxy.tolist(), d.scores.tolist(), d.classes.tolist(), strict=True)
            if score >= confidence
        ]
        for key, d in predictions.images.items()
    }


def _cut(
    images: Sequence[ImageRecord], picked: Sequence[FoundObject], whole: set[str]
) -> tuple[dict[FoundObject, Crop], dict[str, str]]:
    """Return crops of objects, and thumbnails of some pictures; each picture is read once."""
    of: dict[str, list[FoundObject]] = {}
    for o in picked:
        of.setdefault(o.picture, []).append(o)
    crops: dict[FoundObject, Crop] = {}
    thumbnails = {}
    for image in images:
        key = image_key(image)
        levels = read_levels(image.path) if key in whole or key in of else None
        if levels is None:
            continue
        crops |= {o: crop(levels, o.box) for o in of.get(key, ())}
        if key in whole:
            thumbnails[key] = thumbnail(levels)
    return crops, thumbnails


def _class_table(shown: Mapping[str, Sequence[FoundObject]], classes: Sequence[str]) -> Table:
    rows = []
    for name in classes:
        numbers = [sum(o.category == name for o in of) for of in shown.values()]
        if total := sum(numbers):
            rows.append([name, str(total), str(sum(n > 0 for n in numbers)), str(max(numbers))])
    return Table(["class", "detections", "pictures with some", "most in one picture"], rows)


def _confidence_table(predictions: Predictions) -> Table:
    scores = [d.scores for d in predictions.images.values()]
    rows = []
    for level in LEVELS:
        numbers = [int(np.count_nonzero(of >= level)) for of in scores]
        rows.append(
            [f"{level:g}", str(sum(numbers)), f"{sum(numbers) / len(numbers):.2f}", str(sum(map(bool, numbers)))]
        )
    return Table(["confidence", "detections", "a picture", "pictures with some"], rows)


def _chart(pictures: Sequence[Sequence[FoundObject]], classes: Sequence[str]) -> bytes | None:
    """Return a chart of the number of detections in each picture, in order; None for a single picture."""
    if len(pictures) < 2:
        return None
    figure, (ax,) = panels(1, 1, (10, 2.2))
    places = np.arange(1, len(pictures) + 1)
    below = np.zeros(len(pictures))
    for name, colour in zip(classes, cycle(COLOURS), strict=False):
        numbers = np.array([sum(o.category == name for o in of) for of in pictures], np.float64)
        if numbers.any():
            ax.bar(places, numbers, 1.0, below, color=colour, label=plot_text(name))
        below += numbers
    ax.set(xlabel="picture", ylabel="detections", xlim=(0.5, len(pictures) + 0.5))
    if below.any():
        legend(ax, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=6)
    return png_bytes(figure)
