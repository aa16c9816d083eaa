"""WIT-UAS (Jong et al. 2023): runs over wildland fires, frames of a FLIR and a Seek camera, a `.label` beside each.

    {train,val,test}/<YYYY-MM-DD>_FIRE-SGL-<n>-<Site>_<Drone>/<run>_{flir|seek}/time_<seconds>.png and .label

A label line is `x1 y1 x2 y2 code`, edges in pixels; code `h` is a human, `v` or `c` a vehicle. The file may be
missing or empty.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Any

from infrablend.core.capture import Capture
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.errors import Problem
from infrablend.formats.annotation_files import read_text
from infrablend.formats.base import Match, check_splits, require_options
from infrablend.formats.box_checks import check_box, snap
from infrablend.formats.pictures import by_folder, sidecar_labels
from infrablend.formats.records import KEEP_OR_DROP, make_dataset
from infrablend.formats.sidecar_labels import SidecarLabels
from infrablend.formats.values import to_floats

NAME = "wit-uas"
OPTIONS = {
    "camera": "camera whose frames are read: both (the default), flir or seek",
    "unlabelled": "keep or drop pictures without a .label file; keep is the default",
}
CATEGORIES = (Category(0, "human"), Category(1, "vehicle"))
CODES = {"h": "human", "v": "vehicle", "c": "vehicle"}

_RUN = re.compile(r"(.+)_(flir|seek)", re.IGNORECASE)
_TIME = re.compile(r"time_(\d+(?:\.\d+)?)", re.ASCII)
_DATE = re.compile(r"(\d{4}-(?:0[1-9]|1[0-2])-(?:0[1-9]|[12]\d|3[01]))_", re.ASCII)


def _runs(root: Path) -> dict[str, dict[str, Path]]:
    """Return the frames by run folder (relative) and name."""
    found = {}
    for folder, pictures in by_folder(root).items():
        frames = {n: p for n, p in pictures.items() if _TIME.fullmatch(p.stem)}
        if frames and _RUN.fullmatch((root / folder).absolute().name):
            found[folder] = frames
    return found


def detect(root: Path) -> Match:
    """Decide whether `root` contains folders of a run by one camera."""
    runs = _runs(root)
    if not runs:
        return Match(NAME, False, "no folder <run>_flir or <run>_seek with pictures time_<seconds>.png")
    if not sidecar_labels(runs, ".label"):
        return Match(NAME, False, f"{len(runs)} folder(s) of runs, but no .label file beside a picture")
    return Match(NAME, True, f"{len(runs)} folder(s) of runs such as {next(iter(runs))}")


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    camera: str = "both",
    unlabelled: str = "keep",
) -> Dataset:
    """Read the runs below a folder.

    Args:
        root: Folder of splits, or of runs; runs outside the folders of splits are train.
        splits: Splits to read; None reads all.
        metadata: Table of pitch and altitude, by file or by run (`sequence`); None takes `metadata.csv` or `.json`.
        camera: Camera whose frames are read.
        unlabelled: Treatment of frames without a `.label` file.

    Raises:
        DatasetError: An option has a wrong value, or no frame can be read.
    """
    require_options(root, camera=(camera, ("both", "flir", "seek")), unlabelled=(unlabelled, KEEP_OR_DROP))
    wanted = check_splits(splits)
    problems: list[Problem] = []
    counts: Counter[str] = Counter()
    beside = SidecarLabels(root, ".label", unlabelled, _read_label, problems, counts)
    records: list[ImageRecord] = []
    for folder, frames in _runs(root).items():
        found = _RUN.fullmatch((root / folder).absolute().name)
        # Both cameras of a run see the same scene: one sequence.
        run, sensor = (found[1], found[2].lower()) if found else (folder, "")
        split = _split(folder)
        if split not in wanted:
            continue
        if camera not in (sensor, "both"):
            counts["other_camera"] += len(frames)
            continue
        parts = [part for part in PurePosixPath(folder).parts if part not in SPLITS]
        date = _DATE.match((root / folder).absolute().parent.name)
        for p in beside.read(folder, frames):
            time = _TIME.fullmatch(p.path.stem)
            extra: dict[str, Any] = {"sensor": sensor} | ({"time_s": float(time[1])} if time else {})
            extra |= {} if p.labelled else {"labelled": False}
            records.append(
                ImageRecord(
                    "",
                    p.path,
                    split,
                    p.size_wh,
                    p.instances,
                    capture=Capture(sequence=run, captured=date[1] if date else None),
                    extra=extra,
                    file_name="/".join([*parts, p.name]),
                )
            )
    if counts["other_camera"]:
        text = f"{counts['other_camera']} picture(s) of the other camera left out"
        problems.append(Problem(root.name, "camera-excluded", text, f"camera={camera}", "", "warning"))
    keys = ("labelled", "empty", "unlabelled", "objects", "read", "without_area", "other_camera")
    notes = {"labels": NAME, "camera": camera, "rows": {k: counts[k] for k in keys}}
    return make_dataset(root, NAME, records, CATEGORIES, problems, notes, metadata=metadata, splits=wanted)


def _split(folder: str) -> Split:
    return next((s for part in PurePosixPath(folder).parts for s in SPLITS if s == part), "train")


def _read_label(
    root: Path, path: Path, size_wh: tuple[int, int], problems: list[Problem], counts: Counter[str]
) -> list[Instance] | None:
    """Return the objects in a label file; None, with a problem, if it cannot be read."""
    where = path.relative_to(root).as_posix()
    text, problem = read_text(path, where, "a label file")
    if problem is not None:
        problems.append(problem)
        return None
    counts["labelled"] += 1
    instances: list[Instance] = []
    lines = [(n, words) for n, line in enumerate(text.splitlines(), 1) if (words := line.split())]
    counts["empty"] += not lines
    for n, words in lines:
        here = f"{where}: line {n}"
        counts["objects"] += 1
        edges = to_floats(words[:4], 4) if len(words) == 5 else None
        if edges is None:
            found = repr(" ".join(words)[:80])
            problems.append(Problem(here, "label-malformed", found, "x1 y1 x2 y2 code", "correct the line"))
            continue
        code = words[4].lower()
        if code not in CODES:
            problems.append(Problem(here, "category-unknown", f"code {code[:20]!r}", "h, v or c", "correct the line"))
            continue
        box, problem = check_box([snap(v, size_wh[i % 2]) for i, v in enumerate(edges)], size_wh, here)
        if problem is not None:
            problems.append(problem)
            counts["without_area"] += problem.code in ("box-empty", "box-outside")
        if box is not None:
            instances.append(Instance(CODES[code], box, extra={"code": code} if code == "c" else {}))
    counts["read"] += len(instances)
    return instances
