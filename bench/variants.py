"""Make frames in the three ways that are timed: the paper's, Blender's defaults, this program's."""

from __future__ import annotations

import os
import pickle
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from children import Stopwatch
from numpy.typing import NDArray
from scenes import Work

import infrablend.compositing.picture as over
import infrablend.pipeline.compose.extensions as extensions
import infrablend.pipeline.compose.frame as pipeline
import infrablend.pipeline.compose.frame_worker as worker
import infrablend.pipeline.compose.looks as looks
from infrablend.assets.catalogue import load_model
from infrablend.compositing.mapping import percentile_mapping
from infrablend.compositing.overlay import compose, make_layer
from infrablend.core.dataset import ImageRecord
from infrablend.core.files import write_bytes
from infrablend.core.ledger import Ledger
from infrablend.core.render import PlacedScene, RenderResult
from infrablend.core.run_folder import RunFolder
from infrablend.core.scene import SceneSpec
from infrablend.core.tasks import Task
from infrablend.formats.pictures.images import encode_image, load_background, output_suffix
from infrablend.pipeline.compose.frame_worker import FrameMaker
from infrablend.pipeline.plans.plan import RunPlan
from infrablend.pipeline.runs.exports import export_run
from infrablend.sampling.scene_sampler import RecipeSampler, sample_scene

PAPER_SAMPLES = 640
# Blender's own: noise at which adaptive sampling stops, 0 for the least number of samples means "automatic".
DEFAULT_THRESHOLD = 0.01


def time_full_frames(work: Work, defaults: bool) -> list[dict[str, Any]]:
    """Make every frame the way the paper does: the whole frame, 640 samples, boxes and masks from the alpha channel.

    Scenes, materials, pixel filter, overlay and files are those of this program. Start-up is not counted, and neither
    is saving the float pictures for the error measurement.

    Args:
        work: Frames to make, and the output folder.
        defaults: True for Blender's default sampling: adaptive at 0.01, at most 640 samples, then denoised.
    """
    from infrablend.rendering.engine.renderer import BlenderRenderer

    class Defaults(BlenderRenderer):
        def _cycles(self, spec: SceneSpec, bounces: int) -> dict[str, Any]:
            return super()._cycles(spec, bounces) | {
                "use_adaptive_sampling": True,
                "adaptive_threshold": DEFAULT_THRESHOLD,
                "adaptive_min_samples": 0,
                "use_denoising": True,
                "denoiser": "OPENIMAGEDENOISE",
                "denoising_input_passes": "RGB_ALBEDO_NORMAL",
                "denoising_prefilter": "ACCURATE",
            }

    recipe = work.recipe
    models = {o.model: load_model(o.model) for o in recipe.objects}
    renderer = (Defaults if defaults else BlenderRenderer)(whole_frame=True)
    out = work.settings.out
    # A cheap render that is not counted loads the kernels and fills the caches.
    warm = sample_scene(work.frames[0].key((64, 64)), recipe, models, work.settings.seed)
    renderer.render(with_samples(warm, 1))
    rows = []
    for frame in work.frames:
        watch = Stopwatch()
        with watch:
            source = frame.background
            background = load_background(source.path, source.size_wh)
            scene = sample_scene(frame.key(background.size_wh), recipe, models, work.settings.seed)
            result = renderer.render(with_samples(scene, PAPER_SAMPLES))
            layer = make_layer(
                result,
                percentile_mapping(background.pixels, recipe.matching.percentiles),
                recipe.overlay.softness_px,
            )
            pixels = compose(background.pixels, layer)
            name = f"{source.split}/{frame.name}{output_suffix(source.path, 'same')}"
            write_bytes(out / "images" / name, encode_image(pixels, background, "same"))
            write_labels(out, frame.name, source, result.alpha >= 0.5)
        keep_float(out, frame.frame_id, result)
        rows.append({"frame": frame.frame_id, "cpu_s": watch.cpu_s, "wall_s": watch.wall_s})
    return rows


def write_labels(out: Path, name: str, source: ImageRecord, mask: NDArray[np.bool_]) -> None:
    """Return YOLO, oriented and polygon labels of a mask and of the original objects, derived the paper's way."""
    height, width = mask.shape
    size = np.array([width, height], np.float64)
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    boxes, oriented, polygons = [], [], []
    for instance in source.instances:
        boxes.append((1, np.asarray(instance.box_xyxy)))
        if instance.corners_xy is not None:
            oriented.append((1, np.asarray(instance.corners_xy)))
    if contours:
        points = np.concatenate(contours)
        x, y, w, h = cv2.boundingRect(points)
        boxes.append((4, np.array([x, y, x + w, y + h], np.float64)))
        oriented.append((4, cv2.boxPoints(cv2.minAreaRect(points))))
        polygons = [(4, c.reshape(-1, 2)) for c in contours]

    def line(category: int, numbers: Any) -> str:
        return " ".join([str(category), *(f"{v:.6f}" for v in np.asarray(numbers).ravel())])

    files = {
        "yolo": [line(c, np.concatenate([(b[:2] + b[2:]) / 2 / size, (b[2:] - b[:2]) / size])) for c, b in boxes],
        "yolo-obb": [line(c, corners / size) for c, corners in oriented],
        "yolo-seg": [line(c, polygon / size) for c, polygon in polygons],
    }
    for folder, lines in files.items():
        write_bytes(out / folder / f"{name}.txt", "".join(f"{one}\n" for one in lines).encode())


def time_program(work: Work) -> list[dict[str, Any]]:
    """Make every frame with this program's worker, from decoding the background to the image on disk."""
    maker = FrameMaker(work.settings)
    maker(Task("warm", work.frames[0]))
    rows, made = [], {}
    for frame in work.frames:
        watch = Stopwatch()
        with watch:
            made[frame.frame_id] = maker(Task(frame.frame_id, frame))
        rows.append({"frame": frame.frame_id, "cpu_s": watch.cpu_s, "wall_s": watch.wall_s})
    assert work.settings.out is not None
    write_bytes(work.settings.out / f"{os.getpid()}.made", pickle.dumps(made))
    return rows


# Stages of a frame, by the module and the name that it calls; the renderer reports its own parts.
STAGES = {
    (extensions, "load_background"): "decode background",
    (RecipeSampler, "sample"): "draw scene, build shape",
    (over, "make_layer"): "grey levels, blur",
    (looks, "match_locally"): "match grey levels",
    (pipeline, "fit_sensor"): "fit sensor",
    (over, "apply_sensor"): "sensor",
    (over, "compose"): "overlay",
    (pipeline, "label_objects"): "labels",
    (pipeline, "measure_inserts"): "contrast of inserts",
    (pipeline, "merge"): "merge labels",
    (pipeline, "encode_image"): "encode picture",
    (worker, "write_bytes"): "write picture",
}


def split_program(work: Work) -> dict[str, float]:
    """Measure CPU seconds per frame by stage, in a separate pass."""
    spent = dict.fromkeys([*STAGES.values(), "render"], 0.0)

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            begun = time.process_time()
            try:
                return function(*args, **options)
            finally:
                spent[name] += time.process_time() - begun

        return call

    maker = FrameMaker(work.settings)
    maker(Task("warm", work.frames[0]))
    for (module, name), label in STAGES.items():
        setattr(module, name, timed(label, getattr(module, name)))
    renderer = maker._renderer
    renderer.render = timed("render", renderer.render)  # type: ignore[method-assign]
    watch = Stopwatch()
    seconds: Counter[str] = Counter()
    with watch:
        for frame in work.frames:
            seconds.update(maker(Task(frame.frame_id, frame)).seconds)
    # The renderer reports wall-clock times of its parts; here they only divide its CPU time.
    render = spent.pop("render")
    total = sum(seconds.values())
    spent |= {f"render: {name}": render * value / total for name, value in seconds.items()}
    spent["other"] = watch.cpu_s - sum(spent.values())
    return {name: value / len(work.frames) for name, value in spent.items()}


def time_label_files(plan: RunPlan, out: Path) -> float:
    """Measure the CPU seconds for ledger and label files of the frames of the plan, which `time_program` made."""
    made = {}
    for path in sorted(out.glob("*.made")):
        made.update(pickle.loads(path.read_bytes()))

    def export(part: RunPlan) -> None:
        with Ledger.create(out, {}) as ledger:
            for frame in part.frames:
                ledger.add(frame.frame_id, made[frame.frame_id].frame, made[frame.frame_id].record)
            export_run(part, RunFolder(out), ledger, part.frames)

    # The first frame loads the modules of the formats; start-up is not counted.
    export(replace(plan, frames=plan.frames[:1]))
    watch = Stopwatch()
    with watch:
        export(plan)
    return watch.cpu_s


def with_samples(scene: PlacedScene, samples: int) -> PlacedScene:
    """Return the scene with this number of samples per pixel."""
    return replace(scene, spec=replace(scene.spec, samples=samples))


def keep_float(out: Path, frame_id: str, result: RenderResult) -> None:
    """Save radiance and alpha of a whole frame."""
    path = out / "float" / f"{frame_id}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, radiance=result.radiance, alpha=result.alpha)


def load_float(out: Path, frame_id: str) -> RenderResult:
    """Return what `keep_float` saved."""
    with np.load(out / "float" / f"{frame_id}.npz") as data:
        radiance, alpha = data["radiance"], data["alpha"]
    h, w = alpha.shape
    return RenderResult((0, 0), (w, h), radiance, alpha, np.zeros((0, h, w), np.float32))
