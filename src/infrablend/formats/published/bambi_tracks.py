"""BAMBI's published flights: tracks in MOT form or YOLO labels, poses, and videos with the thermal picture on the left.

A row of `<flight>_gt.txt` is `frame, track, left, top, width, height, confidence, class, visibility, species, gender,
age, interpolated`, in px of the thermal picture. Entry k of the poses is that of frame k; its pitch is the tilt from
straight down.
"""

from __future__ import annotations

import csv
import io
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from infrablend.core.camera import STRAIGHT_DOWN_DEG, pitch_of_tilt
from infrablend.core.capture import Capture
from infrablend.core.dataset import SPLITS, Category, ImageRecord, Instance, Split
from infrablend.core.file_names import leaves_folder
from infrablend.core.json_records import is_list
from infrablend.errors import DatasetError
from infrablend.formats.annotation_files import leave_out
from infrablend.formats.base import names_of
from infrablend.formats.box_checks import edges_of_shares, edges_of_xywh, snap_edges
from infrablend.formats.pictures.listing import is_picture_name, list_pictures
from infrablend.formats.pictures.video import Video
from infrablend.formats.published.sidecar import Fault, Stated, checked, if_file, yolo_lines
from infrablend.formats.records import Findings
from infrablend.formats.values import to_floats, to_int, to_number, to_time

CLASSES: tuple[tuple[int, str], ...] = (
    (2, "no animal"), (17, "red deer"), (23, "roe deer"), (27, "chamois"), (34, "human"), (42, "alpine ibex"),
    (49, "fallow deer"), (53, "unknown"), (56, "dog"), (60, "bird"), (70, "wild boar"), (75, "hybrid pig"),
)  # fmt: skip
"""First class number after those of a species, and the species; a class is a species with sex, age and visibility."""
NO_ANIMAL = "no animal"
WIKIDATA = {
    "Q58697": "wild boar", "Q1219579": "red deer", "Q122069": "roe deer", "Q20908334": "fallow deer",
    "Q168327": "alpine ibex", "Q131340": "chamois", "Q5113": "bird", "Q15978631": "human", "Q26972265": "dog",
    "Q602666": "hybrid pig", "Q10738": NO_ANIMAL, "Q24238356": "unknown",
}  # fmt: skip
"""Species by their published numbers, which files in any language contain."""

_TRACKS = "_gt.txt"
_POSES = "_matched_poses.json"
_METADATA = "_metadata.json"
_VIDEO = "_matched_processed.mp4"
_PICTURE = re.compile(r"(\d{1,6})(?:_matched_processed)?_(\d{1,9})", re.ASCII)
_PICTURE_FOLDERS = ("thermal", "frames/thermal")
STRAIGHT_DOWN = Capture(pitch_deg=STRAIGHT_DOWN_DEG)
"""What is known of a frame without a pose."""
COUNTS = ("flights", "frames", "objects", "read", "no_animal", "interpolated_frames", "without_pose")
_COLUMNS = "frame, track_id, bb_left, bb_top, bb_width, bb_height, conf, class_id, visibility, species, ..."


def find_flight(root: Path) -> str:
    """Return what shows that a folder contains published flights; empty if nothing does."""
    for path in _named(root, _TRACKS):
        start = _start(path).split("\n", 1)[0].split(",")
        flight = path.name.removesuffix(_TRACKS)
        beside = [path.with_name(flight + s) for s in (_VIDEO, _POSES, _METADATA)]
        if len(start) >= 8 and to_floats(start[:6], 6) is not None and any(p.is_file() for p in beside):
            return f"{path.relative_to(root).as_posix()} has the tracks of a flight"
    if (root / "images").is_dir() and (root / "labels").is_dir():
        poses = next(iter(_named(root, _POSES)), None)
        if poses is not None:
            return f"{poses.relative_to(root).as_posix()} has the poses of a flight"
    return ""


def _named(root: Path, suffix: str) -> list[Path]:
    """Return files of flights with this ending, in the folder or one below."""
    found = sorted([*root.glob(f"*{suffix}"), *root.glob(f"*/*{suffix}")])
    return [p for p in found if p.is_file() and not leaves_folder(p) and not p.name.startswith(".")]


def _start(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return file.read(4096).decode("utf-8-sig", "replace")
    except OSError:
        return ""


def categories(records: Iterable[ImageRecord]) -> list[Category]:
    """Return the categories of some records, in the order of the published classes, others after them."""
    found = names_of(records)
    known = [name for _, name in CLASSES if name in found]
    return [Category(k, n) for k, n in enumerate([*known, *(n for n in found if n not in known)])]


def species_of(number: int) -> str | None:
    """Return the species of a published class number, or None."""
    return next((name for end, name in CLASSES if 0 <= number < end), None)


def read_flights(found: Findings, wanted: Sequence[Split], *, key_frames: bool) -> list[ImageRecord]:
    """Read all flights of a folder.

    Args:
        found: The folder of the dataset, problems and counts.
        wanted: Splits to read.
        key_frames: Whether to read only frames that people annotated, not those with interpolated boxes alone.
    """
    root = found.root
    poses = {p.name.removesuffix(_POSES): p for p in _named(root, _POSES)}
    records: list[ImageRecord] = []
    if (root / "images").is_dir() and (root / "labels").is_dir():
        records += _read_yolo(found, poses, wanted)
    for path in _named(root, _TRACKS):
        records += _read_tracks(found, path, poses, wanted, key_frames)
    return records


# -- tracks ------------------------------------------------------------------------------------------------------


def _read_tracks(
    found: Findings, path: Path, poses: Mapping[str, Path], wanted: Sequence[Split], key_frames: bool
) -> Iterator[ImageRecord]:
    flight = path.name.removesuffix(_TRACKS)
    split, day = _facts(found, path.with_name(flight + _METADATA))
    if split not in wanted:
        leave_out([path])
        return
    found.counts["flights"] += 1
    frames = _rows(found, path)
    chosen = {
        n: rows for n, rows in frames.items() if not key_frames or not all(r.extra["interpolated"] for _, r in rows)
    }
    found.counts["interpolated_frames"] += len(frames) - len(chosen)
    pictures = _pictures(found, path.parent, flight, sorted(chosen))
    flown = _Flight(flight, split, _poses(found, poses.get(flight)), day)
    missing = [n for n in chosen if n not in pictures]
    if missing:
        text = f"no picture for {len(missing)} of {len(chosen)} annotated frame(s)"
        expected = f"{flight}{_VIDEO} beside it, or pictures such as thermal/{flight}_{missing[0]}.png"
        todo = "fetch the flight with its video, not only its annotations"
        found.add(found.place(path), "image-missing", text, expected, todo)
    for number, picture in sorted(pictures.items()):
        size_wh = found.size(picture, f"{found.place(path)}: frame {number}")
        if size_wh is not None:
            animals = [(here, o) for here, o in chosen[number] if o.category != NO_ANIMAL]
            yield flown.record(found, picture, size_wh, number, animals)


def _facts(found: Findings, path: Path) -> tuple[Split, str | None]:
    """Return the split and the day of a flight from its metadata; train and None without."""
    top = found.json(path) if path.is_file() else None
    if top is None:
        return "train", None
    info = top.get("flight_info")
    start = to_time(info.get("start_time")) if isinstance(info, dict) else None
    day = None if start is None else start.date().isoformat()
    return next((s for s in SPLITS if s == top.get("split")), "train"), day


def _rows(found: Findings, path: Path) -> dict[int, list[tuple[str, Instance]]]:
    """Return place and object of each row by frame; the boxes are still as written."""
    where = found.place(path)
    frames: dict[int, list[tuple[str, Instance]]] = defaultdict(list)
    try:
        lines = list(csv.reader(io.StringIO(found.text(path, "a table of tracks") or "", newline="")))
    except csv.Error as error:
        found.add(where, "annotation-unreadable", str(error), "a CSV table", "fetch it again")
        return frames
    for n, cells in enumerate(lines, 1):
        if not cells or cells[0].strip().startswith("#"):
            continue
        found.counts["objects"] += 1
        here = f"{where}: line {n}"
        numbers = to_floats([c.strip() for c in cells[:8]], 8)
        frame, track, class_ = (to_int(cells[k]) if numbers else None for k in (0, 1, 7))
        if numbers is None or frame is None or track is None or frame < 0:
            found.add(here, "row-malformed", repr(",".join(cells)[:80]), _COLUMNS)
            continue
        written = cells[9].strip() if len(cells) > 9 else ""
        common = re.search(r"\(([^()]+)\)\s*$", written)
        named = (common[1] if common else written).strip().lower()
        species = named or (None if class_ is None else species_of(class_))
        if not species:
            found.add(here, "category-unknown", f"class {cells[7]}", "a species or class 0 to 74")
            continue
        species = species.replace("no-animal", NO_ANIMAL)
        found.counts["no_animal"] += species == NO_ANIMAL
        names = {8: "visibility", 10: "gender", 11: "age"}
        extra = {k: v for i, k in names.items() if len(cells) > i and (v := to_number(cells[i])) is not None}
        interpolated = len(cells) > 12 and cells[12].strip() == "1"
        box = np.array(edges_of_xywh(numbers[2:6], None))
        frames[frame].append(
            (here, Instance(species, box, track_id=track, extra={**extra, "interpolated": interpolated}))
        )
    return frames


def _pictures(found: Findings, folder: Path, flight: str, numbers: Sequence[int]) -> dict[int, Path]:
    """Return the thermal pictures of frames: extracted ones, else the left half of the flight's video."""
    pictures: dict[int, Path] = {}
    wanted = {*numbers}
    for name in _PICTURE_FOLDERS:
        for base in (folder, found.root):
            if not (base / name).is_dir():
                continue
            for p in sorted((base / name).iterdir()):
                match = _PICTURE.fullmatch(p.stem)
                if match and match[1] == flight and is_picture_name(p.name):
                    leave_out([p])  # many frames of a flight have no labels
                    if int(match[2]) in wanted:
                        pictures.setdefault(int(match[2]), p)
    video = folder / f"{flight}{_VIDEO}"
    missing = [n for n in numbers if n not in pictures]
    if missing and video.is_file() and not leaves_folder(video):
        try:
            width, height = Video(video).size_wh
        except DatasetError as error:
            found.add_all(error.problems, found.place(video))
            return pictures
        pictures |= found.video_frames(video, missing, 0.5 if width == 2 * height else 1.0) or {}
    return pictures


# -- poses -------------------------------------------------------------------------------------------------------


def all_poses(found: Findings) -> dict[str, dict[int, Capture]]:
    """Return the poses in a folder or one below by flight and frame."""
    return {p.name.removesuffix(_POSES): _poses(found, p) for p in _named(found.root, _POSES)}


def _poses(found: Findings, path: Path | None) -> dict[int, Capture]:
    """Return what the poses of a flight say of each frame, with pitch and perhaps the time; empty without a file."""
    top = None if path is None else found.json(path)
    if path is None or top is None:
        return {}
    images = top.get("images")
    if not is_list(images):
        expected = "a list of images with pitch and timestamp"
        found.add(found.place(path), "annotation-layout", "no list of images", expected, "fetch it again")
        return {}
    poses = {}
    start: datetime | None = None  # of entry 0, which is frame 0
    for k, entry in enumerate(images):
        values = entry if isinstance(entry, dict) else {}
        rotation = values.get("rotation")
        tilt = values.get("pitch", rotation[0] if isinstance(rotation, list) and rotation else None)
        degrees = to_number(tilt)
        when = to_time(values.get("timestamp"))
        start = when if k == 0 else start
        if degrees is not None:
            captured = when.isoformat() if when else None
            seconds = _seconds(start, when)
            poses[k] = Capture(pitch_deg=pitch_of_tilt(degrees), captured=captured, time_s=seconds)
    return poses


def _seconds(start: datetime | None, when: datetime | None) -> float | None:
    """Return the seconds between two times; None if they cannot be compared or are in the wrong order."""
    if start is None or when is None or (start.tzinfo is None) != (when.tzinfo is None):
        return None
    return Capture.from_json({"time_s": (when - start).total_seconds()}, strict=False).time_s


@dataclass(frozen=True)
class _Flight:
    """What is known of a flight: its name and day, its split, and the poses by frame."""

    name: str
    split: Split
    poses: Mapping[int, Capture]
    day: str | None = None

    def record(
        self, found: Findings, path: Path, size_wh: tuple[int, int], number: int, entries: Iterable[tuple[str, Stated]]
    ) -> ImageRecord:
        """Return the record of a frame, with the objects that entries state."""
        found.counts["frames"] += 1
        found.counts["without_pose"] += number not in self.poses
        objects = tuple(checked(found, entries, size_wh))
        known = Capture(sequence=self.name, captured=self.day, frame=number)
        capture = self.poses.get(number, STRAIGHT_DOWN).over(known)
        name = f"{self.name}_{number}{path.suffix}"
        return ImageRecord("", path, self.split, size_wh, objects, capture, file_name=name)


# -- YOLO --------------------------------------------------------------------------------------------------------


def _read_yolo(found: Findings, poses: Mapping[str, Path], wanted: Sequence[Split]) -> Iterator[ImageRecord]:
    """Yield the pictures in `images/<split>` with their YOLO labels of published class numbers."""
    poses_of: dict[str, dict[int, Capture]] = {}
    for split in wanted:
        base = found.root / "images" / split
        for name, path in list_pictures(base).items():
            match = _PICTURE.fullmatch(path.stem)
            where = found.place(path)
            if match is None:
                found.add(where, "name-unknown", "a name without flight and frame", "<flight>_<frame>.png")
                continue
            flight = match[1]
            number = int(match[2])
            label = if_file((found.root / "labels" / split / name).with_suffix(".txt"))
            size_wh = found.size(path, where)
            if size_wh is None:
                continue
            if flight not in poses_of:
                poses_of[flight] = _poses(found, poses.get(flight))
                found.counts["flights"] += 1
            lines = (label and yolo_lines(found, label)) or ()
            stated = ((here, _stated(found, class_, values, size_wh)) for here, class_, values in lines)
            yield _Flight(flight, split, poses_of[flight]).record(found, path, size_wh, number, stated)


def _stated(found: Findings, class_: int, shares: Sequence[float], size_wh: tuple[int, int]) -> Stated:
    species = species_of(class_)
    if species is None or len(shares) != 4:
        return Fault("category-unknown", f"class {class_}, {len(shares)} numbers", "class 0 to 74 and a box", "")
    if species == NO_ANIMAL:
        found.counts["no_animal"] += 1
        return None
    box = np.array(snap_edges(edges_of_shares(shares, size_wh), size_wh))
    return Instance(species, box, extra={"class": class_})
