"""Writes the virtual world as a background dataset: HIT-UAV, MONET, MOTChallenge, temperatures or camera files.

`world.json` lists what each frame shows.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from infrablend.core.arguments import require_choice
from infrablend.core.dataset import ImageRecord
from infrablend.core.files import link_or_copy
from infrablend.core.tasks import OnProgress, Task, WorkerSpec, paced
from infrablend.core.workspace import WORLD_FILE, replacing, workspace
from infrablend.formats.labels import coco, mot
from infrablend.formats.published import hit_uav, monet
from infrablend.lab.world.frame_files import FinishedFrame
from infrablend.lab.world.rjpeg_writing import MAKERS
from infrablend.lab.world.world_frames import MONET_CATEGORIES, FrameFacts, Layout, plan_frames
from infrablend.pipeline.execution.process_pool import PoolSettings, ProcessPool

# Renders the given frames, writes their images below the given folder, and yields them in any order.
FrameSource = Callable[[Sequence[FrameFacts], Path], Iterable[FinishedFrame]]

_PICTURES = ".frames"
_TOP = {"info": {"description": "InfraBlend virtual thermal world in HIT-UAV layout"}, "licenses": []}
_RADIOMETRIC_INFO = {"description": "InfraBlend virtual thermal world, temperatures"}
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

    Raises:
        ArgumentError: There is no such layout.
    """

    count: int
    seed: int = 0
    layout: Layout = "hit-uav"

    def __post_init__(self) -> None:
        require_choice("layout", self.layout, get_args(Layout))


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
    frames = plan_frames(request.count, request.seed, request.layout)
    finished: dict[int, FinishedFrame] = {}

    with workspace(Path(out), "virtual world", WORLD_FILE, replacing(overwrite)) as space:
        pictures = space.folder / _PICTURES
        for one in source(frames, pictures):
            finished[one.number] = one
            if progress is not None:
                progress(len(finished), len(frames))
        ordered = [finished[f.number] for f in frames]
        _write(space.folder, request.layout, [one.image for one in ordered])
        shutil.rmtree(pictures)  # the dataset has links to them
        space.finish({"seed": request.seed, "frames": [one.facts for one in ordered]})


def _write(out: Path, layout: Layout, images: Sequence[ImageRecord]) -> None:
    if layout == "monet":
        monet.write(out, images, MONET_CATEGORIES, extra=_MONET_TOP)
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
        spec = WorkerSpec(WORKER, {"seed": request.seed, "folder": str(folder)})
        # The scene below a flight is rendered once, which takes longer than cutting hundreds of frames from it.
        most = 1 if request.layout == "flight" else len(frames)
        pool = ProcessPool(spec, PoolSettings(workers=max(1, min(workers, most))))
        for result in pool.run(Task(frame.name, frame) for frame in frames):
            if result.failure is not None:
                raise result.failure.to_exception()
            yield result.value

    write_world(out, request, rendered, paced(on_progress), overwrite=overwrite)
