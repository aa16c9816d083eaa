"""Ultralytics kept to itself: no network, no settings outside our folder, and no torchvision where none can work."""

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


def settle_ultralytics(folder: Path) -> None:
    """To be called before Ultralytics is imported: settings go into `folder`; no installs, no reports, no network."""
    folder.mkdir(parents=True, exist_ok=True)
    os.environ.update(
        YOLO_CONFIG_DIR=str(folder), YOLO_OFFLINE="1", YOLO_AUTOINSTALL="0", YOLO_VERBOSE="1", WANDB_MODE="disabled"
    )
    _settle_torchvision()


@contextlib.contextmanager
def quiet_ultralytics() -> Iterator[None]:
    """While entered, Ultralytics may be used in this process: settled if it is not yet imported, and silent."""
    if "ultralytics" not in sys.modules:
        # Read on import; nothing in there is of use to us, so that it may go with the next clean-up.
        folder = Path(tempfile.gettempdir()) / f"infrablend-ultralytics-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        settle_ultralytics(folder)
    from ultralytics.utils import LOGGER

    before = LOGGER.level
    LOGGER.setLevel(logging.ERROR)
    try:
        yield
    finally:
        LOGGER.setLevel(before)


def wrong_arguments(arguments: Mapping[str, Any]) -> str:
    """Return Ultralytics' objections to training arguments; empty if there are none or it is not installed.

    Its import changes the environment; it is put back, so that a process started later has its own start.
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


def _settle_torchvision() -> None:
    """Put a stand-in in place of torchvision where it does not import, as its CUDA build beside torch's CPU build.

    Detection needs one function of it, non-maximum suppression. `make train` installs such a stand-in for `yolo`, too;
    this one serves environments that somebody else put together.
    """
    try:
        import torchvision  # noqa: F401
    except Exception as error:  # RuntimeError for operators that the other build lacks
        for name in [n for n in sys.modules if n.partition(".")[0] == "torchvision"]:
            del sys.modules[name]
        from infrablend.training.suppression import nms

        stand_in, ops = ModuleType("torchvision"), ModuleType("torchvision.ops")
        stand_in.__doc__ = f"Stand-in: the real one does not import ({error})."
        stand_in.__spec__ = ModuleSpec("torchvision", None)  # find_spec raises for a module without one
        ops.nms = nms  # type: ignore[attr-defined]
        stand_in.ops = ops  # type: ignore[attr-defined]
        sys.modules |= {"torchvision": stand_in, "torchvision.ops": ops}


def has_fast_bfloat16(torch: Any) -> bool:
    """Whether the processor has matrix units for it; elsewhere it is slower than float32."""
    known = getattr(torch.cpu, "_is_amx_tile_supported", None)
    return bool(known and known())
