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
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from infrablend.core.capture import Capture
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.file_names import leaves_folder
from infrablend.core.json_records import is_table
from infrablend.errors import Problem
from infrablend.formats.base import Match, check_splits, names_of, require_options
from infrablend.formats.pictures.listing import PictureFolder, check_name
from infrablend.formats.published import bambi_tracks
from infrablend.formats.published.sidecar import Fault, Stated, checked
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
        listed: Names of the pictures that a file lists.
        poses: Poses by flight and frame.
    """

    pictures: PictureFolder
    listed: set[str] = field(default_factory=set)
    poses: Mapping[str, Mapping[int, Capture]] = field(default_factory=dict)


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
        flights = Findings(root)
        made = bambi_tracks.read_flights(flights, wanted, key_frames=frames == "key")
        notes = {"labels": NAME, "rows": flights.rows(*bambi_tracks.COUNTS)}
        return flights.dataset(NAME, made, bambi_tracks.categories(made), notes, metadata=metadata, splits=wanted)
    state = _Reading(root, pictures=PictureFolder.scan(root / _PICTURES))
    state.poses = bambi_tracks.all_poses(state)
    listed = [record for path in _flight_files(root) for record in _read_flight(state, path)]
    others = [name for name in state.pictures.by_name if name not in state.listed]
    state.counts["unlabelled"] = len(others)
    state.problems += unlabelled_problems(_PICTURES, len(others), unlabelled, "no entry in any file")
    records = [record for record in listed if record.split in wanted]
    for name in others if unlabelled == "keep" and "train" in wanted else ():
        path = state.pictures.by_name[name]
        size_wh = state.size(path, f"{_PICTURES}/{name}")
        if size_wh is not None:
            unsaid = {"labelled": False}
            capture = bambi_tracks.STRAIGHT_DOWN
            records.append(ImageRecord("", path, "train", size_wh, (), capture, extra=unsaid, file_name=name))
    species = names_of(listed)
    names = [n for n in SPECIES.values() if n in species]
    names += [n for n in species if n not in names]
    categories = [Category(k, n) for k, n in enumerate(names)]
    rows = state.rows("flights", "frames", "objects", "read", "no_animal", "unlabelled")
    notes = {"labels": NAME, "rows": rows}
    return state.dataset(NAME, records, categories, notes, metadata=metadata, splits=wanted)


def _read_flight(state: _Reading, path: Path) -> Iterator[ImageRecord]:
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
    # The first valid date in the folder names of the flight's origin.
    dates = (iso_date(*found.groups()) for found in _DATE.finditer(str(top.get("flight_info"))))
    key = str(top.get("flight_key") or path.name.removesuffix(_PATTERN[1:]))
    flight = Capture(sequence=key, captured=next((d for d in dates if d), None))
    for number, frame in frames.items():
        state.counts["frames"] += 1
        record = _frame_record(state, split, flight, frame, f"{path.name}: frame {number}")
        if record is not None:
            yield record


def _frame_record(state: _Reading, split: Split, flight: Capture, frame: object, where: str) -> ImageRecord | None:
    """Return the record of a frame of a flight; None, with a problem, if its entry or picture cannot be used."""
    entry: Mapping[str, object] = frame if isinstance(frame, dict) else {}
    annotations = entry.get("annotations")
    problem = check_name(entry.get("thermal_image"), where)
    if problem is not None or not isinstance(annotations, list):
        expected = "a list of annotations"
        todo = "fetch the file again"
        state.problems.append(problem or Problem(where, "annotation-layout", "no list of annotations", expected, todo))
        return None
    name, path, problem = state.pictures.find(str(entry["thermal_image"]), where)
    if problem is None and name in state.listed:
        problem = Problem(where, "image-duplicate", f"picture {name} again", "each picture once", "keep one entry")
    if problem is None and path is None:
        problem = Problem(where, "image-missing", f"no picture {name}", f"the picture in {_PICTURES}", "restore it")
    state.listed.add(name)
    if problem is not None or path is None:
        state.problems += [problem] if problem else []
        return None
    size_wh = state.size(path, where)
    if size_wh is None:
        return None
    state.counts["objects"] += len(annotations)
    stated = ((f"{where}: annotation {n}", _stated(a)) for n, a in enumerate(annotations, 1))
    objects = checked(state, stated, size_wh)
    animals = tuple(o for o in objects if o.category != bambi_tracks.NO_ANIMAL)
    state.counts["no_animal"] += len(objects) - len(animals)
    state.counts["read"] -= len(objects) - len(animals)
    number = to_int(entry.get("frame_idx"))
    poses = state.poses.get(flight.sequence or "", {})
    pose = poses.get(-1 if number is None else number, bambi_tracks.STRAIGHT_DOWN)
    capture = pose.over(replace(flight, frame=number))
    return ImageRecord("", path, split, size_wh, animals, capture, file_name=name)


def _stated(annotation: object) -> Stated:
    """Return the object that an annotation states; a fault for one without a species or a box of four numbers."""
    values: Mapping[str, object] = annotation if isinstance(annotation, dict) else {}
    species = values.get("species")
    box = values.get("bbox")
    edges = to_floats([box.get(k) for k in _EDGES], 4) if isinstance(box, dict) else None
    if not isinstance(species, str) or not species.strip() or edges is None:
        found = "no species" if edges is not None else "no box of four numbers"
        expected = "species, and bbox with x_min, y_min, x_max and y_max"
        return Fault("annotation-layout", found, expected, "correct the annotation")
    wikidata = bambi_tracks.WIKIDATA.get(str(values.get("wikidata_id")))
    name = SPECIES.get(species.strip()) or wikidata or species.strip()
    # Sex, age and visibility are codes without a published key, kept as they are.
    codes = {k: values[k] for k in ("gender", "age", "visibility") if to_int(values.get(k)) is not None}
    return Instance(name, np.array(edges), source_id=to_int(values.get("label_id")), extra=codes)
