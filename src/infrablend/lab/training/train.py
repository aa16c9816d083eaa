"""Train a detector on a dataset: check the data, cut tiles, run the trainer in a process, record everything."""

from __future__ import annotations

import dataclasses
import json
import logging
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from infrablend import __version__
from infrablend.core.dataset import Dataset
from infrablend.core.file_names import real_path
from infrablend.core.files import read_object, require_free_space, write_json
from infrablend.core.machine import describe_machine
from infrablend.core.tasks import OnProgress
from infrablend.core.typed_command import COMMAND, command_facts
from infrablend.core.workspace import Existing, workspace
from infrablend.detection.training_folder import RECORD, WEIGHTS, WORKING_FILES
from infrablend.detection.ultralytics_environment import require_ultralytics
from infrablend.errors import OtherSettingsError, OutputError, Problem
from infrablend.lab.training import start_weights
from infrablend.lab.training.train_request import TrainRequest
from infrablend.lab.training.training_data import (
    has_deep_pictures,
    select_training_data,
    write_training_data,
)
from infrablend.lab.training.training_plan import choose_device, plan_of, require_arguments
from infrablend.lab.training.training_process import run_trainer
from infrablend.lab.training.training_record import TrainingRecord
from infrablend.pipeline.datasets.content import content_digest

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrainReport:
    """Result of a training.

    Attributes:
        out: Folder of the training.
        weights: File of the final weights.
        record: Content of `train.json`.
    """

    out: Path
    weights: Path
    record: TrainingRecord

    def to_json(self) -> dict[str, object]:
        """Plain JSON values."""
        return {"out": str(self.out), "weights": str(self.weights), **self.record}


def train_dataset(
    dataset: Dataset,
    out: Path,
    request: TrainRequest,
    *,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
) -> TrainReport:
    """Train a detector, and leave `weights.pt` and `train.json` in `out`.

    Args:
        dataset: Dataset with a train split, and with a val split where the preset stops early.
        out: Folder to write.
        request: How to train.
        existing: What to do if `out` already contains a training: `refuse`; `resume` from the last checkpoint, which
            leaves a finished training as it is and refuses other labels or pictures; or `overwrite`.
        on_progress: Called with the number of images shown so far.

    Raises:
        MissingDependencyError: Ultralytics or torch is not installed, or too old.
        DatasetError: The dataset is not fit for training: splits, classes, or labels that would be lost.
        OutputError: The folder, the disk or a setting is not fit for use.
        RenderError: The trainer failed; its log gives the reason.
        Interrupted: The user stopped the training; `resume` continues it.
    """
    preset = request.chosen_preset()
    require_ultralytics()
    device = choose_device(request.device)
    require_arguments(preset)
    wanted, left_out = select_training_data(dataset, request)
    start_asked, digest = start_weights.identify(request.weights)
    asked: TrainingRecord = {
        "preset": preset.name, "task": request.task, "seed": request.seed, "settings": dataclasses.asdict(preset),
        "classes": [c.name for c in wanted.categories], "data": str(real_path(dataset.root)),
        "start_asked": start_asked, "weights_sha256": digest, "content": content_digest(wanted),
    }  # fmt: skip
    if has_deep_pictures(wanted):
        asked["agc"] = request.agc.model_dump()
    with workspace(out, "training", RECORD, existing, keep=True) as space:
        folder = space.folder
        record = None if space.state == "new" else cast("TrainingRecord | None", read_object(folder / RECORD))
        if record is not None:
            require_same(out, record, asked)
        if space.state == "complete":
            if not (folder / WEIGHTS).is_file():
                raise OutputError(f"{out / WEIGHTS}: is not there; train again with --overwrite")
            return TrainReport(out, out / WEIGHTS, record or {})
        if record is None or record.get("prepared") is None:
            if space.state == "started":
                log.warning("%s: was not prepared to the end; the training starts again", out)
            _remove_working_files(folder)
            require_free_space(folder, 1.2 * plan_of(wanted, device, request).disk_bytes, "the training")
            record = {
                "infrablend": __version__,
                **asked,
                "left_out": left_out,
                "sessions": [],
                "machine": _machine_facts(device),
                "start": start_weights.find_start(request.weights, preset, request.task).facts(),
            }
            if command := command_facts():
                record["command"] = command[COMMAND]
            write_json(folder / RECORD, record, durable=True)
            record["prepared"] = write_training_data(wanted, folder, request)
            write_json(folder / RECORD, record, durable=True)
        if "epochs_done" not in record:
            record = run_trainer(folder, record, preset, device, on_progress)
        _remove_working_files(folder)
        space.finish(record)
    return TrainReport(out, out / WEIGHTS, record)


def _remove_working_files(folder: Path) -> None:
    for name in WORKING_FILES:
        path = folder / name
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def require_same(out: Path, record: Mapping[str, object], asked: Mapping[str, object]) -> None:
    """Raise OtherSettingsError if a training to resume was started with other data or settings."""
    now = _flat(json.loads(json.dumps(asked)))
    record = _flat(record)
    now.pop("data")  # the data must be the same, not their folder
    if "weights_sha256" not in record:  # earlier versions recorded the path of the weights alone
        now.pop("weights_sha256", None)
        for side in (now, record):
            side["start_asked"] = Path(str(side.get("start_asked"))).name
    # A setting that only one side has also differs.
    more = [k for k in record if k.startswith("settings.") and k not in now]
    other = [k for k in [*now, *more] if record.get(k) != now.get(k)]
    if other:
        problems = [
            Problem(str(asked["data"]), "resume-other",
                    "other labels or pictures", f"those it was started with, then in {record.get('data')}")
            if k == "content"
            else Problem(k, "resume-other", str(now.get(k)), f"{record.get(k)}, as at the start")
            for k in other
        ]  # fmt: skip
        raise OtherSettingsError(f"{out}: was started with other settings; use the same, or another folder", problems)


def _flat(record: Mapping[str, object]) -> dict[str, object]:
    """Return a record with flattened settings (`settings.passes`, `settings.arguments.lr0`), without their summary."""
    flat = dict(record)
    settings: Any = flat.pop("settings", {})
    for name, value in settings.items():
        if name == "arguments":
            flat |= {f"settings.arguments.{k}": v for k, v in value.items()}
        elif name != "summary":  # prose, which may be reworded
            flat[f"settings.{name}"] = value
    return flat


def _machine_facts(device: str) -> dict[str, object]:
    found: dict[str, object] = {k: describe_machine()[k] for k in ("processor", "cores", "system")}
    if device != "cpu":
        import torch

        found["gpu"] = torch.cuda.get_device_name(int(device)) if device.isdigit() else device
    return found
