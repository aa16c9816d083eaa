"""Find picture files: listings, names that must stay inside the dataset, ids."""

from __future__ import annotations

import io
import os
import re
import warnings
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

from PIL import Image

from infrablend.core.dataset import ImageRecord, Split
from infrablend.core.file_names import is_inside, leaves
from infrablend.core.files import or_lfs_pointer
from infrablend.core.run_folder import kept_aside
from infrablend.errors import Problem
from infrablend.formats.annotation_files import note_read
from infrablend.formats.base import SPLIT_FOLDERS

JPEG_SUFFIXES: tuple[str, ...] = (".jpg", ".jpeg", ".jpe", ".jfif")
PICTURE_SUFFIXES = (*JPEG_SUFFIXES, ".png", ".bmp", ".tif", ".tiff", ".webp")
UNREAD_SUFFIXES = frozenset({
    ".apng", ".avif", ".bw", ".cr2", ".cr3", ".dib", ".dng", ".exr", ".fff", ".fit", ".fits", ".gif", ".hdr", ".heic",
    ".heif", ".hif", ".icb", ".im", ".j2c", ".j2k", ".jp2", ".jpc", ".jpf", ".jps", ".jpx", ".jxl", ".jxr", ".mpo",
    ".nef", ".pam", ".pbm", ".pcx", ".pfm", ".pgm", ".pic", ".pnm", ".ppm", ".psd", ".pxm", ".qoi", ".ras", ".rgb",
    ".sgi", ".sr", ".tga", ".vda", ".vst",
})  # fmt: skip
"""Suffixes of pictures that are not read: what Pillow and OpenCV open, and what cameras write."""
SEQUENCE_DEPTH = 3
"""Folders of sequences are at most so far below that of the dataset."""
# Larger pictures are taken for decompression bombs: 16 times a 4K frame.
MAX_PIXELS = 128 * 1024 * 1024
PICTURE_FORMATS = ("JPEG", "PNG", "BMP", "TIFF", "WEBP")
READABLE = "a JPEG, PNG, BMP, TIFF or WebP file"
# Folders of pictures whose pixels say which object is where in the picture of the same stem.
_MASK_FOLDER = re.compile(
    r"(?:^|/)(?:segmentation(?:class|object)\w*|(?:\w+[_-])?masks?|ann_dir|annotations?|labels?)(?:/|$)", re.IGNORECASE
)
_MASK_END = re.compile(r"[_-]masks?$")
# Folders that only separate pictures from annotations; without them, the paths of a picture and its XML are equal.
_KINDS = {
    "annotations", "annotation", "ann", "jpegimages", "images", "image", "imgs", "img", "xml", "xmls", "json", "jsons",
    "labels",
}  # fmt: skip
# What holds the labels of the one picture that has the stem of the file.
_OWN_LABELS = (".txt", ".xml", ".json")


def is_hidden(name: str) -> bool:
    """Return whether a name is hidden: `.DS_Store`, `._x.jpg`, partly written files."""
    return name.startswith(".")


def is_picture_name(name: str) -> bool:
    """Return whether a name is visible and has a picture's suffix."""
    return not is_hidden(name) and name.lower().endswith(PICTURE_SUFFIXES)


def walk(folder: Path, skip: Sequence[str] = ()) -> Iterator[tuple[str, list[str]]]:
    """Yield each folder of a dataset with the names of its files, in the order of the names of the folders.

    Hidden folders, linked folders and those in which InfraBlend keeps what is no part of a dataset are not entered.
    """
    aside = kept_aside(folder)
    for base, folders, names in os.walk(folder):
        folders[:] = sorted(d for d in folders if not is_hidden(d) and d not in skip and d not in aside)
        aside = frozenset()  # they are at the top
        yield base, names


def folders_of_sequences(root: Path, is_sequence: Callable[[Path], object]) -> list[Path]:
    """Return the folders of sequences, at most three below the dataset's own, sorted; not those inside of another."""
    found: list[Path] = []
    level = [root]
    for _ in range(SEQUENCE_DEPTH + 1):
        here = [folder for folder in level if is_sequence(folder)]
        found += here
        level = [inside for folder in level if folder not in here for inside in _subfolders(folder)]
    return sorted(found)


def _subfolders(folder: Path) -> list[Path]:
    # Unlike `Path.iterdir`, this asks the disk about no file of a large folder of pictures.
    entries = sorted(os.scandir(folder), key=lambda e: e.name)
    return [Path(e.path) for e in entries if e.is_dir(follow_symlinks=False) and not is_hidden(e.name)]


def list_pictures(
    folder: Path, skip: Sequence[str] = (), is_labelled: Callable[[Path], object] | None = None
) -> dict[str, Path]:
    """Return the pictures below `folder` by relative POSIX path, sorted; empty if the folder does not exist.

    The folder itself may be a link; linked folders further down are not entered. Masks of other pictures, see
    `masks_of`, are left out.

    Args:
        folder: The folder.
        skip: Names of folders left out.
        is_labelled: Whether a picture has a label file of its own, so that it is no mask; None looks below `folder`.
    """
    found = _pictures_below(folder, skip)
    masks = _unlabelled_masks(folder, found, is_labelled)
    return {name: path for name, path in found.items() if name not in masks} if masks else found


def _unlabelled_masks(
    folder: Path, found: Mapping[str, Path], is_labelled: Callable[[Path], object] | None = None
) -> set[str]:
    """Return the masks among the pictures below a folder, without those that have label files of their own stems.

    In a folder of masks, a picture has the stem of another one, whose label file that would be.
    """
    masks = masks_of(found)
    named = {n for n, of in masks.items() if PurePosixPath(n).stem != of}
    if named and is_labelled is None:
        files = (PurePosixPath(n) for _, names in walk(folder) for n in names)
        stems = {f.stem for f in files if f.suffix.lower() in _OWN_LABELS}
        return masks.keys() - {n for n in named if PurePosixPath(n).stem in stems}
    return masks.keys() - {n for n in named if is_labelled is not None and is_labelled(found[n])}


def masks_of(names: Collection[str]) -> dict[str, str]:
    """Return which of some pictures, by relative path, are masks of others, with the stems of these.

    The folder or the name tells, as in `SegmentationClass/a.png`, `masks/a.png` and `a_mask.png`. In a folder none of
    whose pictures has the stem of a picture elsewhere, there are no masks.
    """
    inside = {folder for folder in {n.rpartition("/")[0] for n in names} if _MASK_FOLDER.search(folder)}
    stems = {
        n: _MASK_END.sub("", PurePosixPath(n).stem)
        for n in names
        if n.rpartition("/")[0] in inside or ("mask" in n and _MASK_END.search(PurePosixPath(n).stem))
    }
    others = {PurePosixPath(n).stem for n in names if n not in stems} if stems else set()
    folders = {n.rpartition("/")[0] for n, stem in stems.items() if stem in others}
    return {n: stem for n, stem in stems.items() if n.rpartition("/")[0] in folders}


def _pictures_below(folder: Path, skip: Sequence[str] = ()) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for base, names in walk(folder, skip):
        here = Path(base)
        prefix = "" if here == folder else here.relative_to(folder).as_posix() + "/"
        found.update({prefix + n: here / n for n in names if is_picture_name(n)})
    return dict(sorted(found.items()))


PictureKey = tuple[str, ...]


def picture_key(name: str) -> PictureKey:
    """Return the part of a path that a picture shares with its annotation: no folder of kinds, and no suffix."""
    path = PurePosixPath(name)
    return (*(p for p in path.parts[:-1] if p.lower() not in _KINDS), path.stem)


def plain_name(name: str) -> str:
    """Return the picture's path without folders that only name a kind or a split."""
    parts = PurePosixPath(name).parts
    return "/".join([*(p for p in parts[:-1] if p.lower() not in _KINDS | SPLIT_FOLDERS.keys()), parts[-1]])


def folder_split(name: str) -> Split:
    """Return the split that a folder of the path names; train if no folder does."""
    parts = PurePosixPath(name).parts[:-1]
    return next((SPLIT_FOLDERS[p.lower()] for p in parts if p.lower() in SPLIT_FOLDERS), "train")


def check_name(name: object, where: str) -> Problem | None:
    """Return the problem of a picture's name in an annotation: it must be a relative path inside the folder."""
    expected = "a relative file name inside the picture folder"
    if not isinstance(name, str) or not name.strip() or "\0" in name:
        return Problem(where, "name-missing", f"picture name {name!r}", expected, "correct the annotation")
    if leaves(name):
        found = f"picture name {name!r} leads out of the dataset"
        return Problem(where, "name-climbs", found, expected, "correct the annotation")
    return None


def name_in(folder: Path, name: str, start: Path | None) -> str:
    r"""Return a picture's name in an annotation as a path in `folder`, with `/` for the `\` of Windows.

    A name that climbs (`../images/a.jpg`) begins in `start`, the folder of the annotation file. Unless it then leads
    into `folder`, it stays as it is, and `check_name` refuses it.
    """
    plain = name.replace("\\", "/")
    if not plain.startswith("../") or start is None or "\0" in name:
        return plain if not leaves(name) else name
    inside = os.path.relpath(os.path.normpath(start / plain), folder)
    return name if leaves(inside) else inside


def check_link(path: Path, folder: Path, where: str) -> Problem | None:
    """Return a problem if `path`, named by an annotation, is a link out of the picture folder."""
    if is_inside(path, folder):
        return None
    return Problem(
        where,
        "name-climbs",
        f"picture {path.name!r} is a link out of the picture folder",
        "a file inside it",
        "copy the picture, or link the whole picture folder instead",
    )


@dataclass(frozen=True)
class PictureFolder:
    """One folder of pictures to which annotations refer, by name and by stem.

    Attributes:
        folder: The folder.
        by_name: Pictures by their path in the folder.
        by_stem: These paths by path without suffix.
        start: Folder of the annotation file, in which names with `..` begin.
        masks: What looks like masks, see `masks_of`, by path in the folder; pictures where an annotation names them.
    """

    folder: Path
    by_name: dict[str, Path]
    by_stem: dict[str, str]
    start: Path | None = None
    masks: Mapping[str, Path] = field(default_factory=dict)

    @classmethod
    def scan(cls, folder: Path) -> PictureFolder:
        """List `folder`; a missing folder is empty."""
        found = _pictures_below(folder)
        masks = {name: found.pop(name) for name in sorted(_unlabelled_masks(folder, found))}
        by_stem: dict[str, str] = {}
        for name in (*found, *masks):
            by_stem.setdefault(name.rpartition(".")[0], name)
        return cls(folder, found, by_stem, masks=masks)

    @classmethod
    def with_most(cls, places: Iterable[Path], names: Sequence[str], start: Path | None = None) -> PictureFolder:
        """List the place that has most of the first names, none of which may lead out of it; see `name_in`."""

        def has(place: Path, name: str) -> bool:
            # `isfile` is false for a name that is too long, where `Path.is_file` raises.
            return any(os.path.isfile(place / n) for n in (name, name_in(place, name, start)) if not leaves(n))  # noqa: PTH113

        return replace(cls.scan(max(places, key=lambda place: sum(has(place, n) for n in names[:50]))), start=start)

    def find(self, name: str, where: str) -> tuple[str, Path | None, Problem | None]:
        """Return the name with its extension, the file (None if missing), and a problem if it is a link leading out.

        A name without a picture's suffix, as in HIT-UAV's rotate_xml, is looked up by stem.
        """
        if name not in self.by_name and not is_picture_name(name):
            name = self.by_stem.get(name, name)
        path = self.by_name.get(name) or self.masks.get(name)
        if path is None:
            return name, None, None
        linked = path.is_symlink() or "/" in name
        return name, path, check_link(path, self.folder, where) if linked else None

    def find_named(
        self, name: object, where: str, expected: str, todo: str = "restore it"
    ) -> tuple[str, Path | None, Problem | None]:
        """Return what `find` does for a name from an annotation file; a missing picture is a problem.

        Args:
            name: Name in the file, which may be anything.
            where: Place in the file.
            expected: Where the picture should be.
            todo: What to do if it is missing.
        """
        if isinstance(name, str) and name not in self.by_name:
            name = name_in(self.folder, name, self.start)
        fault = check_name(name, where)
        if fault is not None:
            return str(name), None, fault
        found, path, fault = self.find(str(name), where)
        if fault is None and path is None:
            fault = Problem(where, "image-missing", f"no picture {found!r}", expected, todo)
        return found, path, fault


def assign_ids(names: Iterable[str]) -> dict[str, str]:
    """Return a unique id per relative path: the stem if that is unique, else the path with `__` for `/`.

    Pictures that differ in the suffix only get it appended, and numbers settle what is left; the result depends
    on the set of names alone.
    """
    ordered = sorted(names)
    stems = {n: PurePosixPath(n).stem for n in ordered}
    paths = {n: str(PurePosixPath(n).with_suffix("")).replace("/", "__") for n in ordered}
    suffixed = {n: f"{paths[n]}_{PurePosixPath(n).suffix[1:].lower()}" for n in ordered}
    ids: dict[str, str] = {}
    taken: set[str] = set()
    left = ordered
    for choice in (stems, paths, suffixed):
        counts = Counter(choice[n] for n in left)
        for n in left:
            if counts[choice[n]] == 1 and choice[n] not in taken:
                ids[n] = choice[n]
        taken |= set(ids.values())
        left = [n for n in left if n not in ids]
    for n in left:
        k = 2
        while f"{suffixed[n]}_{k}" in taken:
            k += 1
        ids[n] = f"{suffixed[n]}_{k}"
        taken.add(ids[n])
    return {n: ids[n] for n in ordered}


def open_picture(path: Path, formats: Sequence[str] = PICTURE_FORMATS) -> Image.Image:
    """Open a picture without decoding its pixels, and without a warning of its size: `MAX_PIXELS` is the limit here.

    Raises:
        OSError: There is no such file, or it is a folder, device or pipe, which would wait for ever.
        Exception: PIL's decoders raise what they like on broken headers.
    """
    if not path.is_file():
        raise FileNotFoundError("no such file")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # our limit is below PIL's error and above its warning
        return Image.open(path, formats=tuple(formats))


def is_decodable(data: bytes) -> bool:
    """Return whether the header of a picture can be read, and its size is at most `MAX_PIXELS`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=PICTURE_FORMATS) as picture:
                return bool(picture.width * picture.height <= MAX_PIXELS)
    except Exception:  # PIL's decoders raise what they like on broken headers
        return False


def read_size(path: Path, where: str) -> tuple[tuple[int, int] | None, Problem | None]:
    """Return (width, height) from the file's header, without decoding; or None and the problem."""
    if path.is_symlink() and (problem := check_link(path, path.parent, where)) is not None:
        return None, problem
    try:
        with open_picture(path) as picture:
            size_wh = (int(picture.width), int(picture.height))
        if size_wh[0] * size_wh[1] <= MAX_PIXELS:
            note_read(path)
            return size_wh, None
        found = f"{size_wh[0]}x{size_wh[1]} px"
    except Image.DecompressionBombError as error:
        found = str(error)
    except Exception as error:  # PIL's decoders raise what they like on broken headers
        found = f"no readable picture ({error or type(error).__name__})".replace(str(path), path.name)
        expected = READABLE
        todo = "replace or remove the file"
        return None, or_lfs_pointer(Problem(where, "image-unreadable", found, expected, todo), path)
    return None, Problem(where, "image-too-large", found, f"at most {MAX_PIXELS} px", "scale it down")


def with_sizes(
    images: Iterable[ImageRecord], where: Callable[[ImageRecord], str], problems: list[Problem]
) -> list[ImageRecord]:
    """Return the images with sizes, read from the pictures' headers where the labels give none.

    Images whose picture cannot be read are left out, each with a problem.

    Args:
        images: Images of a dataset.
        where: Name of an image in problems.
        problems: List to which problems are added.
    """
    sized = []
    for image in images:
        size_wh, problem = (image.size_wh, None) if image.size_wh else read_size(image.path, where(image))
        problems += [problem] if problem else []
        if size_wh is not None:
            sized.append(image if image.size_wh else replace(image, size_wh=size_wh))
    return sized


def by_folder(root: Path) -> dict[str, dict[str, Path]]:
    """Return the pictures found by `list_pictures`: relative folder (`.` for `root`) -> name -> path.

    Without those in `images` or `JPEGImages`: they have their labels elsewhere, in another format's layout.
    """
    folders: dict[str, dict[str, Path]] = {}
    for name, path in list_pictures(root).items():
        parent = PurePosixPath(name).parent
        if not {"images", "jpegimages"} & {p.lower() for p in parent.parts}:
            folders.setdefault(str(parent), {})[path.name] = path
    return dict(sorted(folders.items()))


def sidecar_labels(folders: dict[str, dict[str, Path]], suffix: str) -> bool:
    """Return whether a picture has a file of its stem beside it, or all folders are in the root."""
    shallow = all("/" not in folder for folder in folders)
    return shallow or any(p.with_suffix(suffix).is_file() for found in folders.values() for p in found.values())
