"""Loads object models; the geometry of user models is imported with Blender once and then cached."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any

from infrablend.assets.catalogue import load_model
from infrablend.assets.model import ObjectModel
from infrablend.assets.model_files import find_model_files
from infrablend.assets.user_model import ImportJob, geometry_path, is_description, read_description
from infrablend.core.files import replace_atomically
from infrablend.core.tasks import Failure, Task, TaskResult, WorkerSpec
from infrablend.errors import InfraBlendError, ModelError, Problem
from infrablend.pipeline.execution.process_pool import PoolSettings, ProcessPool

log = logging.getLogger(__name__)

IMPORTER = "infrablend.rendering.engine.process:make_importer"
IMPORT_CPU_SECONDS = 120
IMPORT_SECONDS = 600.0
IMPORT_MEMORY_BYTES = 3 * 2**30
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

    Blender runs in a process of its own with limits of memory and time, so a broken file ends in an error.

    Raises:
        ModelError: The file or one that it refers to is missing, too large or damaged, or takes too long.
        RenderError: Blender cannot start.
    """
    files = find_model_files(file)
    target = geometry_path(files)
    if target.is_file():
        return
    with replace_atomically(target, beside=target.with_name(f".{target.stem}.{os.getpid()}.part")) as temporary:
        job = ImportJob(files, str(file), temporary, IMPORT_MEMORY_BYTES, IMPORT_CPU_SECONDS)
        failure = _result_of(IMPORTER, job, f"import of {file}", IMPORT_SECONDS).failure
        if failure is not None:
            log.info("%s\n%s", failure.message, failure.traceback)
            raise _import_error(file, failure)
        if find_model_files(file) != files:
            raise ModelError(f"model file {file}: changed while it was being read; run again")


def _import_error(file: Path, failure: Failure) -> InfraBlendError:
    if failure.error != "WorkerDiedError":
        return failure.to_exception()
    if failure.kind == "timeout" or "SIGXCPU" in failure.message:
        limit = f"{IMPORT_SECONDS:g} s" if failure.kind == "timeout" else f"{IMPORT_CPU_SECONDS} s of processor time"
        expected = f"an import in at most {IMPORT_CPU_SECONDS} s of processor time"
        todo = "apply its modifiers in Blender, remove what is not visible, and save it again"
        problem = Problem(str(file), TOO_SLOW, f"its import took more than {limit}", expected, todo)
        return ModelError(f"model file {file}: its import took more than {limit}", [problem])
    memory = f"needed more than {IMPORT_MEMORY_BYTES / 2**30:.2g} GB of memory"  # where Blender crashes, too
    return ModelError(
        f"model file {file}: Blender crashed on it or {memory} ({failure.message}); expected a valid {file.suffix} "
        "file of moderate size. Open it in Blender, reduce it if it is large (Decimate modifier), save it again, and "
        "use the new file."
    )


def run_once(factory: str, payload: Any, key: str) -> Any:
    """Run one job in a separate worker process and return its value.

    Raises:
        InfraBlendError: The job failed.
    """
    result = _result_of(factory, payload, key, JOB_TIMEOUT_S)
    if result.failure is not None:
        raise result.failure.to_exception()
    return result.value


def _result_of(factory: str, payload: Any, key: str, timeout_s: float) -> TaskResult:
    pool = ProcessPool(WorkerSpec(factory), PoolSettings(workers=1, retries=0, task_timeout_s=timeout_s))
    (result,) = pool.run([Task(key, payload)])
    return result
