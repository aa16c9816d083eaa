"""Stages: what identifies one (its key), where it is kept, its record, and what its maker works with.

A finished stage is `WORK/<kind>/<key>/`: `out/` is its output, `stage.json` its record. The key is a digest of all that
decides the result, including the keys of the stages it needs, so the same training in two experiments is one stage.

Datasets are read and described here, too: the facts that stages record, and the evenly spread part of a limited source.
"""

from __future__ import annotations

import logging
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar, cast

from infrablend.annotation.looseness import loosened_counts
from infrablend.core.dataset import SPLITS, Dataset, ImageRecord
from infrablend.core.file_names import leaves_folder, real_path
from infrablend.core.files import read_object
from infrablend.core.tasks import OnProgress
from infrablend.core.workspace import Existing
from infrablend.errors import OtherSettingsError
from infrablend.formats import dataset_folder
from infrablend.formats.read_write import Reading
from infrablend.lab.experiments.experiment_request import ExperimentRequest
from infrablend.lab.experiments.result_record import (
    CompareResult,
    DataResult,
    DatasetFacts,
    DetectabilityResult,
    EvaluateResult,
    StageRecord,
    TrainResult,
)
from infrablend.pipeline.datasets.content import json_digest

RECORD = "stage.json"
VERSIONS = {
    "source": 1, "world": 1, "generate": 1, "convert": 1, "split": 1, "merge": 1, "paste": 1,
    "train": 2, "evaluate": 4, "detectability": 1, "compare": 1,
}  # fmt: skip
"""Version of each kind, part of the key. Raise it when a kind produces something else from the same inputs."""

T = TypeVar("T")

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Stage:
    """One stage of an experiment.

    Attributes:
        kind: Kind of the stage, a key of `VERSIONS`.
        name: Name in the experiment's file.
        inputs: Everything that decides the result besides the stages it needs, as plain JSON.
        needs: Ids of the stages it needs, by role.
        spec: Entry of the experiment's file.
        images: Approximate number of images it makes or learns from, by split; used by plans.
        path: Folder given by the user, of a source.
    """

    kind: str
    name: str
    inputs: Mapping[str, Any]
    needs: Mapping[str, str]
    spec: Any = None
    images: Mapping[str, int] = field(default_factory=dict)
    path: Path | None = None

    @property
    def id(self) -> str:
        """Kind and name: `train:aligned`."""
        return f"{self.kind}:{self.name}"


@dataclass(frozen=True)
class FinishedStage:
    """A finished stage: its folder and its record.

    Attributes:
        folder: Folder of the stage.
        record: Content of its `stage.json`.
        path: Folder given by the user, of a source that is used as it is; None for all others.
    """

    folder: Path
    record: StageRecord
    path: Path | None = None

    @classmethod
    def of(cls, stage: Stage, folder: Path, record: StageRecord) -> FinishedStage:
        """Return the finished stage with that record."""
        as_given = stage.kind == "source" and not record["result"].get("dataset")
        return cls(folder, record, stage.path if as_given else None)

    @property
    def data(self) -> DataResult:
        """Result of a stage that makes data."""
        return cast("DataResult", self.record["result"])

    @property
    def trained(self) -> TrainResult:
        """Result of a training."""
        return cast("TrainResult", self.record["result"])

    @property
    def evaluated(self) -> EvaluateResult:
        """Result of an evaluation."""
        return cast("EvaluateResult", self.record["result"])

    @property
    def measured(self) -> DetectabilityResult:
        """Result of a detectability."""
        return cast("DetectabilityResult", self.record["result"])

    @property
    def compared(self) -> CompareResult:
        """Result of a comparison."""
        return cast("CompareResult", self.record["result"])

    @property
    def dataset(self) -> Path:
        """Folder to read the dataset from; for stages that make data."""
        return self.path if self.path is not None else self.folder / self.data["dataset"]

    @property
    def reader_options(self) -> dict[str, str]:
        """Options of the dataset's reader: those of a source used as it is; our own output needs none."""
        options: Any = self.record["inputs"].get("options", {})
        return {} if self.path is None else dict(options)


def stage_keys(stages: Sequence[Stage]) -> dict[str, str]:
    """Return the key of each stage by id; every stage comes after those it needs."""
    keys: dict[str, str] = {}
    for s in stages:
        needs = {role: keys[i] for role, i in s.needs.items()}
        keys[s.id] = json_digest([s.kind, VERSIONS[s.kind], dict(s.inputs), needs])
    return keys


def stage_folder(work: Path, stage: Stage, key: str) -> Path:
    """Return the folder in which a stage is kept."""
    return work / stage.kind / key


def find_finished(work: Path, stage: Stage, key: str) -> FinishedStage | None:
    """Return the stage if it is finished and its output still exists, else None."""
    folder = stage_folder(work, stage, key)
    record = read_object(folder / RECORD)
    if record is None or not isinstance(record.get("result"), dict):
        return None
    found = FinishedStage.of(stage, folder, cast("StageRecord", record))
    there = [folder / p for p in record["result"].get("there", [])]
    return found if all(p.exists() and not leaves_folder(p, folder) for p in there) else None


@dataclass(frozen=True)
class StageJob:
    """Everything a maker needs.

    Attributes:
        stage: Stage to make.
        out: Folder for its output, in the workspace of the stage. It is there only if the stage was interrupted.
        needs: Finished stages that it needs, by role.
        request: Request of the experiment.
        on_progress: Called by makers that report progress.
    """

    stage: Stage
    out: Path
    needs: Mapping[str, FinishedStage]
    request: ExperimentRequest
    on_progress: OnProgress | None = None

    def resume_or_restart(self, make: Callable[[Existing], T]) -> T:
        """Call `make` to continue what an interrupted run left; start again if that had other settings.

        The settings differ although the stage is the same if an earlier version of InfraBlend started it.
        """
        try:
            return make("resume")
        except OtherSettingsError as error:
            log.warning("%s: an earlier run started it with other settings; it starts again", self.stage.id)
            log.info("%s", error)  # its advice (--overwrite) does not apply to experiments
            return make("overwrite")

    def relative(self, path: Path) -> str:
        """Return a path relative to the stage's folder, as records store it."""
        return os.path.relpath(real_path(path), self.out.parent)


def read_dataset(
    folder: Path, *, splits: Sequence[str] | None = None, options: Mapping[str, str] | None = None
) -> Dataset:
    """Return the dataset in a folder, its format detected."""
    return dataset_folder.read(folder, Reading(splits=splits, options=options or {}))


def dataset_facts(dataset: Dataset) -> DatasetFacts:
    """Return images and labels per split, classes and kinds of labels. Regions to ignore are not a class."""
    ignored = {c.name for c in dataset.categories if c.ignore}
    objects = [o for i in dataset.images for o in i.instances if o.category not in ignored]
    labels: dict[str, dict[str, int]] = {}
    for split in SPLITS:
        found = Counter(o.category for i in dataset.images if i.split == split for o in i.instances)
        labels[split] = {n: k for n, k in sorted(found.items()) if n not in ignored}
    kinds = {
        "AABB": bool(objects),
        "OBB": any(o.corners_xy is not None for o in objects),
        "Masks": any(o.mask is not None for o in objects),
    }
    return {
        "images": {s: n for s in SPLITS if (n := sum(i.split == s for i in dataset.images))},
        "labels": labels,
        "classes": [c.name for c in dataset.categories if not c.ignore],
        "label_kinds": [k for k, present in kinds.items() if present],
        "format": dataset.format,
    }


def data_result(dataset: Dataset, folder: str = "out", counts: Mapping[str, object] | None = None) -> DataResult:
    """Return the result of a stage that makes data.

    Args:
        dataset: The data.
        folder: Where they are, relative to the stage's folder.
        counts: What was counted on the way; those of loosened boxes are recorded.
    """
    facts = dataset_facts(dataset)
    result = {**facts, **loosened_counts(counts or {}), "dataset": folder, "there": [folder]}
    return cast("DataResult", result)


def spread_images(dataset: Dataset, limits: Mapping[str, int]) -> Iterator[ImageRecord]:
    """Yield up to `limits` images per split: first one per class, rarest class first, then evenly spread ones."""
    for split in SPLITS:
        images = [i for i in dataset.images if i.split == split]
        n = limits.get(split, len(images))
        if len(images) <= n:
            yield from images
            continue
        counts = Counter(o.category for i in images for o in i.instances)
        chosen: set[int] = set()
        for name, _ in sorted(counts.items(), key=lambda pair: (pair[1], pair[0])):
            if len(chosen) < n and not any(o.category == name for k in chosen for o in images[k].instances):
                chosen.add(next(k for k, i in enumerate(images) if any(o.category == name for o in i.instances)))
        for k in range(n):
            if len(chosen) < n:
                wanted = k * len(images) // n
                chosen.add(min((j for j in range(len(images)) if j not in chosen), key=lambda j: (abs(j - wanted), j)))
        yield from (images[k] for k in sorted(chosen))
