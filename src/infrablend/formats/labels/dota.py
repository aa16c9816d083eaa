"""DOTA (Xia et al. 2018): oriented boxes as four corners in pixels, one text file per picture.

    <split>/images/<name>.png    <split>/labelTxt/<name>.txt

    imagesource:GoogleEarth
    gsd:0.146
    x1 y1 x2 y2 x3 y3 x4 y4 category difficult

Corners run clockwise on screen. The two first lines may be missing; names of categories hold no blanks. Also read:
`labelTxt-v1.5/`, `annfiles/` (MMRotate), and `images/<split>/` with `labelTxt/<split>/`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from infrablend.core.boxes import box_of_points, corners_of_box
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.files import link_or_copy, write_text
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import read_text
from infrablend.formats.base import (
    Match,
    check_splits,
    ignored_by_class,
    in_order,
    named_categories,
    require_known,
    require_size,
    split_folders,
    unmarked_regions,
)
from infrablend.formats.box_checks import OVERHANG_PX, check_box, clockwise_corners, overhang_px
from infrablend.formats.losses import Written, count_dropped
from infrablend.formats.pictures.listing import check_link, list_pictures
from infrablend.formats.records import Findings
from infrablend.formats.values import to_floats

NAME = "dota"

_LABEL_FOLDERS = ("labelTxt", "annfiles")
_HEADER = re.compile(r"(imagesource|gsd)\s*:\s*(.*)", re.IGNORECASE)
_NOTHING = "null"
_DECIMALS = 8


# -- writing ---------------------------------------------------------------------------------------------------


def dota_names(categories: Iterable[Category]) -> dict[str, str]:
    """Return the unique name to write per category: blanks become hyphens, as in DOTA's `small-vehicle`."""
    names: dict[str, str] = {}
    ordered = sorted(categories, key=lambda c: (any(x.isspace() for x in c.name), c.id))  # names without blanks stay
    for c in ordered:
        name = plain = "-".join(c.name.split())
        k = 2
        while name in names.values():
            name = f"{plain}-{k}"
            k = k + 1
        names[c.name] = name
    return names


def write(
    out: Path, images: Iterable[ImageRecord], categories: Sequence[Category], *, pictures: bool = True
) -> Written:
    """Write `<split>/labelTxt/<stem>.txt` and, as links, `<split>/images/<name>`; see `label_text`.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A size or category is missing, or two pictures of a split have the same stem.
    """
    names = dota_names(categories)
    losses: Counter[str] = Counter(class_name_changed=sum(a != b for a, b in names.items()))
    unsaid = ignored_by_class(categories)
    files: list[Path] = []
    seen: set[tuple[str, str]] = set()
    for image in in_order(images):
        stem = Path(image.name).stem
        if "/" in image.name or (image.split, stem) in seen:
            raise ValueError(f"{image.name}: DOTA needs names without folders and unique stems in a split")
        seen.add((image.split, stem))
        losses["ignore_as_class"] += unmarked_regions(image.instances, unsaid)
        files.append(write_text(out / image.split / "labelTxt" / f"{stem}.txt", label_text(image, names, losses)))
        if pictures:
            files.append(link_or_copy(image.path, out / image.split / "images" / image.name))
    return Written.of(files, losses)


def label_text(image: ImageRecord, names: Mapping[str, str], losses: Counter[str]) -> str:
    """Return the label file of an image, and count what it cannot hold.

    An object without an oriented box gets its axis-aligned one. Corners outside the frame are kept.
    """
    require_size(image)
    lines = [f"{k}:{image.extra.get(k, _NOTHING)}" for k in ("imagesource", "gsd")]
    require_known(image, names)
    for i in image.instances:
        losses["obb_from_box"] += i.corners_xy is None
        count_dropped(i, losses, "mask", "visibility", "occlusion", "truncated")
        corners = corners_of_box(i.box_xyxy) if i.corners_xy is None else i.corners_xy
        numbers = " ".join(_number(v) for v in corners.reshape(-1).tolist())
        flag = 2 if i.difficult and i.extra.get("difficult") == 2 else int(i.difficult is True)
        lines.append(f"{numbers} {names[i.category]} {flag}")
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    text = f"{value:.{_DECIMALS}f}".rstrip("0")
    text = text + "0" if text.endswith(".") else text
    return "0.0" if text == "-0.0" else text


# -- finding ---------------------------------------------------------------------------------------------------


def find_folders(root: Path) -> list[tuple[Split, Path | None, Path]]:
    """Return (split, label folder, picture folder) per split; without folders of splits, everything is train.

    A split with only pictures, such as DOTA's test, has no label folder.
    """
    common = _label_folder(root)
    found = [(split, _label_folder(base), base / "images") for split, base in split_folders(root)]
    found += [(split, _split_of(common, p.name), p) for split, p in split_folders(root / "images")]
    found = [(split, labels, p) for split, labels, p in found if labels is not None or p.is_dir()]
    if any(labels for _, labels, _ in found):
        return found
    return [("train", common, root / "images")] if common else []


def _label_folder(base: Path) -> Path | None:
    versions = sorted((p.name for p in base.glob("labelTxt-v*")), reverse=True) if base.is_dir() else []
    for name in (*_LABEL_FOLDERS, *versions):
        folder = base / name
        if folder.is_dir():
            return folder / "labelTxt" if (folder / "labelTxt").is_dir() else folder
    return None


def _split_of(folder: Path | None, name: str) -> Path | None:
    return folder / name if folder is not None and (folder / name).is_dir() else None


def _label_files(folder: Path) -> list[Path]:
    return sorted(p for p in folder.glob("*.txt") if p.is_file() and not p.name.startswith("."))


def detect(root: Path) -> Match:
    """Decide whether `root` contains `labelTxt` or `annfiles` folders with DOTA's lines."""
    folders = find_folders(root)
    labelled = [labels for _, labels, _ in folders if labels is not None]
    if not labelled:
        return Match(NAME, False, "no folder labelTxt or annfiles, for a split or for all")
    for folder in labelled:
        for path in _label_files(folder)[:20]:
            text, _ = read_text(path, path.name, "")
            lines = text.split("\n", 20)[:20]
            if any(_HEADER.fullmatch(line.strip()) or _is_object(line.split()) for line in lines):
                splits = ", ".join(split for split, _, _ in folders)
                return Match(NAME, True, f"DOTA's text files in {folder.relative_to(root).as_posix()}; {splits}")
    return Match(NAME, False, f"{labelled[0].name} holds no lines of eight numbers, a category and a flag")


def _is_object(words: list[str]) -> bool:
    return len(words) in (9, 10) and to_floats(words[:8], 8) is not None


# -- reading ---------------------------------------------------------------------------------------------------


def read(root: Path, *, splits: Iterable[str] | None = None, metadata: Path | None = None) -> Dataset:
    """Read DOTA's folders; categories are numbered from 0 in the order of their names, since no file lists them.

    Raises:
        DatasetError: No label folder, or nothing can be read.
    """
    wanted = check_splits(splits)
    folders = find_folders(root)
    if not folders:
        problem = Problem(
            str(root), "annotation-missing", "no labelTxt or annfiles", "DOTA's folders", "check the path"
        )
        raise DatasetError(f"{root}: no DOTA dataset", [problem])
    found = Findings(root)
    records: list[ImageRecord] = []
    for split, labels, pictures in folders:
        if split in wanted:
            records += _read_split(found, split, labels, pictures)
    categories = named_categories(sorted({o.category for i in records for o in i.instances}))
    return found.dataset(NAME, records, categories, {"labels": NAME}, metadata=metadata, splits=wanted)


def _read_split(found: Findings, split: Split, labels: Path | None, pictures: Path) -> list[ImageRecord]:
    files = {p.stem: p for p in _label_files(labels)} if labels else {}
    records: list[ImageRecord] = []
    unlabelled = 0
    taken: dict[str, str] = {}
    for name, path in list_pictures(pictures, is_labelled=lambda p: p.stem in files).items():
        key = found.place(path)
        if path.is_symlink() and (fault := check_link(path, pictures, key)):
            found.problems.append(fault)
            continue
        if path.stem in taken:
            text = f"{name} and {taken[path.stem]} share a label file"
            found.add(key, "image-duplicate", text, "each stem once", "rename one of them")
            continue
        taken[path.stem] = name
        size_wh = found.size(path, key)
        if size_wh is None:
            continue
        file = files.get(path.stem)
        unlabelled += file is None
        instances, extra = _read_file(found, file, size_wh) if file else ((), {})
        records.append(ImageRecord("", path, split, size_wh, instances, extra=extra, file_name=name))
    for stem in sorted(set(files) - set(taken)):
        expected = f"{stem}.png or the like in {found.place(pictures)}"
        found.add(found.place(files[stem]), "image-missing", "no picture of that name", expected, "restore it")
    if unlabelled:
        text = f"{unlabelled} picture(s) of {split} have no label file, taken as without objects"
        found.warn(found.root.name, "label-missing", text, "a label file each")
    return records


def _read_file(found: Findings, path: Path, size_wh: tuple[int, int]) -> tuple[tuple[Instance, ...], dict[str, object]]:
    extra: dict[str, object] = {}
    instances: list[Instance] = []
    seen: set[str] = set()
    for n, line in enumerate((found.text(path, "a DOTA label file") or "").splitlines(), 1):
        here = f"{found.place(path)}: line {n}"
        if header := _HEADER.fullmatch(line.strip()):
            if header[2].strip().casefold() not in ("", _NOTHING, "none"):
                extra[header[1].lower()] = header[2].strip()
            continue
        words = line.split()
        if not words:
            continue
        if " ".join(words) in seen:
            found.warn(here, "object-duplicate", "the same line again, kept", "each object once")
        seen.add(" ".join(words))
        instance = _object(found, words, size_wh, here)
        if instance is not None:
            instances.append(instance)
    return tuple(instances), extra


def _object(found: Findings, words: list[str], size_wh: tuple[int, int], where: str) -> Instance | None:
    numbers = to_floats(words[:8], 8) if len(words) in (9, 10) else None
    flag = words[9] if len(words) == 10 else None
    if numbers is None or flag not in (None, "0", "1", "2"):
        expected = "x1 y1 x2 y2 x3 y3 x4 y4 category difficult"
        found.add(where, "label-malformed", repr(" ".join(words)[:80]), expected, "correct the line")
        return None
    corners = clockwise_corners(np.array(numbers, np.float64).reshape(4, 2))
    box, problem = check_box(box_of_points(corners).tolist(), size_wh, where)
    if problem is not None and problem.code == "box-clipped":
        over = overhang_px(corners, size_wh)
        problem = None
        if over > OVERHANG_PX:
            text = f"oriented box reaches {over:.3g} px out of the frame, kept; its axis-aligned box is clipped"
            expected = f"at most {OVERHANG_PX} px outside {size_wh[0]}x{size_wh[1]} px"
            problem = Problem(where, "box-overhang", text, expected, severity="warning")
    found.problems += [problem] if problem is not None else []
    if box is None:
        return None
    # Later versions use 2 for objects too small to identify.
    extra = {"difficult": 2} if flag == "2" else {}
    return Instance(words[8], box, corners, difficult=None if flag is None else flag != "0", extra=extra)
