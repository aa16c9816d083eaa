"""Where a training starts: a file, a usual name where there is a network, or nothing at all."""

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

from infrablend.core.files import write_bytes
from infrablend.core.user_folders import weights_folder
from infrablend.errors import FetchError, MissingDependencyError
from infrablend.training.presets import SUFFIX, Preset

SCRATCH = "scratch"
AUTO = "auto"
# Where Ultralytics publishes its weights.
_ADDRESS = "https://github.com/ultralytics/assets/releases/latest/download/{name}"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}\.pt")
_TIMEOUT_S = 10
# The first version that what is done here was tested with: older ones build their loaders otherwise.
ULTRALYTICS = (8, 4, 190)

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Start:
    """What a network begins with.

    Attributes:
        model: What Ultralytics is given: a file of weights, or the name of a network's description.
        kind: `scratch`, `file` or `published`.
        why: For the record, e.g. why there are no weights.
    """

    model: str
    kind: str
    why: str = ""


def find_start(wanted: str, preset: Preset, task: str, cache: Path | None = None) -> Start:
    """Return the weights to start from.

    Args:
        wanted: A file, a name such as `yolov8s.pt`, `scratch`, or `auto`: the preset's own published weights if they
            can be had, else from scratch.
        preset: Names the network.
        task: One of `presets.TASKS`.
        cache: Folder for downloaded weights; `core.user_folders.weights_folder()` by default.

    Raises:
        FetchError: No such file, and no such published weights within reach.
    """
    own = f"{preset.model}{SUFFIX[task]}"
    if wanted == SCRATCH:
        return Start(f"{own}.yaml", "scratch", "asked for")
    path = Path(wanted)
    if wanted != AUTO and _is_file(path):
        return Start(str(path.resolve()), "file")
    name = f"{own}.pt" if wanted == AUTO else wanted
    require_known(wanted)
    if not _NAME.fullmatch(name):
        return Start(f"{own}.yaml", "scratch", f"{name} is no name of published weights")
    try:
        return Start(str(_published(name, cache or weights_folder())), "published", name)
    except FetchError as error:
        if wanted != AUTO:
            raise
        return Start(f"{own}.yaml", "scratch", f"{name} could not be had: {error.message}")


def require_known(wanted: str) -> None:
    """Raise FetchError if that is no file, no name that published weights might have, and neither word."""
    if wanted not in (SCRATCH, AUTO) and not _is_file(Path(wanted)) and not _NAME.fullmatch(wanted):
        raise FetchError(
            f"--weights {wanted}: no such file; expected a .pt file, a name such as yolov8s.pt, or scratch"
        )


def missing_packages() -> list[str]:
    """Those of Ultralytics and torch that are not installed."""
    from importlib.util import find_spec

    return [name for name in ("ultralytics", "torch") if find_spec(name) is None]


def require_ultralytics() -> None:
    """Raise MissingDependencyError, saying what to install, where Ultralytics or torch is missing or too old."""
    missing = missing_packages()
    if missing:
        raise MissingDependencyError(
            f"{' and '.join(missing)} not installed, which training and prediction need; install with\n"
            '  pip install "infrablend[train]"\n(in a checkout: make train)'
        )
    try:
        found = metadata.version("ultralytics")
    except metadata.PackageNotFoundError:  # put on the path by hand: it cannot be asked
        return
    if tuple(int(n) for n in re.findall(r"\d+", found)[:3]) < ULTRALYTICS:
        raise MissingDependencyError(
            f"ultralytics {found} is installed; expected {'.'.join(map(str, ULTRALYTICS))} or later; upgrade with\n"
            '  pip install --upgrade "infrablend[train]"\n(in a checkout: make train)'
        )


def _published(name: str, folder: Path) -> Path:
    """Return the file of that name from the cache, or downloaded whole into it."""
    path = folder / name
    said = ""
    if path.is_file():
        if zipfile.is_zipfile(path):
            return path
        path.unlink()
        said = f"{path} was no whole file of weights and is deleted; "
        log.warning("%sit is downloaded anew", said)
    address = _ADDRESS.format(name=name)
    todo = f"put the file there by hand ({path}), name a file with --weights, or train from --weights {SCRATCH}"
    try:
        with urllib.request.urlopen(address, timeout=_TIMEOUT_S) as answer:
            data = answer.read()
    except http.client.IncompleteRead as error:
        raise FetchError(f"{said}{address}: broke off ({error}); run the command again") from error
    except (OSError, http.client.HTTPException) as error:
        raise FetchError(f"{said}{address}: {getattr(error, 'reason', None) or error!r}; {todo}") from error
    if not zipfile.is_zipfile(io.BytesIO(data)):  # a page of a proxy that asks for a password, say
        start = repr(data[:20].decode("utf-8", "replace"))
        raise FetchError(
            f"{said}{address}: {len(data)} bytes that begin {start}; expected weights (a zip file); {todo}"
        )
    return write_bytes(path, data, durable=True)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name too long, say
        return False
