"""Writes maps of the places in a dataset's pictures: where objects can stand and drive, and what lies there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import Dataset, ImageRecord, boxes_of
from infrablend.core.files import write_bytes
from infrablend.core.output_checks import require_apart
from infrablend.core.surface_kinds import SURFACES
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.workspace import PLACES_FILE, replacing, workspace
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures.images import load_background, png_bytes
from infrablend.imaging.skyline import find_skyline
from infrablend.imaging.surfaces import DRIVE, STAND, Grey, find_surfaces, model_version
from infrablend.report.preview import spread
from infrablend.report.surface_sheet import place_cell, write_place_sheet
from infrablend.sampling.labelled_ground import ANY_TIME, ClassGround, LabelledGround, Picture, learn_ground

_ON_SHEET = 24
# Cameras that look down further than this show no sky.
_LEAST_DOWN_DEG = 25.0
# Least share of the picture that a kind of ground has to have for objects to stand on it.
_LEAST = 0.005
# Labels contradict the model where more than this share of what is around them is neither ground nor objects.
_CONTRADICTS = 0.5
SHEET = "places.png"


@dataclass(frozen=True)
class PlacesReport:
    """Maps of places that were written.

    Attributes:
        out: Their folder.
        maps: Number of pictures with maps.
        surfaces: Mean share of each kind of surface, in [0, 1].
        model: Version of the model.
        problems: Pictures without a map, each with its reason, and those without a place to stand.
    """

    out: Path
    maps: int
    surfaces: Mapping[str, float]
    model: str
    problems: tuple[Problem, ...] = field(default=())

    @property
    def ok(self) -> bool:
        """True if every picture has a map."""
        return bool(self.maps) and not any(p.severity == "error" for p in self.problems)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {**asdict(self), "out": str(self.out), "problems": [p.to_json() for p in self.problems]}


def map_places(
    dataset: Dataset, out: Path, *, overwrite: bool = False, on_progress: OnProgress | None = None
) -> PlacesReport:
    """Write `<split>/<id>.stand.png` and `.drive.png` of each picture (8 bit, 255 is likely), and a sheet.

    Raises:
        OutputError: `out` has something that may not be replaced, or cannot be written.
        DatasetError: No picture can be read.
    """
    require_apart(dataset.root, out)
    problems = list(dataset.problems)
    ignored = {c.name for c in dataset.categories if c.ignore}
    shown = set(spread(len(dataset.images), _ON_SHEET))
    progress = paced(on_progress)
    cells = []
    total = Counter[str]()
    done = 0
    with workspace(out, "maps of places", PLACES_FILE, replacing(overwrite)) as space:
        for n, image in enumerate(dataset.images):
            try:
                background = load_background(image.path, image.size_wh)
            except DatasetError as error:
                problems += error.problems
                continue
            boxes = boxes_of([i for i in image.instances if i.category not in ignored])
            found = find_surfaces(background.pixels, boxes, _sky(image, background.pixels))
            for name, kinds in (("stand", STAND), ("drive", DRIVE)):
                grey = np.rint(255 * found.share(kinds)).astype(np.uint8)
                write_bytes(space.folder / image.split / f"{image.id}.{name}.png", png_bytes(grey))
            shares = Counter[str](found.shares_of_kinds())
            total.update(shares)
            done += 1
            if not any(shares[kind] >= _LEAST for kind in STAND):
                problems.append(_no_place(image, shares))
            if n in shown:
                cells.append(place_cell(f"{image.split}/{image.name}", background.pixels, found.kinds()))
            if progress is not None:
                progress(n + 1, len(dataset.images))
        if not done:
            raise DatasetError(f"{dataset.root}: no picture can be read", problems)
        write_place_sheet(space.folder / SHEET, cells)
        surfaces: dict[str, float] = {kind: round(total[kind] / done, 4) for kind in SURFACES if total[kind]}
        report = PlacesReport(out, done, surfaces, model_version(), tuple(problems))
        space.finish({"model": report.model, "maps": done, "surfaces": surfaces})
    return report


@dataclass(frozen=True)
class LearnedReport:
    """What is around a dataset's labelled objects.

    Attributes:
        root: Folder of the dataset.
        pictures: Number of pictures that were read.
        ground: Around the objects of each class, by time of day.
        model: Version of the model of surfaces.
        problems: Pictures that cannot be read, and labels that contradict the model.
    """

    root: Path
    pictures: int
    ground: LabelledGround
    model: str
    problems: tuple[Problem, ...] = field(default=())

    @property
    def ok(self) -> bool:
        """True if something was learned from pictures that can all be read."""
        return bool(self.ground) and not any(p.severity == "error" for p in self.problems)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {**asdict(self), "root": str(self.root), "problems": [p.to_json() for p in self.problems]}


def learn_places(dataset: Dataset, count: int = 200, *, on_progress: OnProgress | None = None) -> LearnedReport:
    """Find on which kinds of ground the labelled objects of `count` pictures are, evenly spread over those with labels.

    Raises:
        DatasetError: No picture has labels, or can be read.
    """
    ignored = {c.name for c in dataset.categories if c.ignore}
    labelled = [i for i in dataset.images if any(o.category not in ignored for o in i.instances)]
    if not labelled:
        raise DatasetError(f"{dataset.root}: no picture has labelled objects; expected some to learn from")
    problems: list[Problem] = []
    progress = paced(on_progress)
    read = 0
    chosen = [labelled[k] for k in spread(len(labelled), count)]

    def pictures() -> Iterator[Picture]:
        nonlocal read
        for n, image in enumerate(chosen):
            try:
                pixels = load_background(image.path, image.size_wh).pixels
            except DatasetError as error:
                problems.extend(error.problems)
                continue
            read += 1
            yield pixels, image.instances, image.capture.time_of_day
            if progress is not None:
                progress(n + 1, len(chosen))

    ground = learn_ground(pictures(), {c.name for c in dataset.categories} - ignored)
    if not read:
        raise DatasetError(f"{dataset.root}: no picture can be read", problems)
    problems += [p for name, by_time in ground.items() if (p := _contradicts(name, by_time[ANY_TIME]))]
    return LearnedReport(dataset.root, read, ground, model_version(), tuple(problems))


def _contradicts(name: str, found: ClassGround) -> Problem | None:
    """Return a warning if labelled objects are on what the model does not take for ground, far more often than not."""
    off = {kind: found.around[kind] for kind in SURFACES if kind not in STAND and kind != "object"}
    kind, share = max(off.items(), key=lambda item: item[1])
    if sum(off.values()) < _CONTRADICTS:
        return None
    return Problem(
        f"class {name}",
        "labels-off-ground",
        f"{found.objects} objects, {100 * sum(off.values()):.0f} % of what is around them is no ground to the model "
        f"({100 * share:.0f} % {kind})",
        "ground",
        "look at places.png of infrablend places map; where the model is wrong, state placement.where.surfaces "
        f"with {kind}, masks, or placement.where=anywhere",
        "warning",
    )


def _sky(image: ImageRecord, pixels: Grey) -> NDArray[np.bool_] | None:
    """Return the sky of a picture whose horizon can be in it and is found; None without any."""
    pitch = image.capture.pitch_deg
    if pitch is not None and pitch > _LEAST_DOWN_DEG:
        return None
    skyline = find_skyline(pixels.astype(np.float32), float(np.ptp(pixels)) / 255 if pixels.dtype != np.uint8 else 1.0)
    return None if skyline.horizon_px is None else skyline.sky


def _no_place(image: ImageRecord, shares: Counter[str]) -> Problem:
    ((first, share),) = shares.most_common(1)
    what = f"no ground to stand on: {100 * share:.0f} % {first}"
    return Problem(
        f"{image.split}/{image.name}", "no-ground", what, "ground", "leave it out, or give a mask", "warning"
    )
