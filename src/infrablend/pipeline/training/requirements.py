"""Requirements of a training: device, settings, disk space."""

from __future__ import annotations

import shutil
from importlib.util import find_spec
from pathlib import Path

from infrablend.errors import OutputError, Problem
from infrablend.training import environment, weights
from infrablend.training.presets import PRESETS, Preset
from infrablend.training.request import PRESET_FIELDS


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
        weights.require_ultralytics()
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
    found = f"finds {there} GPU{'s' * (there > 1)}, numbered from 0" if there else "finds no GPU"
    raise OutputError(
        f"--device {wanted}: torch {torch.__version__} {found}; expected one of them, or --device cpu. "
        "infrablend doctor lists the devices"
    )


def require_settings(preset: Preset) -> None:
    """Raise OutputError for settings that the trainer would refuse; without Ultralytics nothing is checked."""
    if not weights.missing_packages():
        require_arguments(preset)


def require_arguments(preset: Preset) -> None:
    """Raise OutputError if Ultralytics refuses arguments set by the user; the check is slow, so presets skip it."""
    own = PRESETS[preset.name].arguments if preset.name in PRESETS else {}
    given = {k: v for k, v in preset.arguments.items() if k not in own or own[k] != v}
    wrong = environment.wrong_arguments(given) if given else ""
    if wrong:
        where = " ".join(f"--set {k}" for k in given)
        raise OutputError(
            "settings of the training",
            [Problem(where, "setting-malformed", wrong, f"fields ({', '.join(PRESET_FIELDS)}) or Ultralytics' own")],
        )


def require_space(out: Path, disk_bytes: int) -> None:
    """Raise OutputError if the disk has less free space than a training needs."""
    need = disk_bytes * 1.2
    free = shutil.disk_usage(out).free
    if free < need:
        found = f"{free / 1e6:.0f} MB free"
        problem = Problem(str(out), "disk-full", found, f"{need / 1e6:.0f} MB", "free some, or give a folder elsewhere")
        raise OutputError(f"{out}: not enough disk space for the training", [problem])
