"""Train a detector on a dataset: check the data, cut tiles, run the trainer in a process, record everything."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend import __version__
from infrablend.core.dataset import Dataset
from infrablend.core.file_names import real_path
from infrablend.core.files import require_still_there, write_json
from infrablend.core.machine import describe_machine
from infrablend.core.output import Existing
from infrablend.core.tasks import OnProgress
from infrablend.core.typed_command import command_facts
from infrablend.pipeline.content import content_digest
from infrablend.pipeline.training.data import (
    has_deep_pictures,
    select_training_data,
    write_training_data,
)
from infrablend.pipeline.training.folder import (
    RECORD,
    begin_training,
    output_folder,
    remove_working_files,
    report_moved,
    require_own_weights,
    require_same,
)
from infrablend.pipeline.training.plan import plan_of
from infrablend.pipeline.training.process import run_trainer
from infrablend.pipeline.training.requirements import choose_device, require_arguments, require_space
from infrablend.training import weights
from infrablend.training.files import WEIGHTS, open_manifest
from infrablend.training.request import TrainRequest


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
    record: Mapping[str, Any]

    def to_json(self) -> dict[str, Any]:
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
    preset, task = request.chosen_preset(), request.task
    weights.require_ultralytics()
    device = choose_device(request.device)
    require_arguments(preset)
    wanted, left_out = select_training_data(dataset, preset, task, request.classes, request.agc)
    with contextlib.ExitStack() as stack:
        stack.enter_context(output_folder(out).claimed())
        manifest = open_manifest(out)
        stack.callback(report_moved, manifest)
        record = begin_training(out, existing, manifest)
        asked = {
            "preset": preset.name, "task": task, "seed": request.seed, "settings": dataclasses.asdict(preset),
            "classes": [c.name for c in wanted.categories], "data": str(real_path(dataset.root)),
            "start_asked": request.weights, "content": content_digest(wanted),
        }  # fmt: skip
        if has_deep_pictures(wanted):
            asked["agc"] = request.agc.model_dump()
        if record is not None:
            require_same(out, record, asked)
            if record["status"] == "complete" and (out / WEIGHTS).is_file():
                require_own_weights(out, manifest)
                remove_working_files(out, manifest)  # of a call that was killed between its record and this
                return TrainReport(out, out / WEIGHTS, record)
        if record is None or record.get("prepared") is None:
            require_space(out, plan_of(wanted, preset, device, request.seed).disk_bytes)
            start = weights.find_start(request.weights, preset, task)
            stack.enter_context(manifest.recording())
            record = {
                "infrablend": __version__, "status": "running", **command_facts(), **asked,
                "left_out": left_out, "sessions": [],
                "machine": _machine_facts(device), "start": dataclasses.asdict(start),
            }  # fmt: skip
            write_json(out / RECORD, record, durable=True)
            record["prepared"] = write_training_data(wanted, manifest, preset, task, request)
            write_json(out / RECORD, record, durable=True)
        else:
            stack.enter_context(manifest.recording())
        if os.path.lexists(out / WEIGHTS) and not manifest.is_own(WEIGHTS):
            manifest.move_aside(WEIGHTS)
        record = run_trainer(out, record, preset, task, device, request.seed, on_progress)
        manifest.read()  # the training process has added its weights
        remove_working_files(out, manifest)
        require_still_there([out / RECORD, out / WEIGHTS], "repeat the command with --resume")
        return TrainReport(out, out / WEIGHTS, record)


def _machine_facts(device: str) -> dict[str, Any]:
    """Return the facts about the machine for the record."""
    found: dict[str, Any] = {k: describe_machine()[k] for k in ("processor", "cores", "system")}
    if device != "cpu":
        import torch

        found["gpu"] = torch.cuda.get_device_name(int(device)) if device.isdigit() else device
    return found
