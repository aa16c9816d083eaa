"""Tries a recipe on one frame, again whenever recipe, models or data change; nothing but a sheet is written.

The worker stays warm between attempts, and the backgrounds are read again only if their folder has changed.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from infrablend.assets.model_files import find_model_files
from infrablend.assets.user_model import is_description, read_description
from infrablend.config.loading import read_recipe
from infrablend.config.recipe import Recipe
from infrablend.config.sensor_profile import PROFILE_SUFFIXES
from infrablend.core.dataset import Dataset, Instance
from infrablend.core.yaml_text import read_yaml
from infrablend.errors import DatasetError, InfraBlendError, Problem
from infrablend.formats import dataset_folder
from infrablend.formats.pictures.listing import PICTURE_SUFFIXES
from infrablend.formats.read_write import READ_ALL, Reading
from infrablend.pipeline.compose.frame_worker import FrameWorkers
from infrablend.pipeline.compose.memory_frames import Frame, as_frame
from infrablend.pipeline.compose.settings import settings_for
from infrablend.pipeline.plans.backgrounds import dataset_levels
from infrablend.pipeline.plans.own_boxes import OwnBoxes
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.pipeline.plans.planning import make_plan, reading_for
from infrablend.pipeline.plans.run_request import ONE_WORKER, Execution, Settings
from infrablend.pipeline.plans.selection import ALL_FRAMES, FrameSelection
from infrablend.report.preview import PreviewFrame, contact_sheet
from infrablend.sampling.labelled_ground import LabelledGround

POLL_S = 0.02
"""Time between two looks at recipe and models; the data are looked at less often, since they may be many files."""
_DATA_POLL_S = 0.5
_DATA_POLL_SHARE = 0.1
_MOST_POLLS = 50

_State = tuple[str, int, int] | None
"""Path, time of change and size of a file; None if it does not exist."""


@dataclass(frozen=True)
class TrialRequest:
    """Request to try a recipe on one frame.

    Attributes:
        recipe: Name of a shipped recipe, or path of a YAML file.
        data: Folder of the background dataset, or a video.
        frame: Id of the frame (`test/a_c0`) or of a background; None for the first one.
        seed: Seed, as of a run.
        settings: Recipe fields to set.
        reading: How to read `data`.
        execution: Device and renderer.
    """

    recipe: str | Path
    data: Path
    frame: str | None = None
    seed: int = 0
    settings: Settings = ()
    reading: Reading = READ_ALL
    execution: Execution = ONE_WORKER


@dataclass(frozen=True, eq=False)
class Trial:
    """A frame that was tried.

    Attributes:
        frame: The frame, with the same picture and labels as in a run.
        problems: Warnings about the recipe and the background.
        seconds: Time from the change of a file, or from the start, to the frame.
        labelled_ground: On which kinds of ground the dataset's labelled objects are.
        scenes: Number of scenes that a run makes of each background.
    """

    frame: Frame
    problems: tuple[Problem, ...]
    seconds: float
    labelled_ground: LabelledGround
    scenes: int

    def write(self, out: str | Path) -> Path:
        """Write the frame with its boxes and its enlarged inserts as a PNG; return its path.

        Raises:
            OutputError: The file exists and is not such a sheet, or cannot be written.
        """
        image = self.frame.image
        facts = [f"{name} {value:g}{unit}" for name, value, unit in (
            ("pitch", image.capture.pitch_deg, "\u00b0"), ("altitude", image.capture.altitude_m, " m"),
        ) if value is not None]  # fmt: skip
        title = "   ".join([self.frame.id, *facts, *([image.capture.time_of_day] if image.capture.time_of_day else [])])
        shown = PreviewFrame(title, self.frame.pixels, self.frame.labels, self.frame.id)
        return contact_sheet([shown], Path(out), compress_level=1)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        record = self.frame.record
        return {
            "frame": self.frame.id,
            "background": dict(record.background),
            "inserted": [i.to_json() for i in self.frame.inserted],
            "removed": [dict(r) for r in record.removed],
            "draws": {} if record.scene is None else dict(record.scene.draws),
            "facts": dict(record.facts),
            "problems": [p.to_json() for p in self.problems],
            "seconds": round(self.seconds, 3),
        }


def how_visible(label: Instance) -> list[str]:
    """Return the visible share and the contrast of an insert in words, as far as they are known."""
    found = [] if label.visibility is None else [f"{100 * label.visibility:.0f} % visible"]
    if "contrast_grey" in label.extra:
        found.append(f"contrast {label.extra['contrast_grey']:+.0f} grey levels")
    return found


def gain_words(matching: Mapping[str, Any]) -> list[str]:
    """Return the gain of a frame, and what it rests on, in words."""
    found = []
    for which, gain in (matching.get("gain") or {}).items():
        value = gain.get("grey_per_k")
        count = gain.get("anchors_used", 0)
        if not isinstance(value, int | float):
            continue
        alone = not count or gain.get("from_prior")
        rests = "the recipe's expectation alone" if alone else f"{count} patches of the background"
        doubts = gain.get("doubts") or ()
        doubt = f"; doubtful: {', '.join(str(d) for d in doubts)}" if doubts else ""
        found.append(f"gain ({which}) {value:.1f} grey levels per kelvin, from {rests}{doubt}")
    return found


class Trials:
    """Tries of one recipe on one frame, on a warm worker."""

    def __init__(self, request: TrialRequest) -> None:
        """Start the worker, which loads Blender while the recipe and the backgrounds are read."""
        self._request = request
        self._workers = FrameWorkers(request.execution)
        if not request.execution.in_process:
            self._workers.start()
        self._read: tuple[Any, Dataset, OwnBoxes] | None = None
        self._levels: tuple[Dataset, tuple[float, float]] | None = None
        self._recipe: Recipe | None = None
        self._picture: Path | None = None

    def again(self, *, recipe: str | Path, settings: Settings, frame: str) -> Trial:
        """Return a frame of another recipe, or of the same one with other settings, from the same worker and data.

        Raises:
            InfraBlendError: The recipe, the data or the frame cannot be used.
        """
        self._request = replace(self._request, recipe=recipe, settings=settings, frame=frame)
        return self.compose()

    def compose(self) -> Trial:
        """Read what has changed, and return the frame.

        Raises:
            InfraBlendError: The recipe, the data or the frame cannot be used.
        """
        started = time.perf_counter()
        request = self._request
        loaded = read_recipe(request.recipe, request.settings)
        self._recipe = loaded.recipe
        reading = reading_for(loaded.recipe, request.reading, request.data)
        if self._read is None or self._read[0] != reading:
            read = dataset_folder.read(request.data, reading)
            self._read = reading, read, OwnBoxes(read)
        _, dataset, boxes = self._read
        selection = ALL_FRAMES if request.frame is None else FrameSelection(frames=[request.frame])
        plan = make_plan(
            loaded.recipe, dataset, request.seed, splits=request.reading.splits, selection=selection, own_boxes=boxes
        )
        planned = _frame_of(plan)
        self._picture = planned.background.path
        settings = settings_for(plan, self._levels_of(plan, dataset), request.execution)
        composed = self._workers.compose_one(planned, settings)
        frame = as_frame(planned, composed, plan.recipe)
        warnings = composed.record.warnings
        seconds = time.perf_counter() - started
        return Trial(frame, (*loaded.warnings, *warnings), seconds, settings.labelled_ground, plan.recipe.scenes)

    def watch(self) -> Iterator[Trial | InfraBlendError]:
        """Yield the frame, and again whenever a file changes that it depends on; errors are yielded, too."""
        data = self._data_state()
        while True:
            states = {path: _state(path) for path in self._files()}
            try:
                yield self.compose()
            except InfraBlendError as error:
                yield error
            # Files that the attempt has found, such as a new model's.
            states = {path: _state(path) for path in self._files()} | states
            data = self._wait(states, data)

    def close(self) -> None:
        """End the worker."""
        self._workers.close()

    def __enter__(self) -> Trials:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _levels_of(self, plan: RunPlan, dataset: Dataset) -> tuple[float, float] | None:
        if not plan.needs_levels:
            return None
        if self._levels is None or self._levels[0] is not dataset:
            self._levels = dataset, dataset_levels(plan)
        return self._levels[1]

    def _wait(self, states: Mapping[Path, _State], data: Sequence[_State]) -> Sequence[_State]:
        """Return when one of these files or the data have changed; return the state of the data."""
        next_look = 0.0
        while True:
            changed = {path for path, state in states.items() if _state(path) != state}
            now = time.perf_counter()
            if now >= next_look:
                found = self._data_state()
                next_look = now + max(_DATA_POLL_S, (time.perf_counter() - now) / _DATA_POLL_SHARE)
                if found != data or self._picture in changed:
                    self._read = self._levels = None
                    return found
            if changed:
                _wait_for_rest(changed)
                return data
            time.sleep(POLL_S)

    def _files(self) -> set[Path]:
        found = {Path(self._request.recipe), *self._profile()}
        if self._request.reading.metadata is not None:
            found.add(Path(self._request.reading.metadata))
        if self._picture is not None:
            found.add(self._picture)
        for name in {o.model for o in self._recipe.objects if is_description(o.model)} if self._recipe else ():
            found.add(Path(name))
            with contextlib.suppress(InfraBlendError, OSError):  # the description itself is watched
                found |= set(find_model_files(read_description(Path(name))[1]).paths)
        return found

    def _profile(self) -> list[Path]:
        """Return the file of the recipe's sensor profile, if it has one of its own."""
        recipe = Path(self._request.recipe)
        with contextlib.suppress(OSError, ValueError, TypeError, AttributeError):
            profile = str((read_yaml(recipe.read_text("utf-8")) or {}).get("sensor", {}).get("profile", ""))
            if profile.lower().endswith(tuple(PROFILE_SUFFIXES)):
                return [recipe.parent / profile]
        return []

    def _data_state(self) -> Sequence[_State]:
        states: list[_State] = []
        for folder, subfolders, files in os.walk(self._request.data):
            subfolders.sort()
            states.append(_state(Path(folder)))
            names = (name for name in sorted(files) if not name.lower().endswith(PICTURE_SUFFIXES))
            states += [_state(Path(folder, name)) for name in names]
        return states


def _frame_of(plan: RunPlan) -> PlannedFrame:
    for frame in plan.frames:
        if frame.configuration is not None:
            return frame
    raise DatasetError(f"{plan.frames[0].frame_id}: an unchanged original; expected a frame with inserted objects")


def _wait_for_rest(paths: Iterable[Path]) -> None:
    """Return when these files stay as they are: editors empty a file before they write it."""
    states = None
    for _ in range(_MOST_POLLS):
        before = states
        states = [_state(path) for path in paths]
        if states == before:
            return
        time.sleep(POLL_S)


def _state(path: Path) -> _State:
    """Return what changes with a file; None if it does not exist."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return str(path), status.st_mtime_ns, status.st_size
