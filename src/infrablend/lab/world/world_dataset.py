"""Writes the virtual world as a background dataset: HIT-UAV, MONET, MOTChallenge, temperatures or camera files.

`world.json` lists what each frame shows.

Pictures of the sky with small objects are made without rendering: a stand-in for the dataset of a camera on the ground.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.arguments import require_choice
from infrablend.core.dataset import SPLITS, Category, ImageRecord, Instance, Split
from infrablend.core.files import link_or_copy, write_bytes
from infrablend.core.rng import stream
from infrablend.core.tasks import OnProgress, Task, WorkerSpec, paced
from infrablend.core.workspace import WORLD_FILE, replacing, workspace
from infrablend.errors import ArgumentError
from infrablend.formats.labels import coco, mot
from infrablend.formats.pictures.images import png_bytes
from infrablend.formats.published import hit_uav, monet
from infrablend.lab.world.frame_files import FinishedFrame
from infrablend.lab.world.rjpeg_writing import MAKERS
from infrablend.lab.world.world_frames import MONET_CATEGORIES, Engine, FrameFacts, Layout, Survey, plan_frames
from infrablend.pipeline.execution.process_pool import PoolSettings, ProcessPool

# Renders the given frames, writes their images below the given folder, and yields them in any order.
FrameSource = Callable[[Sequence[FrameFacts], Path], Iterable[FinishedFrame]]

_PICTURES = ".frames"
_TOP = {"info": {"description": "InfraBlend virtual thermal world in HIT-UAV layout"}, "licenses": []}
_RADIOMETRIC_INFO = {"description": "InfraBlend virtual thermal world, temperatures"}
_SURVEY_INFO = {"description": "InfraBlend virtual thermal world, a survey"}
_MONET_TOP = {"info": {"description": "InfraBlend virtual thermal world in MONET layout"}, "licenses": []}


@dataclass(frozen=True)
class WorldRequest:
    """The frames that a virtual dataset contains.

    Attributes:
        count: Number of frames.
        seed: Seed of everything random.
        layout: `hit-uav`: 640x512 JPEG of a town. `monet`: 800x600 PNG of airfields and dirt roads, persons and
            vehicles with axis-aligned boxes, telemetry in the JSON; two sequences and single frames have lost theirs.
            `radiometric`: the frames of `hit-uav` as 16-bit TIFF in centikelvin, with COCO labels that state the scale,
            the air and the camera.
            `dji`, `flir`: the radiometric JPEG files of one flight as they come off the card, without labels.
            `flight`: 640x512 PNG of one flight over one scene, a sequence of 25 frames per second with the tracks of
            people, cars and bicycles in MOTChallenge's layout, and telemetry in `metadata.csv`.
        survey: For `flight`: parallel strips with overlap, in COCO's layout with positions and times; None for a
            smooth course of 25 frames per second.
        engine: What draws it: `blender`, or `lattice`, which needs no Blender and gives other pixels.

    Raises:
        ArgumentError: There is no such layout or engine, or another layout than `flight` has a survey.
    """

    count: int
    seed: int = 0
    layout: Layout = "hit-uav"
    survey: Survey | None = None
    engine: Engine = "blender"

    def __post_init__(self) -> None:
        require_choice("layout", self.layout, get_args(Layout))
        require_choice("engine", self.engine, get_args(Engine))
        if self.survey is not None and self.layout != "flight":
            raise ArgumentError(f"survey: found layout {self.layout}, expected flight, which alone has strips")


def write_world(
    out: Path,
    request: WorldRequest,
    source: FrameSource,
    progress: Callable[[int, int], None] | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Write a background dataset of the virtual world; the same request gives the same bytes.

    `world.json` lists the camera, the place and every object of each frame. `progress` is called with (finished frames,
    all frames) after each frame; `overwrite` replaces an earlier world.

    Raises:
        RecipeError: The number of frames is out of range.
        OutputError: `out` has something that may not be replaced, or cannot be written.
        RenderError: Blender failed.
    """
    frames = plan_frames(request.count, request.seed, request.layout, request.survey)
    finished: dict[int, FinishedFrame] = {}

    with workspace(Path(out), "virtual world", WORLD_FILE, replacing(overwrite)) as space:
        pictures = space.folder / _PICTURES
        for one in source(frames, pictures):
            finished[one.number] = one
            if progress is not None:
                progress(len(finished), len(frames))
        ordered = [finished[f.number] for f in frames]
        _write(space.folder, request, [one.image for one in ordered])
        shutil.rmtree(pictures)  # the dataset has links to them
        space.finish({"seed": request.seed, "engine": request.engine, "frames": [one.facts for one in ordered]})


def _write(out: Path, request: WorldRequest, images: Sequence[ImageRecord]) -> None:
    layout = request.layout
    if layout == "monet":
        monet.write(out, images, MONET_CATEGORIES, extra=_MONET_TOP)
    elif request.survey is not None:
        coco.write(out, images, [c for c in hit_uav.CATEGORIES if not c.ignore], info=_SURVEY_INFO, pictures=True)
    elif layout == "flight":
        mot.write(out, images, [c for c in hit_uav.CATEGORIES if not c.ignore])
    elif layout in MAKERS:
        for image in images:
            link_or_copy(image.path, out / image.path.name)
    elif layout == "radiometric":
        coco.write(out, images, hit_uav.CATEGORIES, info=_RADIOMETRIC_INFO, pictures=True)
    else:
        hit_uav.write(out, images, hit_uav.CATEGORIES, forms=("normal_json", "rotate_json"), extra=_TOP)


WORKER = "infrablend.lab.world.blender_world:make_world_worker"


def make_world(
    out: Path,
    request: WorldRequest,
    workers: int,
    on_progress: OnProgress | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Render a background dataset of the virtual world; the bytes do not depend on the number of workers.

    Raises:
        RecipeError: The number of frames is out of range.
        OutputError: `out` has something that may not be replaced, or cannot be written.
        RenderError: Blender failed on a frame.
        Interrupted: The user stopped the run; nothing is left behind.
    """

    def rendered(frames: Sequence[FrameFacts], folder: Path) -> Iterator[FinishedFrame]:
        spec = WorkerSpec(WORKER, {"seed": request.seed, "folder": str(folder), "engine": request.engine})
        # The scene below a flight is rendered once, which takes longer than cutting hundreds of frames from it.
        most = 1 if request.layout == "flight" else len(frames)
        pool = ProcessPool(spec, PoolSettings(workers=max(1, min(workers, most))))
        for result in pool.run(Task(frame.name, frame) for frame in frames):
            if result.failure is not None:
                raise result.failure.to_exception()
            yield result.value

    write_world(out, request, rendered, paced(on_progress), overwrite=overwrite)


SIZE_WH = (320, 256)
# Levels of sky and trees, and of objects above the sky; deviation of the noise.
_SKY = 70.0
_TREES = 150.0
_OBJECT = (60.0, 120.0)
_NOISE = 1.5
# Longest side of objects, px.
_SIZE_PX = (14.0, 26.0)
# Bars from the middle of an object, as (length, angle), by class; other classes look like drones.
_SHAPES: Mapping[str, tuple[tuple[float, float], ...]] = {
    "airplane": ((1.0, 0.0), (1.0, 3.14), (0.7, 1.57)),
    "bird": ((1.0, 0.5), (1.0, 2.6)),
    "drone": ((1.0, 0.4), (1.0, 2.7), (1.0, 3.6), (1.0, 5.8)),
    "helicopter": ((1.0, 0.0), (0.4, 3.14), (0.5, 4.71)),
}


def write_sky_pictures(out: Path, count: int, seed: int, classes: Sequence[str]) -> None:
    """Write a COCO dataset of pictures that show one object each, and `world.json`.

    Seven in ten pictures are train, one in ten val, the others test, but at least one of each; classes come in turn.

    Raises:
        OutputError: The folder is not empty or cannot be written.
    """
    with workspace(out, "virtual world", WORLD_FILE) as space:
        images = _write_pictures(space.folder, count, seed, classes)
        coco.write(space.folder, images, [Category(n, name) for n, name in enumerate(classes, 1)])
        space.finish({"seed": seed, "layout": "sky", "classes": list(classes), "frames": []})


def _write_pictures(folder: Path, count: int, seed: int, classes: Sequence[str]) -> list[ImageRecord]:
    images = []
    per_split: dict[Split, int] = {"val": max(1, count // 10), "test": max(1, count // 5)}
    per_split["train"] = max(1, count - sum(per_split.values()))
    for split in SPLITS:
        for number in range(per_split[split]):
            category = classes[number % len(classes)]
            rng = stream(seed, "sky", *classes, split, number)
            grey, box = _picture(rng, _SHAPES.get(category, _SHAPES["drone"]))
            path = folder / "images" / split / f"sky_{number:05d}.png"
            write_bytes(path, png_bytes(grey))
            label = Instance(category, box)
            images.append(ImageRecord(f"{split}/{number}", path, split, SIZE_WH, (label,)))
    return images


def _picture(
    rng: np.random.Generator, shape: Sequence[tuple[float, float]]
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return the (h, w) levels of a picture, and the (4,) box of its object."""
    width, height = SIZE_WH
    rows = np.arange(height, dtype=np.float32)[:, None]
    clouds = cv2.resize(rng.normal(0, 3, (5, 6)).astype(np.float32), SIZE_WH, interpolation=cv2.INTER_CUBIC)
    grey = _SKY + 0.05 * rows + clouds
    tops = cv2.GaussianBlur(rng.normal(0, 1, (1, width)).astype(np.float32), (0, 0), 4)[0]
    ends = rng.uniform(0.7, 0.85) * height + 25 * tops
    trees = _TREES + cv2.GaussianBlur(rng.normal(0, 40, (height, width)).astype(np.float32), (0, 0), 2)
    grey = np.where(rows < ends[None, :], grey, trees).astype(np.float32)
    half = float(rng.uniform(*_SIZE_PX)) / 2
    centre = np.array([rng.uniform(30, width - 30), rng.uniform(30, 0.5 * height)])
    mask = np.zeros((height * 4, width * 4), np.uint8)  # drawn larger, then averaged: smooth outlines
    middle = tuple(int(v) for v in np.rint(4 * centre))
    tips = [centre + half * length * np.array([np.cos(turn), np.sin(turn)]) for length, turn in shape]
    for tip in tips:
        cv2.line(mask, middle, tuple(int(v) for v in np.rint(4 * tip)), 255, max(2, int(half * 1.2)))
    cv2.circle(mask, middle, max(3, int(half * 1.6)), 255, -1)
    cover = cv2.resize(mask, SIZE_WH, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
    grey = cv2.GaussianBlur(grey + cover * np.float32(rng.uniform(*_OBJECT)), (0, 0), 0.7)
    grey = grey + rng.normal(0, _NOISE, grey.shape)
    ys, xs = np.nonzero(cover > 0.3)
    box = np.array([xs.min() - 1, ys.min() - 1, xs.max() + 2, ys.max() + 2], np.float64)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8), box
