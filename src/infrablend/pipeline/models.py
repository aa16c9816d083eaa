"""Getting models ready: the shipped ones as they are, a user's own through Blender once, then from the cache."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from infrablend.assets.catalogue import load_model
from infrablend.assets.model import ObjectModel
from infrablend.assets.user_model import geometry_file, is_description, read_description
from infrablend.core.tasks import Task, WorkerSpec
from infrablend.errors import ModelError, WorkerDiedError
from infrablend.execution.process_pool import PoolSettings, ProcessPool

# A throw-away process: a damaged or hostile file may hang Blender, also when it ends.
IMPORT_TIMEOUT_S = 300.0


def ready_model(name: str) -> ObjectModel:
    """Return the model of that name or YAML path, its geometry imported if need be.

    Raises:
        ModelError: If there is none, its description is wrong, or Blender cannot read its file.
    """
    if is_description(name):
        _, file = read_description(Path(name))
        target = geometry_file(file)
        if not target.is_file():
            try:
                run_once("infrablend.blender.importer:make_importer", (str(file), str(target)), f"import {file.name}")
            except WorkerDiedError as error:
                raise ModelError(
                    f"model file {file}: Blender crashed or hung on it ({error.message}); expected a valid "
                    f"{file.suffix} file. Open it in Blender, save it anew, and use that file."
                ) from error
    return load_model(name)


def run_once(factory: str, payload: Any, key: str, settings: Any = None, timeout_s: float = IMPORT_TIMEOUT_S) -> Any:
    """One job in a worker process of its own; gives back its value.

    Raises:
        InfraBlendError: Whatever went wrong in it.
    """
    pool = ProcessPool(WorkerSpec(factory, settings), PoolSettings(workers=1, retries=0, task_timeout_s=timeout_s))
    for result in pool.run([Task(key, payload)]):
        if result.failure is not None:
            raise result.failure.to_exception()
        return result.value
    raise AssertionError("an executor gives one result for each task")
