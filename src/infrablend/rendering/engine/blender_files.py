"""Files that Blender reads and writes: users' 3D files, in a process of its own with limits, and our node groups."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from infrablend.assets.model_files import NO_FILE, too_large
from infrablend.assets.user_model import GroupFacts, ImportJob, write_geometry
from infrablend.core.files import replace_atomically
from infrablend.core.tasks import Task
from infrablend.core.wire import ModelFileMessage
from infrablend.errors import ModelError, Problem
from infrablend.rendering.engine.process import blender_process


def make_importer(_settings: None) -> Callable[[Task], None]:
    """Return the callable that performs one import: the payload of its task is an `ImportJob`."""
    return lambda task: _import(task.payload)


def _import(job: ImportJob) -> None:
    """Read a 3D file and write its geometry: triangles in world coordinates, Z up, metres, and named pieces.

    Raises:
        ModelError: Blender cannot read the file, it contains no surface, or too many triangles.
        MissingDependencyError: There is no Blender.
        WorkerDiedError: Blender crashed on the file, or exceeded a limit.
    """
    asked: ModelFileMessage = {
        "file": str(job.files.main.absolute()),
        "shown": job.shown,
        "known": [str(path.resolve()) for path in job.files.paths],
        "memory_bytes": job.memory_bytes,
        "cpu_seconds": job.cpu_seconds,
    }
    with blender_process() as blender:
        found = blender.ask("read_file", asked)
    if "too_large" in found:
        raise too_large(Path(job.shown), found["too_large"])
    if "libraries" in found:
        raise _unknown_libraries(job.shown, found["libraries"])
    write_geometry(job.target, [GroupFacts(**g) for g in found["groups"]], found["arrays"])


def _unknown_libraries(shown: str, libraries: list[tuple[str, str]]) -> ModelError:
    todo = "make linked data local, or paths relative (File > External Data), and save it again"
    problems = [
        Problem(
            shown, NO_FILE, f"refers to the linked library {path!r}, which is {found}", "a file beside the model", todo
        )
        for path, found in libraries
    ]
    return ModelError(f"model file {shown}: cannot use {len(problems)} of the files it refers to", problems)


def write_infrared_effect(path: Path) -> Path:
    """Write the node groups InfraredEffect and InfraredEffect Physical, with an example of each; return the path.

    Raises:
        MissingDependencyError: There is no Blender.
        OutputError: The file cannot be written.
    """
    with replace_atomically(path) as temporary, blender_process() as blender:
        blender.ask("write_infrared_effect", {"file": str(temporary.absolute())})
    return path
