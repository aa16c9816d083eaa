"""Find label files that a reader did not understand, so that lost labels do not look like pictures without objects."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from io import BufferedReader
from itertools import compress
from operator import itemgetter
from pathlib import Path, PurePosixPath

from infrablend.core.dataset import Dataset
from infrablend.core.file_names import fold_name
from infrablend.core.files import LFS_FOUND, LFS_TODO, open_regular
from infrablend.core.json_records import is_list
from infrablend.core.run_folder import RUN_FILE, SHARDS_FILE
from infrablend.core.workspace import CONVERT_FILE, FRAMES_FILE, SOURCE_FILE, SPLIT_FILE, TEMPERATURES_FILE, WORLD_FILE
from infrablend.errors import DatasetError, Problem, Severity
from infrablend.formats.annotation_files import MAX_TEXT_BYTES, as_utf8, read_json, read_xml
from infrablend.formats.base import stated_split
from infrablend.formats.labels import folder
from infrablend.formats.pictures.listing import PICTURE_SUFFIXES, is_hidden, is_picture_name, masks_of, walk
from infrablend.formats.unread_pictures import folders_like_classes, path_below, unread_pictures, unread_videos

_JSON_SUFFIXES = {".json", ".jsonl", ".ndjson", ".geojson", ".manifest", ".odgt"}
_YAML_SUFFIXES = {".yaml", ".yml"}
_SUFFIXES = {
    ".xml", ".txt", ".csv", ".tsv", ".label", ".tfrecord", ".record", ".pkl", *_JSON_SUFFIXES, *_YAML_SUFFIXES,
}  # fmt: skip
# Other texts that may be labels: errors if they show boxes, but many of them name pictures for another purpose.
_RARE_SUFFIXES = {".lst", ".dat", ".log", ".ann", ".gt", ".idl", ".lbl", ".bbox", ".pts", ".xgtf", ""}
# What cannot be searched as text: the suffix alone says that there may be labels or pictures.
_ARCHIVES = {".zip", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".7z", ".rar"}
_BINARY = {".mat", ".parquet", ".arrow", ".xlsx", ".xls", ".ods", ".h5", ".hdf5"}
# Such files of any purpose are common: only their names tell.
_ARRAYS = {".npy", ".npz"}
# Names of such files that speak of labels.
_OF_LABELS = re.compile(
    r"label|annot|(?:^|[\W_])(?:gt|xml|voc|coco|yolo|dota)(?:[\W_]|$)|truth|box|mask", re.IGNORECASE
)
# Whole words of names and lines that speak of labels, and of names that speak of something else.
_WORD_OF_LABELS = re.compile(
    r"(?:^|[\W_])(?:label(?:s|l?ed)?|annos?|annot(?:ation)?s?|gt|(?:ground_?)?truth|(?:b|bounding_?)?box(?:es)?|bbs?|det(?:ection)?s?|masks?"
    r"|objects?|rects?|res|voc|coco|yolo|dota)\d*(?=[\W_]|$)",
    re.IGNORECASE,
)
_WORD_OF_OTHERS = re.compile(
    r"(?:^|[\W_])(?:(?:flight)?log|times?|timestamps?|gps|imu|poses?|homograph(?:y|ies)|calib(?:ration)?|srt|telemetry)"
    r"(?:[\W_]|$)"
)
_PART = re.compile(r"\.part(-\d+)?$")
_EXPECTED = "a label file that can be read"
# What InfraBlend writes of the datasets that it made.
_RECORDS = {WORLD_FILE, CONVERT_FILE, SPLIT_FILE, FRAMES_FILE, TEMPERATURES_FILE, SOURCE_FILE}
# Texts for people, which may name pictures as examples.
_FOR_PEOPLE = re.compile(r"(readme|licen[cs]e|citation|notice|attribution|changelog)", re.IGNORECASE)
# Folders that separate pictures from labels.
_KIND = re.compile(r"(?<=/)(?:images?|imgs?|jpegimages|labels?|annotations?|xmls?)/", re.IGNORECASE)
# Titles of columns, keys of JSON and tags of XML that tell of boxes, outlines or classes.
_LABEL_WORD = (
    r"(?:\w{1,40}[_ .-])?(?:\w{0,40}labels?|class(?:es)?|category|species|objects?|detections?|\w{0,3}box(?:es)?"
    r"|bounding_?box(?:es)?|polygons?|segmentations?|wkt|rle|encoded_?pixels|shapes|regions|x_?(?:min|max|[012]))"
    r"(?:[_ ]?(?:ids?|names?|title))?|\w{0,40}shape_attributes"
)
_TITLE = re.compile(_LABEL_WORD, re.IGNORECASE)
# Titles of the sides of a box, of which four make one, and of the column of pictures.
_SIDE = re.compile(
    r"(?:(?:b?box|bb|bounding_?box|rect|roi)[_ .-]?)?(?:(?:c|cent(?:er|re)|min|max|[tbul][lr])?[_ ]?[xy]"
    r"|[xy][_ ]?(?:c|cent(?:er|re)|min|max|[tbul][lr]|left|right|top|bottom|[0-4])|w|h|width|height"
    r"|(?:(?:top|bottom|upper|lower)[_ ]?)?(?:left|right|top|bottom)(?:[_ ]?[xy])?)(?:[_ ](?:px|pixels?|norm|rel))?",
    re.IGNORECASE,
)
_PICTURE_TITLE = re.compile(
    r"(?:image|img|picture|frame|file)?[_ ]?(?:id|name|no|nr|num|number|index|idx|image|img|picture|frame|file)",
    re.IGNORECASE,
)
_KEY = re.compile(rf'"(?:{_LABEL_WORD})"\s*:', re.IGNORECASE)
_YAML_KEY = re.compile(rf"""(?:^[ -]*|[{{,] ?)["']?(?:{_LABEL_WORD})["']?:(?:\s|$)""", re.IGNORECASE | re.MULTILINE)
# A recipe of ours may name pictures, and has `objects`.
_RECIPE = re.compile(r"^(?:configurations|camera|placement|sensor):", re.MULTILINE)
_TAG = re.compile(rf"<(?:{_LABEL_WORD})[\s/>]", re.IGNORECASE)
# What the first line of a table of places on the ground says of them.
_COORDINATES = re.compile(r"EPSG:|\+proj|WGS", re.IGNORECASE)
# The end of a picture's name, and what separates names. Names are looked for backwards from their ends: forwards, a
# line of a megabyte without a separator would be searched from each of its characters.
_PICTURE_END = re.compile(r"\.(?:jpe?g|jpe|jfif|png|tiff?|bmp|webp)\b", re.IGNORECASE)
_SEPARATOR = re.compile(r"[\\/\"'<>\x00-\x1f\ufffd]")
# What also separates names, unless it is in one.
_BREAK = re.compile(r"[ |,;:=]")
_LONGEST_NAME = 255
_PIECE = re.compile(r"""[\\/"'<>|,;:= ()\[\]{}#?&-]|[\x00-\x1f\ufffd]""")
# What Label Studio puts before the names of uploaded pictures.
_UPLOADED = re.compile(r"[0-9a-f]{8}-(?=.)")
# Names without a suffix in tables and in JSON; plain numbers and dates are none, unless zeros fill them up.
_TELLING = re.compile(r"(?=.*\d).*[^\d.+-]|0\d{3}", re.DOTALL)
# What labels leave out of such a name: a word at its end that tells one form of a picture from another, such as `_ir`,
# and then a word before a number, such as `frame_`.
_LAST_WORD = re.compile(r"[_\-. ][^\W\d_]{1,12}$")
_FIRST_WORD = re.compile(r"^[^\W\d_]{1,12}[_\-. ]?(?=\d+$)")
_CELL = re.compile(r"[,;\s|\"'\[\]()]+")
_TEXT = re.compile(r'(:\s*)?"([^"\\/]{1,255})"(?=(\s*:)?)')
# A line of a table of boxes: left, top, width and height at least, perhaps after the frame and the track.
_NUMBER = r"(?:-?(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][-+]?\d++)?|(?i:nan)\b)"
_IS_NUMBER = re.compile(_NUMBER).fullmatch
_BOX = 4
_NUMBERS = re.compile(rf"(?<![\w.])(?:{_NUMBER}[,; \t]++){{3,}}{_NUMBER}")
# Also as pairs, each in brackets.
_TUPLE = re.compile(rf"[(\[{{][\s(\[{{]{{0,9}}+{_NUMBER}(?:(?:[\s)\]}}]*+[,;][\s(\[{{]*+|[ \t]++){_NUMBER}){{3}}")
_VALUES = re.compile(rf"(?:=\s*+{_NUMBER}[^=]{{1,20}}){{3}}=\s*+{_NUMBER}")
# In JSON, four numbers as the value of a key, perhaps in lists, and characters that are written as numbers.
_BOX_OF = re.compile(rf'"([^"\\]{{1,255}})"\s*:\s*\[[\s\[]*+{_NUMBER}(?:\s*,\s*{_NUMBER}){{3}}')
# Keys of JSON with the number of a picture; and those of a list of results, which may be numbers of another file.
_PICTURE_NUMBER = re.compile(
    r'"(?:image|img|picture|file|frame)[_ ]?(?:id|no|nr|num|number|index|idx)?"\s*:\s*"?(\d+)\b', re.IGNORECASE
)
_RESULTS = re.compile(
    r'\s*[\[{](?!.*"images"\s*:)(?=.*"image_id"\s*:).*"(?:bbox|segmentation|keypoints)"\s*:', re.DOTALL
)
_ESCAPED = re.compile(r"\\u([0-9a-fA-F]{4})")
_TRUTH = re.compile(r"(?:^|[\W_])(?:gt|det|ground_?truth)(?:[\W_]|$)")
_HEAD_BYTES = 1_000_000
_LONGEST_LINE = 10_000
# Files of one folder that are named one by one; more are one problem.
_MOST_NAMED = 3
_EMPTY = "an empty file"
_UNKNOWN = "labels in no known layout, which are not read"
_IF_LABELS = "if it holds labels, convert it, for example with CVAT or Datumaro, to a format of docs/formats"
_RENAME = "rename it to .txt"
_TODO = "convert it, for example with CVAT or Datumaro, to a format of docs/formats; or move it out of the folder"


def unread_files(
    dataset: Dataset,
    read: Collection[Path] = (),
    splits: Collection[str] | None = None,
    options: Collection[str] = (),
) -> list[Problem]:
    """Return the problems of what is below the dataset's folder and was not taken by its reader.

    Args:
        dataset: The dataset.
        read: Files from which the reader took something (see `annotation_files.noting_files_read`).
        splits: Splits that were asked for; None for all.
        options: Names of the reader's options that were given.
    """
    files = list(files_below(dataset.root))
    if (dataset.root / RUN_FILE).is_file():  # a run, with the labels of all its formats
        return _unread_labels(dataset, files, {}, read, splits)
    masks = masks_of([name for name in files if is_picture_name(name)])
    if masks:  # but for pictures that have labels of their own, or are named by an annotation
        taken = {i.path for i in dataset.images}.union(read)
        masks = {name: stem for name, stem in masks.items() if dataset.root / name not in taken}
    below = path_below(dataset.root)
    known = {os.fspath(path) for path in read}
    others = [name for name in files if name not in masks and below + name not in known]
    return [
        *_unread_labels(dataset, files, masks, read, splits),
        *unread_pictures(dataset, others, splits, options),
        *unread_videos(dataset, others),
        *(folders_like_classes(dataset) if dataset.format == folder.NAME else ()),
    ]


def _unread_labels(
    dataset: Dataset,
    files: Sequence[str],
    masks: Mapping[str, str],
    read: Collection[Path],
    splits: Collection[str] | None,
) -> list[Problem]:
    """Return the problems of label files below the dataset's folder that its reader did not take.

    These are damaged XML and JSON files, text files with a suffix such as `.TXT`, files that name pictures of the
    dataset or hold a table of boxes, files named after a picture with its suffix, files named like a picture, archives
    and other files that are no text, and masks. Lists of pictures and texts for people are none.
    """
    reported = {p.where.partition(":")[0] for p in dataset.problems if p.severity == "error"}
    bare = reported.difference(files)  # readers state some places without their folders
    left = [name for name in files if name not in reported and dataset.root / name not in read]
    suffixes = _SUFFIXES | _RARE_SUFFIXES
    texts = [name for name in left if _is_candidate(name, splits, suffixes) and PurePosixPath(name).name not in bare]
    ours = any((dataset.root / name).is_file() for name in (RUN_FILE, SHARDS_FILE))  # with the labels of all formats
    closed = [] if ours else [name for name in left if _suffix(name) in _ARCHIVES | _BINARY | _ARRAYS]
    if not texts and not masks and not closed:
        return []
    judge = _Judge(dataset, ours)
    problems = []
    alike = defaultdict[tuple[str, str, Problem], list[str]](list)
    for name in texts:
        fault = _fault(dataset.root / name, name)
        problem = judge.of_text(name, fault)
        if problem is not None and (fault or problem.todo == _RENAME):
            problems.append(replace(problem, where=name))
        elif problem is not None:
            alike[name.rpartition("/")[0], _suffix(name), problem].append(name)
    for name in closed:
        if problem := judge.of_closed(name):
            alike[name.rpartition("/")[0], _suffix(name), problem].append(name)
    for name, picture in masks.items():
        if fold_name(picture) in judge.labelled:
            alike[name.rpartition("/")[0], "", judge.of_mask(picture)].append(name)
    for (_, _, problem), names in alike.items():
        if len(names) > _MOST_NAMED:
            problems.append(replace(problem, where=names[0], found=f"{len(names)} files: {problem.found}"))
        else:
            problems += [replace(problem, where=name) for name in names]
    return problems


def _unread(found: str, todo: str, severity: Severity = "error") -> Problem:
    """Return what is said of a file; its place is added where it is known whether others are alike."""
    return Problem("", "label-unread", found, _EXPECTED, todo, severity)


class _Judge:
    """Judges how grave it is that a file is not read, by what is known of the pictures of a dataset.

    A file of one picture, or its mask, is only worth a warning if the picture has labels from elsewhere; so is a file
    that names pictures, but shows neither boxes nor classes.

    Attributes:
        labelled: Whether a picture has objects, by its folded stem.
    """

    def __init__(self, dataset: Dataset, ours: bool) -> None:
        self._root = dataset.root
        self._ours = ours
        self._plain = dataset.format == folder.NAME
        self._pictures = _Pictures.of(dataset)
        self.labelled: dict[str, bool] = {}
        for image in dataset.images:
            stem = fold_name(image.path.stem)
            self.labelled[stem] = bool(image.instances) or self.labelled.get(stem, False)
        self._any = any(self.labelled.values())
        # Also by what labels of all forms of a picture are named.
        forms = ((_LAST_WORD.sub("", stem), has) for stem, has in sorted(self.labelled.items(), key=itemgetter(1)))
        self._forms = {stem: has for stem, has in forms if _TELLING.match(stem)} | self.labelled
        # Elsewhere in the folders, a file may be that of a picture of the same stem in another split.
        self._places = {_place(os.fspath(i.path)) for i in dataset.images}

    def of_text(self, name: str, fault: str) -> Problem | None:
        """Return the remark on a file of text, and why it cannot be read; None if it is harmless."""
        path = self._root / name
        stem = fold_name(path.stem)
        if fault:
            # What our own runs have for a sequence without objects.
            if self._ours and fault == _EMPTY and name.endswith("/gt/gt.txt"):
                return None
            todo = LFS_TODO if fault == LFS_FOUND else "restore or remove the file"
            return _unread(fault, todo, "warning" if fault == _EMPTY and self._any else "error")
        if path.suffix != path.suffix.lower() == ".txt" and stem in self.labelled:
            return _unread(f"labels with the suffix {path.suffix}, which are not read", _RENAME)
        if self._ours or name in _RECORDS or (path.suffix.lower() in (".txt", "") and _FOR_PEOPLE.match(path.name)):
            return None
        if self.labelled.get(stem) and (self._plain or _place(os.fspath(path)) in self._places):
            return _unread("labels of a picture that has other labels, which are not read", _TODO, "warning")
        rare = _suffix(name) in _RARE_SUFFIXES
        if self._plain and not rare and (stem in self.labelled or _is_annotation(path, name)):
            return _unread(_UNKNOWN, _TODO)
        alone = self._is_alone(stem)
        says = _tells_of(path, self._pictures, alone=alone)
        if rare and (says != "error" or _suffix(name) == ".log"):
            says = "warning" if says == "error" or alone else None
        if says == "warning":
            return _unread("a file that names pictures, and is not read", _IF_LABELS, says)
        return None if says is None else _unread(_UNKNOWN, _TODO)

    def _is_alone(self, stem: str) -> bool:
        """Return whether a folded stem, perhaps but for a word such as `gt`, is that of a picture without objects."""
        if stem not in self._forms:
            stem = _WORD_OF_LABELS.sub("", stem).strip("_-. ")
        return self._forms.get(stem) is False

    def of_closed(self, name: str) -> Problem | None:
        """Return the remark on a file that cannot be searched as text; None for arrays that are not named for one."""
        stem = fold_name(PurePosixPath(name).stem)
        lost = _OF_LABELS.search(stem) and not self._any
        if _suffix(name) in _ARRAYS and not (lost or stem in self._forms or self._pictures.are_of_clip(stem)):
            return None
        severity: Severity = "error" if lost else "warning"
        if _suffix(name) in _ARCHIVES:
            todo = "if it holds labels or pictures, unpack it; else move it out of the folder"
            return _unread("an archive, which is not read", todo, severity)
        return _unread("a file that may hold labels, and is not read", _IF_LABELS, severity)

    def of_mask(self, picture: str) -> Problem:
        """Return the remark on the mask of a picture."""
        severity: Severity = "warning" if self.labelled[fold_name(picture)] else "error"
        return _unread("masks of pictures, which are not read", _TODO, severity)


def hidden_pictures(root: Path) -> list[Problem]:
    """Return a warning if there are hidden pictures with label files of their stems: no reader takes them."""
    hidden = [Path(base, name) for base, names in walk(root) for name in names if is_hidden(name)]
    # Neither notes of macOS nor parts of files.
    hidden = [path for path in hidden if not path.name.startswith("._") and not _PART.search(path.stem)]
    labelled = {path.stem for path in hidden if path.suffix.lower() in _SUFFIXES}
    pictures = [path for path in hidden if path.suffix.lower() in PICTURE_SUFFIXES and path.stem in labelled]
    if not pictures:
        return []
    first = min(path.relative_to(root).as_posix() for path in pictures)
    found = f"{len(pictures)} hidden picture(s) with labels, left out, such as {first}"
    expected = "names that do not begin with a dot"
    todo = "rename pictures and label files"
    return [Problem(root.name, "picture-hidden", found, expected, todo, "warning")]


def label_candidates(root: Path) -> Iterator[str]:
    """Yield the files below a folder that may be label files, by relative POSIX path, sorted within each folder."""
    return filter(_is_candidate, files_below(root))


def _is_candidate(
    name: str, splits: Collection[str] | None = None, suffixes: Collection[str] = frozenset(_SUFFIXES)
) -> bool:
    """Return whether a file may hold labels, unless its path states another split than those asked for."""
    return _suffix(name) in suffixes and (splits is None or stated_split(name) in (None, *splits))


def _suffix(name: str) -> str:
    """Return the suffix of a file, without the number of a part as in `train.record-00000-of-00010`."""
    name = name.rpartition("/")[2]
    return name[name.rfind(".") :].lower().partition("-")[0] if "." in name else ""


def files_below(root: Path) -> Iterator[str]:
    """Yield the files below a folder by relative POSIX path, sorted within each folder, without hidden ones."""
    for base, names in walk(root):
        prefix = "" if Path(base) == root else Path(base).relative_to(root).as_posix() + "/"
        yield from (prefix + n for n in sorted(names) if not is_hidden(n))


def _parts_below(folder: Path, root: Path) -> tuple[str, ...]:
    """Return the names of the folders from below `root` to `folder`; its own name for frames of videos, elsewhere."""
    return folder.relative_to(root).parts if folder.is_relative_to(root) else (folder.name,)


def _place(path: str) -> str:
    """Return a path without suffix and without folders that only separate pictures from labels."""
    return _KIND.sub("", path.rpartition(".")[0])


def _fault(path: Path, name: str) -> str:
    """Return why a file cannot be read; empty for XML and JSON that can be, and for other files with contents.

    An empty text file says nothing, or that a picture shows no object, unless its name speaks of tables.
    """
    if path.suffix.lower() == ".xml":
        problem = read_xml(path, name)[1]
        return "" if problem is None else problem.found
    if path.suffix.lower() == ".json":
        try:
            read_json(path)
        except DatasetError as error:
            return error.problems[0].found
    silent = path.suffix.lower() in (".txt", ".label") and not _TRUTH.search(fold_name(path.stem))
    silent = silent or _suffix(name) in _RARE_SUFFIXES
    return _EMPTY if not silent and path.is_file() and not path.stat().st_size else ""


def _is_annotation(path: Path, name: str) -> bool:
    """Return whether a readable file contains annotations of a usual layout, whatever its name."""
    if path.suffix.lower() == ".xml":
        return bool(read_xml(path, name)[0].tag == "annotation")
    if path.suffix.lower() == ".json":
        top = read_json(path)
        return isinstance(top, dict) and is_list(top.get("annotations", top.get("annotation")))
    return False


@dataclass(frozen=True)
class _Pictures:
    """Names by which files tell of the pictures of a dataset.

    Attributes:
        names: Names of the files, folded.
        stems: Those without suffix, unless they look like numbers; also without a word such as `_ir` at the end.
        numbers: Those that are numbers, perhaps but for a word before them, without zeros before them.
        folders: Names of the folders below the dataset's that they are in, folded.
        clips: Those of the folders whose names are of one clip, not of a kind or a split.
        words: Number of words of the longest name, see `_BREAK`.
        ends: The last pieces of the names, see `_PIECE`.
    """

    names: frozenset[str]
    stems: frozenset[str]
    numbers: frozenset[str]
    folders: frozenset[str]
    clips: tuple[str, ...]
    words: int
    ends: frozenset[str]

    @classmethod
    def of(cls, dataset: Dataset) -> _Pictures:
        paths = [i.path for i in dataset.images]
        names = frozenset(fold_name(p.name) for p in paths)
        stems = {p.stem for p in paths}
        stems |= {_LAST_WORD.sub("", s) for s in stems}
        places = {p.parent for p in paths}
        folders = {fold_name(n) for place in places for n in _parts_below(place, dataset.root)}
        clips = tuple(f for f in sorted(folders) if _TELLING.match(f))
        plain = (_FIRST_WORD.sub("", s) for s in stems)
        numbers = frozenset(s.lstrip("0") for s in plain if s.isdecimal())
        words = 1 + max((len(_BREAK.findall(n)) for n in names), default=0)
        ends = frozenset(_PIECE.split(n)[-1] for n in names)
        telling = frozenset(s for s in stems if _TELLING.match(s))
        return cls(names, telling, numbers, frozenset(folders), clips, words, ends)

    def are_of_clip(self, stem: str) -> bool:
        """Return whether a folded stem is the name of a folder of pictures, or begins with that of a clip."""
        return stem in self.folders or any(stem.startswith(c) and not stem[len(c)].isalnum() for c in self.clips)

    def may_be_in(self, text: str) -> bool:
        """Return whether a name of a picture may be in a text, as fast as a text of many megabytes needs it."""
        return not self.ends.isdisjoint(_PIECE.split(fold_name(text)))

    def named_in(self, line: str) -> str | None:
        """Return the first name of a picture in a line; a name may contain blanks and commas, or follow one."""
        for end in (m.end() for m in _PICTURE_END.finditer(line)):
            said = _SEPARATOR.split(line[max(0, end - _LONGEST_NAME) : end])[-1]
            starts = [0, *(m.end() for m in _BREAK.finditer(said))]
            for name in (said[k:] for k in starts[-self.words :]):
                for plain in (name, _UPLOADED.sub("", name, count=1)):
                    if fold_name(plain) in self.names:
                        return plain
        return None

    def are_keys_of_boxes(self, text: str) -> bool:
        """Return whether four numbers follow the name of a picture in JSON."""
        said = (m[1] for m in _BOX_OF.finditer(text))
        return any(n in self.stems or self.is_number(n) or self.named_in(n) for n in said)

    def is_number(self, text: str) -> bool:
        """Return whether a text is the number of a picture, whatever zeros are before it."""
        return text.isdecimal() and text.lstrip("0") in self.numbers


def _tells_of(path: Path, pictures: _Pictures, *, alone: bool) -> Severity | None:
    """Return how grave it is that a file is not read: an error if it shows labels, else a warning if it names pictures.

    Args:
        path: The file.
        pictures: The pictures of the dataset.
        alone: Whether the file has the stem of a picture without labels.
    """
    stem = fold_name(path.stem)
    suffix = _suffix(path.name)
    if stem in pictures.names:  # f.jpg.json
        return "error"
    with suppress(OSError), open_regular(path) as stream:
        head = _block(stream)
        if suffix in _RARE_SUFFIXES and b"\0" in head:
            return None  # no text
        text = as_utf8(head).decode("utf-8", "replace")
        if not pictures.may_be_in(text):
            text = f"{text}\n{_block_with_name(stream, head, pictures)}"
        lines = [line for line in map(str.strip, text.splitlines()) if line]
        if not lines:
            return "error" if stem in pictures.folders and suffix not in _RARE_SUFFIXES else None
        named = stem in pictures.folders
        others = not named and _WORD_OF_OTHERS.search(stem)
        clip = pictures.are_of_clip(stem) and not others
        truth = _TRUTH.search(stem)
        word = _WORD_OF_LABELS.search(stem)
        records = suffix in {".xml", ".xgtf", *_JSON_SUFFIXES, *_YAML_SUFFIXES}
        tuples = [line for line in lines if _TUPLE.search(line)] if not records and (clip or word) else []
        if (
            (named and (tuples or _NUMBERS.match(lines[0])))
            or (truth and any(map(_NUMBERS.match, lines)))
            or ((clip or truth) and (word or any(map(_WORD_OF_LABELS.search, tuples))) and tuples)
            or (not records and clip and word and any(map(_NUMBERS.search, lines)))
        ):
            return "error"
        if records:
            return _said_in_records(text, lines, pictures, suffix, alone=alone or clip)
        if suffix in {".csv", ".tsv", ".txt", *_RARE_SUFFIXES}:
            if says := _said_in_table(lines, pictures, suffix, alone=alone):
                return says
            keyed = not others and _are_keyed(lines, pictures)
            if keyed and _OF_LABELS.search(stem):
                return "error"
            values = (clip and _NUMBERS.match(lines[0])) or (named and any(map(_VALUES.search, lines)))
            return "warning" if keyed or tuples or values else None
        return "error" if any(map(pictures.named_in, lines)) else None
    return None


def _block(stream: BufferedReader) -> bytes:
    """Return the next part of a file, up to the end of a line unless that is far."""
    return stream.read(_HEAD_BYTES) + stream.readline(_LONGEST_LINE)


def _block_with_name(stream: BufferedReader, before: bytes, pictures: _Pictures) -> str:
    """Return the next part of a file of text in UTF-8 in which a picture is named, within `MAX_TEXT_BYTES`; or none."""
    while stream.tell() < MAX_TEXT_BYTES and (block := _block(stream)):
        text = (before[-_LONGEST_NAME:] + block).decode("utf-8", "replace")
        if pictures.may_be_in(text) and pictures.named_in(text):
            return text
        before = block
    return ""


def _said_in_records(
    text: str, lines: Sequence[str], pictures: _Pictures, suffix: str, *, alone: bool
) -> Severity | None:
    """Return what `_tells_of` does for JSON, YAML or XML, whose keys or tags speak of labels or do not."""
    is_json = suffix in _JSON_SUFFIXES
    keys = _TAG if suffix in (".xml", ".xgtf") else _KEY
    if suffix in _YAML_SUFFIXES:
        keys = _YAML_KEY
        if _RECIPE.search(text):
            return None
    if is_json and "\\u" in text:
        text = _ESCAPED.sub(lambda m: chr(int(m[1], 16)), text)
        lines = text.splitlines()
    labels = bool(keys.search(text)) or (is_json and pictures.are_keys_of_boxes(text))
    if labels and (alone or (is_json and _RESULTS.match(text))):
        return "error"
    said = {name for value, name, key in _TEXT.findall(text) if value or key} if is_json else set()
    if not pictures.stems.isdisjoint(said) or any(map(pictures.named_in, lines)):
        return "error" if labels else "warning"
    said.update(_PICTURE_NUMBER.findall(text))
    return "error" if is_json and labels and any(map(pictures.is_number, said)) else None


def _said_in_table(lines: Sequence[str], pictures: _Pictures, suffix: str, *, alone: bool) -> Severity | None:
    """Return what `_tells_of` does for lines of cells: titles, or numbers after a name or beside a class, show labels.

    A list of pictures has a path on each line, and nothing else.
    """
    if alone and any(_count_numbers(_CELL.split(line)) >= _BOX for line in lines):
        return "error"
    titles = _titles(lines[0])
    sides = sum(_SIDE.fullmatch(t) is not None for t in titles)
    labels = any(map(_TITLE.fullmatch, titles)) or sides >= _BOX - 1
    of_pictures = [bool(_PICTURE_TITLE.fullmatch(t)) for t in titles]
    fits = len(lines) > 1 and len(titles) == len(_titles(lines[-1])) and not any(_IS_NUMBER(t) for t in titles)
    other = not labels and (fits or _COORDINATES.search(lines[0])) and not pictures.named_in(lines[0])
    says: Severity | None = None
    listed = False
    for line in lines:
        cells = _CELL.split(line)
        name = pictures.named_in(line)
        if name is not None and suffix not in (".csv", ".tsv") and re.split(r"[\\/]", line)[-1] == name:
            listed = True
            continue
        stem = next((c for c in cells if c in pictures.stems), None)
        boxed = _count_numbers(cells) >= _BOX
        numbered = (
            labels
            and boxed
            and (sides >= _BOX or _TUPLE.search(line))
            and any(map(pictures.is_number, compress(_titles(line), of_pictures)))
        )
        if name is None and not numbered and (stem is None or not (labels or boxed)):
            continue
        if labels:
            return "error"
        after = line.rpartition(name or stem or " ")[2]
        if boxed and not other and (_count_numbers(_CELL.split(after)) >= _BOX or any(map(str.isalpha, cells))):
            return "error"
        says = "warning"
    return "error" if listed and any(map(_NUMBERS.match, lines)) else says


def _are_keyed(lines: Iterable[str], pictures: _Pictures) -> bool:
    """Return whether each line has the number of a picture and then four others; one alone may be anything."""
    keys = set()
    for line in lines:
        cells = list(filter(None, _CELL.split(line)))
        if _count_numbers(cells) <= _BOX or not pictures.is_number(cells[0].removesuffix(".0")):
            return False
        keys.add(cells[0])
    return len(keys) > 1


def _titles(line: str) -> list[str]:
    """Return the cells of a line, which commas, semicolons, tabs or bars separate, else blanks."""
    line = line.strip("# ")
    return [t.strip(" \"'") for t in re.split(r"[,;\t|]" if re.search(r"[,;\t|]", line) else r"\s+", line)]


def _count_numbers(cells: Iterable[str]) -> int:
    return sum(_IS_NUMBER(c) is not None for c in cells)
