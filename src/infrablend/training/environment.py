"""Environment for Ultralytics: no network, no settings outside our folder, a stand-in where torchvision fails."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any


def configure_ultralytics(folder: Path) -> None:
    """Prepare for the import of Ultralytics: settings in `folder`, no installs, no telemetry, no network."""
    folder.mkdir(parents=True, exist_ok=True)
    os.environ.update(
        YOLO_CONFIG_DIR=str(folder), YOLO_OFFLINE="1", YOLO_AUTOINSTALL="0", YOLO_VERBOSE="1", WANDB_MODE="disabled"
    )
    _replace_broken_torchvision()


@contextlib.contextmanager
def quiet_ultralytics() -> Iterator[None]:
    """Return a context in which Ultralytics is set up and logs errors only."""
    if "ultralytics" not in sys.modules:
        # Ultralytics reads its settings on import; we need none of them, so the folder may be cleaned up at any time.
        folder = Path(tempfile.gettempdir()) / f"infrablend-ultralytics-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        configure_ultralytics(folder)
    from ultralytics.utils import LOGGER

    before = LOGGER.level
    LOGGER.setLevel(logging.ERROR)
    try:
        yield
    finally:
        LOGGER.setLevel(before)


def wrong_arguments(arguments: Mapping[str, Any]) -> str:
    """Return Ultralytics' error message about training arguments; empty if they are valid or cannot be checked.

    Importing Ultralytics changes environment variables; they are restored for processes started later.
    """
    before = dict(os.environ)
    try:
        with quiet_ultralytics():
            try:
                from ultralytics.cfg import DEFAULT_CFG_DICT, check_cfg, check_dict_alignment
            except ImportError:
                return ""
            try:
                check_dict_alignment(DEFAULT_CFG_DICT, dict(arguments))
                check_cfg(dict(arguments))
            except (SyntaxError, TypeError, ValueError) as error:
                return " ".join(str(error).split()).rstrip(".")
    finally:
        os.environ.clear()
        os.environ.update(before)
    return ""


def _replace_broken_torchvision() -> None:
    """Replace torchvision by a stand-in if it fails to import, like its CUDA build beside the CPU build of torch.

    Detection needs one of its functions, non-maximum suppression. `make train` also installs such a stand-in for the
    command `yolo`; this one serves environments that were set up without `make train`.
    """
    try:
        import torchvision  # noqa: F401
    except Exception as error:  # RuntimeError for operators that the other build lacks
        for name in [n for n in sys.modules if n.partition(".")[0] == "torchvision"]:
            del sys.modules[name]
        from infrablend.training.suppression import nms

        stand_in, ops = ModuleType("torchvision"), ModuleType("torchvision.ops")
        stand_in.__doc__ = f"Stand-in: the real one does not import ({error})."
        stand_in.__spec__ = ModuleSpec("torchvision", None)  # find_spec raises for modules without a spec
        ops.nms = nms  # type: ignore[attr-defined]
        stand_in.ops = ops  # type: ignore[attr-defined]
        sys.modules |= {"torchvision": stand_in, "torchvision.ops": ops}


def has_fast_bfloat16(torch: Any) -> bool:
    """Return whether the processor has matrix units for bfloat16; on others it is slower than float32."""
    known = getattr(torch.cpu, "_is_amx_tile_supported", None)
    return bool(known and known())
