"""Estimates pitch, roll, height and lens of the cameras of a dataset, from what its pictures and labels show.

Labelled people, cars and two-wheelers tell most: see `core.camera_fit`. What the data state, the horizon, upright lines
and the overlap of flights are sources beside them, and it is said where they contradict each other.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.core.camera_fit import fit_camera
from infrablend.core.capture import FACTS
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.files import write_text
from infrablend.core.output_checks import require_outside_datasets
from infrablend.core.tasks import OnProgress, paced
from infrablend.errors import ArgumentError, DatasetError, OutputError, Problem
from infrablend.formats.pictures.listing import read_size
from infrablend.formats.values import csv_text
from infrablend.pipeline.studies.camera_sources import (
    LEVEL_RAD,
    CameraEstimate,
    CameraValue,
    FittedCamera,
    describe_camera,
    doubts,
)
from infrablend.pipeline.studies.flight_overlap import glance_at_overlap
from infrablend.pipeline.studies.labelled_camera import (
    LEAST_BOXES,
    SeenBoxes,
    SeenLines,
    Turns,
    find_lines,
    find_turns,
    rolls_of_spans,
    sized_boxes,
    still,
)
from infrablend.report.ground_preview import data_ground_sheet

# A camera that turns is believed if sizes then scatter less by this share.
_LESS_SCATTER = 0.8


@dataclass(frozen=True)
class CameraSettings:
    """What is known of a camera beside the data.

    Attributes:
        hfov_deg: Field of view across the picture's width, degrees [default: as the data state it].

    Raises:
        ArgumentError: It is no field of view.
    """

    hfov_deg: float | None = None

    def __post_init__(self) -> None:
        if self.hfov_deg is not None and not 0.1 <= self.hfov_deg <= 170:
            raise ArgumentError(f"hfov_deg: found {self.hfov_deg:g}, expected 0.1 to 170 degrees")


AS_STATED = CameraSettings()


@dataclass(frozen=True)
class CameraReport:
    """The cameras of a dataset.

    Attributes:
        cameras: Each of them.
        written: Files that were written.
        problems: Sequences whose camera is not known, and what contradicts each other.
        dataset: The dataset, whose pictures state what was found.
    """

    cameras: tuple[CameraEstimate, ...]
    written: tuple[Path, ...]
    problems: tuple[Problem, ...]
    dataset: Dataset = field(repr=False)

    @property
    def ok(self) -> bool:
        """Whether the camera of each sequence is known."""
        return not any(p.severity == "error" for p in self.problems)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "cameras": [asdict(camera) for camera in self.cameras],
            "written": [str(path) for path in self.written],
            "problems": [p.to_json() for p in self.problems],
        }


def estimate_camera(
    dataset: Dataset,
    out: Path | None = None,
    settings: CameraSettings = AS_STATED,
    *,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> CameraReport:
    """Estimate the camera of each sequence, or of all pictures that state the same where there are none.

    Args:
        dataset: Dataset with labels, or pictures that state pitch and height.
        out: CSV file to write what was found of each picture to, as a table that `--metadata` takes; a picture of the
            ground is written beside it.
        settings: What is known beside the data.
        overwrite: Replace an earlier table.
        on_progress: Called after each picture.

    Raises:
        DatasetError: No camera is known.
        OutputError: `out` exists, or cannot be written.
    """
    if out is not None:
        require_outside_datasets(dataset.root, out)
        if out.exists() and not overwrite:
            raise OutputError(f"{out}: exists; nothing was touched. Give another file, or --overwrite")
    groups = _groups(dataset)
    progress = paced(on_progress)
    total = len(dataset.images)
    done = 0

    def read() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(min(done, total), total)

    cameras = []
    problems: list[Problem] = []
    stating: dict[tuple[str, str], ImageRecord] = {}
    for name, images in groups.items():
        try:
            found = _estimate(name, images, settings, read)
        except DatasetError as error:
            problems += error.problems
            continue
        cameras.append(found.estimate)
        problems += found.problems
        stating |= {(i.split, i.id): i for i in found.images}
    if not cameras:
        raise DatasetError(f"{dataset.root}: no camera is known", problems)
    known = replace(dataset, images=tuple(stating.get((i.split, i.id), i) for i in dataset.images))
    written = () if out is None else _write(known, [*stating.values()], out)
    return CameraReport(tuple(cameras), written, tuple(problems), known)


def _groups(dataset: Dataset) -> dict[str, list[ImageRecord]]:
    """Return the pictures of each camera: of one sequence, or with the same stated pitch and height, and of one size.

    Raises:
        DatasetError: The size of a picture cannot be read.
    """
    found: dict[tuple[str, tuple[int, int]], list[ImageRecord]] = {}
    problems = []
    for image in dataset.images:
        size_wh, problem = (image.size_wh, None) if image.size_wh else read_size(image.path, image.name)
        if size_wh is None:
            problems += [problem] if problem else []
            continue
        capture = image.capture
        name = capture.sequence or ", ".join(
            f"{name.partition('_')[0]} {value:g}"
            for name in ("pitch_deg", "altitude_m")
            if (value := getattr(capture, name)) is not None
        )
        found.setdefault((name or "all pictures", size_wh), []).append(replace(image, size_wh=size_wh))
    if problems:
        raise DatasetError(f"{dataset.root}: pictures that cannot be read", problems)
    sizes = Counter(name for name, _ in found)
    return {name if sizes[name] == 1 else f"{name}, {w}x{h}": of for (name, (w, h)), of in found.items()}


@dataclass(frozen=True)
class _Found:
    """An estimate, the pictures of known cameras, which state it, and what contradicts it."""

    estimate: CameraEstimate
    images: list[ImageRecord]
    problems: list[Problem]


def _estimate(name: str, images: list[ImageRecord], settings: CameraSettings, read: Callable[[], None]) -> _Found:
    """Return the camera of one sequence.

    Raises:
        DatasetError: It is not known.
    """
    size_wh = images[0].size_wh
    assert size_wh is not None
    stated = all(i.capture.pitch_deg is not None for i in images)
    turning = None
    if stated or images[0].capture.sequence is None or len(images) == 1:
        for _ in images:
            read()
    else:
        turning = find_turns(images, size_wh, read)
    lens = _stated_lens(images, settings)
    focal_px = None if lens is None else size_wh[0] / 2 / math.tan(math.radians(lens.value) / 2)
    lines = find_lines(images)
    ways = [still(len(images)), *([] if turning is None else [turning])]
    tried = [fitted for turns in ways if (fitted := _fitted(images, size_wh, turns, lines, focal_px)) is not None]
    if not tried:
        raise _too_few(name, sized_boxes(images, size_wh, ways[-1]))
    best = tried[-1] if tried[-1].scatter < _LESS_SCATTER * tried[0].scatter else tried[0]
    labels = best
    if stated:
        held = np.zeros(len(best.fit.pitch_rad))
        best = replace(best, fit=fit_camera(best.seen.boxes, focal_px, held))
    elif not best.told.any():
        raise _not_told(name, best)
    estimate, known = describe_camera(name, images, best, labels, lens, lines)
    return _Found(estimate, known, doubts(estimate))


def _fitted(
    images: Sequence[ImageRecord], size_wh: tuple[int, int], turns: Turns, lines: SeenLines, focal_px: float | None
) -> FittedCamera | None:
    """Return the camera that boxes agree with; None if there are too few of them."""
    seen = sized_boxes(images, size_wh, turns)
    if len(seen.boxes) < LEAST_BOXES:
        return None
    fit = fit_camera(seen.boxes, focal_px)
    rolls = rolls_of_spans(lines, turns, seen.spans.tolist(), fit.focal_px)
    level = abs(float(np.median(fit.pitch_rad)) + float(np.median(seen.boxes.pitch_rad))) < LEVEL_RAD
    if level and np.isfinite(rolls).any():
        fit = fit_camera(seen.boxes, focal_px, roll_rad=rolls)
    return FittedCamera(turns, seen, fit)


def _stated_lens(images: Sequence[ImageRecord], settings: CameraSettings) -> CameraValue | None:
    """Return the field of view that is given, stated, or told by the overlap of a flight; None without any."""
    if settings.hfov_deg is not None:
        return CameraValue("hfov_deg", "given", settings.hfov_deg, 0.0, "used")
    if stated := [i.capture.hfov_deg for i in images if i.capture.hfov_deg is not None]:
        return CameraValue("hfov_deg", "stated", float(np.median(stated)), 0.0, "used")
    overlap = glance_at_overlap(images)
    for value in overlap if isinstance(overlap, list) else ():
        if value["name"] == "hfov_deg":
            half = (value["high"] - value["low"]) / 2
            return CameraValue("hfov_deg", "overlap", value["value"], half, "used")
    return None


def _too_few(name: str, seen: SeenBoxes) -> DatasetError:
    left_out = ", ".join(f"{n} {reason}" for reason, n in seen.left_out.items())
    found = f"{len(seen.boxes)} boxes of people, cars or bicycles in different places"
    found += f" ({left_out} left out)" if left_out else ""
    todo = "label more, over all of the ground that is seen; or state pitch, height and lens in metadata.csv"
    problem = Problem(name, "labels-few", found, f"at least {LEAST_BOXES}", todo)
    return DatasetError(f"{name}: too few labels", [problem])


def _not_told(name: str, fitted: FittedCamera) -> DatasetError:
    fit = fitted.fit
    rows = fitted.seen.boxes.boxes[:, 3]
    error = math.degrees(float(fit.pitch_sd.min()))
    found = (
        f"{len(rows)} boxes, with their feet in rows over {np.ptp(rows):.0f} px, tell the pitch to {error:.0f} degrees"
    )
    found += f"; only the height over the focal length, {1000 * fit.factor / fit.focal_px:.3g} mm per px, follows"
    todo = "state pitch_deg in metadata.csv (90 for a camera that looks straight down)"
    expected = "boxes whose size changes from row to row: not those of a camera that looks straight down"
    return DatasetError(f"{name}: no pitch", [Problem(name, "pitch-untold", found, expected, todo)])


def _write(dataset: Dataset, images: Sequence[ImageRecord], out: Path) -> tuple[Path, ...]:
    """Write the table of the pictures whose camera is known, and the ground under some of them beside it."""
    rows = [(i.name, i.capture.to_json()) for i in images]
    columns = [name for name in FACTS if any(name in facts for _, facts in rows)]
    lines = [(name, *(facts.get(column, "") for column in columns)) for name, facts in rows]
    table = write_text(out, csv_text(("file", *columns), lines))
    return table, data_ground_sheet(replace(dataset, images=tuple(images)), out.with_suffix(".png"))
