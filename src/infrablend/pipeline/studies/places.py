"""Writes maps of the places in a dataset's pictures: where objects can stand and drive, and what lies there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.files import write_bytes
from infrablend.core.output import require_apart
from infrablend.core.skyline import find_skyline
from infrablend.core.surface_kinds import SURFACES
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.workspace import PLACES_FILE, replacing, workspace
from infrablend.errors import DatasetError, Problem
from infrablend.formats.images import load_background, png_bytes
from infrablend.places.surfaces import DRIVE, STAND, Grey, SurfaceMap, find_surfaces, model_version
from infrablend.report.place_sheet import place_cell, write_place_sheet
from infrablend.report.preview import spread
from infrablend.sampling.placement import boxes_of

_ON_SHEET = 24
# Cameras that look down further than this show no sky.
_LEAST_DOWN_DEG = 25.0
# Least share of the picture that a kind of ground has to have for objects to stand on it.
_LEAST = 0.005
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

    def to_json(self) -> dict[str, Any]:
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
    progress, cells, total, done = paced(on_progress), [], Counter[str](), 0
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
            shares = _shares(found)
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


def _sky(image: ImageRecord, pixels: Grey) -> NDArray[np.bool_] | None:
    """Return the sky of a picture whose horizon can be in it and is found; None without any."""
    pitch = image.capture.pitch_deg
    if pitch is not None and pitch > _LEAST_DOWN_DEG:
        return None
    skyline = find_skyline(pixels.astype(np.float32), float(np.ptp(pixels)) / 255 if pixels.dtype != np.uint8 else 1.0)
    return None if skyline.horizon_px is None else skyline.sky


def _shares(found: SurfaceMap) -> Counter[str]:
    """Return the share of the picture of each kind of surface."""
    kinds = found.shares.argmax(axis=0)
    return Counter({kind: float((kinds == k).mean()) for k, kind in enumerate(SURFACES)})


def _no_place(image: ImageRecord, shares: Counter[str]) -> Problem:
    ((first, share),) = shares.most_common(1)
    what = f"no ground to stand on: {100 * share:.0f} % {first}"
    return Problem(
        f"{image.split}/{image.name}", "no-ground", what, "ground", "leave it out, or give a mask", "warning"
    )
