"""WIT-UAS (Jong et al. 2023): runs over wildland fires, frames of a FLIR and a Seek camera, a `.label` beside each.

    {train,val,test}/<YYYY-MM-DD>_FIRE-SGL-<n>-<Site>_<Drone>/<run>_{flir|seek}/time_<seconds>.png and .label

A label line is `x1 y1 x2 y2 code`, edges in pixels; code `h` is a human, `v` or `c` a vehicle. The file may be
missing or empty.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath

import numpy as np

from infrablend.core.capture import Capture
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.formats.base import Match, check_splits, require_options
from infrablend.formats.box_checks import snap_edges
from infrablend.formats.pictures.listing import by_folder, sidecar_labels
from infrablend.formats.published.sidecar import Fault, LabelledFolder, Stated, if_file, line_reader
from infrablend.formats.records import KEEP_OR_DROP, Findings
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
    """Read the runs below a folder; runs outside the folders of splits are train.

    Raises:
        DatasetError: An option has a wrong value, or no frame can be read.
    """
    require_options(root, camera=(camera, ("both", "flir", "seek")), unlabelled=(unlabelled, KEEP_OR_DROP))
    wanted = check_splits(splits)
    found = Findings(root)
    records: list[ImageRecord] = []
    for folder, frames in _runs(root).items():
        pictures = _labelled(root, folder, frames)
        if pictures.split not in wanted:
            continue
        if camera in (pictures.extra["sensor"], "both"):
            records += pictures.read(found, unlabelled, line_reader("a label file", _stated))
        else:
            found.counts["other_camera"] += len(frames)
    if found.counts["other_camera"]:
        text = f"{found.counts['other_camera']} picture(s) of the other camera left out"
        found.warn(root.name, "camera-excluded", text, f"camera={camera}")
    found.counts["without_area"] = found.counts["box-empty"] + found.counts["box-outside"]
    rows = found.rows("labelled", "empty", "unlabelled", "objects", "read", "without_area", "other_camera")
    notes = {"labels": NAME, "camera": camera, "rows": rows}
    return found.dataset(NAME, records, CATEGORIES, notes, metadata=metadata, splits=wanted)


def _labelled(root: Path, folder: str, frames: Mapping[str, Path]) -> LabelledFolder:
    place = (root / folder).absolute()
    # Both cameras of a run see the same scene: one sequence.
    run, _, sensor = place.name.rpartition("_")
    date = _DATE.match(place.parent.name)
    parts = PurePosixPath(folder).parts
    split: Split = next((s for part in parts for s in SPLITS if s == part), "train")
    below = [part for part in parts if part not in SPLITS]

    def capture_of(stem: str) -> Capture:
        time = Capture.from_json({"time_s": stem.removeprefix("time_")}, strict=False)
        return time.over(Capture(sequence=run, captured=date[1] if date else None))

    return LabelledFolder(
        where=folder,
        pictures={"/".join([*below, name]): path for name, path in frames.items()},
        label_of=lambda picture: if_file(picture.with_suffix(".label")),
        missing="no .label file",
        capture_of=capture_of,
        split=split,
        extra={"sensor": sensor.lower()},
    )


def _stated(line: str, size_wh: tuple[int, int]) -> Stated:
    words = line.split()
    values = to_floats(words[:4], 4) if len(words) == 5 else None
    if values is None:
        return Fault("label-malformed", repr(" ".join(words)[:80]), "x1 y1 x2 y2 code")
    code = words[-1].lower()
    if code not in CODES:
        return Fault("category-unknown", f"code {code[:20]!r}", "h, v or c")
    return Instance(CODES[code], np.array(snap_edges(values, size_wh)), extra={"code": code} if code == "c" else {})
