"""Find label files that a reader did not understand, so that lost labels do not look like pictures without objects."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from infrablend.core.dataset import Dataset
from infrablend.core.file_names import fold_name
from infrablend.core.files import LFS_FOUND, LFS_TODO, open_regular
from infrablend.core.json_records import is_list
from infrablend.core.run_folder import RUN_FILE
from infrablend.core.workspace import CONVERT_FILE, FRAMES_FILE, SPLIT_FILE, TEMPERATURES_FILE, WORLD_FILE
from infrablend.errors import DatasetError, Problem, Severity
from infrablend.formats import folder
from infrablend.formats.annotation_files import as_utf8, read_json, read_xml
from infrablend.formats.base import stated_split
from infrablend.formats.pictures import PICTURE_SUFFIXES, is_hidden, is_picture_name, masks_of, walk

_JSON_SUFFIXES = {".json", ".jsonl", ".ndjson", ".geojson", ".manifest", ".odgt"}
_SUFFIXES = {".xml", ".txt", ".csv", ".tsv", ".label", ".tfrecord", ".record", ".pkl", *_JSON_SUFFIXES}
_PART = re.compile(r"\.part(-\d+)?$")
_EXPECTED = "a label file that can be read"
# What InfraBlend writes of the datasets that it made.
_RECORDS = {WORLD_FILE, CONVERT_FILE, SPLIT_FILE, FRAMES_FILE, TEMPERATURES_FILE, "SOURCE.json"}
# Texts for people, which may name pictures as examples.
_FOR_PEOPLE = re.compile(r"(readme|licen[cs]e|citation|notice|attribution|changelog)", re.IGNORECASE)
# Folders that separate pictures from labels.
_KIND = re.compile(r"(?<=/)(?:images?|imgs?|jpegimages|labels?|annotations?|xmls?)/", re.IGNORECASE)
# The end of a picture's name, and what separates names. Names are looked for backwards from their ends: forwards, a
# line of a megabyte without a separator would be searched from each of its characters.
_PICTURE_END = re.compile(r"\.(?:jpe?g|png|tiff?|bmp)\b", re.IGNORECASE)
_SEPARATOR = re.compile(r"[\\/\"'<>|,;:=\x00-\x1f\ufffd]")
_LONGEST_NAME = 255
# What Label Studio puts before the names of uploaded pictures.
_UPLOADED = re.compile(r"[0-9a-f]{8}-(?=.)")
# Names without a suffix in tables and in JSON; plain numbers and dates are none.
_TELLING = re.compile(r"(?=.*\d).*[^\d.+-]", re.DOTALL)
_CELL = re.compile(r"[,;\s|\"'\[\]()]+")
_TEXT = re.compile(r'(:\s*)?"([^"\\/]{1,255})"(?=(\s*:)?)')
# A line of a table of boxes: left, top, width and height at least, perhaps after the frame and the track.
_NUMBER = r"-?\d++(?:\.\d++)?"
_NUMBERS = re.compile(rf"(?:{_NUMBER}[,; \t]++){{3,}}{_NUMBER}")
_TRUTH = re.compile(r"(?:^|[\W_])(?:gt|det|ground_?truth)(?:[\W_]|$)")
_HEAD_BYTES = 1_000_000
# Files of one folder that are named one by one; more are one problem.
_MOST_NAMED = 3
_TODO = "convert it, for example with CVAT or Datumaro, to a format of docs/formats; or move it out of the folder"


def unread_label_files(
    dataset: Dataset, read: Collection[Path] = (), splits: Collection[str] | None = None
) -> list[Problem]:
    """Return the problems of label files below the dataset's folder that its reader did not take.

    These are damaged XML and JSON files, text files with a suffix such as `.TXT`, files that name pictures of the
    dataset or hold a table of boxes, files named after a picture with its suffix, files named like a picture, and
    masks. Lists of pictures and texts for people are none. A file of one picture, or its mask, is only worth a warning
    if the picture has labels from elsewhere.

    Args:
        dataset: The dataset.
        read: Files from which the reader took something (see `annotation_files.noting_files_read`).
        splits: Splits that were asked for; None for all.
    """
    files = list(_files_below(dataset.root))
    reported = {p.where.partition(":")[0] for p in dataset.problems if p.severity == "error"}
    left = [name for name in files if _is_candidate(name, splits) and dataset.root / name not in read]
    left = [name for name in left if name not in reported and PurePosixPath(name).name not in reported]
    masks = masks_of([name for name in files if is_picture_name(name)])
    if masks:  # but for pictures that have labels of their own, or are named by an annotation
        taken = {i.path for i in dataset.images}.union(read)
        masks = {name: stem for name, stem in masks.items() if dataset.root / name not in taken}
    if not left and not masks:
        return []
    names = _Pictures.of(dataset)
    plain = dataset.format == folder.NAME
    labelled = {fold_name(i.path.stem): bool(i.instances) for i in dataset.images}
    # Elsewhere in the folders, a file may be that of a picture of the same stem in another split.
    places = set() if plain else {_place(os.fspath(i.path)) for i in dataset.images}
    ours = (dataset.root / RUN_FILE).is_file()  # with the labels of all its formats
    problems, alike = [], defaultdict[tuple[str, str, str, Severity], list[str]](list)
    for name in left:
        path = dataset.root / name
        stem = fold_name(path.stem)
        if fault := _fault(path, name):
            todo = LFS_TODO if fault == LFS_FOUND else "restore or remove the file"
            problems.append(Problem(name, "label-unread", fault, _EXPECTED, todo))
        elif path.suffix != path.suffix.lower() == ".txt" and stem in labelled:
            found = f"labels with the suffix {path.suffix}, which are not read"
            problems.append(Problem(name, "label-unread", found, _EXPECTED, "rename it to .txt"))
        elif ours or name in _RECORDS or _FOR_PEOPLE.match(path.name):
            continue
        elif labelled.get(stem) and (plain or _place(os.fspath(path)) in places):
            found = "labels of a picture that has other labels, which are not read"
            alike[path.parent.as_posix(), path.suffix, found, "warning"].append(name)
        elif (plain and (stem in labelled or _is_annotation(path, name))) or _tells_of(path, names):
            found = "labels in no known layout, which are not read"
            alike[path.parent.as_posix(), path.suffix, found, "error"].append(name)
    for name, of in {} if ours else masks.items():
        if fold_name(of) in labelled:
            severity: Severity = "warning" if labelled[fold_name(of)] else "error"
            alike[name.rpartition("/")[0], "", "masks of pictures, which are not read", severity].append(name)
    for (_, _, found, severity), same in alike.items():
        if len(same) > _MOST_NAMED:
            found, same = f"{len(same)} files with {found}", same[:1]
        problems += [Problem(name, "label-unread", found, _EXPECTED, _TODO, severity) for name in same]
    return problems


def hidden_pictures(root: Path) -> list[Problem]:
    """Return a warning if there are hidden pictures with label files of their stems: no reader takes them."""
    pictures: list[str] = []
    labelled: set[str] = set()
    for base, names in walk(root):
        for path in (Path(base, n) for n in names if is_hidden(n)):
            if path.name.startswith("._") or _PART.search(path.stem):  # notes of macOS; parts of files
                continue
            if path.suffix.lower() in PICTURE_SUFFIXES:
                pictures.append(path.relative_to(root).as_posix())
            elif path.suffix.lower() in _SUFFIXES:
                labelled.add(path.stem)
    left_out = sorted(p for p in pictures if PurePosixPath(p).stem in labelled)
    if not left_out:
        return []
    found = f"{len(left_out)} hidden picture(s) with labels, left out, such as {left_out[0]}"
    expected, todo = "names that do not begin with a dot", "rename pictures and label files"
    return [Problem(root.name, "picture-hidden", found, expected, todo, "warning")]


def label_candidates(root: Path) -> Iterator[str]:
    """Yield the files below a folder that may be label files, by relative POSIX path, sorted within each folder."""
    return filter(_is_candidate, _files_below(root))


def _is_candidate(name: str, splits: Collection[str] | None = None) -> bool:
    """Return whether a file may hold labels, unless its path states another split than those asked for."""
    return _suffix(name) in _SUFFIXES and (splits is None or stated_split(name) in (None, *splits))


def _suffix(name: str) -> str:
    """Return the suffix of a file, without the number of a part as in `train.record-00000-of-00010`."""
    return name[name.rfind(".") :].lower().partition("-")[0]


def _files_below(root: Path) -> Iterator[str]:
    for base, names in walk(root):
        prefix = "" if Path(base) == root else Path(base).relative_to(root).as_posix() + "/"
        yield from (prefix + n for n in sorted(names) if not is_hidden(n))


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
    return "an empty file" if not silent and path.is_file() and not path.stat().st_size else ""


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
        stems: Those without suffix, unless they look like numbers.
        folders: Names of the folders that they are in, folded.
    """

    names: frozenset[str]
    stems: frozenset[str]
    folders: frozenset[str]

    @classmethod
    def of(cls, dataset: Dataset) -> _Pictures:
        paths = [i.path for i in dataset.images]
        names, stems = frozenset(fold_name(p.name) for p in paths), frozenset(p.stem for p in paths)
        folders = frozenset(fold_name(p.parent.name) for p in paths)
        return cls(names, frozenset(s for s in stems if _TELLING.match(s)), folders)

    def are_named_in(self, text: str, suffix: str) -> bool:
        """Return whether a text names a picture without its suffix: in JSON, or beside the numbers of a box."""
        if suffix in _JSON_SUFFIXES:
            return any(said in self.stems for value, said, key in _TEXT.findall(text) if value or key)
        if suffix not in (".csv", ".tsv", ".txt") or self.stems.isdisjoint(_CELL.split(text)):
            return False
        rows = (cells for line in text.splitlines() if not self.stems.isdisjoint(cells := _CELL.split(line)))
        return any(sum(re.fullmatch(_NUMBER, c) is not None for c in cells) >= 4 for cells in rows)


def _tells_of(path: Path, pictures: _Pictures) -> bool:
    """Return whether a file says something of the pictures, or is a table of boxes."""
    stem = fold_name(path.stem)
    if stem in pictures.names:  # f.jpg.json
        return True
    with suppress(OSError), open_regular(path) as stream:
        text = as_utf8(stream.read(_HEAD_BYTES)).decode("utf-8", "replace")
        lines = [line for line in map(str.strip, text.splitlines()) if line]
        if not lines:
            return stem in pictures.folders
        numbers = map(_NUMBERS.match, lines)
        if (stem in pictures.folders and _NUMBERS.match(lines[0])) or (_TRUTH.search(stem) and any(numbers)):
            return True
        if pictures.are_named_in(text, _suffix(path.name)):
            return True
        listed = False
        for line in lines:
            named = next((n for n in _picture_names(line) if fold_name(n) in pictures.names), None)
            # A list of pictures has a path on each line, and nothing else.
            alone = path.suffix.lower() == ".txt" and re.split(r"[\\/]", line)[-1] == named
            if named is not None and not alone:
                return True
            listed |= alone
        return listed and any(numbers)
    return False


def _picture_names(line: str) -> Iterator[str]:
    """Yield what may be names of pictures in a line; a name may contain blanks, or follow one."""
    for end in (m.end() for m in _PICTURE_END.finditer(line)):
        words = _SEPARATOR.split(line[max(0, end - _LONGEST_NAME) : end])[-1].split(" ")
        for name in (" ".join(words[k:]) for k in range(len(words))):
            yield name
            if uploaded := _UPLOADED.match(name):
                yield name[uploaded.end() :]
