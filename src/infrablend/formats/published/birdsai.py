"""BIRDSAI (Bondi et al. 2020): thermal video from fixed-wing aircraft with tracks of animals and people.

    TrainReal/images/<sequence>/<sequence>_<frame>.jpg    TrainReal/annotations/<sequence>.csv    TestReal likewise

The name of a sequence is two numbers of ten digits, joined by `_`; the number of a frame has ten digits. The CSV files
have no header and ten columns: frame, object, x, y, w, h (px; x and y of the upper left corner), class (0 animal,
1 human), species, occlusion, noise. A frame without a row may still show objects. A folder that contains only frames is
read as pictures without labels.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Literal

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance, Split
from infrablend.formats.base import (
    Match,
    check_splits,
    count_crowds,
    option_error,
    require_known,
    require_options,
)
from infrablend.formats.box_checks import edges_of_xywh, snap_edges
from infrablend.formats.losses import Written, without_regions
from infrablend.formats.pictures.listing import is_hidden, is_picture_name, list_pictures
from infrablend.formats.records import KEEP_OR_DROP, Findings, unlabelled_problems
from infrablend.formats.sequence_writing import Frames, Place, SequenceWriter, by_sequence, with_names
from infrablend.formats.values import number_text, plain_id, to_floats, to_int

NAME = "birdsai"
OPTIONS = {
    "category": "categories to use: species (the default) or class (animal, human)",
    "noise": "keep (the default) or drop objects in frames flagged as noisy",
    "unlabelled": "keep or drop frames without a row in the table; keep is the default",
    "frames": "meaning of a row's frame: number (the default), as in the picture's name, or order, its position from 0",
    "frame_offset": "whole number added to a row's frame to get the picture's; 0 by default",
}
SPECIES = {
    0: "human", 1: "elephant", 2: "lion", 3: "giraffe", 4: "dog", 5: "crocodile", 6: "hippo", 7: "zebra", 8: "rhino",
}  # fmt: skip
# The id of a category must not be negative, so species -1 (unknown) gets the first free number.
UNKNOWN = Category(9, "unknown", "animal")
CATEGORIES = (*(Category(k, n, "human" if k == 0 else "animal") for k, n in SPECIES.items()), UNKNOWN)
CLASSES = (Category(0, "animal", "animal"), Category(1, "human", "human"))
_HUMAN = {"human", "person", "pedestrian", "people"}

_FOLDERS: Mapping[str, Split] = {"TrainReal": "train", "ValReal": "val", "TestReal": "test"}
_FOLDER_OF = {split: name for name, split in _FOLDERS.items()}
_SEQUENCE = re.compile(r"\d{10}_\d{10}", re.ASCII)
_FRAME = re.compile(r"(\d{10}_\d{10})_(\d{10})", re.ASCII)
_COLUMNS = "frame, object, x, y, w, h, class, species, occlusion, noise"
_SPECIES_FILE = "species.csv"
_SPECIES_COLUMNS = ("species", "name", "ignore")
_LACKS = ("obb", "mask", "visibility", "occlusion boxes", "truncated", "difficult")


# -- finding ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    """A folder with `images` and optionally `annotations`, or a folder that contains only frames."""

    split: Split
    folder: Path
    flat: bool = False

    @cached_property
    def pictures(self) -> dict[str, Path]:
        """Return all pictures."""
        if not self.flat:
            return list_pictures(self.folder / "images")
        return {p.name: p for p in sorted(self.folder.glob("*")) if is_picture_name(p.name) and p.is_file()}

    @cached_property
    def frames(self) -> dict[str, dict[int, Path]]:
        """Return the pictures whose names contain a sequence and a frame number, by both."""
        found: dict[str, dict[int, Path]] = defaultdict(dict)
        for path in self.pictures.values():
            named = _FRAME.fullmatch(path.stem)
            if named is not None:
                found[named[1]].setdefault(int(named[2]), path)
        return dict(sorted(found.items()))

    @property
    def others(self) -> int:
        """Return the number of pictures that are not frames."""
        return len(self.pictures) - sum(map(len, self.frames.values()))

    @cached_property
    def tables(self) -> dict[str, Path]:
        """Return the CSV files by sequence, without other files such as `tracking` and `water_metadata`."""
        files = [] if self.flat else sorted((self.folder / "annotations").glob("*.csv"))
        return {p.stem: p for p in files if p.is_file() and not is_hidden(p.name) and _SEQUENCE.fullmatch(p.stem)}


def _parts(root: Path) -> list[_Part]:
    """Return the folders to read.

    They are the split folders (or folders of the same name inside them), else the folder itself or its `Real`, else a
    folder that contains only frames.
    """
    named = [_Part(split, f) for name, split in _FOLDERS.items() for f in (root / name, root / name / name)]
    found = [p for p in named if (p.folder / "images").is_dir() and (p.tables or p.frames)]
    if not found:
        name = root.absolute().name
        split = _FOLDERS.get(name, "train")
        others = [_Part(split, f) for f in (root, root / "Real", root / name) if (f / "images").is_dir()]
        found = [p for p in others if p.tables or (name in _FOLDERS and p.frames)][:1]
    # A folder with labels or subfolders is BIRDSAI converted to another format, not a bare folder of frames.
    labels = (".txt", ".xml", ".json", ".yaml", ".yml", ".csv")
    if not found and root.is_dir():
        beside = [p for p in sorted(root.glob("*")) if p.is_dir() or p.suffix.lower() in labels]
        bare = all(p.stem == "metadata" or is_hidden(p.name) for p in beside)
        found = [p for p in [_Part("train", root, True)] if bare and p.frames]
    return found


def detect(root: Path) -> Match:
    """Decide whether `root` contains BIRDSAI's folders, or frames named like BIRDSAI's without other labels."""
    parts = _parts(root)
    if not parts:
        return Match(NAME, False, "no TrainReal or TestReal with images, and no pictures <10 digits>_<10>_<10>.jpg")
    frames = sum(len(s) for p in parts for s in p.frames.values())
    others = sum(p.others for p in parts)
    if others > frames:
        return Match(NAME, False, f"{others} of {others + frames} pictures are not named like BIRDSAI's frames")
    tables = sum(len(p.tables) for p in parts)
    return Match(NAME, True, f"{frames} frame(s) and {tables} table(s) in {len(parts)} folder(s)")


# -- reading ---------------------------------------------------------------------------------------------------


@dataclass(kw_only=True)
class _Reading(Findings):
    """Options of the reader, and what it found so far.

    Attributes:
        by_class: Whether the categories are the classes, not the species.
        drop_noise: Whether objects in frames flagged as noisy are left out.
        names: Name by number of species.
        shifted: Number of rows with a picture for each offset of the frame numbers.
    """

    by_class: bool
    drop_noise: bool
    names: Mapping[int, str] = field(default_factory=dict)
    shifted: Counter[int] = field(default_factory=Counter)


@dataclass(frozen=True)
class _Row:
    where: str
    frame: int
    track: int
    box: tuple[float, ...]
    class_: int
    species: int
    occlusion: int
    noise: int


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    category: str = "species",
    noise: str = "keep",
    unlabelled: str = "keep",
    frames: str = "number",
    frame_offset: str = "0",
) -> Dataset:
    """Read the sequences below a folder; the size of every picture comes from its header, as it differs by sequence.

    Raises:
        DatasetError: An option is unknown, or no picture can be read.
    """
    require_options(
        root,
        category=(category, ("species", "class")),
        noise=(noise, KEEP_OR_DROP),
        unlabelled=(unlabelled, KEEP_OR_DROP),
        frames=(frames, ("number", "order")),
    )
    offset = to_int(frame_offset)
    if offset is None:
        raise option_error(root, "frame_offset", frame_offset, "a whole number")
    wanted = check_splits(splits)
    reading = _Reading(root, by_class=category == "class", drop_noise=noise == "drop")
    further = _further_species(reading)
    reading.names = {**SPECIES, **{k: c.name for k, c in further.items()}, -1: UNKNOWN.name}
    records: list[ImageRecord] = []
    parts = _parts(root)
    for part in parts:
        if part.split in wanted:
            records += _read_part(reading, part, frames == "order", offset, unlabelled)
    if (root / "TrainSimulation").is_dir():
        found = "TrainSimulation was left out because its pictures are simulated"
        reading.warn(root.name, "simulation-excluded", found, "thermal pictures of a camera")
    _warn_of_offset(reading, offset)
    keys = ("tables", "rows", "incomplete", "read", "without_picture", "noisy", "noise_dropped", "unlabelled")
    notes = {
        "labels": NAME,
        "category": category,
        "noise": noise,
        "frames": f"{frames}{offset:+d}" if offset else frames,
        "rows": reading.rows(*keys),
    }
    categories = CLASSES if reading.by_class else (*CATEGORIES, *further.values())
    if not any(part.tables for part in parts):
        categories = ()  # bare frames have no classes
    records = with_names(reading, records)
    return reading.dataset(NAME, records, categories, notes, metadata=metadata, splits=wanted)


def _further_species(reading: _Reading) -> dict[int, Category]:
    """Return the categories that our writer's table adds to BIRDSAI's own, by species number."""
    further: dict[int, Category] = {}
    for n, row in enumerate(reading.own_table(_SPECIES_FILE, _SPECIES_COLUMNS), 1):
        number = to_int(row[0]) if len(row) == len(_SPECIES_COLUMNS) else None
        known = {*SPECIES.values(), UNKNOWN.name, "", *(c.name for c in further.values())}
        if number is not None and number > UNKNOWN.id and number not in further and row[1] not in known:
            further[number] = Category(number, row[1], "", row[2] == "1")
        elif n > 1 and row:
            expected = f"a new number above {UNKNOWN.id}, a new name, and 1 for a class to ignore"
            reading.add(f"{_SPECIES_FILE}: line {n}", "species-malformed", repr(row)[:80], expected)
    return further


def _read_part(reading: _Reading, part: _Part, order: bool, offset: int, unlabelled: str) -> list[ImageRecord]:
    frames = part.frames
    tables = part.tables
    records: list[ImageRecord] = []
    where = reading.place(part.folder) if part.folder != reading.root else reading.root.name
    if part.others:
        found = f"{part.others} picture(s) were left out because their names are not those of frames, or repeat one"
        reading.warn(where, "name-grammar", found, "<10 digits>_<10 digits>_<10 digits>.jpg")
    missing = 0
    for sequence in sorted(frames.keys() | tables.keys()):
        pictures = dict(sorted(frames.get(sequence, {}).items()))
        table = tables.get(sequence)
        rows = _read_table(reading, table) if table else []
        if rows is None:  # not readable: its frames are not known to be without objects
            continue
        places = dict(enumerate(pictures)) if order else {n: n for n in pictures}
        of_frame: dict[int, list[_Row]] = defaultdict(list)
        for row in rows:
            number = places.get(row.frame + offset)
            if number is None:
                reading.counts["without_picture"] += 1
            else:
                of_frame[number].append(row)
            reading.shifted.update(d for d in (-1, 0, 1) if row.frame + offset + d in places)
        lost = len(rows) - sum(map(len, of_frame.values()))
        if lost and table is not None:
            found = f"{lost} of {len(rows)} row(s) left out because their frame has no picture"
            reading.warn(reading.place(table), "row-without-picture", found, "a picture per frame")
        for number, path in pictures.items():
            missing += number not in of_frame
            if number not in of_frame and unlabelled == "drop":
                continue
            size_wh = reading.size(path, reading.place(path))
            if size_wh is None:
                continue
            instances = _instances(reading, of_frame.get(number, []), size_wh)
            capture = Capture(sequence=sequence, frame=number)
            extra = {} if number in of_frame else {"labelled": False}
            name = f"{sequence}/{path.name}"
            records.append(ImageRecord("", path, part.split, size_wh, instances, capture, extra=extra, file_name=name))
    reading.counts["unlabelled"] += missing
    reading.problems += unlabelled_problems(where, missing, unlabelled, "no row in the annotation table")
    return records


def _read_table(reading: _Reading, path: Path) -> list[_Row] | None:
    where = reading.place(path)
    text = reading.text(path, "a CSV table of ten columns")
    if text is None:
        return None
    reading.counts["tables"] += 1
    rows: list[_Row] = []
    contradictions = 0
    for n, line in enumerate(text.split("\n"), 1):
        if not line.strip():
            continue
        reading.counts["rows"] += 1
        here = f"{where}: line {n}"
        cells = [c.strip() for c in line.split(",")]
        numbers = to_floats(cells, 10)
        if numbers is None or not all(map(math.isfinite, numbers)):
            reading.counts["incomplete"] += 1
            code = "row-incomplete" if len(cells) < 10 or {"", "nan"} & {c.lower() for c in cells} else "row-malformed"
            reading.add(here, code, repr(line[:80]), _COLUMNS, "complete the row")
            continue
        frame, track, class_, species, occlusion, noise = (to_int(cells[i]) for i in (0, 1, 6, 7, 8, 9))
        if frame is None or track is None:
            reading.add(here, "row-malformed", repr(line[:80]), "whole numbers as frame and object")
            continue
        if class_ is None or species is None or class_ not in (0, 1) or species not in reading.names:
            expected = f"class 0 or 1, species one of {sorted(reading.names)}"
            reading.add(here, "category-unknown", f"class {cells[6]}, species {cells[7]}", expected)
            continue
        if occlusion not in (0, 1) or noise not in (0, 1):
            reading.warn(here, "flag-value", f"occlusion {cells[8]}, noise {cells[9]}", "0 or 1")
        contradictions += species in SPECIES and (species == 0) != (class_ == 1)
        rows.append(_Row(here, frame, track, numbers[2:6], class_, species, int(occlusion == 1), int(noise == 1)))
    if contradictions:
        counts = "class" if reading.by_class else "species"
        found = f"{contradictions} row(s) in which class and species contradict each other; the {counts} is used"
        reading.warn(where, "species-class", found, "class 1 and species 0 for humans alone")
    return rows


def _instances(reading: _Reading, rows: Sequence[_Row], size_wh: tuple[int, int]) -> tuple[Instance, ...]:
    instances: list[Instance] = []
    tracks: set[int] = set()
    for row in rows:
        reading.counts["noisy"] += row.noise
        if row.noise and reading.drop_noise:
            reading.counts["noise_dropped"] += 1
            continue
        box = reading.box(snap_edges(edges_of_xywh(row.box, None), size_wh), size_wh, row.where)
        if box is None:
            continue
        if row.track in tracks:
            reading.track_twice(row.where, row.track, row.frame)
        tracks.add(row.track)
        extra = {"class": row.class_, "species": row.species, "occlusion": row.occlusion, "noise": row.noise}
        name = CLASSES[row.class_].name if reading.by_class else _species(row.class_, row.species, reading.names)
        instances.append(Instance(name, box, extra=extra, track_id=row.track))
        reading.counts["read"] += 1
    return tuple(instances)


def _species(class_: int, number: int, names: Mapping[int, str]) -> str:
    """Return the name of a species; an unknown species of class human is human."""
    return "human" if number == -1 and class_ == 1 else names[number]


def _warn_of_offset(reading: _Reading, offset: int) -> None:
    """Warn if another offset of the frame numbers would match clearly more rows."""
    best = max((0, -1, 1), key=lambda d: reading.shifted[d])
    total = reading.counts["rows"] - reading.counts["incomplete"]
    if best and reading.shifted[best] > reading.shifted[0] + 0.02 * total:
        found = (
            f"{reading.shifted[0]} of {total} rows have a picture; with another offset {reading.shifted[best]} would"
        )
        todo = f"compare some boxes with their pictures; if they fit better so, add --read frame_offset={offset + best}"
        reading.warn(reading.root.name, "frame-offset", found, "frame numbers as in the names", todo)
    noise = reading.counts["noise_dropped"]
    if noise:
        reading.warn(reading.root.name, "noise-dropped", f"{noise} object(s) in noisy frames left out", "noise=keep")


# -- writing ---------------------------------------------------------------------------------------------------


def write(
    out: Path,
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    *,
    dont_care: Literal["drop", "keep"] = "drop",
    pictures: bool = True,
) -> Written:
    """Write `<Split>Real/annotations/<sequence>.csv`, and link the pictures as `<Split>Real/images/<sequence>/...`.

    Sequences and frames keep their numbers if these are unique and in BIRDSAI's form. Otherwise they are numbered, and
    `names.csv` lists the original names, from which `read` takes sequence, number, date and time. Coordinates have up
    to eight decimals. Categories that BIRDSAI does not have get new species numbers, listed in `species.csv`; their
    class is human or animal. Pitch, altitude and time of day are written to `metadata.csv`. Validation pictures go to
    `ValReal`, which BIRDSAI itself does not have.

    The pictures' sizes may be unknown. Regions to ignore are dropped, or kept as objects with a species of their own.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A category is not in the list.
    """
    writer = SequenceWriter(out, images, categories, _LACKS, _places)
    places = writer.places
    losses = writer.losses
    species = _species_numbers(categories)
    regions = {c.name for c in categories if c.ignore}
    tracks: dict[str, _Tracks] = defaultdict(_Tracks)
    for image, place in zip(writer.images, places, strict=True):
        tracks[place.sequence].reserve(o.track_id for o in image.instances)

    def kept_of(image: ImageRecord) -> ImageRecord:
        kept = image if dont_care == "keep" else without_regions(image, regions, losses)
        losses["ignore_as_class"] += count_crowds(kept.instances, regions)
        losses["empty_unsaid"] += not kept.instances and image.extra.get("labelled", True) is True
        require_known(kept, species)
        return kept

    def row(frame: int, track: int, o: Instance) -> str:
        class_, number = _codes(o, species)
        losses["class_unfit"] += class_ == 0 and number > UNKNOWN.id
        return _line(frame, track, o, class_, number)

    # Tracks of a sequence that is in several splits have numbers in the order of their frames.
    groups = sorted(by_sequence(places).values(), key=lambda g: (places[g[0]].sequence, places[g[0]].number, g[0]))
    for group in groups:
        first = places[group[0]]
        frames = map(kept_of, Frames(writer.images, group))
        rows = writer.rows(frames, [places[n].number for n in group], tracks[first.sequence], row)
        writer.text(f"{_FOLDER_OF[first.split]}/annotations/{first.sequence}.csv", rows)
    writer.files.sort()
    writer.pictures(_path_of, pictures, facts=("pitch_deg", "altitude_m", "time_of_day"))
    written = {c.name: int(c.ignore) for c in categories if not (c.ignore and dont_care == "drop")}
    further = [(k, n, written[n]) for n, (_, k) in species.items() if k > UNKNOWN.id and n in written]
    writer.table(_SPECIES_FILE, _SPECIES_COLUMNS, further)
    return writer.written()


def _path_of(image: ImageRecord, place: Place) -> str:
    name = f"{place.sequence}_{place.number:010d}{PurePosixPath(image.name).suffix}"
    return f"{_FOLDER_OF[place.split]}/images/{place.sequence}/{name}"


def _species_numbers(categories: Sequence[Category]) -> dict[str, tuple[int, int]]:
    """Return (class, species) by category name; names that BIRDSAI does not have get a new species number."""
    own = {name: number for number, name in SPECIES.items()} | {UNKNOWN.name: -1, "animal": -1}
    taken = {c.id for c in categories if c.name not in own and c.id > UNKNOWN.id}
    free = (n for n in itertools.count(UNKNOWN.id + 1) if n not in taken)
    numbers = {}
    for c in categories:
        number = own.get(c.name)
        if number is None:
            number = c.id if c.id in taken else next(free)
        numbers[c.name] = (int(c.name.casefold() in _HUMAN), number)
    return numbers


def _places(images: Sequence[ImageRecord]) -> list[Place]:
    """Return the place of each image; images keep their own if these are unique names in BIRDSAI's form."""
    groups: dict[tuple[Split, str], list[int]] = defaultdict(list)
    for n, image in enumerate(images):
        groups[image.split, image.capture.sequence or ""].append(n)
    names = sorted({sequence for _, sequence in groups})
    own = {n for n in names if _SEQUENCE.fullmatch(n)}
    free = iter(s for k in range(len(names) + len(own)) if (s := f"{k:010d}_{0:010d}") not in own)
    named = {n: n if n in own else next(free) for n in names}
    places: dict[int, Place] = {}
    for (split, sequence), group in groups.items():
        frames = [frame for n in group if (frame := _frame_of(images[n])) is not None]
        if len({*frames}) < len(group):
            frames = list(range(len(group)))
        places |= {n: Place(split, named[sequence], frame) for n, frame in zip(group, frames, strict=True)}
    return [places[n] for n in range(len(images))]


def _frame_of(image: ImageRecord) -> int | None:
    """Return the frame number from the image's name, else the one that was read; None if there is neither."""
    named = _FRAME.fullmatch(PurePosixPath(image.name).stem)
    number = int(named[2]) if named and named[1] == image.capture.sequence else image.capture.frame
    return number if number is not None and number < 10**10 else None


class _Tracks:
    """Track numbers of one sequence; named tracks and objects without a track get free numbers.

    Attributes:
        changed: The numbers of tracks whose ids are texts.
    """

    def __init__(self) -> None:
        self.changed: dict[str, int] = {}
        self._free = 0

    def reserve(self, ids: Iterable[int | str | None]) -> None:
        """Reserve the numbers of numbered tracks."""
        self._free = max([self._free, *(n + 1 for i in ids if i is not None and isinstance(n := plain_id(i), int))])

    def of(self, image: ImageRecord, losses: Counter[str]) -> list[tuple[int, int | str | None]]:
        """Return number and id of the track of each object of an image; an object without a track gets a new number."""
        tracks: list[tuple[int, int | str | None]] = []
        for o in image.instances:
            losses["track_made"] += o.track_id is None
            known = None if o.track_id is None else plain_id(o.track_id)
            if isinstance(known, int):
                number = known
            else:
                number = self._free if known is None else self.changed.setdefault(known, self._free)
                self._free += number == self._free
            tracks.append((number, known))
        return tracks


def _codes(instance: Instance, species: Mapping[str, tuple[int, int]]) -> tuple[int, int]:
    """Return class and species: as read if they still match the category, else those of the category's name."""
    class_, number = (instance.extra.get(k) for k in ("class", "species"))
    if class_ in (0, 1) and (number in SPECIES or number == -1):
        names = {**SPECIES, -1: UNKNOWN.name}
        if instance.category in (CLASSES[class_].name, _species(class_, number, names)):
            return class_, number
    return species[instance.category]


def _line(frame: int, track: int, o: Instance, class_: int, species: int) -> str:
    x0, y0, x1, y1 = o.box_xyxy.tolist()
    box = ",".join(number_text(v) for v in (x0, y0, x1 - x0, y1 - y0))
    hidden = o.extra.get("occluded") is True or (o.visibility is not None and o.visibility < 1)
    occluded = hidden or o.extra.get("occlusion") == 1
    noisy = o.extra.get("noise") == 1
    return f"{frame},{track},{box},{class_},{species},{int(occluded)},{int(noisy)}\n"
