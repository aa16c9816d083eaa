"""Loads object models; the geometry of user models is imported with Blender once and then cached."""

from __future__ import annotations

import json
import logging
import os
from pathlib import Path
from typing import Any

from infrablend.assets.catalogue import load_model
from infrablend.assets.model import ObjectModel
from infrablend.assets.model_files import find_model_files, too_large
from infrablend.assets.user_model import (
    geometry_path,
    is_description,
    read_description,
    read_geometry,
    write_geometry,
)
from infrablend.core.files import read_object, replace_atomically
from infrablend.core.tasks import Task, WorkerSpec
from infrablend.errors import ModelError, Problem, RenderError
from infrablend.execution.confined import ConfinedLimits, ConfinedOutcome, run_confined
from infrablend.execution.process_pool import PoolSettings, ProcessPool
from infrablend.execution.scratch import scratch_folder

log = logging.getLogger(__name__)

IMPORTER = "infrablend.blender.importer:import_staged"
# Files that the importer reads and writes in its folder.
REQUEST, GEOMETRY, REFUSAL = "request.json", "geometry.npz", "refusal.json"
IMPORT_LIMITS = ConfinedLimits(cpu_seconds=120.0, seconds=600.0, memory_bytes=2 * 2**30)
TOO_SLOW = "model-too-slow"
# Time limit of a single job in a worker process.
JOB_TIMEOUT_S = 300.0


def ready_model(name: str) -> ObjectModel:
    """Return the model with this name or YAML path; import its geometry if it is not cached yet.

    Raises:
        ModelError: The model does not exist, its description is invalid, or Blender cannot read its file.
    """
    if is_description(name):
        import_geometry(read_description(Path(name))[1])
    return load_model(name)


def import_geometry(file: Path) -> None:
    """Read a 3D file with Blender and cache its geometry, unless that was done before.

    Blender runs in a confined process on copies of the file and of those that it refers to.

    Raises:
        ModelError: The file refers to others that it may not use, is too large, takes too long, or cannot be read.
        RenderError: Blender cannot start.
    """
    files = find_model_files(file)
    target = geometry_path(files)
    if target.is_file():
        return
    with scratch_folder(in_memory=False) as scratch:
        folder = Path(scratch)
        copy = files.copy_to(folder / "model")
        request = {"file": str(copy.relative_to(folder)), "shown": str(file)}
        (folder / REQUEST).write_text(json.dumps(request), "utf-8")
        outcome = run_confined(IMPORTER, folder, IMPORT_LIMITS)
        log.info("import of %s: %s, %d MiB\n%s", file, outcome.ending, outcome.peak_bytes >> 20, outcome.output)
        _require_done(file, outcome)
        if refusal := read_object(folder / REFUSAL):
            if refusal.get("too_large"):
                raise too_large(file, str(refusal["too_large"]))
            raise ModelError(str(refusal.get("message")))
        try:
            groups, arrays = read_geometry(folder / GEOMETRY, str(file))
        except ModelError as error:
            raise _damaged(file, f"its surfaces are damaged ({error.__cause__})") from error
        with replace_atomically(target, beside=target.with_name(f".{target.stem}.{os.getpid()}.part")) as temporary:
            write_geometry(temporary, groups, arrays)


def _require_done(file: Path, outcome: ConfinedOutcome) -> None:
    """Raise the error of an import that did not come to its end."""
    if outcome.ending == "memory":
        raise too_large(file, outcome.detail)
    if outcome.ending == "time":
        expected = f"an import in at most {IMPORT_LIMITS.cpu_seconds:g} s"
        todo = "apply its modifiers in Blender, remove what is not visible, and save it again"
        problem = Problem(str(file), TOO_SLOW, f"its import took {outcome.detail}", expected, todo)
        raise ModelError(f"model file {file}: its import took {outcome.detail}", [problem])
    if outcome.ending == "no-start":
        raise RenderError(f"Blender could not start to import {file}: {outcome.last_line}. Run `infrablend doctor`.")
    if outcome.ending == "crash":
        raise _damaged(file, f"Blender crashed on it ({outcome.detail}; {outcome.last_line})")


def _damaged(file: Path, found: str) -> ModelError:
    return ModelError(
        f"model file {file}: {found}; expected a valid {file.suffix} file. Open it in Blender, save it again, and use "
        "the new file."
    )


def run_once(factory: str, payload: Any, key: str, settings: Any = None, timeout_s: float = JOB_TIMEOUT_S) -> Any:
    """Run one job in a separate worker process and return its value.

    Raises:
        InfraBlendError: The job failed.
    """
    pool = ProcessPool(WorkerSpec(factory, settings), PoolSettings(workers=1, retries=0, task_timeout_s=timeout_s))
    for result in pool.run([Task(key, payload)]):
        if result.failure is not None:
            raise result.failure.to_exception()
        return result.value
    raise AssertionError("an executor yields one result per task")
