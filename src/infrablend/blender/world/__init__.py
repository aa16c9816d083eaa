"""The virtual thermal world: procedural outdoor scenes seen by a thermal camera from a given pitch and altitude.

`sample_world` draws a plan (pure numpy), `render_world` renders a whole background dataset in HIT-UAV's layout. Only
the latter needs Blender, and imports it when called.
"""

from __future__ import annotations

import contextlib
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from infrablend.blender.world.layout import KINDS, WorldPlan, sample_world
from infrablend.core.cores import take_core
from infrablend.core.dataset import SPLITS, ImageRecord, Instance, Split, TimeOfDay
from infrablend.core.files import write_bytes, write_json
from infrablend.core.rng import stream
from infrablend.core.tasks import Task
from infrablend.errors import OutputError, Problem, RecipeError
from infrablend.formats import hit_uav

if TYPE_CHECKING:
    from infrablend.blender.world.labels import Label

__all__ = ["KINDS", "FrameFacts", "WorldPlan", "WorldReport", "plan_frames", "render_world", "sample_world"]

PITCHES_DEG = (30, 40, 50, 60, 70, 80, 90)
ALTITUDES_M = (60, 70, 80, 90, 100, 110, 120, 130)
# HIT-UAV's own proportions.
SPLIT_SHARES: Mapping[Split, float] = {"train": 0.7, "val": 0.1, "test": 0.2}
NIGHT_SHARE = 0.68
_TOP = {"info": {"description": "InfraBlend virtual thermal world in HIT-UAV layout"}, "licenses": []}


@dataclass(frozen=True)
class FrameFacts:
    """What is fixed of a frame before its scene is drawn; `name` is its file name in HIT-UAV's grammar."""

    number: int
    split: Split
    pitch_deg: int
    altitude_m: int
    time_of_day: TimeOfDay

    @property
    def name(self) -> str:
        """`T_HHH_AA_W_NNNNN.jpg`."""
        night = int(self.time_of_day == "night")
        return f"{night}_{self.altitude_m}_{self.pitch_deg}_0_{self.number:05d}.jpg"


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


def plan_frames(
    count: int,
    seed: int,
    splits: Mapping[Split, float] = SPLIT_SHARES,
    pitches_deg: Sequence[int] = PITCHES_DEG,
    altitudes_m: Sequence[int] = ALTITUDES_M,
) -> tuple[FrameFacts, ...]:
    """Split, pitch, altitude and time of day of `count` frames.

    Pitches, altitudes and splits come in shuffled rounds, so few frames already cover the range.

    Raises:
        RecipeError: A value out of range; all of them are named.
    """
    problems = [
        *_check(count >= 1, "count", str(count), "at least 1"),
        *_check(count <= 100_000, "count", str(count), "at most 100000, the names have five digits"),
        *_check(bool(splits) and set(splits) <= set(SPLITS), "splits", str(sorted(splits)), "train, val or test"),
        *_check(
            all(v >= 0 for v in splits.values()) and sum(splits.values()) > 0,
            "splits", str(dict(splits)), "shares of at least 0, not all 0",
        ),
        *_check(
            bool(pitches_deg) and all(10 <= p <= 90 and p == int(p) for p in pitches_deg),
            "pitches_deg", str(list(pitches_deg)), "whole degrees in [10, 90]",
        ),
        *_check(
            bool(altitudes_m) and all(10 <= a <= 1000 and a == int(a) for a in altitudes_m),
            "altitudes_m", str(list(altitudes_m)), "whole metres in [10, 1000]",
        ),
    ]  # fmt: skip
    if problems:
        raise RecipeError("the virtual world cannot be rendered as asked", problems)
    names = [s for s in SPLITS if splits.get(s, 0) > 0]
    total = sum(splits[s] for s in names)
    given: Counter[Split] = Counter()
    frames = []
    for k in range(count):
        # The split that is furthest behind its share gets the frame.
        split = max(names, key=lambda s: (splits[s] / total * (k + 1) - given[s], -SPLITS.index(s)))
        given[split] += 1
        rng = stream(seed, "world", k, "facts")
        frames.append(
            FrameFacts(
                k,
                split,
                int(_round_robin(pitches_deg, k, seed, "pitch")),
                int(_round_robin(altitudes_m, k, seed, "altitude")),
                "night" if rng.random() < NIGHT_SHARE else "day",
            )
        )
    return tuple(frames)


def _check(good: bool, where: str, found: str, expected: str) -> list[Problem]:
    return [] if good else [Problem(where, "world-value", f"found {found}", expected, "correct the value")]


def _round_robin(values: Sequence[int], k: int, seed: int, what: str) -> int:
    """Value number k of a sequence of shuffled rounds through `values`."""
    turn, at = divmod(k, len(values))
    return values[int(stream(seed, "world", what, turn).permutation(len(values))[at])]


def render_world(
    out: Path,
    count: int,
    seed: int = 0,
    *,
    splits: Mapping[Split, float] = SPLIT_SHARES,
    pitches_deg: Sequence[int] = PITCHES_DEG,
    altitudes_m: Sequence[int] = ALTITUDES_M,
    threads: int = 0,
    paint: Painter | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> WorldReport:
    """Render a background dataset in HIT-UAV's layout: `normal_json/`, `rotate_json/`, and `world.json` with the facts.

    The same arguments give the same bytes; frame k does not depend on how many follow. Without `paint` it needs
    Blender and owns the process's scene while it runs.

    Args:
        out: Folder to write to; must not exist or be empty.
        count: Number of frames.
        seed: Of everything random.
        splits: Share of the frames of each split.
        pitches_deg: Camera depression angles to cover, 90 is straight down.
        altitudes_m: Camera heights to cover.
        threads: CPU threads of the renderer; 0 takes all cores.
        paint: Makes the frames' pictures in the folder it is given, in any order; by default here, one by one.
        progress: Called with (frames done, frames in all) after each frame.

    Raises:
        RecipeError: A value out of range.
        OutputError: `out` is not empty or cannot be written.
        RenderError: Blender failed.
    """
    frames = plan_frames(count, seed, splits, pitches_deg, altitudes_m)
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
        written = hit_uav.write(out, images, hit_uav.CATEGORIES, forms=("normal_json", "rotate_json"), extra=_TOP)
        write_json(out / "world.json", {"seed": seed, "frames": [one.facts for one in ordered]})
    finally:
        # Finished pictures are linked into both forms by now; after a stop nothing half-done is left behind.
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
        plan = sample_world(rng, frame.pitch_deg, frame.altitude_m, frame.time_of_day)
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
    from infrablend.blender.world.look import jpeg_bytes, thermal_frame

    kelvin, labels = renderer.render(plan)
    grey = thermal_frame(
        kelvin, plan.gain_per_k, plan.std_grey, plan.mean_grey, stream(seed, "world", frame.number, "look")
    )
    path = folder / frame.split / frame.name
    write_bytes(path, jpeg_bytes(grey))
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
