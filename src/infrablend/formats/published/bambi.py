"""BAMBI (2026): wildlife from straight above, thermal pictures and videos with boxes per flight.

    <flight>_metadata.json    thermal/<flight>_<frame>.jpg    [rgb/<flight>_<frame>.jpg]      corrected boxes
    [<flight>/]<flight>_gt.txt  <flight>_matched_processed.mp4  [<flight>_matched_poses.json <flight>_metadata.json]
    images/<split>/<flight>_<frame>.png  labels/<split>/<flight>_<frame>.txt  [**/<flight>_matched_poses.json]

The first file lists the frames of one flight and the boxes of each, in px of the undistorted thermal picture; the
others are read by `bambi_tracks`. The split is that of the flight. Flights look straight down, unless their poses say
otherwise. The visible-light twins are not read.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from infrablend.core.camera import STRAIGHT_DOWN_DEG
from infrablend.core.capture import Capture
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.file_names import leaves_folder
from infrablend.core.json_records import is_table
from infrablend.errors import Problem
from infrablend.formats.base import Match, check_splits, require_options
from infrablend.formats.pictures.listing import PictureFolder, check_name
from infrablend.formats.published import bambi_tracks
from infrablend.formats.records import KEEP_OR_DROP, Findings, unlabelled_problems
from infrablend.formats.values import iso_date, to_floats, to_int

NAME = "bambi"
OPTIONS = {
    "unlabelled": "keep or drop thermal pictures that no file lists; drop is the default",
    "frames": "key (the default): annotated frames of published flights, or all: also those with interpolated boxes",
}
SPECIES = {
    "Rotwild": "red deer",
    "Rehwild": "roe deer",
    "Damwild": "fallow deer",
    "Schwarzwild": "wild boar",
}
"""English class names by the hunters' names in the files; of other species, by their Wikidata number."""

_PATTERN = "*_metadata.json"
_PICTURES = "thermal"
_EDGES = ("x_min", "y_min", "x_max", "y_max")
_DATE = re.compile(r"(?<!\d)(\d{4})_(\d\d)_(\d\d)(?!\d)", re.ASCII)


def _flight_files(root: Path) -> list[Path]:
    """Return the files of flights; no links out of the folder, pipes or devices."""
    return sorted(p for p in root.glob(_PATTERN) if p.is_file() and not leaves_folder(p))


def detect(root: Path) -> Match:
    """Decide whether `root` contains a flight: boxes as JSON beside thermal pictures, tracks, or YOLO with poses."""
    flight = bambi_tracks.find_flight(root)
    if flight:
        return Match(NAME, True, flight)
    if not (root / _PICTURES).is_dir():
        return Match(
            NAME, False, f"no folder {_PICTURES}, and no flight with <flight>_gt.txt or <flight>_matched_poses"
        )
    for path in _flight_files(root):
        try:
            with path.open("rb") as file:
                start = file.read(4096)
        except OSError:
            continue
        if b'"flight_key"' in start:
            return Match(NAME, True, f"{path.name} describes a flight")
    return Match(NAME, False, f"no file {_PATTERN} with a flight_key")


@dataclass(kw_only=True)
class _Reading(Findings):
    """State of reading one dataset.

    Attributes:
        pictures: Thermal pictures.
        records: Records of the frames in the wanted splits.
        species: Names of all species in the files.
        listed: Names of the pictures that a file lists.
        poses: Poses by flight and frame.
    """

    pictures: PictureFolder
    records: list[ImageRecord] = field(default_factory=list)
    species: set[str] = field(default_factory=set)
    listed: set[str] = field(default_factory=set)
    poses: Mapping[str, Mapping[int, bambi_tracks.Pose]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Flight:
    """What a file says about all frames of its flight."""

    key: str
    split: Split
    captured: str | None


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    unlabelled: str = "drop",
    frames: str = "key",
) -> Dataset:
    """Read the thermal pictures and boxes of all flights in a folder.

    Without a table or poses, the pitch is straight down. Kept pictures that no file lists are train.

    Raises:
        DatasetError: An option has a wrong value, or no picture can be read.
        MissingDependencyError: The frames are in a video, and PyAV is not installed.
    """
    require_options(root, unlabelled=(unlabelled, KEEP_OR_DROP), frames=(frames, ("key", "all")))
    wanted = check_splits(splits)
    if bambi_tracks.find_flight(root):
        flights = bambi_tracks.read_flights(root, wanted, key_frames=frames == "key")
        notes = {"labels": NAME, "rows": flights.rows(*bambi_tracks.COUNTS)}
        categories = bambi_tracks.categories(flights.species)
        return flights.dataset(NAME, flights.records, categories, notes, metadata=metadata, splits=wanted)
    state = _Reading(root, pictures=PictureFolder.scan(root / _PICTURES))
    state.poses = bambi_tracks.all_poses(state)
    for path in _flight_files(root):
        _read_flight(state, path, wanted)
    others = [name for name in state.pictures.by_name if name not in state.listed]
    state.counts["unlabelled"] = len(others)
    state.problems += unlabelled_problems(_PICTURES, len(others), unlabelled, "no entry in any file")
    for name in others if unlabelled == "keep" and "train" in wanted else ():
        path = state.pictures.by_name[name]
        size_wh = state.size(path, f"{_PICTURES}/{name}")
        if size_wh is not None:
            capture = Capture(pitch_deg=STRAIGHT_DOWN_DEG)
            unsaid = {"labelled": False}
            state.records.append(
                ImageRecord("", path, "train", size_wh, (), capture, extra=unsaid, file_name=name)
            )  # fmt: skip
    names = [n for n in SPECIES.values() if n in state.species]
    names += sorted(state.species - set(names))
    categories = [Category(k, n) for k, n in enumerate(names)]
    rows = state.rows("flights", "frames", "objects", "read", "no_animal", "unlabelled")
    notes = {"labels": NAME, "rows": rows}
    return state.dataset(NAME, state.records, categories, notes, metadata=metadata, splits=wanted)


def _read_flight(state: _Reading, path: Path, wanted: tuple[Split, ...]) -> None:
    top = state.json(path)
    if top is None:
        return
    frames = top.get("frames")
    split = next((s for s in SPLITS if s == top.get("split")), None)
    if not is_table(frames) or split is None:
        found = "no frames" if split is not None else "no split train, val or test"
        expected = "flight_key, split (train, val or test) and frames by number"
        state.add(path.name, "annotation-layout", found, expected, "fetch the file again")
        return
    state.counts["flights"] += 1
    flight = _Flight(str(top.get("flight_key") or path.name.removesuffix(_PATTERN[1:])), split, _date(top))
    for number, frame in frames.items():
        state.counts["frames"] += 1
        record = _frame_record(state, flight, frame, f"{path.name}: frame {number}")
        if record is not None and split in wanted:
            state.records.append(record)


def _date(top: dict[str, Any]) -> str | None:
    """Return the date in the folder names of the flight's origin as ISO 8601; None if there is no valid date."""
    dates = (iso_date(*found.groups()) for found in _DATE.finditer(str(top.get("flight_info"))))
    return next((d for d in dates if d), None)


def _frame_record(state: _Reading, flight: _Flight, frame: Any, where: str) -> ImageRecord | None:
    """Return the record of a frame, or None with a problem if its entry or picture cannot be used."""
    entry = frame if isinstance(frame, dict) else {}
    given = entry.get("annotations")
    path = None
    name = str(entry.get("thermal_image"))
    problem = check_name(entry.get("thermal_image"), where)
    if problem is None and not isinstance(given, list):
        expected = "a list of annotations"
        problem = Problem(where, "annotation-layout", "no list of annotations", expected, "fetch the file again")
    if problem is None:
        name, path, problem = state.pictures.find(name, where)
        if problem is None and name in state.listed:
            problem = Problem(where, "image-duplicate", f"picture {name} again", "each picture once", "keep one entry")
        if problem is None and path is None:
            expected = f"the picture in {_PICTURES}"
            problem = Problem(where, "image-missing", f"no picture {name}", expected, "restore it")
        state.listed.add(name)
    if problem is not None or path is None:
        state.problems += [problem] if problem else []
        return None
    size_wh = state.size(path, where)
    if size_wh is None:
        return None
    instances = tuple(_instances(state, given, size_wh, where))
    number = to_int(entry.get("frame_idx"))
    pose = state.poses.get(flight.key, {}).get(-1 if number is None else number)
    posed = Capture(pitch_deg=STRAIGHT_DOWN_DEG) if pose is None else pose.capture
    capture = posed.over(Capture(sequence=flight.key, captured=flight.captured, frame=number))
    return ImageRecord("", path, flight.split, size_wh, instances, capture, file_name=name)


def _instances(state: _Reading, given: Any, size_wh: tuple[int, int], where: str) -> Iterator[Instance]:
    """Yield the objects of a frame; those without a species or with a bad box are left out with a problem."""
    for n, annotation in enumerate(given, 1):
        here = f"{where}: annotation {n}"
        state.counts["objects"] += 1
        values = annotation if isinstance(annotation, dict) else {}
        species = values.get("species")
        box = values.get("bbox")
        edges = to_floats([box.get(k) for k in _EDGES], 4) if isinstance(box, dict) else None
        if not isinstance(species, str) or not species.strip() or edges is None:
            expected = "species, and bbox with x_min, y_min, x_max and y_max"
            found = "no species" if edges is not None else "no box of four numbers"
            state.add(here, "annotation-layout", found, expected, "correct the annotation")
            continue
        xyxy = state.box(edges, size_wh, here)
        if xyxy is None:
            continue
        wikidata = bambi_tracks.WIKIDATA.get(str(values.get("wikidata_id")))
        name = SPECIES.get(species.strip()) or wikidata or species.strip()
        if name == bambi_tracks.NO_ANIMAL:
            state.counts["no_animal"] += 1
            continue
        state.species.add(name)
        state.counts["read"] += 1
        # Sex, age and visibility are codes without a published key, kept as they are.
        codes = {k: values[k] for k in ("gender", "age", "visibility") if to_int(values.get(k)) is not None}
        yield Instance(name, xyxy, source_id=to_int(values.get("label_id")), extra=codes)
