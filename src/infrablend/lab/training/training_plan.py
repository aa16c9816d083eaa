"""Plan of a training: images, epochs, time and disk space; and what it requires of device, settings and disk."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from infrablend.core.dataset import Dataset
from infrablend.core.workspace import Existing, partial_of, workspace
from infrablend.detection import tiles, ultralytics_environment
from infrablend.detection.training_folder import RECORD
from infrablend.errors import OutputError, Problem
from infrablend.lab.training import presets, start_weights
from infrablend.lab.training.presets import PRESETS, Preset
from infrablend.lab.training.train_request import PRESET_FIELDS, TrainRequest
from infrablend.lab.training.training_data import most_tiles, select_training_data

# Arguments of Ultralytics that follow from the request and its folder, and what to give in their place.
_OF_TRAINER = {
    "imgsz": "--set image_size", "device": "--device", "seed": "--seed", "val": "--set patience",
    "pretrained": "--weights", "task": "--task",
    **dict.fromkeys(
        ("data", "mode", "project", "name", "save_dir", "exist_ok", "resume", "single_cls"), "nothing in its place"
    ),
}  # fmt: skip


@dataclass(frozen=True)
class TrainPlan:
    """Plan of a training.

    Attributes:
        images: Number of pictures, or of tiles cut from them, in the train split.
        labels: Number of labels in the train split.
        epochs: Maximum number of epochs.
        shown: Images shown per epoch.
        tiled: Whether `images` are tiles.
        device: Ultralytics' name of the device.
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
    require_arguments(preset)
    start_weights.require_known(request.weights, request.task)
    if out is not None and (out.exists() or partial_of(out).exists()):
        # Nothing is deleted: what may be replaced may also be resumed.
        with workspace(out, "training", RECORD, "refuse" if existing == "refuse" else "resume", keep=True):
            pass
    wanted, _ = select_training_data(dataset, request)
    return plan_of(wanted, device, request)


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
        images=images, labels=labels, epochs=epochs, shown=shown, tiled=preset.tile > 0, device=device,
        seconds=presets.estimate_seconds(preset, images, gpu=device != "cpu", threads=presets.cpu_threads()),
        disk_bytes=round(size + presets.weights_bytes(preset)), weights=Path(request.weights).name,
        network=start_weights.network_of(request.weights, preset, request.task),
    )  # fmt: skip


def choose_device(wanted: str, *, planning: bool = False) -> str:
    """Return Ultralytics' name of a device: `cpu`, `mps` or the number of a GPU.

    For a plan where torch is not installed, `auto` is the processor.
    """
    number = wanted.removeprefix("cuda:")
    if "," in wanted:
        raise OutputError(f"--device {wanted}: several GPUs; expected one, such as {number.partition(',')[0]}")
    if wanted not in ("auto", "cpu", "cuda", "mps") and not (number.isascii() and number.isdigit()):
        raise OutputError(f"--device {wanted}: no such device; expected auto, cpu, mps, cuda, or a GPU such as cuda:1")
    if wanted == "cpu" or (planning and wanted == "auto" and find_spec("torch") is None):
        return "cpu"
    if planning:
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


def require_arguments(preset: Preset) -> None:
    """Raise OutputError for arguments of the user that the trainer sets itself, or that Ultralytics refuses.

    The latter are not checked where Ultralytics is missing. That check is slow: the presets' own arguments skip it.
    """
    fixed = [k for k in _OF_TRAINER if k in preset.arguments]
    if fixed:
        raise OutputError(
            "settings of the training",
            [Problem(f"--set {k}", "setting-malformed", "an argument that InfraBlend sets itself", _OF_TRAINER[k])
             for k in fixed],
        )  # fmt: skip
    own = PRESETS[preset.name].arguments if preset.name in PRESETS else {}
    given = {k: v for k, v in preset.arguments.items() if k not in own or own[k] != v}
    wrong = (
        ultralytics_environment.wrong_arguments(given)
        if given and not ultralytics_environment.missing_packages()
        else ""
    )
    if wrong:
        where = " ".join(f"--set {k}" for k in given)
        raise OutputError(
            "settings of the training",
            [Problem(where, "setting-malformed", wrong, f"fields ({', '.join(PRESET_FIELDS)}) or Ultralytics' own")],
        )
