"""The record of `detectability`: content of `detectability.json`, which docs/explanation/detectability.md explains."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypedDict


class RecallFacts(TypedDict, total=False):
    """Share of objects found: of inserted ones, and of real ones where the data have labels.

    `difference` is predicted less actual, with the ends of its interval.
    """

    predicted: float | None
    low: float | None
    high: float | None
    inserted: int
    actual: float | None
    actual_low: float | None
    actual_high: float | None
    real: int
    difference: list[float]


class CellFacts(RecallFacts):
    """The same of objects with one value of a condition."""

    by: str
    value: str


class AlarmFacts(RecallFacts):
    """The same at one confidence, with the detections that see no labelled object."""

    confidence: float
    alarms_per_picture: float


class CountFacts(TypedDict):
    """Objects counted, each once for each picture that shows it.

    `detections` are those counted: of labelled objects (`of` is `labelled`) or all (`all`, some of which may be false
    alarms); `corrected` is the estimate of the objects, with its interval, which includes the error of p; it is None
    where p is unknown or 0.
    """

    of: str
    detections: int
    corrected: float | None
    low: float | None
    high: float | None


class AreaRow(TypedDict):
    """Fields of `pipeline.flights.search_map.AreaFigures`; a share is None where it is unknown."""

    name: str
    area_m2: float
    photographed: float
    pod: float | None
    low: float | None
    high: float | None
    coverage: float | None


class MapFacts(TypedDict):
    """The map of a flight: its cells, how far looks depend on each other, and the figures of flight and sectors.

    `searched_ha` is the ground of all pictures, what several show several times; `alarms_per_ha` are the alarms in
    these pictures, at the stated confidence, by that area.
    """

    cell_m: float
    cells: int
    rho: float
    rho_from: str
    track_m: float
    sweep_width_m: float | None
    pictures_without_pose: int
    searched_ha: float
    alarms_per_ha: float
    areas: list[AreaRow]


class MeasuredFacts(TypedDict):
    """What trials measured, see docs/explanation/detectability.md."""

    category: str
    confidence: float
    least_overlap: float
    recall: RecallFacts
    at_place: RecallFacts
    confidences: list[AlarmFacts]
    cells: list[CellFacts]
    tracks: RecallFacts | None
    counted: CountFacts
    pictures: int
    weighted_by: str
    real_of_other_sizes: int
    not_counted: dict[str, int]


class DetectabilityFacts(MeasuredFacts):
    """Content of `detectability.json`.

    `kind` is `measured`; or `upper bound` for a detector that was trained on inserted objects where no real ones say
    how well it does.
    """

    kind: str
    sentence: str
    map: MapFacts | None
    recipe: str
    detector: Mapping[str, object]
    trained_on: str
    data: str
    seed: int
    until: float
    infrablend: str
    problems: list[dict[str, str]]
