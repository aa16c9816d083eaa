"""Renders one frame of a run again from its record."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.compositing.mapping import GreyMapping
from infrablend.compositing.other_camera import OtherCamera
from infrablend.compositing.picture import overlay
from infrablend.compositing.sensor import Sensor
from infrablend.config.modes import recipe_from_json
from infrablend.core.file_names import real_path
from infrablend.core.files import sha256_of, write_bytes
from infrablend.core.frame_row import FrameRecord
from infrablend.core.operating_system import take_core
from infrablend.core.output_checks import require_outside_datasets, require_replaceable
from infrablend.core.rle_masks import Mask
from infrablend.core.run_folder import RunFolder
from infrablend.core.tasks import Task
from infrablend.core.workspace import partial_of
from infrablend.errors import DatasetError, OutputError
from infrablend.formats.pictures.images import encode_image, load_background
from infrablend.pipeline.compose.partly_hidden import recorded_front
from infrablend.pipeline.plans.models import ready_model, run_once
from infrablend.pipeline.runs.record import RecordedRun
from infrablend.pipeline.storage.store import local_folder
from infrablend.rendering import make_renderer
from infrablend.sampling.scene_sampler import rebuild_scene


@dataclass(frozen=True)
class Rerender:
    """Job of the worker process.

    Attributes:
        record: Record of the frame.
        recipe_json: Recipe of the run, as JSON.
        background: File of the background.
        out: File to write.
        renderer: Name of the renderer in `rendering.RENDERERS`.
        device: Device that Cycles computes on.
        overwrite: Replace another file.
    """

    record: FrameRecord
    recipe_json: str
    background: Path
    out: Path
    renderer: str
    device: str
    overwrite: bool = False


def rerender_frame(
    run: Path, frame_id: str, out: Path | None = None, data: Path | None = None, *, overwrite: bool = False
) -> Path:
    """Render a frame again from its record; the same kind of device gives the same bytes.

    Args:
        run: Folder of a run.
        frame_id: `<split>/<background>_c<k>`.
        out: File to write; by default the frame's own file name in the working folder. A .png file is lossless.
        data: Folder of the backgrounds if they have moved.
        overwrite: Replace a file that exists and is something else.

    Raises:
        OutputError: The run or the frame does not exist, or `out` exists and is something else or is inside a dataset.
        DatasetError: The background is missing or has changed.
    """
    folder = RunFolder(run)
    recorded = RecordedRun.read(folder)
    record = folder.record(frame_id)
    if record.scene is None:
        raise OutputError(f"{run}: frame {frame_id!r} is an unchanged original; there is nothing to render")
    source = local_folder(data or recorded.data)
    # Not by the file system: the data may be one video, below which no path leads out to the cache.
    background = Path(os.path.normpath(source / record.background["path"]))
    if not background.is_file():
        todo = "give its folder with --data"
        if record.background["path"].startswith("../"):
            todo = f"frames of videos are in the cache folder: `infrablend inspect {source}` decodes them again"
        raise DatasetError(f"{background}: the background of the frame does not exist; {todo}")
    if sha256_of(real_path(background)) != record.background["sha256"]:
        raise DatasetError(f"{background}: not the background of the frame (its SHA-256 differs)")
    target = out if out is not None else Path(Path(record.image).name)
    require_outside_datasets(run, target, data)
    for o in recorded.recipe.objects:
        ready_model(o.model)
    job = Rerender(
        record,
        recorded.recipe.model_dump_json(),
        background,
        target,
        recorded.renderer,
        recorded.device,
        overwrite,
    )
    run_once("infrablend.pipeline.runs.rerender:make_rerenderer", job, frame_id)
    return target


def show_frame(run: Path, frame_id: str) -> dict[str, Any]:
    """Return the record of a frame as JSON values, or why it failed, also from a run that is not finished.

    Raises:
        OutputError: The run or the frame does not exist.
    """
    folder = RunFolder(run if run.is_dir() else partial_of(run))
    with folder.ledger() as ledger:
        if (failure := ledger.failures().get(frame_id)) is not None:
            return {"frame_id": frame_id, "failure": {**failure.to_json(), "traceback": failure.traceback}}
    return folder.record(frame_id).to_json()


def make_rerenderer(_settings: Any) -> Callable[[Task], str]:
    """Return the worker: a function of a task whose payload is a `Rerender`."""
    take_core()

    def run(task: Task) -> str:
        job: Rerender = task.payload
        recipe = recipe_from_json(job.recipe_json)
        record = job.record
        background = load_background(job.background)
        models = {o.model: ready_model(o.model) for o in recipe.objects}
        assert record.scene is not None and record.mapping is not None, "no unchanged original"
        scene = rebuild_scene(record.scene, models)
        fitted = record.facts.get("sensor")
        with contextlib.closing(make_renderer(job.renderer, job.device)) as renderer:
            rendered = renderer.render(scene)
        pixels = overlay(
            rendered,
            background.pixels,
            GreyMapping.from_json(record.mapping),
            recipe.overlay,
            None if fitted is None else Sensor.from_json(fitted),
            scene.spec.motion_px,
            recorded_front(record.facts, background.pixels, rendered),
        )
        if (text := record.facts.get("written")) is not None:
            pixels = np.where(Mask.from_coco(text, pixels.shape).to_array(), background.pixels, pixels)
        if (known := record.facts.get("camera")) is not None:
            pixels = OtherCamera.from_json(known).take(pixels)
        lossless = job.out.suffix.lower() == ".png"
        data = encode_image(pixels, background, "png" if lossless else "same")
        if job.overwrite or not (job.out.is_file() and job.out.read_bytes() == data):
            require_replaceable(job.out, "rendering of this frame", ours=job.overwrite)
            write_bytes(job.out, data)
        return str(job.out)

    return run
