"""Train a detector on a dataset: plan it, check the data, cut tiles, run the trainer in a process, record everything.

The plan has images, epochs, time and disk space, and what the training requires of device, settings and disk.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

from infrablend import __version__
from infrablend.core.dataset import Dataset
from infrablend.core.file_names import real_path
from infrablend.core.files import read_object, require_free_space, write_json
from infrablend.core.machine import describe_machine
from infrablend.core.tasks import OnProgress
from infrablend.core.typed_command import COMMAND, command_facts
from infrablend.core.workspace import Existing, partial_of, workspace
from infrablend.detection import tiles, ultralytics_environment
from infrablend.detection.scale import ONNX_WEIGHTS, RECORD, WORKING_FILES
from infrablend.errors import OtherSettingsError, OutputError, Problem
from infrablend.lab.training import presets, start_weights
from infrablend.lab.training.export_onnx import export_onnx
from infrablend.lab.training.train_request import TrainRequest
from infrablend.lab.training.training_backends import BACKENDS
from infrablend.lab.training.training_data import (
    has_deep_pictures,
    most_tiles,
    select_training_data,
    write_training_data,
)
from infrablend.lab.training.training_process import run_trainer
from infrablend.lab.training.training_record import TrainingRecord
from infrablend.pipeline.datasets.content import content_digest


@dataclass(frozen=True)
class TrainPlan:
    """Plan of a training.

    Attributes:
        images: Number of pictures, or of tiles cut from them, in the train split.
        labels: Number of labels in the train split.
        epochs: Maximum number of epochs.
        shown: Images shown per epoch.
        tiled: Whether `images` are tiles.
        tile_px: Side of the tiles, px; 0 for whole pictures.
        device: `cpu`, `mps` or the number of a GPU.
        seconds: Estimated duration, s.
        disk_bytes: Estimated peak disk space, bytes.
        weights: Name of the start weights, or `auto` or `scratch`.
        network: Name of the network, which weights other than these two bring along; empty before a download.
    """

    images: int
    labels: int
    epochs: int
    shown: int
    tiled: bool
    tile_px: int
    device: str
    seconds: float
    disk_bytes: int
    weights: str
    network: str


def plan_training(
    dataset: Dataset, request: TrainRequest, *, out: Path | None = None, existing: Existing = "refuse"
) -> TrainPlan:
    """Return what `train_dataset` would do, without doing it; whatever it would refuse is refused here too.

    Two checks are left to the training: arguments of Ultralytics where that is not installed, and whether published
    weights can be downloaded.
    """
    preset = request.chosen_preset()
    device = choose_device(request.device, planning=True)
    backend = BACKENDS[request.backend]
    backend.require_settings(preset, request.task)
    backend.require_start(request.weights, preset, request.task)
    if out is not None and (out.exists() or partial_of(out).exists()):
        # Nothing is deleted: what may be replaced may also be resumed.
        with workspace(out, "training", RECORD, "refuse" if existing == "refuse" else "resume", keep=True):
            pass
    wanted, _ = select_training_data(dataset, request)
    return plan_of(wanted, device, request.fitted_to(wanted))


def plan_of(wanted: Dataset, device: str, request: TrainRequest) -> TrainPlan:
    """Return the plan of a training on selected data; see `select_training_data`."""
    preset = request.chosen_preset()
    seed = request.seed
    parts = {s: [i for i in wanted.images if i.split == s] for s in ("train", "val")}
    if preset.tile:
        cut = {s: tiles.plan_tiles(p, preset.tile, seed=seed, most=most_tiles(preset, s)) for s, p in parts.items()}
        images = len(cut["train"])
        size = sum(len(c) for c in cut.values()) * preset.tile**2
    else:
        images = len(parts["train"])
        size = sum(i.path.stat().st_size for i in wanted.images if i.path.is_file())
    labels = sum(len(i.instances) for i in parts["train"])
    epochs, shown = preset.epochs_for(images)
    return TrainPlan(
        images=images, labels=labels, epochs=epochs, shown=shown, tiled=preset.tile > 0, tile_px=preset.tile,
        device=device,
        seconds=presets.estimate_seconds(preset, images, gpu=device != "cpu", threads=presets.cpu_threads()),
        disk_bytes=round(size + presets.weights_bytes(preset)), weights=Path(request.weights).name,
        network=BACKENDS[request.backend].network_of(request.weights, preset, request.task),
    )  # fmt: skip


def choose_device(wanted: str, *, planning: bool = False) -> str:
    """Return the trainers' name of a device: `cpu`, `mps` or the number of a GPU.

    For a plan where torch is not installed, `auto` is the processor.
    """
    number = wanted.removeprefix("cuda:")
    if "," in wanted:
        raise OutputError(f"--device {wanted}: several GPUs; expected one, such as {number.partition(',')[0]}")
    if wanted not in ("auto", "cpu", "cuda", "mps") and not (number.isascii() and number.isdigit()):
        raise OutputError(f"--device {wanted}: no such device; expected auto, cpu, mps, cuda, or a GPU such as cuda:1")
    if wanted == "cpu" or (planning and wanted == "auto" and find_spec("torch") is None):
        return "cpu"
    if find_spec("torch") is None:
        ultralytics_environment.require_ultralytics()
    import torch

    if wanted == "mps":
        if torch.backends.mps.is_available():
            return "mps"
        raise OutputError(f"--device mps: not available in torch {torch.__version__}; expected --device cpu")
    there = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if wanted == "auto":
        return "0" if there else "cpu"
    index = 0 if wanted == "cuda" else int(number)
    if index < there:
        return str(index)
    found = f"finds {there} GPU{'s' if there > 1 else ''}, numbered from 0" if there else "finds no GPU"
    raise OutputError(
        f"--device {wanted}: torch {torch.__version__} {found}; expected one of them, or --device cpu. "
        "infrablend doctor lists the devices"
    )


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
    """Train a detector, and leave its weights, `train.json`, and `weights.onnx` if asked for or by YOLOX, in `out`.

    Args:
        dataset: Dataset with a train split, and with a val split where the preset stops early.
        out: Folder to write.
        request: How to train.
        existing: What to do if `out` already contains a training: `refuse`; `resume` from the last checkpoint, which
            leaves a finished training as it is and refuses other labels or pictures; or `overwrite`.
        on_progress: Called with the number of images shown so far.

    Raises:
        MissingDependencyError: The library or torch is not installed, or too old.
        DatasetError: The dataset is not fit for training: splits, classes, or labels that would be lost.
        OutputError: The folder, the disk or a setting is not fit for use.
        RenderError: The trainer failed; its log gives the reason.
        Interrupted: The user stopped the training; `resume` continues it.
    """
    backend = BACKENDS[request.backend]
    backend.require_packages(export=bool(request.export))
    device = choose_device(request.device)
    backend.require_settings(request.chosen_preset(), request.task)
    wanted, left_out = select_training_data(dataset, request)
    request = request.fitted_to(wanted)
    preset = request.chosen_preset()
    start_asked, digest = start_weights.identify(request.weights)
    asked: TrainingRecord = {
        "preset": preset.name, "backend": request.backend, "task": request.task,
        "seed": request.seed, "settings": dataclasses.asdict(preset),
        "classes": [c.name for c in wanted.categories], "data": str(real_path(dataset.root)),
        "start_asked": start_asked, "weights_sha256": digest, "content": content_digest(wanted),
    }  # fmt: skip
    if has_deep_pictures(wanted):
        asked["agc"] = request.agc.model_dump()
    with workspace(out, "training", RECORD, existing, keep=True, derived={ONNX_WEIGHTS}) as space:
        folder = space.folder
        record = None if space.state == "new" else cast("TrainingRecord | None", read_object(folder / RECORD))
        if record is not None:
            require_same(out, record, asked)
        if space.state == "complete":
            if not (folder / backend.weights).is_file():
                raise OutputError(f"{out / backend.weights}: is not there; train again with --overwrite")
            if request.export:
                export_onnx(out / backend.weights, record or {})
            return TrainReport(out, out / backend.result, record or {})
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
                "start": backend.find_start(request.weights, preset, request.task).facts(),
            }
            if command := command_facts():
                record["command"] = command[COMMAND]
            write_json(folder / RECORD, record, durable=True)
            record["prepared"] = write_training_data(wanted, folder, request)
            write_json(folder / RECORD, record, durable=True)
        if "epochs_done" not in record:
            record = run_trainer(folder, record, preset, device, on_progress)
        _remove_working_files(folder)
        if request.export or backend.result == ONNX_WEIGHTS:
            export_onnx(folder / backend.weights, record)
        space.finish(record)
    return TrainReport(out, out / backend.result, record)


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
    record = {"backend": "ultralytics"} | _flat(record)  # which earlier versions did not record
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
