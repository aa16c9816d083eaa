"""The virtual thermal world: procedural outdoor scenes seen by a thermal camera from a given pitch and altitude.

`sample_world` draws a plan (pure numpy), `render_world` renders a whole background dataset in HIT-UAV's layout or in
MONET's. Only the latter needs Blender, and imports it when called.
"""

from __future__ import annotations

import contextlib
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from infrablend.blender.world.frames import (
    ALTITUDES_M,
    MONET_ALTITUDES_M,
    MONET_CATEGORIES,
    PITCHES_DEG,
    SPLIT_SHARES,
    FrameFacts,
    plan_frames,
    plan_sequences,
    telemetry_of,
)
from infrablend.blender.world.layout import KINDS, WorldPlan, sample_world
from infrablend.core.cores import take_core
from infrablend.core.dataset import ImageRecord, Instance, Split
from infrablend.core.files import write_bytes, write_json
from infrablend.core.rng import stream
from infrablend.core.tasks import Task
from infrablend.errors import OutputError, Problem
from infrablend.formats import hit_uav, monet

if TYPE_CHECKING:
    from infrablend.blender.world.labels import Label

__all__ = ["KINDS", "FrameFacts", "WorldPlan", "WorldReport", "plan_frames", "render_world", "sample_world"]

Layout = Literal["hit-uav", "monet"]
_TOP = {"info": {"description": "InfraBlend virtual thermal world in HIT-UAV layout"}, "licenses": []}
_MONET_TOP = {"info": {"description": "InfraBlend virtual thermal world in MONET layout"}, "licenses": []}


@dataclass(frozen=True)
class WorldReport:
    """What `render_world` wrote.

    Attributes:
        out: The dataset's folder.
        frames: Number of pictures by split.
        labels: Number of labels by class.
        dropped: Number of things without a label by reason (`hidden`, `small`, `outside`).
        losses: What the format could not hold, see `formats.base.LOSSES`.
    """

    out: Path
    frames: Mapping[str, int]
    labels: Mapping[str, int]
    dropped: Mapping[str, int]
    losses: Mapping[str, int]


def render_world(
    out: Path,
    count: int,
    seed: int = 0,
    *,
    layout: Layout = "hit-uav",
    splits: Mapping[Split, float] = SPLIT_SHARES,
    pitches_deg: Sequence[int] = PITCHES_DEG,
    altitudes_m: Sequence[int] | None = None,
    threads: int = 0,
    paint: Painter | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> WorldReport:
    """Render a background dataset: HIT-UAV's `normal_json/` and `rotate_json/`, or MONET's sequences; and `world.json`.

    MONET's layout: 800x600 PNG of airfields and dirt roads, persons and vehicles with axis-aligned boxes, telemetry
    in the JSON; two sequences and single frames have lost theirs. `world.json` holds the facts of every frame.
    The same arguments give the same bytes; frame k does not depend on how many follow. Without `paint` it needs
    Blender and owns the process's scene while it runs.

    Args:
        out: Folder to write to; must not exist or be empty.
        count: Number of frames.
        seed: Of everything random.
        layout: `hit-uav` or `monet`.
        splits: Share of the frames of each split; MONET's sequences belong to theirs.
        pitches_deg: Camera depression angles to cover, 90 is straight down.
        altitudes_m: Camera heights to cover; the layout's own if None.
        threads: CPU threads of the renderer; 0 takes all cores.
        paint: Makes the frames' pictures in the folder it is given, in any order; by default here, one by one.
        progress: Called with (frames done, frames in all) after each frame.

    Raises:
        RecipeError: A value out of range.
        OutputError: `out` is not empty or cannot be written.
        RenderError: Blender failed.
    """
    frames = (
        plan_sequences(count, seed, pitches_deg, altitudes_m or MONET_ALTITUDES_M)
        if layout == "monet"
        else plan_frames(count, seed, splits, pitches_deg, altitudes_m or ALTITUDES_M)
    )
    out = Path(out)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        problem = Problem(str(out), "not-empty", "not an empty folder", "an empty or new folder", "choose another one")
        raise OutputError(f"cannot write the virtual world to {out}", [problem])
    made: dict[int, MadeFrame] = {}
    stage = out / ".frames"
    try:
        for one in (paint or _paint_here(seed, threads))(frames, stage):
            made[one.number] = one
            if progress is not None:
                progress(len(made), count)
        ordered = [made[f.number] for f in frames]
        images = [one.image for one in ordered]
        if layout == "monet":
            written = monet.write(out, images, MONET_CATEGORIES, extra=_MONET_TOP)
        else:
            written = hit_uav.write(out, images, hit_uav.CATEGORIES, forms=("normal_json", "rotate_json"), extra=_TOP)
        write_json(out / "world.json", {"seed": seed, "frames": [one.facts for one in ordered]})
    finally:
        # Finished pictures are linked by now; after a stop nothing half-done is left behind.
        shutil.rmtree(stage, ignore_errors=True)
        if out.is_dir() and not any(out.iterdir()):
            out.rmdir()
    labels_of = Counter(i.category for image in images for i in image.instances)
    dropped: Counter[str] = Counter()
    for one in ordered:
        dropped.update(one.dropped)
    return WorldReport(
        out,
        dict(Counter(i.split for i in images)),
        dict(sorted(labels_of.items())),
        dict(sorted(dropped.items())),
        dict(written.losses),
    )


@dataclass(frozen=True, eq=False)
class MadeFrame:
    """A frame whose picture is on disk: its labels, its entry in world.json, things without a label by reason."""

    number: int
    image: ImageRecord
    facts: dict[str, Any]
    dropped: Mapping[str, int]


Painter = Callable[[Sequence[FrameFacts], Path], Iterable[MadeFrame]]


def _paint_here(seed: int, threads: int) -> Painter:
    """Frames one by one in this process."""

    def paint(frames: Sequence[FrameFacts], folder: Path) -> Iterator[MadeFrame]:
        worker = WorldWorker(seed, folder, threads)
        try:
            for frame in frames:
                yield worker.make(frame)
        finally:
            worker.close()

    return paint


class WorldWorker:
    """Makes frames of the virtual world; holds Blender."""

    def __init__(self, seed: int, folder: Path, threads: int) -> None:
        """Start Blender; pictures go to `folder`/<split>/."""
        from infrablend.blender.world.build import WorldRenderer

        self._seed, self._folder = seed, folder
        self._stack = contextlib.ExitStack()
        self._renderer = self._stack.enter_context(WorldRenderer(threads))

    def __call__(self, task: Task) -> MadeFrame:
        """Make the `FrameFacts` in the task's payload."""
        return self.make(task.payload)

    def make(self, frame: FrameFacts) -> MadeFrame:
        """Draw the scene, render it, write the picture."""
        rng = stream(self._seed, "world", frame.number, "plan")
        plan = sample_world(rng, frame.pitch_deg, frame.altitude_m, frame.time_of_day, frame.kind, frame.size_wh)
        image, labels = _make_frame(self._renderer, frame, plan, self._seed, self._folder)
        dropped = Counter(label.dropped for label in labels if label.dropped)
        return MadeFrame(frame.number, image, _facts(frame, plan, labels), dict(dropped))

    def close(self) -> None:
        """Release Blender's scene."""
        self._stack.close()


def make_world_worker(settings: Mapping[str, Any]) -> WorldWorker:
    """Worker factory: `settings` has `seed` and `folder`; one render thread, since workers are parallel."""
    take_core()
    return WorldWorker(settings["seed"], Path(settings["folder"]), 1)


def _make_frame(
    renderer: Any, frame: FrameFacts, plan: WorldPlan, seed: int, folder: Path
) -> tuple[ImageRecord, list[Label]]:
    from infrablend.blender.world.look import jpeg_bytes, png_bytes, thermal_frame

    kelvin, labels = renderer.render(plan)
    grey = thermal_frame(
        kelvin, plan.gain_per_k, plan.std_grey, plan.mean_grey, stream(seed, "world", frame.number, "look")
    )
    path = folder / frame.split / frame.name
    write_bytes(path, jpeg_bytes(grey) if frame.sequence is None else png_bytes(grey))
    if frame.sequence is not None:
        return _monet_record(frame, plan, labels, path, seed), labels
    instances = tuple(
        Instance(
            category=label.category,
            box_xyxy=np.asarray(label.box_xyxy, np.float64),
            corners_xy=label.corners_xy,
            visibility=label.visibility,
            truncated=label.truncated,
            difficult=label.visibility < 0.5,
            extra={"tight_box": True},
        )
        for label in labels
        if label.box_xyxy is not None
    )
    record = ImageRecord(
        id=path.stem, path=path, split=frame.split, size_wh=plan.camera.size_wh, pitch_deg=frame.pitch_deg,
        altitude_m=frame.altitude_m, time_of_day=frame.time_of_day, instances=instances, extra={"weather": "0"},
    )  # fmt: skip
    return record, labels


def _monet_record(frame: FrameFacts, plan: WorldPlan, labels: Sequence[Label], path: Path, seed: int) -> ImageRecord:
    """A frame as MONET has it: axis-aligned boxes of persons and vehicles, telemetry in `metadata` or nothing."""
    boxes = [("person" if i.category == "Person" else "vehicle", i.box_xyxy) for i in labels]
    instances = [Instance(category, np.asarray(box, np.float64)) for category, box in boxes if box is not None]
    return ImageRecord(
        f"{frame.sequence}_{path.stem}", path, frame.split, plan.camera.size_wh,
        frame.pitch_deg if frame.telemetry else None, frame.altitude_m if frame.telemetry else None, None,
        tuple(instances), extra={"fields": {monet.NEST: telemetry_of(frame, seed)}}, file_name=frame.name,
        sequence=frame.sequence,
    )  # fmt: skip


def _facts(frame: FrameFacts, plan: WorldPlan, labels: Sequence[Label]) -> dict[str, Any]:
    """A frame's entry in world.json: its camera, its place, and every classed thing with its visibility."""
    return {
        "name": frame.name,
        "split": frame.split,
        "kind": plan.kind,
        "air_k": plan.air_k,
        "camera": asdict(plan.camera),
        "objects": [
            {
                "category": label.category,
                "visibility": round(label.visibility, 4),
                "truncated": label.truncated,
                "dropped": label.dropped,
            }
            for label in labels
        ],
    }
