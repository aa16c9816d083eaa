"""Check whether this machine can run InfraBlend: `survey` gathers facts, `assess` rates them, `diagnose` does both.

Blender and torch are asked in processes of their own: this module then needs neither, and survives a broken one.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from infrablend.core.files import cache_folder, existing_part, free_bytes
from infrablend.core.machine import installed_version, usable_cores, usable_memory_bytes
from infrablend.core.operating_system import memory_folder
from infrablend.errors import InfraBlendError, MissingDependencyError
from infrablend.rendering.engine.process import blender_process
from infrablend.rendering.engine.programs import TODO, VARIABLE, Program, absence, candidates
from infrablend.rendering.engine.system_libraries import install_command, missing_packages

Status = Literal["ok", "warning", "error"]

SUPPORTED_PYTHON = (3, 11), (3, 13)

# Measured: a worker stays under 1 GiB; a 640 x 512 frame with all its labels takes about 0.3 MB.
LITTLE_MEMORY_BYTES = 2 * 1024**3
NO_DISK_BYTES = 200 * 1024**2
LITTLE_DISK_BYTES = 2 * 1024**3
LITTLE_SHM_BYTES = 64 * 1024**2
MUCH_CACHE_BYTES = 10 * 1024**3

_ASK_TORCH_S = 60.0
_ASK_TORCH = """
import json, os
stdout = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)
import torch
there = torch.cuda.is_available()
names = [torch.cuda.get_device_name(k) for k in range(torch.cuda.device_count())] if there else []
stdout.write(json.dumps({"devices": names}))
"""
_NOT_INSTALLED = 'not installed: make train, or pip install "infrablend[train]"'


@dataclass(frozen=True)
class Check:
    """One check: its name, its status, what was found, and the remedy (empty if none is needed)."""

    name: str
    status: Status
    found: str
    todo: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """All checks of a machine."""

    checks: tuple[Check, ...]

    @property
    def ok(self) -> bool:
        """True if a run can work; warnings do not prevent it."""
        return all(c.status != "error" for c in self.checks)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {"ok": self.ok, "checks": [asdict(c) for c in self.checks]}


@dataclass(frozen=True)
class Blender:
    """A Blender of this machine.

    Attributes:
        name: What it is, and its path.
        version: Version of Blender, or None if it cannot be used.
        devices: Names of the devices that Cycles sees, by GPU type.
        trouble: Why it cannot be used, or empty.
    """

    name: str
    version: str | None = None
    devices: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    trouble: str = ""


@dataclass(frozen=True)
class Trainer:
    """State of the packages for training and prediction.

    Attributes:
        torch: Version of torch, or None if it is not installed.
        ultralytics: Version of Ultralytics, or None.
        devices: Names of the CUDA devices that torch sees.
        trouble: Reason why torch did not answer, or empty.
    """

    torch: str | None = None
    ultralytics: str | None = None
    devices: tuple[str, ...] = ()
    trouble: str = ""


@dataclass(frozen=True)
class Machine:
    """Facts about this machine. Free space is in bytes; None means that the folder cannot be written.

    `blenders` are in the order of preference: the first one is used. `cache_bytes` is what the user's cache folder
    contains.
    """

    system: str
    architecture: str
    python: tuple[int, int, int]
    blenders: tuple[Blender, ...]
    missing_packages: tuple[str, ...]
    cores: float
    memory_bytes: int
    free_bytes: Mapping[str, int | None]
    temp_folder: str
    free_temp_bytes: int | None
    free_shm_bytes: int | None
    trainer: Trainer
    cache_folder: str
    cache_bytes: int


def survey(folder: str | Path | None = None) -> Machine:
    """Return facts about this machine; it takes a few seconds because Blender is started.

    Args:
        folder: Folder for the output, by default the current one. It need not exist.
    """
    folder = Path(folder or ".").absolute()
    temp = Path(tempfile.gettempdir())
    cache = cache_folder()
    memory = memory_folder()
    return Machine(
        system=platform.system(),
        architecture=platform.machine(),
        python=sys.version_info[:3],
        blenders=_ask_blenders(),
        missing_packages=missing_packages(),
        cores=usable_cores(),
        memory_bytes=usable_memory_bytes(),
        free_bytes={str(folder): _free_bytes(folder)},
        temp_folder=str(temp),
        free_temp_bytes=_free_bytes(temp),
        free_shm_bytes=_free_bytes(memory) if memory else None,
        trainer=_ask_trainer(_ASK_TORCH_S),
        cache_folder=str(cache),
        cache_bytes=_bytes_in(cache),
    )


def assess(machine: Machine) -> Diagnosis:
    """Return the checks of the facts, in the order in which they are shown."""
    return Diagnosis(
        (
            _check_system(machine),
            _check_python(machine),
            _check_libraries(machine),
            *_check_blenders(machine),
            _check_torch(machine),
            Check("Ultralytics", "ok", machine.trainer.ultralytics or _NOT_INSTALLED),
            Check("cores", "ok", f"{machine.cores:g} usable"),
            _check_memory(machine),
            *(_check_space("disk", name, free) for name, free in sorted(machine.free_bytes.items())),
            _check_space("temporary folder", machine.temp_folder, machine.free_temp_bytes),
            *([_check_shm(machine.free_shm_bytes)] if machine.system == "Linux" else []),
            _check_cache(machine),
        )
    )


def diagnose(folder: str | Path | None = None) -> Diagnosis:
    """Check whether a run that writes to `folder` (by default the current one) can work on this machine."""
    return assess(survey(folder))


def _check_system(m: Machine) -> Check:
    found = f"{m.system} {m.architecture}"
    if found == "Linux x86_64":
        return Check("system", "ok", found)
    return Check("system", "warning", found, "only Linux on x86_64 is tested; please report how it works")


def _check_python(m: Machine) -> Check:
    found, oldest, newest = (".".join(map(str, version)) for version in (m.python, *SUPPORTED_PYTHON))
    if SUPPORTED_PYTHON[0] <= m.python[:2] <= SUPPORTED_PYTHON[1]:
        return Check("Python", "ok", found)
    return Check("Python", "warning", found, f"use Python {oldest} to {newest}: no other one is tested")


def _check_libraries(m: Machine) -> Check:
    if not m.missing_packages:
        return Check("system libraries", "ok", "complete")
    found = "missing (Debian names): " + " ".join(m.missing_packages)
    needed: Status = "error" if any(b.version is None for b in m.blenders[:1]) else "warning"
    return Check("system libraries", needed, found, "for Blender, run: " + install_command(m.missing_packages))


def _check_blenders(m: Machine) -> list[Check]:
    """Return the checks of the Blender that is used, of its devices, and of others."""
    if not m.blenders:
        found, todo = absence()
        use = "`quality: paper`, bare metal, 3D files of your own and `world` without `--engine lattice` need it"
        return [Check("Blender", "warning", found, f"{use}. {todo}")]
    first, *others = m.blenders
    if first.version is None:
        checks = [Check("Blender", "error", f"{first.name}: {first.trouble}", f"{TODO}, or name another: {VARIABLE}")]
    else:
        gpus = [f"{kind.lower()}: {', '.join(names)}" for kind, names in first.devices.items() if names]
        checks = [
            Check("Blender", "ok", f"{first.version}, {first.name}"),
            Check("Cycles devices", "ok", "; ".join(["cpu", *gpus]) if gpus else "cpu only"),
        ]
    for other in others:
        found = f"{other.version}, {other.name}" if other.version else f"{other.name}: {other.trouble}"
        checks.append(Check("other Blender", "ok", f"{found}; not used"))
    return checks


def _check_torch(m: Machine) -> Check:
    # Training is an extra: everything else works without torch.
    t = m.trainer
    if t.torch is None:
        return Check("torch", "ok", _NOT_INSTALLED)
    if t.trouble:
        return Check("torch", "warning", f"{t.torch}, does not work: {t.trouble}", "reinstall it: make train")
    found = f"CUDA devices: {', '.join(t.devices)}" if t.devices else "no CUDA device"
    return Check("torch", "ok", f"{t.torch}, {found}")


def _check_memory(m: Machine) -> Check:
    found = f"{_size(m.memory_bytes)} available"
    if m.memory_bytes >= LITTLE_MEMORY_BYTES:
        return Check("memory", "ok", found)
    return Check("memory", "warning", found, "a worker needs up to 1 GiB: run with --workers 1")


def _check_space(name: str, folder: str, free: int | None) -> Check:
    if free is None:
        return Check(name, "error", f"{folder} cannot be written", "choose another folder or change its permissions")
    found = f"{_size(free)} free in {folder}"
    if free < NO_DISK_BYTES:
        return Check(name, "error", found, "free some space")
    if free < LITTLE_DISK_BYTES:
        return Check(name, "warning", found, "`infrablend generate ... --plan` shows how much a run needs")
    return Check(name, "ok", found)


def _check_shm(free: int | None) -> Check:
    if free is None:
        found = "missing or cannot be written"
        todo = "mount it, see man shm_overview: worker processes use it"
        return Check("shared memory", "warning", found, todo)
    found = f"{_size(free)} free"
    if free < LITTLE_SHM_BYTES:
        return Check("shared memory", "warning", found, "give the container more, e.g. docker run --shm-size=1g")
    return Check("shared memory", "ok", found)


def _check_cache(m: Machine) -> Check:
    found = f"{_size(m.cache_bytes)} in {m.cache_folder}"
    if m.cache_bytes <= MUCH_CACHE_BYTES:
        return Check("cache", "ok", found)
    todo = "delete the folder if space is short: what is needed is made or downloaded again"
    return Check("cache", "warning", found, todo)


def _size(n_bytes: int) -> str:
    return f"{n_bytes / 1024**3:.1f} GiB"


def _ask_blenders() -> tuple[Blender, ...]:
    """Start each Blender of this machine in turn, and return what it says of itself."""
    found = []
    try:
        for program in candidates():
            found.append(_ask_blender(program))
    except MissingDependencyError as error:
        found.append(Blender("the one that INFRABLEND_BLENDER names", trouble=error.message))
    return tuple(found)


def _ask_blender(program: Program) -> Blender:
    try:
        with blender_process(program) as process:
            process.greet()
            devices = {kind: tuple(names) for kind, names in process.ask("devices").items()}
            return Blender(str(program), process.greeting["blender"], devices)
    except InfraBlendError as error:
        return Blender(str(program), trouble=error.message)


def _ask_trainer(limit_s: float) -> Trainer:
    """Return the versions, and the devices that torch sees in a process of its own."""
    torch = installed_version("torch")
    ultralytics = installed_version("ultralytics")
    if torch is None:
        return Trainer(None, ultralytics)
    try:
        # A file of ours in the current folder must not be imported in place of the real thing: -P.
        command = [sys.executable, "-P", "-c", _ASK_TORCH]
        done = subprocess.run(command, capture_output=True, timeout=limit_s, check=False)
    except subprocess.TimeoutExpired:
        return Trainer(torch, ultralytics, trouble=f"no answer within {limit_s:g} s")
    except OSError as error:
        return Trainer(torch, ultralytics, trouble=str(error))
    try:
        return Trainer(torch, ultralytics, tuple(json.loads(done.stdout)["devices"]))
    except ValueError:
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        trouble = lines[-1] if lines else f"it ended with code {done.returncode} and no answer"
        return Trainer(torch, ultralytics, trouble=trouble)


def _free_bytes(folder: Path) -> int | None:
    """Return the free bytes on the disk of `folder`, which need not exist; None if it cannot be written."""
    existing = existing_part(folder)
    if not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
        return None
    return free_bytes(existing)


def _bytes_in(folder: Path) -> int:
    """Return the size of all files below a folder; those that cannot be read count nothing."""
    total = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            with contextlib.suppress(OSError):
                total += Path(parent, name).lstat().st_size
    return total
