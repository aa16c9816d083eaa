"""Start weights of a training: a file, published weights by name, or none (training from scratch)."""

from __future__ import annotations

import http.client
import io
import logging
import pickle
import re
import urllib.request
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend.core.file_names import real_path
from infrablend.core.files import sha256_of, weights_folder, write_bytes
from infrablend.detection.detections import TASKS, Task
from infrablend.errors import FetchError, ModelError
from infrablend.lab.training.presets import SUFFIX, Preset
from infrablend.lab.training.training_record import StartFacts

SCRATCH = "scratch"
AUTO = "auto"
# Address of Ultralytics' published weights.
_ADDRESS = "https://github.com/ultralytics/assets/releases/latest/download/{name}"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}\.pt")
_TIMEOUT_S = 10

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StartWeights:
    """Start weights of a network.

    Attributes:
        model: Argument for the library: a file of weights, or the name of a network or its description.
        kind: `scratch`, `file` or `published`.
        why: Reason for the record, such as why published weights are not used.
        network: Name of the network, which a file of weights brings along; empty if unknown.
    """

    model: str
    kind: str
    why: str = ""
    network: str = ""

    def facts(self) -> StartFacts:
        """Return the fields as `train.json` has them."""
        return {"model": self.model, "kind": self.kind, "why": self.why, "network": self.network}


def find_yolox_start(wanted: str, preset: Preset) -> StartWeights:
    """Return the weights of YOLOX to start from; none are downloaded.

    Raises:
        FetchError: There is no such file.
    """
    if wanted == SCRATCH:
        return StartWeights(preset.model, "scratch", "requested", preset.model)
    if wanted == AUTO:
        return StartWeights(preset.model, "scratch", "no weights of YOLOX are downloaded", preset.model)
    path = Path(wanted)
    if not _is_file(path):
        raise FetchError(f"--weights {wanted}: no such file; expected a .pth file of YOLOX, or {SCRATCH}")
    return StartWeights(str(real_path(path)), "file", network=preset.model)


def find_start(wanted: str, preset: Preset, task: Task, cache: Path | None = None) -> StartWeights:
    """Return the weights to start from, after downloading them if needed.

    Args:
        wanted: A file, a name such as `yolov8s.pt`, `scratch`, or `auto`: the preset's published weights if they are
            available, else from scratch.
        preset: Settings that name the network.
        task: Task of the network.
        cache: Folder for downloaded weights; `core.files.weights_folder()` by default.

    Raises:
        FetchError: There is no such file, and published weights of that name cannot be downloaded.
        ModelError: The file is damaged, or its network is for another task.
    """
    own = f"{preset.model}{SUFFIX[task]}"
    if wanted == SCRATCH:
        return StartWeights(f"{own}.yaml", "scratch", "requested", own)
    require_known(wanted, task)
    path = Path(wanted)
    if wanted != AUTO and _is_file(path):
        return StartWeights(str(real_path(path)), "file", network=network_of(wanted, preset, task))
    name = f"{own}.pt" if wanted == AUTO else wanted
    if not _NAME.fullmatch(name):
        return StartWeights(f"{own}.yaml", "scratch", f"{name} is not a name of published weights", own)
    try:
        found = _published(name, cache or weights_folder())
    except FetchError as error:
        if wanted != AUTO:
            raise FetchError(f"--weights {wanted}: no file {path.absolute()}; {error.message}") from error
        return StartWeights(f"{own}.yaml", "scratch", f"{name} is not available: {error.message}", own)
    require_known(str(found), task)
    return StartWeights(str(found), "published", name, _read_network(found)[1])


def require_known(wanted: str, task: Task | None = None) -> None:
    """Check that `wanted` is a file, for the task if one is given, a possible published name, `scratch` or `auto`.

    Raises:
        FetchError: It is none of these.
        ModelError: The file is damaged, or its network is for another task.
    """
    path = Path(wanted)
    if wanted in (SCRATCH, AUTO):
        return
    if not _is_file(path):
        if not _NAME.fullmatch(wanted):
            raise FetchError(
                f"--weights {wanted}: no such file; expected a .pt file, a name such as yolov8s.pt, or scratch"
            )
    elif path.suffix.lower() == ".pt":
        if not zipfile.is_zipfile(path):
            raise ModelError(f"--weights {wanted}: damaged, or no weights; expected a complete .pt file")
        found, _ = _read_network(path)
        if task is not None and found not in ("", task):
            raise ModelError(f"--weights {wanted}: weights for {found}; expected {task}")


def identify(wanted: str) -> tuple[str, str | None]:
    """Return what tells start weights apart wherever they lie: their name, and the SHA-256 of a file."""
    path = Path(wanted)
    return (path.name, sha256_of(path)) if wanted not in (SCRATCH, AUTO) and _is_file(path) else (wanted, None)


def network_of(wanted: str, preset: Preset, task: Task) -> str:
    """Return the name of the network that is trained: the preset's, or that of a file; empty if unknown."""
    path = Path(wanted)
    if wanted in (SCRATCH, AUTO):
        return f"{preset.model}{SUFFIX[task]}"
    if path.suffix.lower() == ".pt":
        return _read_network(path)[1]
    return path.stem


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


class _Part:
    """Stand-in for any object of a pickle, with its attributes."""

    def __init__(self, *args: Any) -> None:
        pass

    def __setitem__(self, key: Any, value: Any) -> None:
        pass


class _Skeleton(pickle.Unpickler):
    """Reads plain values; everything else becomes a `_Part`, so no code of the file runs."""

    def find_class(self, module: str, name: str) -> Any:
        return _Part

    def persistent_load(self, pid: Any) -> Any:
        return None


def _read_network(path: Path) -> tuple[str, str]:
    """Return the task and the name of the network in a .pt file; empty if unknown."""
    try:
        with zipfile.ZipFile(path) as file:
            name = next(n for n in file.namelist() if n.endswith("data.pkl"))
            content = _Skeleton(io.BytesIO(file.read(name))).load()
        network = (content.get("ema") or content["model"]).yaml
        head = network["head"][-1][2].lower()  # such as Detect or OBB26
        return next((t for t in (*TASKS, "pose", "classify") if t in head), ""), Path(network["yaml_file"]).stem
    except Exception:  # a pickle can contain anything
        return "", ""


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # such as a name that is too long
        return False
