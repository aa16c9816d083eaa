"""What a training records in `train.json`, and what its process says while it runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NotRequired, TypedDict

from infrablend.detection.detections import Task
from infrablend.lab.training.presets import Backend


class StartFacts(TypedDict):
    """Start weights, as the fields of `StartWeights`."""

    model: str
    kind: str
    why: str
    network: str


class PreparedCounts(TypedDict):
    """What was written for the trainer; names with `_val` are of split val, the others of split train.

    `pictures` and `objects` (by class) are by split and count whole pictures, `images` and `labels` what is trained on,
    `tiles` how it was cut, and `picture_px` the median longer side of the pictures that tiles are from. `val` says
    where the split comes from if the dataset has none. `losses` are those of the label format.
    """

    pictures: Mapping[str, int]
    objects: Mapping[str, Mapping[str, int]]
    picture_px: NotRequired[int]
    tiles: NotRequired[Mapping[str, int]]
    tiles_val: NotRequired[Mapping[str, int]]
    val: NotRequired[str]
    images: int
    labels: int
    images_val: int
    labels_val: int
    losses: Mapping[str, int]


class SessionFacts(TypedDict):
    """One sitting of a training.

    `end` is `end`, `stopped`, `failed`, or `killed`, which stays if nothing could be recorded at the end. `epoch` is
    the last finished one, and `restarted` says why the sitting started from the beginning again.
    """

    seconds: float
    end: str
    epoch: int
    restarted: NotRequired[str]


class TrainingRecord(TypedDict, total=False):
    """Content of `train.json`, which grows as the training is prepared, runs and ends.

    Settings are those of the preset, `content` is the digest of the data, `left_out` counts labels that were not
    trained on, and `agc` is there for 16-bit pictures. From `epochs_done` on, fields are of a finished training.
    `adopted` stands only in the records of experiments that took the training from elsewhere.
    """

    infrablend: str
    command: Mapping[str, object]
    preset: str
    backend: Backend
    task: Task
    seed: int
    settings: dict[str, object]
    classes: list[str]
    data: str
    start_asked: str
    weights_sha256: str | None
    content: str
    agc: Mapping[str, object]
    left_out: Mapping[str, int]
    sessions: list[SessionFacts]
    machine: Mapping[str, object]
    start: StartFacts
    prepared: PreparedCounts
    epochs: int
    device: str
    epochs_done: int
    passes: int
    seconds: float
    losses: Mapping[str, float]
    gate: Mapping[str, int]
    precision: str
    threads: int
    versions: Mapping[str, str]
    batch: int
    note: str
    adopted: bool


class TrainerEvent(TypedDict, total=False):
    """One line from the training process; `event` says what it is and which of the other fields it has.

    `step` has the number of `images` shown so far, `epoch` the number of finished epochs, `damaged` and `error` a
    `message`, `error` a `code` as well, and `end` what the record of a finished training needs.
    """

    event: str
    epoch: int
    epochs: int
    images: int
    message: str
    code: str
    batch: int
    short_of_memory: bool
    gate: Mapping[str, int]
    losses: Mapping[str, float]
    metrics: Mapping[str, float]
    precision: str
    threads: int
    versions: Mapping[str, str]
