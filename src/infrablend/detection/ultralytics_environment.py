"""Environment for Ultralytics: no network, no settings outside our folder, a stand-in where torchvision fails.

The package registry has torchvision for Linux with CUDA only. Its compiled operators do not load beside the CPU build
of torch, and detection needs one of them, `nms`. Ultralytics' own replacement handles one detection at a time with
torch operations, which takes longer than the network. It also sorts unstably, so that the order of equal scores, and
thus the result, depends on the processor.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import sys
import tempfile
from collections.abc import Iterator, Mapping
from importlib import metadata
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.operating_system import user_id
from infrablend.errors import MissingDependencyError

if TYPE_CHECKING:
    from torch import Tensor

_BLOCK = 64
# Oldest version that we have tested; older ones build their data loaders differently.
ULTRALYTICS = (8, 4, 190)


def configure_ultralytics(folder: Path) -> None:
    """Prepare for the import of Ultralytics: settings in `folder`, no installs, no telemetry, no network."""
    folder.mkdir(parents=True, exist_ok=True)
    os.environ.update(
        YOLO_CONFIG_DIR=str(folder), YOLO_OFFLINE="1", YOLO_AUTOINSTALL="0", YOLO_VERBOSE="1", WANDB_MODE="disabled"
    )
    replace_broken_torchvision()


@contextlib.contextmanager
def quiet_ultralytics() -> Iterator[None]:
    """Return a context in which Ultralytics is set up and logs errors only.

    Its import changes environment variables, such as the number of threads, which are restored for later trainings.
    """
    environment = dict(os.environ)
    try:
        if "ultralytics" not in sys.modules:
            # It reads its settings on import; we need none of them, so the folder may be cleaned up at any time.
            folder = Path(tempfile.gettempdir()) / f"infrablend-ultralytics-{user_id()}"
            folder.mkdir(mode=0o700, exist_ok=True)
            configure_ultralytics(folder)
        from ultralytics.utils import LOGGER
    finally:
        os.environ.clear()
        os.environ.update(environment)

    before = LOGGER.level
    LOGGER.setLevel(logging.ERROR)
    try:
        yield
    finally:
        LOGGER.setLevel(before)


def wrong_arguments(arguments: Mapping[str, object]) -> str:
    """Return Ultralytics' error message about training arguments; empty if they are valid or cannot be checked."""
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
    return ""


def replace_broken_torchvision() -> None:
    """Replace torchvision by a stand-in if it fails to import, like its CUDA build beside the CPU build of torch.

    Detection needs one of its functions, non-maximum suppression. `make train` also installs such a stand-in for the
    command `yolo`; this one serves environments that were set up without `make train`.
    """
    try:
        import torchvision  # noqa: F401
    except Exception as error:  # RuntimeError for operators that the other build lacks
        for name in [n for n in sys.modules if n.partition(".")[0] == "torchvision"]:
            del sys.modules[name]
        stand_in = ModuleType("torchvision")
        ops = ModuleType("torchvision.ops")
        stand_in.__doc__ = f"Stand-in: the real one does not import ({error})."
        stand_in.__spec__ = ModuleSpec("torchvision", None)  # find_spec raises for modules without a spec
        ops.nms = nms  # type: ignore[attr-defined]
        stand_in.ops = ops  # type: ignore[attr-defined]
        sys.modules |= {"torchvision": stand_in, "torchvision.ops": ops}


def has_fast_bfloat16(torch: Any) -> bool:
    """Return whether the processor has matrix units for bfloat16; on others it is slower than float32."""
    known = getattr(torch.cpu, "_is_amx_tile_supported", None)
    return bool(known and known())


def nms(boxes: Tensor, scores: Tensor, iou_threshold: float) -> Tensor:
    """Return the indices of the boxes that non-maximum suppression keeps, like `torchvision.ops.nms`.

    Args:
        boxes: (n, 4) left, top, right, bottom.
        scores: (n,) confidences; equal ones keep their order.
        iou_threshold: Intersection over union above which the box with the lower score is dropped.

    Returns:
        (k,) int64 indices, highest score first, on the device of `boxes`.
    """
    import torch

    kept = kept_indices(boxes.detach().float().cpu().numpy(), scores.detach().float().cpu().numpy(), iou_threshold)
    return torch.from_numpy(kept).to(boxes.device)


def kept_indices(
    boxes_xyxy: NDArray[np.float32], scores: NDArray[np.float32], iou_threshold: float
) -> NDArray[np.int64]:
    """Return the indices that `nms` returns, for arrays.

    Boxes are processed in blocks of descending score: the boxes kept so far suppress boxes of the block at once, then
    the remaining boxes of the block suppress each other one by one.
    """
    order = np.argsort(-scores, kind="stable")
    boxes = boxes_xyxy[order]
    kept = np.zeros(0, np.int64)
    for start in range(0, len(boxes), _BLOCK):
        block = np.arange(start, min(start + _BLOCK, len(boxes)))
        block = block[~(_iou(boxes[kept], boxes[block]) > iou_threshold).any(axis=0)]
        hides = _iou(boxes[block], boxes[block]) > iou_threshold
        hidden = np.zeros(len(block), np.bool_)
        for k in range(len(block)):
            if not hidden[k]:
                hidden[k + 1 :] |= hides[k, k + 1 :]
        kept = np.concatenate([kept, block[~hidden]])
    return order[kept]


def _iou(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, m) intersection over union, in the order of operations of torchvision; NaN where both boxes are empty."""
    left, top = (np.maximum(a[:, None, k], b[None, :, k]) for k in (0, 1))
    right, bottom = (np.minimum(a[:, None, k], b[None, :, k]) for k in (2, 3))
    shared = np.maximum(right - left, 0) * np.maximum(bottom - top, 0)
    areas_a, areas_b = ((x[:, 2] - x[:, 0]) * (x[:, 3] - x[:, 1]) for x in (a, b))
    with np.errstate(divide="ignore", invalid="ignore"):
        overlap: NDArray[np.float32] = shared / (areas_a[:, None] + areas_b[None] - shared)
    return overlap


def missing_packages() -> list[str]:
    """Return which of Ultralytics and torch are not installed."""
    from importlib.util import find_spec

    return [name for name in ("ultralytics", "torch") if find_spec(name) is None]


def require_ultralytics() -> None:
    """Raise MissingDependencyError with the command to run if Ultralytics or torch is missing or too old."""
    missing = missing_packages()
    if missing:
        raise MissingDependencyError(
            f"{' and '.join(missing)} not installed, which training and prediction need; install with\n"
            '  pip install "infrablend[train]"\n(in a checkout: make train)'
        )
    try:
        found = metadata.version("ultralytics")
    except metadata.PackageNotFoundError:  # on the path without being installed: its version is unknown
        return
    if tuple(int(n) for n in re.findall(r"\d+", found)[:3]) < ULTRALYTICS:
        raise MissingDependencyError(
            f"ultralytics {found} is installed; expected {'.'.join(map(str, ULTRALYTICS))} or later; upgrade with\n"
            '  pip install --upgrade "infrablend[train]"\n(in a checkout: make train)'
        )
