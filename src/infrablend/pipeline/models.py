"""Loads object models; the geometry of user models is imported with Blender once and then cached."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from infrablend.assets.catalogue import load_model
from infrablend.assets.model import ObjectModel
from infrablend.assets.user_model import geometry_file, is_description, read_description
from infrablend.core.tasks import Task, WorkerSpec
from infrablend.errors import ModelError, WorkerDiedError
from infrablend.execution.process_pool import PoolSettings, ProcessPool

# Time limit of the import process: a damaged or hostile file may hang Blender, even while it exits.
IMPORT_TIMEOUT_S = 300.0


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

    Raises:
        ModelError: Blender cannot read the file.
    """
    target = geometry_file(file)
    if target.is_file():
        return
    try:
        run_once("infrablend.blender.importer:make_importer", (str(file), str(target)), f"import {file.name}")
    except WorkerDiedError as error:
        raise ModelError(
            f"model file {file}: Blender crashed or hung on it ({error.message}); expected a valid "
            f"{file.suffix} file. Open it in Blender, save it again, and use the new file."
        ) from error


def run_once(factory: str, payload: Any, key: str, settings: Any = None, timeout_s: float = IMPORT_TIMEOUT_S) -> Any:
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
