"""The shape of `evaluation.json`: what an evaluation writes, and what pages, the studio and experiments read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, NotRequired, TypedDict

Interval = Sequence[float]
"""The two ends of a 95 % interval."""
Measure = Literal["images", "instances", "p", "r", "map10", "map50", "map50_95"]
"""A column of the table by class."""


class ClassRow(TypedDict):
    """The figures of a class, or of `all`; None where there are no objects.

    Rows of strata and of Ultralytics have no measures of small targets, and the row `all` alone has `as_one50` and
    `as_one50_95`, the AP of all classes taken as one. `median_px` is the median longer side of the objects. `found` is
    a share of the objects, `named` one of those found, and `false_alarms` a number a picture at recall 0.8.
    """

    images: int
    instances: int
    map50: float | None
    map50_95: float | None
    p: NotRequired[float | None]
    r: NotRequired[float | None]
    map10: NotRequired[float | None]
    median_px: NotRequired[float | None]
    as_one50: NotRequired[float]
    as_one50_95: NotRequired[float]
    found: NotRequired[float | None]
    named: NotRequired[float | None]
    false_alarms: NotRequired[float | None]
    ci: NotRequired[Mapping[str, Interval | None] | None]


ClassRows = Mapping[str, ClassRow]


class Stratum(TypedDict):
    """The figures of some of the objects, such as those of one size."""

    images: int
    classes: ClassRows


Strata = Mapping[str, Mapping[str, Stratum]]
"""Kind (`size`, `body`, `pitch`, `altitude`, `time`) -> bin -> figures."""


class FoundCounts(TypedDict):
    """Numbers of objects, and of those that a detection of any class overlaps."""

    objects: int
    found: int


class NamedCounts(FoundCounts):
    """Also the number of objects that have the right name, and what all are called, by class."""

    named: int
    called: Mapping[str, int]


class Targets(TypedDict):
    """Objects found by any class; `by` counts them by size and by visible share."""

    iou: float
    confidence: float
    classes: Mapping[str, NamedCounts]
    by: NotRequired[Mapping[str, Mapping[str, FoundCounts]]]


class AlarmsAtRecall(TypedDict):
    """False alarms a picture at the confidence that reaches a recall."""

    confidence: float
    per_picture: float


class ClassAlarms(TypedDict):
    """False alarms a picture at the confidence of P and R, and at each recall, None where it is not reached."""

    per_picture: float
    at_recall: Mapping[str, AlarmsAtRecall | None]


class FalseAlarms(TypedDict):
    """False alarms on pictures without objects of the evaluated classes."""

    pictures: int
    classes: Mapping[str, ClassAlarms]


class TrackRow(TypedDict):
    """The figures of the tracks of a class; None without labelled tracks."""

    sequences: int
    tracks: int
    objects: int
    found: int
    hota: float | None
    deta: float | None
    assa: float | None
    mota: float | None
    idf1: float | None
    switches: int | None
    ci: Mapping[str, Interval | None] | None


class TrackFacts(TypedDict):
    """The figures of a tracker."""

    tracker: Mapping[str, object]
    iou: float
    counts: Mapping[str, int]
    classes: Mapping[str, TrackRow]


class ListedObject(TypedDict("_Listed", {"class": str})):
    """An object, and the rank, score and overlap of the detection that found it; None if it was missed."""

    image: str
    box: Sequence[float]
    rank: int | None
    score: float | None
    iou: float | None


class FirstDetections(TypedDict):
    """The objects that are among the detections with the highest scores."""

    first: int
    iou: float
    detections: int
    found: int
    objects: Sequence[ListedObject]


class Difference(TypedDict):
    """Ours minus theirs on the same images; `same_sign` is the share of draws with the sign of the difference."""

    ours: float
    theirs: float
    difference: float
    ci: Interval | None
    same_sign: float | None


class Rival(TypedDict):
    """The other side of a comparison."""

    name: str
    detector: Mapping[str, object]


class Paired(TypedDict):
    """Differences by class and measure."""

    against: Rival
    draws: int
    detectors: Sequence[int]
    classes: Mapping[str, Mapping[str, Difference | None]]
    left_out: Sequence[str]


class Confusion(TypedDict):
    """Counts by detected (row) and labelled class (column); the last of both is the background."""

    classes: Sequence[str]
    found_by_labelled: Sequence[Sequence[int]]
    confidence: float
    iou: float


class Curves(TypedDict):
    """Precision of each class at each recall."""

    recall: Sequence[float]
    precision: Mapping[str, Sequence[float]]


class StressRow(TypedDict):
    """The figures of a class, or of `all`, under a change; None without objects, `named` also if none is found.

    `found` is a share of the objects, `named` one of those found, and `false_alarms` the number of detections a picture
    that overlap no object of the class.
    """

    objects: int
    map50: float | None
    map10: float | None
    found: float | None
    named: float | None
    false_alarms: float


class StressedFigures(TypedDict):
    """The figures under a change, and the numbers of objects that it cuts, which are ignored, and leaves outside."""

    change: str
    objects_cut: int
    objects_outside: int
    classes: Mapping[str, StressRow]


class StressFacts(TypedDict):
    """Content of `stress.json`; the first of the changes is none."""

    confidence: float
    iou: float
    changes: Sequence[StressedFigures]


class EvaluatedDataset(TypedDict):
    """What was evaluated on."""

    name: str
    format: str
    split: str
    images: int
    labels_sha256: str


class EvaluationRecord(TypedDict):
    """Content of `evaluation.json`."""

    infrablend: str
    dataset: EvaluatedDataset
    task: str
    settings: Mapping[str, object]
    detector: Mapping[str, object]
    counts: Mapping[str, int]
    classes: ClassRows
    confidence: float
    strata: Strata
    targets: Targets
    false_alarms: FalseAlarms
    confusion: Confusion
    curves: Curves
    ultralytics: ClassRows | None
    paired: Paired | None
    problems: Sequence[Mapping[str, str]]
    tracks: NotRequired[TrackFacts]
    first_detections: NotRequired[FirstDetections]
    stress: NotRequired[StressFacts]
