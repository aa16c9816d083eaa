"""Read MONET, or a dataset laid out like it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Literal, TypedDict

from infrablend.core.dataset import Category, Dataset, ImageRecord, Split
from infrablend.core.file_names import real_path
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import too_long
from infrablend.formats.base import check_splits, shorten, sort_images
from infrablend.formats.labels import coco
from infrablend.formats.picture_facts import Captures
from infrablend.formats.pictures.listing import assign_ids, check_name
from infrablend.formats.published.monet.folders import (
    NAME,
    MonetOptions,
    Pictures,
    check_options,
    find_files,
    sequence_of,
    split_in,
    split_in_stem,
)
from infrablend.formats.published.monet.telemetry import (
    BEYOND_DEG,
    Frame,
    UnusableValues,
    apply_table,
    frame_of,
    join_lists,
    require_pitch,
    set_pitches,
)
from infrablend.formats.records import Findings
from infrablend.formats.values import to_key

_COCO_FIELDS = ("id", "file_name", "width", "height", "source_id")


@dataclass(kw_only=True)
class _Reading(Findings):
    """What is known while a dataset is read.

    Attributes:
        listing: Its pictures.
        options: The options.
        splits: Splits to read.
        seen: Pictures that a file has described.
        categories: Categories found so far.
        folders: Folder of the pictures of each annotation file.
    """

    listing: Pictures
    options: MonetOptions
    splits: Sequence[Split]
    seen: set[str] = field(default_factory=set)
    categories: list[Category] = field(default_factory=list)
    folders: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _File:
    """A COCO file: its place in the dataset, all of it, and its lists of records, which may be anything."""

    where: str
    top: Mapping[str, object]
    images: Iterable[object]
    annotations: Iterable[object]


class _Excluded(TypedDict):
    """Why a sequence was left out, and how much of it."""

    why: str
    images: int
    labels: int


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    **options: str | None,
) -> Dataset:
    """Read MONET, or a dataset laid out like it.

    `pitch_deg` is the gimbal pitch as a depression angle, negative where the camera looks up. The sign is the one for
    which most frames look down. Sequences without any pitch are left out, as in the paper; single frames without
    pitch are kept with pitch None. `notes` counts both.

    `root` may be the folder of one split. A table overrides the telemetry. The options are described in `OPTIONS`.

    Raises:
        DatasetError: There is no annotation file, nothing to read, no telemetry, a file in which more than half of
            the cameras would look up, or an option with a wrong value.
    """
    wanted = check_splits(splits)
    chosen = check_options(root, options)
    dataset = _Reading(root, listing=Pictures(root), options=chosen, splits=wanted)
    problems = dataset.problems
    files = find_files(root, chosen.annotations)
    frames, extra = _read_files(dataset, files)
    dataset.report_left_out()
    if not dataset.folders:
        raise _nothing_found(root, files, chosen.annotations, problems)
    excluded = _leave_out(dataset, frames, chosen.exclude, "exclude")
    if not frames:
        raise DatasetError(f"{root}: nothing to read in the splits {', '.join(wanted)}", shorten(problems))
    gimbal_pitch = set_pitches(root, frames, chosen, problems)
    captures, table = apply_table(root, metadata, frames, problems)
    if not chosen.keep_empty:
        require_pitch(root, frames, chosen, problems)
        has_pitch = {(f.record.split, f.sequence) for f in frames if f.record.capture.pitch_deg is not None}
        bare = {(f.record.split, f.sequence) for f in frames} - has_pitch
        empty = _leave_out(dataset, frames, bare, "empty")
        excluded |= empty
        captures.sources["none"] -= sum(entry["images"] for entry in empty.values())
    without = Counter(f"{f.record.split}/{f.sequence}" for f in frames if f.record.capture.pitch_deg is None)
    notes = {
        "labels": "coco",
        "annotations": list(dataset.folders),
        "pictures": dataset.folders,
        "excluded": excluded,
        "gimbal_pitch": gimbal_pitch,
        "table": table,
        "pitch": captures.note(),
        "frames_without_pitch": dict(sorted(without.items())),
    }
    return Dataset(root, NAME, tuple(dataset.categories), _records(frames), tuple(problems), notes, extra)


def _read_files(dataset: _Reading, files: Sequence[Path]) -> tuple[list[Frame], dict[str, object]]:
    """Return the pictures of all annotation files, and the top-level fields to keep."""
    problems = dataset.problems
    frames: list[Frame] = []
    extra: dict[str, object] = {}
    for path in files:
        where = dataset.place(path)
        top = dataset.json(path)
        if top is None:
            continue
        if not coco.is_coco(top):
            expected = "images with file_name, annotations, categories"
            dataset.warn(where, "annotation-layout", "no COCO keys, left out", expected)
            continue
        file = _File(where, top, top["images"], top["annotations"])
        place = _place_of(dataset, file)
        if isinstance(place, Problem):
            problems.append(place)
            continue
        kept = {k: top[k] for k in ("info", "licenses") if k in top}
        large = {k: p for k, v in kept.items() if (p := too_long(where, k, v))}
        problems += large.values()
        extra = {k: v for k, v in kept.items() if k not in large} | extra
        dataset.folders[where] = place[0] or "."
        frames += _read_file(dataset, file, place)
    return frames, extra


def _place_of(dataset: _Reading, file: _File) -> tuple[str, int] | Problem:
    """Return the folder to which a file's names of pictures are relative, see `Pictures.locate`."""
    names = [i["file_name"] for i in file.images if isinstance(i, dict) and check_name(i.get("file_name"), "") is None]
    given = dataset.options.pictures
    return dataset.listing.given(given, names, file.where) if given else dataset.listing.locate(names, file.where)


def _nothing_found(root: Path, files: Sequence[Path], pattern: str | None, problems: Sequence[Problem]) -> DatasetError:
    """Return the error for a folder without a usable COCO file, listing the files that were tried."""
    shown = ", ".join(p.relative_to(root).as_posix() for p in files[:8]) or "no JSON file"
    found = f"{shown}{f' and {len(files) - 8} more' if len(files) > 8 else ''}"
    expected = f"COCO files that match {pattern}" if pattern else "COCO files at most four levels down"
    todo = "give their place with --read annotations=PATTERN"
    return DatasetError(
        f"{root}: no annotations of MONET",
        [Problem(str(root), "annotation-missing", found, expected, todo), *shorten(problems)],
    )


def _read_file(dataset: _Reading, file: _File, place: tuple[str, int]) -> list[Frame]:
    where = file.where
    path = PurePosixPath(where)
    part, fields = _own_part(dataset, file, place)
    captures = Captures(None, dataset.problems)
    records = coco.read_records(dataset, part, dataset.listing.folder, "train", where, dataset.categories, captures)
    tally = UnusableValues()
    frames = []
    for record in records:
        sequence = sequence_of(record.name, path.stem, real_path(dataset.root).name)
        known = replace(record.capture, sequence=sequence or record.capture.sequence)
        record = replace(record, split=_split_of(dataset, path, record.name), capture=known)
        frames.append(frame_of(record, where, fields.get(to_key(record.source_id), {}), dataset.options, tally))
    expected = {
        "pitch": f"a number of at most {90 + BEYOND_DEG:g} degrees", "altitude": "metres, at least 0",
        "time": "ISO 8601",
    }  # fmt: skip
    dataset.problems += tally.problems(where, expected)
    return frames


def _split_of(dataset: _Reading, file: PurePosixPath, picture: str) -> Split:
    """Return the split of a picture in an annotation file: of the file, else of the picture, else of the dataset."""
    of_file = dataset.options.split or split_in_stem(file.stem) or split_in(file.parent.parts)
    of_root = split_in([real_path(dataset.root).name])
    return of_file or split_in(PurePosixPath(picture).parent.parts) or of_root or "train"


def _own_part(
    dataset: _Reading, file: _File, place: tuple[str, int]
) -> tuple[dict[str, object], dict[int | str | None, dict[str, object]]]:
    """Return an annotation file without pictures of other splits and earlier files, and the pictures' own fields."""
    listing = dataset.listing
    joined = join_lists(file.top)
    images: list[object] = []
    fields: dict[int | str | None, dict[str, object]] = {}
    skipped: set[int | str] = set()
    twice = 0
    for r in file.images:
        if not isinstance(r, dict) or check_name(r.get("file_name"), "") is not None:
            images.append(r)
            continue
        below = listing.resolve(r["file_name"], *place)
        name = below if below in listing.by_path else listing.folder.by_stem.get(below, below)
        is_there = name in listing.by_path
        r = r | {"file_name": name if is_there else r["file_name"]}
        number = to_key(r.get("id"))
        in_split = _split_of(dataset, PurePosixPath(file.where), below)
        if number is not None and (in_split not in dataset.splits or name in dataset.seen):
            twice += in_split in dataset.splits
            skipped.add(number)
            continue
        if is_there:
            dataset.seen.add(name)
        if number is not None:
            fields.setdefault(number, {k: v for k, v in r.items() if k not in _COCO_FIELDS} | joined.get(number, {}))
        images.append(r)
    if twice:
        found = f"{twice} picture(s) that another annotation file contains too; left out here"
        dataset.add(file.where, "image-duplicate", found, "each picture once", "remove one of the files")
    annotations = (a for a in file.annotations if not isinstance(a, dict) or to_key(a.get("image_id")) not in skipped)
    return {**file.top, "images": images, "annotations": annotations}, fields


def _leave_out(
    dataset: _Reading,
    frames: list[Frame],
    sequences: Collection[str | tuple[Split, str | None]],
    option: Literal["exclude", "empty"],
) -> dict[str, _Excluded]:
    """Remove sequences (names, or pairs of split and name) from `frames`; report and count them."""
    why = "named in exclude" if option == "exclude" else "no telemetry in any frame"
    out = [f for f in frames if f.sequence in sequences or (f.record.split, f.sequence) in sequences]
    frames[:] = [f for f in frames if f.sequence not in sequences and (f.record.split, f.sequence) not in sequences]
    counts: dict[str, _Excluded] = {}
    for f in out:
        entry = counts.setdefault(f"{f.record.split}/{f.sequence}", {"why": why, "images": 0, "labels": 0})
        entry["images"] += 1
        entry["labels"] += len(f.record.instances)
    if counts:
        labels = sum(len(f.record.instances) for f in out)
        found = f"{len(counts)} sequence(s) left out, {why}: {', '.join(sorted(counts))} "
        found += f"({len(out)} images, {labels} labels)"
        todo = "keep them with --read empty=keep" if option == "empty" else ""
        dataset.warn(dataset.root.name, "sequence-excluded", found, todo=todo)
    unknown = sorted({str(s) for s in sequences} - {f.sequence for f in out}) if option == "exclude" else []
    if unknown:
        there = ", ".join(sorted({str(f.sequence) for f in frames})[:20])
        dataset.warn("option exclude", "option-value", f"no sequence {', '.join(unknown)}", f"some of {there}")
    return dict(sorted(counts.items()))


def _records(frames: Sequence[Frame]) -> tuple[ImageRecord, ...]:
    """Return the records with ids: `<sequence>_<stem>` where that is unique."""
    plain: dict[str, str] = {}
    for f in frames:
        r = f.record
        name = PurePosixPath(r.name).name
        # Pictures written by InfraBlend already have the sequence in their names.
        if f.sequence and not name.startswith(f"{f.sequence}_"):
            name = f"{f.sequence}_{name}"
        plain[f"{r.split}/{r.name}"] = f"{r.split}/{name}"
    clear = Counter(plain.values())
    keys = {full: short if clear[short] == 1 else full for full, short in plain.items()}
    ids = assign_ids(keys.values())
    return sort_images(replace(f.record, id=ids[keys[f"{f.record.split}/{f.record.name}"]]) for f in frames)
