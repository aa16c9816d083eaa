"""WIT-UAS (Jong et al. 2023): runs over wildland fires, frames of a FLIR and a Seek camera, a `.label` beside each.

    {train,val,test}/<YYYY-MM-DD>_FIRE-SGL-<n>-<Site>_<Drone>/<run>_{flir|seek}/time_<seconds>.png and .label

A label line is `x1 y1 x2 y2 code`, edges in pixels; code `h` is a human, `v` or `c` a vehicle. The file may be
missing or empty.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path, PurePosixPath

from infrablend.core.capture import Capture
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.formats.base import Match, check_splits, require_options
from infrablend.formats.box_checks import snap_edges
from infrablend.formats.pictures.listing import by_folder, sidecar_labels
from infrablend.formats.records import KEEP_OR_DROP, Findings, with_label_files
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
        place = (root / folder).absolute()
        # Both cameras of a run see the same scene: one sequence.
        run, _, sensor = place.name.rpartition("_")
        split = _split(folder)
        if split not in wanted:
            continue
        if camera not in (sensor.lower(), "both"):
            found.counts["other_camera"] += len(frames)
            continue
        parts = [part for part in PurePosixPath(folder).parts if part not in SPLITS]
        date = _DATE.match(place.parent.name)
        capture = Capture(sequence=run, captured=date[1] if date else None)
        for r in with_label_files(found, frames, ".label", unlabelled, folder, _read_label):
            time = Capture.from_json({"time_s": r.path.stem.removeprefix("time_")}, strict=False)
            extra = {"sensor": sensor.lower(), **r.extra}
            name = "/".join([*parts, r.name])
            records.append(replace(r, split=split, capture=time.over(capture), extra=extra, file_name=name))
    if found.counts["other_camera"]:
        text = f"{found.counts['other_camera']} picture(s) of the other camera left out"
        found.warn(root.name, "camera-excluded", text, f"camera={camera}")
    rows = found.rows("labelled", "empty", "unlabelled", "objects", "read", "without_area", "other_camera")
    notes = {"labels": NAME, "camera": camera, "rows": rows}
    return found.dataset(NAME, records, CATEGORIES, notes, metadata=metadata, splits=wanted)


def _split(folder: str) -> Split:
    return next((s for part in PurePosixPath(folder).parts for s in SPLITS if s == part), "train")


def _read_label(found: Findings, path: Path, size_wh: tuple[int, int]) -> list[Instance] | None:
    text = found.text(path, "a label file")
    if text is None:
        return None
    found.counts["labelled"] += 1
    instances: list[Instance] = []
    lines = [(n, words) for n, line in enumerate(text.splitlines(), 1) if (words := line.split())]
    found.counts["empty"] += not lines
    for n, words in lines:
        here = f"{found.place(path)}: line {n}"
        found.counts["objects"] += 1
        edges = to_floats(words[:4], 4) if len(words) == 5 else None
        code = words[-1].lower()
        if edges is None:
            found.add(here, "label-malformed", repr(" ".join(words)[:80]), "x1 y1 x2 y2 code", "correct the line")
        elif code not in CODES:
            found.add(here, "category-unknown", f"code {code[:20]!r}", "h, v or c", "correct the line")
        elif (box := found.box(snap_edges(edges, size_wh), size_wh, here)) is not None:
            instances.append(Instance(CODES[code], box, extra={"code": code} if code == "c" else {}))
        else:
            found.counts["without_area"] += found.problems[-1].code in ("box-empty", "box-outside")
    found.counts["read"] += len(instances)
    return instances
