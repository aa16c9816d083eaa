"""Check a dataset: the problems found by its reader, and those that only pictures and comparisons reveal."""

from __future__ import annotations

import hashlib
import stat
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.core.dataset import Dataset, ImageRecord, Instance
from infrablend.errors import DatasetError, Problem
from infrablend.formats.box_checks import check_box
from infrablend.formats.pictures.images import Background, load_background, size_problem
from infrablend.formats.pictures.listing import read_size

# HIT-UAV truncates its boxes, which moves them by less than a pixel from the oriented ones.
AGREE_PX = 1.0
# A picture whose grey levels vary by less (standard deviation, of 255) is taken as empty.
CONSTANT_LEVELS = 1.0


@dataclass(frozen=True)
class CheckReport:
    """The problems of a dataset, sorted: errors first, then by code and place.

    Attributes:
        root: Folder of the dataset.
        format: Name of the format; None if the dataset could not be read at all.
        images: Number of images read.
        objects: Number of labels read.
        decoded: Whether the pictures were decoded.
        problems: All errors and warnings.
        suffixes: Number of images by the suffix of the picture.
    """

    root: Path
    format: str | None
    images: int
    objects: int
    decoded: bool
    problems: tuple[Problem, ...]
    suffixes: Mapping[str, int] = field(default_factory=dict)

    @property
    def errors(self) -> tuple[Problem, ...]:
        """Errors: an item was skipped or is wrong."""
        return tuple(p for p in self.problems if p.severity == "error")

    @property
    def warnings(self) -> tuple[Problem, ...]:
        """Warnings: an item was kept."""
        return tuple(p for p in self.problems if p.severity != "error")

    def ok(self, strict: bool = False) -> bool:
        """Return whether there are no errors and, if `strict`, no warnings."""
        return not (self.problems if strict else self.errors)

    def by_code(self) -> dict[str, int]:
        """Return the number of problems per code, errors first."""
        return dict(Counter(p.code for p in self.problems))

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "root": str(self.root),
            "format": self.format,
            "images": self.images,
            "suffixes": dict(self.suffixes),
            "objects": self.objects,
            "decoded": self.decoded,
            "errors": len(self.errors),
            "warnings": len(self.warnings),
            "by_code": self.by_code(),
            "problems": [p.to_json() for p in self.problems],
        }


def check_dataset(
    dataset: Dataset, *, decode: bool = True, on_image: Callable[[int, int], None] | None = None
) -> CheckReport:
    """Check every label and every picture; one picture is in memory at a time.

    Args:
        dataset: Dataset to check; the problems of its reader become part of the report.
        decode: Decode every picture; False reads only the headers.
        on_image: Called with the number of images checked and of all images.
    """
    checking = Checking(decode)
    checking.add(dataset, on_image=on_image)
    return checking.report()


class Checking:
    """Check of a dataset in parts."""

    def __init__(self, decode: bool = True, *, in_parts: bool = False) -> None:
        """Start without any image.

        Args:
            decode: Decode every picture; False reads only the headers.
            in_parts: The pictures of a part are gone when the next one is added; their files are then always read.
        """
        self._decode = decode
        self._in_parts = in_parts
        self._problems: list[Problem] = []
        self._copies: dict[bytes, list[str]] = {}
        self._images = self._objects = 0
        self._suffixes: Counter[str] = Counter()
        self._root = Path()
        self._format = ""

    def add(
        self, dataset: Dataset, *, on_image: Callable[[int, int], None] | None = None, total: int | None = None
    ) -> None:
        """Check the next images.

        Args:
            dataset: These images, with the problems of their reader.
            on_image: Called with the number of images checked and of all images.
            total: Number of all images; None if these are all.
        """
        self._root = dataset.root
        self._format = dataset.format
        self._problems += dataset.problems
        # Some readers already report duplicates, with their lines.
        compares = any(p.code == "object-duplicate" for p in dataset.problems)
        for image in dataset.images:
            where = f"{image.split}/{image.name}"
            size_wh, more, print_ = _check_picture(image, where, self._decode)
            self._problems += more
            if self._in_parts and not self._decode:
                print_ = _file_digest(image.path)
            if print_ is not None:
                self._copies.setdefault(print_, []).append(where)
            self._problems += check_objects(image, where, size_wh, duplicates=not compares)
            self._images += 1
            self._suffixes[image.path.suffix.lower()] += 1
            self._objects += len(image.instances)
            if on_image is not None:
                on_image(self._images, max(self._images, total or len(dataset.images)))
        if not self._decode and not self._in_parts:
            for number, group in enumerate(_same_files(dataset.images)):
                self._copies[number.to_bytes(8, "big")] = [f"{i.split}/{i.name}" for i in group]

    def report(self, further: Iterable[Problem] = ()) -> CheckReport:
        """Return the problems of all images together, and further ones of the dataset."""
        copies = [p for group in self._copies.values() for p in _check_copies(group)]
        problems = _sorted([*self._problems, *copies, *further])
        kinds = dict(sorted(self._suffixes.items()))
        return CheckReport(self._root, self._format, self._images, self._objects, self._decode, problems, kinds)


def unreadable(root: Path, error: DatasetError) -> CheckReport:
    """Return the report on a dataset that could not be read."""
    problems = error.problems or (Problem(root.name, "dataset-unreadable", error.message),)
    return CheckReport(root, None, 0, 0, False, _sorted(problems))


def _sorted(problems: Iterable[Problem]) -> tuple[Problem, ...]:
    return tuple(sorted(set(problems), key=lambda p: (p.severity, p.code, p.where, p)))


def _check_picture(
    image: ImageRecord, where: str, decode: bool
) -> tuple[tuple[int, int] | None, list[Problem], bytes | None]:
    """Return a picture's true size, its problems, and a digest of its pixels if they were decoded."""
    if not decode:
        size_wh, problem = read_size(image.path, where)
        problem = problem or size_problem(image, where, size_wh)
        return size_wh, [problem] if problem else [], None
    try:
        picture = load_background(image.path)
    except DatasetError as error:
        return None, [replace(p, where=where) for p in error.problems], None
    pixels = picture.pixels
    problems = [replace(p, where=where) for p in picture.problems]
    if other := size_problem(image, where, picture.size_wh):
        problems.append(other)
    if _is_constant(picture):
        found = f"grey levels {pixels.min()} to {pixels.max()}, almost uniform"
        problems.append(Problem(where, "image-constant", found, "a picture with visible content", severity="warning"))
    digest = hashlib.sha256(repr((pixels.shape, pixels.dtype.str)).encode())
    digest.update(np.ascontiguousarray(pixels).data)
    return picture.size_wh, problems, digest.digest()


def _is_constant(picture: Background) -> bool:
    if picture.bit_depth == 16:  # radiometric pictures use only a few of the 65,536 levels
        return int(picture.pixels.max()) - int(picture.pixels.min()) < 3
    return float(picture.pixels.std()) < CONSTANT_LEVELS


def check_objects(
    image: ImageRecord, where: str, size_wh: tuple[int, int] | None, *, duplicates: bool = True
) -> list[Problem]:
    """Return the problems of the labels of one image.

    Args:
        image: Image to check.
        where: Name of the image in messages.
        size_wh: True size of the picture; None if unknown.
        duplicates: Whether to look for duplicate objects.
    """
    problems: list[Problem] = []
    keys = [_key(o) for o in image.instances]
    times = Counter(keys)
    seen = Counter[tuple[Any, ...]]()
    for k, (o, key) in enumerate(zip(image.instances, keys, strict=True)):
        number = k if o.source_id is None else o.source_id
        here = f"{where}: {'object' if o.source_id is None else 'annotation'} {number}"
        # Readers clip to the annotated size, so this finds boxes only if the true size differs.
        _, problem = check_box(o.box_xyxy.tolist(), size_wh or image.size_wh, here)
        if problem is not None:
            problems.append(problem)
        low = float((o.box_xyxy[2:] - o.box_xyxy[:2]).min())
        if 0 < low < 1:
            found = f"a box {low:.3g} px across"
            problems.append(Problem(here, "box-tiny", found, "at least 1 px", severity="warning"))
        apart = _box_distance_px(o, image.size_wh or size_wh)
        if apart > AGREE_PX:
            found = f"oriented and axis-aligned box are {apart:.3g} px apart"
            expected = f"the bounds of the oriented box, within {AGREE_PX:g} px"
            problems.append(Problem(here, "obb-disagrees", found, expected, "correct one of them", severity="warning"))
        seen[key] += 1
        if duplicates and seen[key] == 2:
            box = ", ".join(f"{v:g}" for v in o.box_xyxy)
            found = f"{o.category} [{box}] occurs {times[key]} times"
            problems.append(Problem(here, "object-duplicate", found, "each object once", severity="warning"))
    return problems


def _key(o: Instance) -> tuple[Any, ...]:
    corners = None if o.corners_xy is None else o.corners_xy.tobytes()
    return o.category, o.box_xyxy.tobytes(), corners, o.mask, o.track_id


def _box_distance_px(o: Instance, size_wh: tuple[int, int] | None) -> float:
    """Return the distance (px) of the box from the oriented box's bounds inside the frame; 0 where they may differ."""
    if o.corners_xy is None or o.inserted or o.extra.get("tight_box"):
        return 0.0
    bounds = np.concatenate([o.corners_xy.min(axis=0), o.corners_xy.max(axis=0)])
    if size_wh is not None:
        bounds = np.clip(bounds, 0.0, np.array([*size_wh, *size_wh], np.float64))
    return float(np.abs(bounds - o.box_xyxy).max())


def _same_files(images: Iterable[ImageRecord]) -> list[list[ImageRecord]]:
    """Group images whose files are equal; only files of equal length are read."""
    by_length: dict[int, list[ImageRecord]] = defaultdict(list)
    for image in images:
        try:
            status = image.path.stat()
        except OSError:
            continue  # reported when the picture was opened
        if stat.S_ISREG(status.st_mode):
            by_length[status.st_size].append(image)
    groups: dict[tuple[int, bytes], list[ImageRecord]] = defaultdict(list)
    for length, alike in sorted(by_length.items()):
        for image in alike if len(alike) > 1 else ():
            if (digest := _file_digest(image.path)) is not None:
                groups[length, digest].append(image)
    return list(groups.values())


def _file_digest(path: Path) -> bytes | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").digest()
    except OSError:
        return None


def _check_copies(names: list[str]) -> list[Problem]:
    """Return the problem of several images that are the same picture, from `<split>/<name>` of each."""
    if len(names) < 2:
        return []
    splits = sorted({name.partition("/")[0] for name in names})
    if len(splits) > 1:
        found = f"the same picture in {' and '.join(splits)}: {', '.join(names[:4])}"
        return [Problem(names[0], "image-leak", found, "each picture in one split", "remove it from the others")]
    found = f"the same picture {len(names)} times: {', '.join(names[:4])}"
    return [Problem(names[0], "image-repeated", found, "each picture once", severity="warning")]
