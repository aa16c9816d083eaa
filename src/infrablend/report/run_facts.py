"""Facts that the report of a run shows: its summary, lists of frames that numbers lead to, and removed labels as crops.

The records of the frames already hold all facts. A list has an anchor; the page's style hides all other frames when the
anchor is the target of a link, so that the page works without scripts.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median_high
from typing import Any

from infrablend.core.frame_row import Box, FrameRow, InsertRow, RemovedLabel
from infrablend.core.run_record import RunTiming
from infrablend.errors import Problem
from infrablend.thermal.radiometry import ZERO_C_K

_NEAR = 2.0
_NEAR_PX = 30.0


@dataclass(frozen=True)
class RunFacts:
    """Content of the report of a run.

    Attributes:
        root: Folder of the run, from which the pictures are read; the page does not name it.
        recipe: Name of the recipe.
        settings: Settings of the recipe that are not the default, as YAML.
        command: Command that makes the run again from `settings`.
        version: Version of InfraBlend.
        made: Further facts about how the run was made, (name, value).
        excluded: Frames that were left out of the finished run, each with its reason.
        timing: Times, as in its record; the only facts that differ between equal runs.
        frames: Finished frames.
    """

    root: Path
    recipe: str
    description: str
    settings: str
    command: str
    version: str
    made: Sequence[tuple[str, str]]
    counts: Mapping[str, Any]
    problems: Sequence[Problem]
    excluded: Mapping[str, str]
    timing: RunTiming
    machine: Mapping[str, Any]
    frames: Sequence[FrameRow]


@dataclass(frozen=True)
class RemovedCrop:
    """A removed label with what the crop shows: its box, and the insert that covers most of it, if any does."""

    frame: int
    label: RemovedLabel
    box_xyxy: Box
    cover: InsertRow | None

    @property
    def window_xyxy(self) -> Box:
        """Box around the object and the insert, or the part of it near the object where that would be tiny."""
        if self.cover is None:
            return self.box_xyxy
        a, b = self.box_xyxy, self.cover.box_xyxy
        far = max(_NEAR_PX, _NEAR * max(a[2] - a[0], a[3] - a[1]))
        left, top = (max(min(a[k], b[k]), a[k] - far) for k in (0, 1))
        right, bottom = (min(max(a[k], b[k]), a[k] + far) for k in (2, 3))
        return left, top, right, bottom


def removed_crops(frames: Sequence[FrameRow], most: int) -> dict[str, list[RemovedCrop]]:
    """Return at most `most` removed labels by reason; those of which most can still be seen come first."""
    found: dict[str, list[RemovedCrop]] = {}
    for number, frame in enumerate(frames):
        for label in frame.removed:
            if label.box_xyxy is not None:
                one = RemovedCrop(number, label, label.box_xyxy, _cover(label.box_xyxy, frame.inserts))
                found.setdefault(label.reason, []).append(one)
    return {
        reason: sorted(labels, key=lambda c: (c.label.covered_share, c.frame, c.box_xyxy))[:most]
        for reason, labels in sorted(found.items())
    }


def _cover(box: Box, inserts: Sequence[InsertRow]) -> InsertRow | None:
    shared = [(_shared_px(box, i.box_xyxy), i) for i in inserts]
    most = max((area for area, _ in shared), default=0.0)
    return next((i for area, i in shared if area == most), None) if most > 0 else None


def _shared_px(a: Box, b: Box) -> float:
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    return max(0.0, width) * max(0.0, height)


@dataclass(frozen=True)
class Filter:
    """A list of frames: its anchor, what they have in common, and their numbers, ascending."""

    name: str
    title: str
    frames: tuple[int, ...]


class Filters:
    """All lists of frames of a page."""

    def __init__(self) -> None:
        self.all: list[Filter] = []

    def add(self, title: str, frames: Iterable[int]) -> str:
        """Add a list of frames and return the link to it; empty without frames."""
        found = tuple(sorted(set(frames)))
        if not found:
            return ""
        name = f"f{len(self.all)}"
        self.all.append(Filter(name, title, found))
        return f"#{name}"

    def classes(self, count: int) -> list[list[str]]:
        """Return for each of `count` frames the names of its lists."""
        found: list[list[str]] = [[] for _ in range(count)]
        for one in self.all:
            for k in one.frames:
                found[k].append(one.name)
        return found


Sentence = tuple[str, str]
"""A sentence, and the link to the section that it is about; empty for none."""

SMALL_PX = 10

MEANINGS: Mapping[str, str] = {
    "air-drawn": "How warm the air was is not known, so the temperatures of the inserted objects are a guess. State "
    "it.",
    "anchors-contradict": "People or cars in these pictures suggest different temperature scales, so inserted "
    "objects may be too bright or too faint there.",
    "anchors-off": "People or cars in these pictures are brighter or darker than the weather of the recipe "
    "explains. Check whether it was as warm as the recipe says, and whether warm is bright.",
    "capture-zone": "When some pictures were taken is not quite known, because their times have no time zone, so "
    "the sun over them is a guess.",
    "form-partial": "The dataset's own label files do not all have the same pictures; one of them was used.",
    "frame-rate": "How fast the video runs is not known, so the speed of moving objects is a guess.",
    "gain-at-limit": "The estimated temperature scale of these pictures is as far as it may go, so inserted objects "
    "may be too bright or too faint there.",
    "gain-negative": "Real people or cars are dark where they should be bright: perhaps warm is dark in these "
    "pictures.",
    "height-at-limit": "The height of the camera does not fit the sizes of the real objects, so inserted objects "
    "may be too large or too small. Look at the ground with people of 1.7 m: infrablend preview --ground.",
    "height-contradicted": "Real objects are much larger or smaller than the height of the camera gives, and inserted "
    "objects are of another size than they.",
    "height-doubtful": "Real objects are larger or smaller than the height of the camera gives, and inserted objects "
    "are of another size than they. Check height, pitch and lens.",
    "height-replaced": "The recipe states another height of the camera than the pictures; the recipe's was used.",
    "horizon-absent": "Where the camera looked is a guess in many pictures, because no horizon was found.",
    "lens-replaced": "The recipe states another lens than the pictures; the recipe's was used, so sizes are those "
    "that its camera would see.",
    "lens-wide": "The field of view that the pictures state is very wide; sizes follow from it. Check the lens.",
    "low-contrast": "Many objects were left out because nobody could see them, so the pictures are easier than "
    "reality.",
    "masks-missing": "Some pictures have no mask that says where objects may stand, so any suitable ground was used.",
    "no-anchor": "Nothing of known temperature is in sight in these pictures, so how bright the inserted objects "
    "are is an estimate for this kind of camera, not a measurement. Look at some of them beside real ones.",
    "no-effect": "A setting of the recipe does nothing here.",
    "no-ground": "Many objects have no place, because the pictures show too little ground that suits them. Nothing "
    "is wrong if that is so; look at the place map.",
    "no-horizon": "These pictures have no inserted objects, because it is not known where the camera looked.",
    "no-labels": "The pictures have no labels, so real objects in them, if there are any, teach a detector to "
    "overlook such objects.",
    "noise-only": "These pictures are little but noise and have no inserted objects.",
    "nothing-in-front": "Fewer objects are partly hidden than was asked for, because few things in the pictures can "
    "hide them.",
    "objects-absent": "At least half of the objects found no place. Most often the height of the camera or the "
    "field of view is wrong, so that objects would be too small or too large.",
    "pitch-replaced": "The recipe states another direction of the camera than the pictures; the recipe's was used.",
    "recipe-kept": "The recipe was used as it is where the pictures suggest another setting.",
    "sun-above-horizon": "The pictures are said to be of the night, but the sun was up at that time and place. "
    "Check the clock, its time zone and the place.",
    "sun-below-horizon": "The pictures are said to be of the day, but the sun was down at that time and place. "
    "Check the clock, its time zone and the place.",
    "time-replaced": "The recipe states another time of day than the pictures; the recipe's was used.",
    "time-unknown": "Whether some pictures show day or night is not known; they were taken to be by night. State it.",
    "too-hidden": "Many objects were left out because too much of them would have been hidden.",
    "track-faint": "In some frames nobody can see an object whose track goes on; its label is there.",
    "track-smeared": "In some frames the camera or an object moves so fast that little of the object can be seen; its "
    "label is there.",
    "untrusted-left-out": "Objects were left out where the temperature scale of the picture is doubtful.",
    "val-absent": "No pictures are set apart for validation, so a training measures itself on what it has learned, "
    "and its results look better than they are. Divide the dataset: infrablend split.",
}
"""Code of a warning about a run -> what it means for those who use the run."""


def plain_summary(run: RunFacts) -> list[Sentence]:
    """Return the run in a few sentences for readers who do not know the program."""
    frames = run.frames
    inserts = [i for f in frames for i in f.inserts]
    found = _inserted(frames, inserts)
    if hidden := _objects([i for i in inserts if i.visibility is not None and i.visibility < 0.95]):
        text = f"{_count(hidden, 'object')} {_were(hidden)} partly hidden, or cut by the picture's edge."
        found.append((text, "#extremes"))
    found += _times(frames)
    if weather := run.counts.get("weather"):
        found.append((f"Weather over the inserted objects: {weather}.", ""))
    if dropped := sum(len(f.missing) for f in frames):
        text = f"{_count(dropped, 'more object')} {_were(dropped)} wanted, but {_are(dropped)} missing or without label"
        found.append((f"{text}, for the reasons listed below.", "#dropped"))
    removed = sum(not r.inserted for f in frames for r in f.removed)
    real = sum(run.counts.get("labels", {}).values()) - len(inserts)
    lost = f"{_count(removed, 'label')} of real objects {_were(removed)} removed"
    if removed:
        found.append((f"{lost}; all others stay." if real else f"{lost}, and none is left.", "#removed"))
    elif real:
        found.append(("All labels of real objects stay.", ""))
    warnings = {p.code for p in run.problems if p.severity == "warning"}
    if warnings:
        what = "is one thing" if len(warnings) == 1 else f"are {len(warnings)} things"
        found.append((f"There {what} to check before the run is used.", "#warnings"))
    if skipped := run.counts.get("skipped_backgrounds", 0):
        found.append((f"{_count(skipped, 'background')} could not be used.", "#problems"))
    if failed := run.counts.get("failed_frames", 0):
        found.append((f"{_count(failed, 'picture')} could not be made.", "#problems"))
    return found


def _inserted(frames: Sequence[FrameRow], inserts: Sequence[InsertRow]) -> list[Sentence]:
    """Return what was inserted, and of what size."""
    if not inserts:
        bare = sum(r.inserted for f in frames for r in f.removed)
        text = f"{_count(bare, 'object')} {_were(bare)} inserted without label, as the recipe asks for."
        return [(text, "#removed") if bare else ("Nothing was inserted.", "")]
    filled = sum(bool(f.inserts) for f in frames)
    named = ", ".join(f"{n} x {name}" for name, n in Counter(i.category for i in inserts).most_common())
    count = _objects(inserts)
    of_all = _count(len(frames), "picture")
    what = f"{_count(count, 'object')} {_were(count)} inserted into {filled} of {of_all}"
    if count < len(inserts):
        what += f", with {_count(len(inserts), 'label')}"
    found = [(f"{what}: {named}. Each has a label.", "#frames")]
    sizes = [i.size_px for i in inserts]
    small = sum(s < SMALL_PX for s in sizes)
    if len(sizes) == 1:
        return [*found, (f"It is {sizes[0]:.0f} pixels long.", "#charts")]
    text = f"Half of them are at least {median_high(sizes):.0f} pixels long, the smallest is {min(sizes):.0f}"
    return [*found, (f"{text}; {small} of {len(sizes)} {_are(small)} smaller than {SMALL_PX} pixels.", "#charts")]


def _objects(inserts: Sequence[InsertRow]) -> int:
    """Return the number of objects, each of which a sequence shows in many pictures."""
    return len({i.track for i in inserts if i.track}) + sum(not i.track for i in inserts)


def _times(frames: Sequence[FrameRow]) -> list[Sentence]:
    times = Counter(f.time_of_day or "at an unknown time" for f in frames)
    text = ", ".join(f"{n} by {t}" if t in ("day", "night") else f"{n} {_at(t)}" for t, n in times.most_common())
    return [(f"Time of day: {text}.", "#charts")] if frames else []


def weather_of(frames: Iterable[FrameRow]) -> str:
    """Return air, sky and sun over a run in words; empty in a look without weather."""
    found = [f.scene.weather for f in frames if f.scene is not None and f.scene.weather is not None]
    if not found:
        return ""
    skies = Counter("clear" if w.cloud == 0 else "closed" if w.overcast else "partly clouded" for w in found)
    text = f"air {_span([w.air_k - ZERO_C_K for w in found])} °C; sky "
    text += ", ".join(f"{sky} in {n} of {len(found)} pictures" for sky, n in skies.most_common())
    if suns := [w.sun for w in found if w.sun is not None]:
        how = ", ".join(dict.fromkeys("by time and place" if s.source == "computed" else "drawn" for s in suns))
        high = _span([math.degrees(s.elevation_rad) for s in suns])
        text += f"; sun {high} degrees high ({how}) in {len(suns)}"
    return text


def _span(values: Sequence[float]) -> str:
    low = f"{min(values):.1f}"
    high = f"{max(values):.1f}"
    return low if low == high else f"{low} to {high}"


def _at(time: str) -> str:
    return time if time.startswith("at ") else f"at {time}"


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


def _were(n: int) -> str:
    return "was" if n == 1 else "were"


def _are(n: int) -> str:
    return "is" if n == 1 else "are"
