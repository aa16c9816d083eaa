"""Detect the format of a folder and read it, whatever its format."""

from __future__ import annotations

import os
import stat
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from infrablend.core.addresses import address_of, shown
from infrablend.core.boxes import MANY_PX, are_shares
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.file_names import real_path
from infrablend.core.files import read_object
from infrablend.core.format_table import FORMATS, Format, find_format
from infrablend.core.run_folder import RUN_FILE, SHARDS_FILE, RunFolder
from infrablend.core.temperature import TemperatureScale
from infrablend.core.workspace import unfinished
from infrablend.errors import DatasetError, Problem, UnknownFormatError
from infrablend.formats.annotation_files import noting_files_read
from infrablend.formats.base import FormatModule, Match, shorten
from infrablend.formats.cameras.flight_headers import add_flight_data
from infrablend.formats.image_groups import with_val
from infrablend.formats.labels import folder
from infrablend.formats.pictures import temperature_scale
from infrablend.formats.pictures.images import is_turned, size_problem
from infrablend.formats.pictures.listing import JPEG_SUFFIXES, check_link, is_picture_name, read_size
from infrablend.formats.pictures.video import is_video
from infrablend.formats.read_write import READ_ALL, Reading
from infrablend.formats.text_fields import with_fitting_fields
from infrablend.formats.unread import files_below, hidden_pictures, label_candidates, unread_files

DATASET_INSIDE = "dataset-inside"
"""Code of the problem of a folder that has datasets inside, whose labels are not read."""
PART_FRAMES = 2000
"""Largest number of frames of a part of a dataset; smaller datasets are read at once."""
# Read from runs that have it, whatever else they have.
_FIRST_OF_RUN = "coco"
# Pictures whose EXIF is looked at.
_LOOKED_AT = 64
_LEAVE_OUT = "leave --format out, or give the folder of the dataset"


def reader_options(format: Format) -> Mapping[str, str]:
    """Return the options of the format's reader and what each does; empty if it has none."""
    return FormatModule.load(format.module).OPTIONS


@dataclass(frozen=True)
class Detection:
    """The detected format (None if none fits), and the result of each format, in order."""

    format: str | None
    matches: tuple[Match, ...]

    @property
    def reasons(self) -> dict[str, str]:
        """Return per format the reason why it fits, or why it does not."""
        return {m.format: m.reason for m in self.matches}


def detect(root: Path) -> Detection:
    """Return the first format of the table that fits a folder or video, with the reasons of all formats."""
    single = root.is_file()
    modules = ((f.name, FormatModule.load(f.module)) for f in FORMATS)
    matches = tuple(
        m.detect(root) if m.TAKES_VIDEO or not single else Match(name, False, "a file, not a folder")
        for name, m in modules
    )
    return Detection(next((m.format for m in matches if m.ok), None), matches)


def with_every_frame(reading: Reading, root: Path) -> Reading:
    """Return how to read all frames of videos, unless the reading states a step."""
    if "every" in reading.options or not root.exists():  # which `read` reports
        return reading
    name = reading.format or detect(root).format
    if name is None or "every" not in reader_options(find_format(name)):
        return reading
    return replace(reading, options={**reading.options, "every": "1"})


def read(root: Path, reading: Reading = READ_ALL, *, compare_sizes: bool = True) -> Dataset:
    """Read a dataset folder of any format, or one video.

    Args:
        root: Folder of the dataset, or a video.
        reading: Format, splits and reader options; by default the format is detected and every split is read.
        compare_sizes: Whether to compare the sizes that labels state with the headers of the pictures.

    Raises:
        UnknownFormatError: No format fits, as there is no picture to read; `detect` gives the reason of each format.
        DatasetError: The folder cannot be read, or its format does not have one of the options. Or it is a run that
            has no labels in the wanted format. Or no val split can be made.
    """
    reader = _Reader.of(root, reading)
    splits = reading.splits if reading.val_share is None else None
    with noting_files_read() as files:
        dataset = reader.module.read(reader.root, splits=splits, **reader.options)
    dataset = reader.completed(dataset)
    if compare_sizes:
        dataset = replace(
            dataset, problems=(*dataset.problems, *_other_sizes(dataset.images, files), *_turned(dataset))
        )
    if reading.val_share is not None:
        dataset = with_val(dataset, reading.val_share, reading.splits)
    return replace(dataset, problems=(*dataset.problems, *_unread(dataset, files, splits, reader.options)))


def read_parts(root: Path, pictures: Path, reading: Reading = READ_ALL) -> Iterator[Dataset]:
    """Read a dataset in parts, if its format can be; the arguments and errors are those of `read`.

    Args:
        root: Folder of the dataset.
        pictures: Empty folder for the pictures of one part, which are deleted when the next one is asked for.
        reading: See `read`.
    """
    reader = _Reader.of(root, reading)
    if reader.module.read_parts is None:
        yield reader.completed(reader.module.read(reader.root, splits=reading.splits, **reader.options))
        return
    for part in reader.module.read_parts(reader.root, pictures, splits=reading.splits, most=PART_FRAMES):
        yield reader.completed(part)


@dataclass(frozen=True)
class _Reader:
    """The reader of a folder, with its options.

    Attributes:
        root: Folder of the labels.
        module: Module of the format.
        options: Options of the reader.
        stated: Whether the user stated how levels mean temperatures.
        scale: That scale, if it is one for all pictures.
    """

    root: Path
    module: FormatModule
    options: Mapping[str, object]
    stated: bool
    scale: TemperatureScale | None

    @classmethod
    def of(cls, root: Path, reading: Reading) -> _Reader:
        single = is_video(root)
        if not root.is_dir() and not single:
            raise _missing(root)
        _require_merged(root)
        root, format = _labels_of_run(root, reading.format)
        if format is None:
            format = detect(root).format
            if format is None:
                raise UnknownFormatError(f"{root}: no format fits", [_nothing_to_read(root)])
        chosen = find_format(format)
        given: dict[str, object] = dict(reading.options)
        stated = {name: str(given.pop(name)) for name in temperature_scale.OPTIONS if name in given}
        scale = temperature_scale.scale_of_options(stated) if stated else None
        if reading.form is not None:
            given["form"] = reading.form
        table = None if reading.metadata is None else Path(reading.metadata)
        module = FormatModule.load(chosen.module)
        if single and not module.TAKES_VIDEO:
            problem = Problem(
                shown(root), "folder-missing", "a video", f"a folder in the format {chosen.name}", _LEAVE_OUT
            )
            raise DatasetError("no dataset to read", [problem])
        known = module.OPTIONS
        problems = [
            Problem(f"option {name}", "option-unknown", f"{name}={value}", _options_text(chosen.name, known))
            for name, value in sorted(given.items())
            if name not in known
        ]
        if table is not None and not module.TAKES_TABLE:
            message = f"{chosen.name} already contains pitch and altitude"
            problems.append(Problem(table.name, "table-unused", message, "no table", "leave it out"))
        if problems:
            raise DatasetError(f"{root}: the format is {chosen.name}, which does not have these options", problems)
        if table is not None:
            given["metadata"] = real_path(table)  # the user's own file: it may be a link to anywhere
        return cls(root, module, given, bool(stated), scale)

    def completed(self, dataset: Dataset) -> Dataset:
        """Return what the module read with the facts and remarks that do not depend on the format."""
        dataset = _in_pixels(with_fitting_fields(_with_regular_pictures(dataset)))
        if self.stated:
            dataset = temperature_scale.with_scale(dataset, self.scale)
        dataset = add_flight_data(dataset)
        if dataset.format == folder.NAME and dataset.notes.get("labels") != "coco":  # which can state it
            dataset = replace(dataset, images=folder.with_numbered_frames(dataset.images))
        remarks = (*hidden_pictures(dataset.root), *temperature_scale.scale_warnings(dataset))
        return replace(dataset, problems=(*dataset.problems, *remarks))


def _nothing_to_read(root: Path) -> Problem:
    """Return what is in a folder that has no picture to read, and so no format."""
    files = [name for name in files_below(root) if not is_picture_name(name)]
    named = f", but {len(files)} other file(s), such as {', '.join(files[:3])}" if files else " and no other file"
    found = f"no picture (JPEG, PNG, BMP, TIFF, WebP) to read{named}"
    todo = "check the path; unpack archives; put labels and pictures into one folder"
    return Problem(shown(root), "not-this-format", found, "a dataset in a format of docs/formats, or pictures", todo)


def _missing(root: Path) -> DatasetError:
    found = "no such folder"
    todo = "check the path"
    if address_of(root) is not None:
        todo = "copy it here first, with `infrablend merge` if it is a run"
    elif root.is_file():
        found = "a file"
        todo = "give the folder that it is in, or unpack it if it is an archive"
    elif (left := unfinished(root)) is not None:
        found, _, todo = left.partition("; ")
    problem = Problem(shown(root), "folder-missing", found, "the folder of a dataset", todo)
    return DatasetError("no dataset to read", [problem])


def _require_merged(root: Path) -> None:
    """Refuse the folder of a run in shards that have no label files.

    Raises:
        DatasetError: It is one.
    """
    plan = read_object(root / SHARDS_FILE) or {}
    one = "shard" in (read_object(root / RUN_FILE) or {})
    if one or ("shards" in plan and plan.get("layout") != "shards"):
        found = "shards of a run, which have no label files"
        todo = f"merge them: infrablend merge {root.parent if one else root} DST"
        raise DatasetError(f"{root}: cannot be read", [Problem(str(root), "shards-unmerged", found, "a dataset", todo)])


def _unread(
    dataset: Dataset, read: Collection[Path], splits: Collection[str] | None, options: Collection[str]
) -> Sequence[Problem]:
    """Return what was not read; one problem for the labels of whole datasets inside of a plain folder."""
    unread = unread_files(dataset, read, splits, options)
    if dataset.format != folder.NAME:
        return unread
    # Datasets inside have label files and pictures in their folders; `images` and `labels` have one of both.
    labelled = {name.partition("/")[0] for name in label_candidates(dataset.root) if "/" in name}
    folders = sorted(labelled & _top_folders(dataset) | {p.where.partition("/")[0] for p in unread if "/" in p.where})
    known = {name: detect(dataset.root / name).format for name in folders}
    inside = {name: format for name, format in known.items() if format not in (None, folder.NAME)}
    if not inside:
        return unread
    listed = ", ".join(f"{name} ({format})" for name, format in inside.items())
    found = f"{len(inside)} dataset(s) inside, whose labels are not read: {listed}"
    todo = f"give one of them, such as {dataset.root / next(iter(inside))}"
    others = [p for p in unread if p.where.partition("/")[0] not in inside]
    return [Problem(dataset.root.name, DATASET_INSIDE, found, "the folder of one dataset", todo), *others]


def _top_folders(dataset: Dataset) -> set[str]:
    """Return the folders right below the dataset's that have pictures, at any depth."""
    below = (os.fspath(i.path).removeprefix(f"{dataset.root}{os.sep}").partition(os.sep) for i in dataset.images)
    return {top for top, inside, _ in below if inside}


def _with_regular_pictures(dataset: Dataset) -> Dataset:
    """Return the dataset without pictures that are no files: pipes, and links out of their folders or to nowhere.

    Opening a pipe would wait for ever, and links out of the folder would copy foreign files.
    """
    problems = list(dataset.problems)
    kept = []
    for image in dataset.images:
        problem = _picture_fault(image.path, f"{image.split}/{image.name}")
        if problem is None:
            kept.append(image)
        else:
            problems.append(problem)
    if len(kept) == len(dataset.images):
        return dataset
    if not kept:
        raise DatasetError(f"{dataset.root}: no picture is a file in its folder", shorten(problems))
    return replace(dataset, images=tuple(kept), problems=tuple(problems))


def _other_sizes(images: Iterable[ImageRecord], measured: Collection[Path]) -> list[Problem]:
    """Return the problem of each picture whose labels state another size than its header.

    Args:
        images: Pictures of a dataset.
        measured: Those whose sizes were read from their headers.
    """
    stated = (i for i in images if i.size_wh is not None and i.path not in measured)
    found = (size_problem(i, f"{i.split}/{i.name}", read_size(i.path, i.name)[0]) for i in stated)
    return [problem for problem in found if problem is not None]


def _turned(dataset: Dataset) -> list[Problem]:
    """Return a warning if EXIF turns JPEG files whose labels do not state a size that could show it."""
    jpegs = [i for i in dataset.images if i.path.suffix.lower() in JPEG_SUFFIXES and i.instances]
    looked_at = jpegs[:: max(1, len(jpegs) // _LOOKED_AT)]
    names = [f"{i.split}/{i.name}" for i in looked_at if is_turned(i.path)]
    if not names:
        return []
    found = f"EXIF says that {len(names)} of {len(looked_at)} JPEG files that were looked at are turned; "
    found += "labels are taken to be those of the pixels as stored"
    todo = "if they were made on the turned pictures, turn the pixels, as with `mogrify -auto-orient`"
    return [Problem(names[0], "image-exif-turned", found, "no EXIF orientation", todo, "warning")]


def _in_pixels(dataset: Dataset) -> Dataset:
    """Return the dataset without pictures that have boxes in shares of the picture where the format has pixels.

    Raises:
        DatasetError: No picture is left.
    """
    objects = [(image, o.box_xyxy) for image in dataset.images for o in image.instances]
    shares = are_shares(np.array([box for _, box in objects]))
    few = {i.id: (i, box) for (i, box), is_share in zip(objects, shares, strict=True) if is_share and _has_many_px(i)}
    if not few:
        return dataset
    first, edges = next(iter(few.values()))
    box = ", ".join(f"{v:.3g}" for v in edges)
    found = f"boxes of {len(few)} picture(s) lie within 0 to 2 px, such as {box} (edges): shares of the picture, "
    found += f"normalised by its size; left out with {sum(len(i.instances) for i, _ in few.values())} object(s)"
    todo = "multiply them by the picture's width and height, or convert them with the tool that wrote them"
    problem = Problem(f"{first.split}/{first.name}", "box-shares", found, "boxes in px", todo)
    images = tuple(i for i in dataset.images if i.id not in few)
    if not images:
        raise DatasetError(f"{dataset.root}: boxes in shares of the picture", [problem])
    return replace(dataset, images=images, problems=(*dataset.problems, problem))


def _has_many_px(image: ImageRecord) -> bool:
    size_wh = image.size_wh or read_size(image.path, image.name)[0]
    return size_wh is not None and min(size_wh) >= MANY_PX


def _picture_fault(path: Path, where: str) -> Problem | None:
    try:
        mode = path.lstat().st_mode
    except (OSError, ValueError):  # reported by what reads the picture
        return None
    if stat.S_ISREG(mode):
        return None
    if stat.S_ISLNK(mode):
        problem = check_link(path, path.parent, where)
        if problem is not None or path.is_file():
            return problem
    found = "a link that leads to no file" if stat.S_ISLNK(mode) else "no regular file, but a folder, pipe or device"
    return Problem(where, "image-missing", found, "a picture file", "restore the file")


def _options_text(name: str, known: Mapping[str, str]) -> str:
    if not known:
        return f"no option: {name} has none"
    return "one of " + "; ".join(f"{k} ({what})" for k, what in known.items())


def _labels_of_run(root: Path, format: str | None) -> tuple[Path, str | None]:
    """Return the folder to read a run from, and the format of its labels; other folders are returned as they are.

    COCO files are read from the root of the run, the labels of the other formats from their own folders, so that each
    picture is read once and with its labels.

    Args:
        root: Folder of a dataset, perhaps of a run.
        format: Wanted format; None takes COCO if the run has it, else the first of the run's formats.

    Raises:
        DatasetError: The run has no labels of the wanted format.
    """
    record = (read_object(root / RUN_FILE) if (root / RUN_FILE).is_file() else None) or {}
    formats = record.get("formats")
    if "infrablend" not in record or not isinstance(formats, list):
        return root, format
    layout = RunFolder(root)
    there = [str(f) for f in formats if str(f) in {*(x.name for x in FORMATS), "native"} and layout.labels(f).is_dir()]
    wanted = format or (_FIRST_OF_RUN if _FIRST_OF_RUN in there or not there else there[0])
    if not there:
        # The folder of tracks has no pictures of its own.
        kinds = (m.format for m in detect(root).matches if m.ok and m.format != "mot")
        return root, format or next(kinds, None)
    if wanted == _FIRST_OF_RUN and _FIRST_OF_RUN in there:
        return root, wanted  # a run has other folders that look like datasets, such as that of tracks
    if wanted in there:
        return layout.labels(wanted), None if wanted == "native" else wanted
    found = f"a run with labels in {', '.join(there)}"
    problem = Problem(
        str(root), "format-none", found, f"labels in {wanted}", f"leave out --format, or give one of {', '.join(there)}"
    )
    raise DatasetError(f"{root}: cannot be read as {wanted}", [problem])
