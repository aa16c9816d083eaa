"""The shape of an experiment's records: `stage.json` of its stages, and the JSON beside its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NotRequired, TypedDict

from infrablend.detection.detectability_record import AlarmFacts, CellFacts, DetectabilityFacts, RecallFacts
from infrablend.lab.evaluation.evaluation_record import (
    ClassRows,
    Curves,
    Difference,
    EvaluationRecord,
    FalseAlarms,
    FirstDetections,
    Strata,
    Targets,
    TrackFacts,
)
from infrablend.lab.training.training_record import TrainingRecord

# -- stage.json ------------------------------------------------------------------------------------------------


class DatasetFacts(TypedDict):
    """Images and labels per split of a dataset, its classes and kinds of labels. Regions to ignore are not a class."""

    images: dict[str, int]
    labels: dict[str, dict[str, int]]
    classes: list[str]
    label_kinds: list[str]
    format: str


class DataResult(DatasetFacts):
    """The result of a stage that makes data.

    `dataset` is the folder to read, relative to the stage's; a source that is used as it is has none. `there` lists
    what must exist, `whole` the images of a source before its limits, `boxes_...` and `loosened_...` how boxes were
    drawn, `run` counts of a run, `pasted` those of cut-outs, `leakage_...` pictures of one place in several splits, and
    `adopted` how far a result made elsewhere was checked.
    """

    dataset: NotRequired[str]
    there: NotRequired[list[str]]
    whole: NotRequired[dict[str, int]]
    boxes_loosened: NotRequired[int]
    boxes_fit: NotRequired[str]
    loosened_by: NotRequired[float]
    loosened_by_px: NotRequired[float]
    run: NotRequired[Mapping[str, int]]
    pasted: NotRequired[Mapping[str, object]]
    leakage_before: NotRequired[Sequence[Mapping[str, object]]]
    leakage_after: NotRequired[Sequence[Mapping[str, object]]]
    adopted: NotRequired[str]


class TrainResult(TypedDict):
    """The result of a training: its record, and its weights relative to the stage's folder."""

    record: TrainingRecord
    weights: str
    there: list[str]
    adopted: NotRequired[str]


class EvaluateResult(TypedDict):
    """The result of an evaluation."""

    metrics: EvaluationRecord
    there: list[str]


class DetectabilityResult(TypedDict):
    """The result of a detectability."""

    facts: DetectabilityFacts
    there: list[str]


class CompareResult(TypedDict):
    """The result of a comparison: differences by class and measure, and the classes that only one side has."""

    classes: Mapping[str, Mapping[str, Difference | None]]
    left_out: Sequence[str]


class StageRecord(TypedDict):
    """Content of `stage.json`.

    `inputs` decide the result besides the stages in `needs`, which are keys by role; `commit` is that of the code that
    made the stage, and `result` one of the results above.
    """

    kind: str
    name: str
    key: str
    inputs: Mapping[str, object]
    needs: Mapping[str, str]
    machine: Mapping[str, object]
    packages: Mapping[str, str]
    commit: str | None
    seconds: float
    result: Mapping[str, object]


# -- the plan --------------------------------------------------------------------------------------------------


class PlannedStage(TypedDict):
    """A stage in a plan; trainings have the fields of their preset, start weights and network."""

    stage: str
    key: str
    images: int
    status: str
    needs: Sequence[str]
    about_s: float
    disk_bytes: int
    training: NotRequired[Mapping[str, object]]
    weights: NotRequired[str]
    network: NotRequired[str]


class PlanFacts(TypedDict):
    """What a run would do: its stages, time and disk space, and what is left out or stood in for."""

    experiment: str
    scale: str
    device: str
    seed: int
    stages: Sequence[PlannedStage]
    to_do: int
    about_s: int
    disk_bytes: int
    disk_free_bytes: int
    left_out: Mapping[str, str]
    stand_ins: Sequence[str]


# -- the results -----------------------------------------------------------------------------------------------


class EvaluationFigures(TypedDict):
    """The part of an evaluation's record that the page shows; None where an earlier version recorded nothing."""

    classes: ClassRows
    confidence: float | None
    ultralytics: ClassRows | None
    strata: Strata | None
    counts: Mapping[str, int] | None
    settings: Mapping[str, object] | None
    curves: Curves | None
    targets: Targets | None
    false_alarms: FalseAlarms | None
    first_detections: NotRequired[FirstDetections]
    tracks: NotRequired[TrackFacts]


class DetectabilityFigures(TypedDict):
    """The part of a detectability's record that the page shows; see `detectability.json`.

    `compared` is the number of cells with enough real objects, `holding` of those whose interval of the difference
    between predicted and actual recall holds 0.
    """

    title: str
    kind: str
    recipe: str
    trained_on: str
    category: str
    confidence: float
    pictures: int
    recall: RecallFacts
    confidences: Sequence[AlarmFacts]
    cells: Sequence[CellFacts]
    not_counted: Mapping[str, int]
    real_of_other_sizes: int
    compared: int
    holding: int


class ComparisonFigures(TypedDict):
    """The differences of the evaluations `a` and `b`, by class and measure."""

    title: str
    a: Sequence[str]
    b: Sequence[str]
    classes: Mapping[str, Mapping[str, Difference | None]]


class SourceFacts(TypedDict):
    """A source: images used and in the whole dataset, and how many the paper had."""

    title: str
    stand_in: bool
    images: Mapping[str, int]
    whole: Mapping[str, int]
    paper_images: Mapping[str, int]


class TableRow(TypedDict("_TableRow", {"class": str})):
    """A row of a table: figures of the paper and ours by name, their differences, or why ours are missing.

    `ours` also has the intervals `ci`, and `range`, the smallest and largest values, if it has the `means_of` several.
    """

    title: str
    evaluation: str
    means_of: NotRequired[Sequence[str]]
    paper: Mapping[str, float | None]
    ours: Mapping[str, object] | None
    difference: Mapping[str, float]
    missing: str | None


class ResultTable(TypedDict):
    """A table of the page."""

    title: str
    note: str
    columns: Sequence[str]
    rows: Sequence[TableRow]


class PaperDataset(TypedDict):
    """Numbers of images and classes of a dataset in the paper, and its kinds of labels."""

    images: int | None
    classes: int | None
    labels: Sequence[str]


class OurDataset(TypedDict):
    """The same of our dataset, with the names of the classes and the number of labels."""

    images: int
    classes: int
    names: Sequence[str]
    labels: Sequence[str]
    instances: int


class DatasetRow(TypedDict):
    """A row of the table of datasets, or why ours is missing."""

    title: str
    paper: PaperDataset
    ours: OurDataset | None
    missing: str | None


class Claim(TypedDict("_Claim", {"class": str})):
    """A claim and what decides it: the interval of a comparison, a ratio of figures, or differences of recall.

    `holds` is None where that cannot be decided; `missing` says why figures are missing. Of differences of recall, the
    largest of all `cells` is in `difference` and `ci`, its cell in `where`, and `holding` of their intervals hold 0.
    """

    text: str
    metric: str
    expect: str
    holds: bool | None
    missing: NotRequired[str]
    comparison: NotRequired[str]
    difference: NotRequired[float]
    ci: NotRequired[Sequence[float]]
    same_sign: NotRequired[float | None]
    ratio_of: NotRequired[Sequence[str]]
    least: NotRequired[float | None]
    values: NotRequired[Sequence[float]]
    ratio: NotRequired[float]
    recall_of: NotRequired[Sequence[str]]
    most: NotRequired[float | None]
    cells: NotRequired[int]
    holding: NotRequired[int]
    where: NotRequired[str]


class ExperimentRecord(TypedDict):
    """Everything that the page of an experiment shows.

    `stopped` says what stopped an unfinished run. `trainings` have parts of their records, `stages` a row each, and
    `strata_class` is the class whose strata are shown. Records of earlier versions have no `detectabilities`.
    """

    experiment: str
    title: str
    description: str
    about: str
    scale: str
    seed: int
    renderer: str
    status: str
    stopped: str | None
    missing: Sequence[str]
    left_out: Mapping[str, str]
    at_other_scales: Sequence[str]
    command: str
    commit: str | None
    commits: Sequence[str]
    hardware: Mapping[str, Sequence[object]]
    versions: Mapping[str, Sequence[object]]
    sources: Mapping[str, SourceFacts]
    stages: Sequence[Mapping[str, object]]
    trainings: Mapping[str, Mapping[str, object]]
    evaluations: Mapping[str, EvaluationFigures]
    detectabilities: NotRequired[Mapping[str, DetectabilityFigures]]
    comparisons: Mapping[str, ComparisonFigures]
    tables: Sequence[ResultTable]
    datasets: Sequence[DatasetRow]
    strata_class: str | None
    checks: Sequence[Claim]
