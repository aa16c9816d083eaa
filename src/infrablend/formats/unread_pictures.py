"""Find pictures and videos in a dataset's folder that no reader took, so that a lost part of it does not go unseen."""

from __future__ import annotations

import os
import re
import shlex
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path, PurePosixPath

from infrablend.core.addresses import shown
from infrablend.core.dataset import Dataset
from infrablend.core.file_names import fold_name
from infrablend.errors import Problem, Severity
from infrablend.formats.base import SPLIT_FOLDERS, stated_split
from infrablend.formats.labels import folder
from infrablend.formats.pictures import video
from infrablend.formats.pictures.listing import READABLE, UNREAD_SUFFIXES, is_picture_name
from infrablend.formats.records import LEFT_OUT

# Words that tell one form of a picture from another, as in `rgb/f1.jpg`, `DJI_0001_W.JPG` and `f1_depth.png`.
_FORMS = frozenset({
    "rgb", "vis", "visible", "visual", "color", "colour", "eo", "ir", "lwir", "nir", "thermal", "infrared", "mask",
    "masks", "depth", "overlay", "overlays", "preview", "previews", "thumb", "thumbs", "thumbnail", "thumbnails", "viz",
})  # fmt: skip
# Words of folders, and of a few pictures, that are for people or programs, but no part of a dataset.
_NO_DATA = frozenset({
    "sky", "doc", "docs", "figure", "figures", "icon", "icons", "logo", "logos", "asset", "assets", "sheet", "sheets",
    "plot", "plots", "chart", "charts", "screenshot", "screenshots", "calib", "calibration", "related", "runs",
    "results", "inspect", "readme",
})  # fmt: skip
_OWN_LABELS = (".txt", ".xml", ".json")
# Words of folders that sort pictures, but not by what they show.
_CONDITIONS = _FORMS | {"day", "night", "images"}
# DJI ends the names of pictures taken at once by the camera: thermal, visible, wide, zoom; others add `_R`.
_LENS = re.compile(r"(?<=[_-])[trsvwz]$")
_WORD = re.compile(r"[^\W\d_]+")
# So many pictures beside folders of pictures are the picture of a readme, or plots of a training.
_FEW = 9
_MOST_NAMED = 3  # folders that are named one by one
_FEW_VIDEOS = 3  # named one by one
_LEAST_CLASSES = 2
# Options of readers that take some of the pictures of a folder, and those that choose among folders.
_SAMPLING = {"every", "frames"}
_CHOOSING = {"form", "modality", "camera"}
_UNLISTED = "in no record of the dataset, which are not read"
_CONVERT_THEM = "if they belong to the dataset, convert them to PNG without changing their pixels; else move them out"
_LIST_THEM = (
    "if they belong to the dataset, add them to its labels or lists (`test:` in YOLO's data.yaml); if they are another "
    "one, give their folder; else move them out"
)


def unread_pictures(
    dataset: Dataset, files: Sequence[str], splits: Collection[str] | None, options: Collection[str]
) -> list[Problem]:
    """Return a warning per folder with pictures that are in no record of the dataset, and one about other kinds.

    None are: other forms of pictures that were read, those of splits that were not asked for or that options leave out,
    what problems already name, and what is no part of a dataset by the name of its folder.

    Args:
        dataset: The dataset.
        files: Files below its folder that its reader did not take and that are no masks, by relative POSIX path.
        splits: Splits that were asked for; None for all.
        options: Names of the reader's options that were given.
    """
    dropped = any(p.code == "label-missing" and p.found.endswith(LEFT_OUT) for p in dataset.problems)
    if dropped or _SAMPLING & set(options):
        return []
    below = path_below(dataset.root)
    known = [os.fspath(i.path).removeprefix(below) for i in dataset.images]
    read = set(known)
    left = defaultdict[str, list[str]](list)
    for name in files:
        if (is_picture_name(name) and name not in read) or PurePosixPath(name).suffix.lower() in UNREAD_SUFFIXES:
            left[name.rpartition("/")[0]].append(name)
    if not left:
        return []
    forms = _Forms(dataset, known)
    named = {fold_name(PurePosixPath(p.where.partition(":")[0]).stem) for p in dataset.problems}
    # With label files of their own in a folder from which nothing was read, equal names are those of another dataset.
    labelled = {(n.partition("/")[0], _stem(n)) for n in files if n.lower().endswith(_OWN_LABELS)}
    labelled = {(top, stem) for top, stem in labelled if top not in forms.tops}
    unlisted = {}
    others: list[str] = []
    for place, names in left.items():
        taken = place in forms.places
        top = place.partition("/")[0]
        own = [n for n in names if not forms.has(n) or (top, _stem(n)) in labelled]
        if splits is not None and stated_split(place) not in splits:
            continue
        # A tenth of the pictures of visible light may lack their thermal ones.
        if not taken and (10 * len(own) <= len(names) or _CHOOSING & set(options) or forms.is_aside(place)):
            continue
        if not place and not taken and len(names) <= _FEW and dataset.format != folder.NAME:
            continue
        if len(own) <= _FEW:
            own = [n for n in own if _NO_DATA.isdisjoint(_words(_stem(n)))]
        others += [n for n in own if not is_picture_name(n)]
        # Left out with a problem of their own, or of their label files.
        if own := [n for n in own if is_picture_name(n) and fold_name(_stem(n)) not in named]:
            unlisted[place] = own
    problems = [(place, f"{len(own)} picture(s) {_UNLISTED}, such as {own[0]}") for place, own in unlisted.items()]
    if len(problems) > _MOST_NAMED:
        count = sum(map(len, unlisted.values()))
        first = next(iter(unlisted.values()))[0]
        problems = [("", f"{count} picture(s) in {len(unlisted)} folders {_UNLISTED}, such as {first}")]
    expected = "labels or lists of all pictures"
    return [
        Problem(w or dataset.root.name or ".", "image-unlisted", f, expected, _LIST_THEM, "warning")
        for w, f in problems
    ] + _of_other_kinds(dataset, others)


def _of_other_kinds(dataset: Dataset, names: Sequence[str]) -> list[Problem]:
    """Return a warning of pictures that no reader takes because of their kinds, with the number of each."""
    if not names:
        return []
    kinds = Counter(PurePosixPath(n).suffix.lower() for n in names)
    counts = ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items()))
    found = f"{len(names)} picture(s) of kinds that are not read ({counts}), such as {names[0]}"
    where = dataset.root.name or "."
    return [Problem(where, "image-kind", found, READABLE, _CONVERT_THEM, "warning")]


def path_below(root: Path) -> str:
    """Return what comes before relative names in the paths of the files below a folder."""
    return "" if root == Path() else f"{root}{os.sep}"


class _Forms:
    """The pictures of a dataset, as far as others are forms of them.

    A picture of the same name in a folder of another split is another picture: many datasets count from 1 in each.

    Attributes:
        places: Folders of the pictures, by relative path.
        tops: The folders right below the dataset's that these are in.
    """

    def __init__(self, dataset: Dataset, names: Sequence[str]) -> None:
        stated = {place: stated_split(place) for place in {n.rpartition("/")[0] for n in names}}
        self.places = stated.keys()
        self.tops = {place.partition("/")[0] for place in stated}
        self._splits = defaultdict[str, set[str | None]](set)
        for name, image in zip(names, dataset.images, strict=True):
            self._splits[_stem(name)] |= {image.split, stated[name.rpartition("/")[0]]}
        self._aside = (_FORMS | _NO_DATA).difference(*map(_words, self.places))

    def has(self, name: str) -> bool:
        """Return whether a picture has the name of one that was read, but for words such as `rgb`."""
        stem = _stem(name)
        splits = self._splits.get(stem) or self._by_form.get(_form(stem))
        lens = _LENS.search(stem.casefold())
        if splits is None and lens and self._lenses:
            return lens[0] not in self._lenses  # of another camera, perhaps a second later
        return splits is not None and stated_split(name.rpartition("/")[0]) in {None, *splits}

    @cached_property
    def _by_form(self) -> Mapping[str, set[str | None]]:
        found = defaultdict[str, set[str | None]](set)
        for stem, splits in self._splits.items():
            found[_form(stem)] |= splits
        return found

    @cached_property
    def _lenses(self) -> set[str]:
        return {m[0] for stem in self._splits if (m := _LENS.search(stem.casefold()))}

    def is_aside(self, place: str) -> bool:
        """Return whether a word of a folder says that it is not for reading, and is in no folder that was read."""
        return not self._aside.isdisjoint(_words(place))


def _stem(name: str) -> str:
    return name[name.rfind("/") + 1 :].rpartition(".")[0]


def _words(text: str) -> set[str]:
    return set(_WORD.findall(text.casefold()))


def _form(stem: str) -> str:
    """Return what the names of forms of one picture have in common."""
    name = fold_name(stem)
    for word in _FORMS & _words(name):
        name = re.sub(rf"(?<![^\W\d_]){word}(?![^\W\d_])", "", name)
    return _LENS.sub("", name).strip("_-. ")


def unread_videos(dataset: Dataset, files: Iterable[str]) -> list[Problem]:
    """Return a warning if there are videos beside the pictures of a dataset, none of which are frames of theirs."""
    found = [PurePosixPath(n) for n in files if n.lower().endswith(video.SUFFIXES)]
    # Readers of videos make pictures elsewhere; extracted frames, or their folders, have the name of the video.
    if not found or any(not i.path.is_relative_to(dataset.root) for i in dataset.images):
        return []
    named = {fold_name(n) for i in dataset.images for n in (i.path.stem, *i.path.relative_to(dataset.root).parts[:-1])}
    left = [dataset.root / p for p in found if not any(n.startswith(fold_name(p.stem)) for n in named)]
    text = f"{len(left)} video(s) beside the pictures, not read"
    return [video_problem(dataset.root, left, text, "warning")] if left else []


def video_problem(root: Path, videos: Sequence[Path], found: str, severity: Severity = "error") -> Problem:
    """Return what to do with videos that are not read: the command that extracts their frames, or give one alone."""
    named = [shlex.quote(str(p)) for p in videos]
    if len(named) > _FEW_VIDEOS:
        named = sorted({f"{shlex.quote(str(p.parent))}/*{p.suffix}" for p in videos})
    frames = shlex.quote(f"{root.resolve().stem}_frames")
    todo = f"extract frames with infrablend frames {' '.join(named)} --out {frames}, then use {frames}; "
    todo += "or give a video, or a folder of videos alone, as the data"
    expected = "the folder of a dataset of pictures"
    return Problem(shown(root), "video-not-pictures", found, expected, todo, severity)


def folders_like_classes(dataset: Dataset) -> list[Problem]:
    """Return a warning if pictures without labels are sorted into folders below their split, as for classification.

    The folders have names without digits, as classes do, but clips and flights seldom.
    """
    below = defaultdict[str, set[str]](set)
    for image in dataset.images:
        split, kind, _ = ("", "", *Path(os.fspath(image.path).removeprefix(path_below(dataset.root))).parts)[-3:]
        if (
            split.lower() not in SPLIT_FOLDERS
            or image.instances
            or _CONDITIONS & _words(kind)
            or re.search(r"\d", kind)
        ):
            return []
        below[split].add(kind)
    split, kinds = max(below.items(), key=lambda item: len(item[1]), default=("", set()))
    if len(kinds) < _LEAST_CLASSES:
        return []
    found = f"pictures in folders that may be classes, in {split}: {', '.join(sorted(kinds)[:5])}; not read as labels"
    todo = "if they are classes, draw boxes, for example with CVAT; the class of a picture is no box"
    expected = "a box for each object"
    return [Problem(dataset.root.name, "label-unread", found, expected, todo, "warning")]
