"""Start weights of a training: a file, published weights by name, or none (training from scratch)."""

from __future__ import annotations

import http.client
import io
import logging
import re
import urllib.request
import zipfile
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from infrablend.core.file_names import real_path
from infrablend.core.files import write_bytes
from infrablend.core.user_folders import weights_folder
from infrablend.errors import FetchError, MissingDependencyError
from infrablend.evaluation.detections import Task
from infrablend.training.presets import SUFFIX, Preset

SCRATCH = "scratch"
AUTO = "auto"
# Address of Ultralytics' published weights.
_ADDRESS = "https://github.com/ultralytics/assets/releases/latest/download/{name}"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}\.pt")
_TIMEOUT_S = 10
# Oldest version that we have tested; older ones build their data loaders differently.
ULTRALYTICS = (8, 4, 190)

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StartWeights:
    """Start weights of a network.

    Attributes:
        model: Argument for Ultralytics: a file of weights, or the name of a network description.
        kind: `scratch`, `file` or `published`.
        why: Reason for the record, such as why published weights are not used.
    """

    model: str
    kind: str
    why: str = ""


def find_start(wanted: str, preset: Preset, task: Task, cache: Path | None = None) -> StartWeights:
    """Return the weights to start from, after downloading them if needed.

    Args:
        wanted: A file, a name such as `yolov8s.pt`, `scratch`, or `auto`: the preset's published weights if they are
            available, else from scratch.
        preset: Settings that name the network.
        task: Task of the network.
        cache: Folder for downloaded weights; `core.user_folders.weights_folder()` by default.

    Raises:
        FetchError: There is no such file, and published weights of that name cannot be downloaded.
    """
    own = f"{preset.model}{SUFFIX[task]}"
    if wanted == SCRATCH:
        return StartWeights(f"{own}.yaml", "scratch", "requested")
    path = Path(wanted)
    if wanted != AUTO and _is_file(path):
        return StartWeights(str(real_path(path)), "file")
    name = f"{own}.pt" if wanted == AUTO else wanted
    require_known(wanted)
    if not _NAME.fullmatch(name):
        return StartWeights(f"{own}.yaml", "scratch", f"{name} is not a name of published weights")
    try:
        return StartWeights(str(_published(name, cache or weights_folder())), "published", name)
    except FetchError as error:
        if wanted != AUTO:
            raise
        return StartWeights(f"{own}.yaml", "scratch", f"{name} is not available: {error.message}")


def require_known(wanted: str) -> None:
    """Raise FetchError unless `wanted` is a file, a possible name of published weights, `scratch` or `auto`."""
    if wanted not in (SCRATCH, AUTO) and not _is_file(Path(wanted)) and not _NAME.fullmatch(wanted):
        raise FetchError(
            f"--weights {wanted}: no such file; expected a .pt file, a name such as yolov8s.pt, or scratch"
        )


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


def _published(name: str, folder: Path) -> Path:
    path = folder / name
    note = ""
    if path.is_file():
        if zipfile.is_zipfile(path):
            return path
        path.unlink()
        note = f"{path} was not a complete file of weights and was deleted; "
        log.warning("%sdownloading it again", note)
    address = _ADDRESS.format(name=name)
    todo = f"save the file as {path}, name a file with --weights, or train with --weights {SCRATCH}"
    try:
        with urllib.request.urlopen(address, timeout=_TIMEOUT_S) as answer:
            data = answer.read()
    except http.client.IncompleteRead as error:
        raise FetchError(f"{note}{address}: the download broke off ({error}); run the command again") from error
    except (OSError, http.client.HTTPException) as error:
        raise FetchError(f"{note}{address}: {getattr(error, 'reason', None) or error!r}; {todo}") from error
    if not zipfile.is_zipfile(io.BytesIO(data)):  # such as the login page of a proxy
        start = repr(data[:20].decode("utf-8", "replace"))
        raise FetchError(
            f"{note}{address}: found {len(data)} bytes that begin {start}, expected weights (a zip file); {todo}"
        )
    return write_bytes(path, data, durable=True)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # such as a name that is too long
        return False
