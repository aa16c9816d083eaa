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
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.core.boxes import box_of_points, corners_of_box
from infrablend.core.capture import Capture
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.files import link_or_copy, write_text
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import read_text
from infrablend.formats.base import (
    Match,
    check_splits,
    ignored_by_class,
    in_order,
    is_ignored_name,
    require_size,
    shorten,
    sort_images,
    unmarked_regions,
)
from infrablend.formats.box_checks import OVERHANG_PX, check_box, clockwise_corners, overhang_px
from infrablend.formats.capture import CaptureTable, facts_from_name, find_table, read_table
from infrablend.formats.losses import Written
from infrablend.formats.occlusion import loses_occlusion
from infrablend.formats.pictures import assign_ids, check_link, list_pictures, read_size

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
            name, k = f"{plain}-{k}", k + 1
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
    return Written(tuple(files), {k: v for k, v in sorted(losses.items()) if v})


def label_text(image: ImageRecord, names: Mapping[str, str], losses: Counter[str]) -> str:
    """Return the label file of an image, and count what it cannot hold.

    An object without an oriented box gets its axis-aligned one. Corners outside the frame are kept.
    """
    require_size(image)
    lines = [f"{k}:{image.extra.get(k, _NOTHING)}" for k in ("imagesource", "gsd")]
    for i in image.instances:
        if i.category not in names:
            raise ValueError(f"{image.id}: category {i.category!r} is not in the list of categories")
        losses["obb_from_box"] += i.corners_xy is None
        losses["mask_dropped"] += i.mask is not None
        losses["visibility_dropped"] += i.visibility is not None
        losses["occlusion_dropped"] += loses_occlusion(i)
        losses["truncated_dropped"] += i.truncated is True
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
    found: list[tuple[Split, Path | None, Path]] = []
    for split in SPLITS:
        for labels, pictures in (
            (_label_folder(root / split), root / split / "images"),
            (_split_of(_label_folder(root), split), root / "images" / split),
        ):
            if pictures.is_dir() or labels is not None:
                found.append((split, labels, pictures))
                break
    if any(labels for _, labels, _ in found):
        return found
    labels = _label_folder(root)
    return [("train", labels, root / "images")] if labels else []


def _label_folder(base: Path) -> Path | None:
    versions = sorted((p.name for p in base.glob("labelTxt-v*")), reverse=True) if base.is_dir() else []
    for name in (*_LABEL_FOLDERS, *versions):
        folder = base / name
        if folder.is_dir():
            return folder / "labelTxt" if (folder / "labelTxt").is_dir() else folder
    return None


def _split_of(folder: Path | None, split: Split) -> Path | None:
    return folder / split if folder is not None and (folder / split).is_dir() else None


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


def _is_object(words: Sequence[str]) -> bool:
    return len(words) in (9, 10) and _floats(words[:8]) is not None


def _floats(words: Sequence[str]) -> list[float] | None:
    try:
        return [float(w) for w in words]
    except ValueError:
        return None


# -- reading ---------------------------------------------------------------------------------------------------


def read(root: Path, *, splits: Iterable[str] | None = None, metadata: Path | None = None) -> Dataset:
    """Read DOTA's folders; categories are numbered from 0 in the order of their names, since no file lists them.

    Args:
        root: The folder.
        splits: Splits to read; None reads all.
        metadata: Table of pitch and altitude; None uses `metadata.csv` or `.json` in the folder, if it exists.

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
    table_path = metadata or find_table(root)
    table = read_table(table_path) if table_path else None
    problems: list[Problem] = list(table.problems) if table else []
    found: list[tuple[str, ImageRecord]] = []
    for split, labels, pictures in folders:
        if split in wanted:
            found += _read_split(root, split, labels, pictures, table, problems)
    if not found:
        raise DatasetError(f"{root}: no picture to read in the splits {', '.join(wanted)}", shorten(problems))
    if table is not None and (unused := table.unused([key for key, _ in found])):
        text = f"{len(unused)} row(s) of the table name no picture: {', '.join(unused[:3])}"
        problems.append(Problem(root.name, "table-unused", text, "a picture for each row", severity="warning"))
    ids = assign_ids([key for key, _ in found])
    images = [replace(r, id=ids[key]) for key, r in found]
    names = sorted({o.category for i in images for o in i.instances})
    categories = tuple(Category(n, name, "", is_ignored_name(name)) for n, name in enumerate(names))
    notes = {"labels": NAME, "table": table_path.name if table_path else None}
    return Dataset(root, NAME, categories, sort_images(images), tuple(problems), notes)


def _read_split(
    root: Path,
    split: Split,
    labels: Path | None,
    pictures: Path,
    table: CaptureTable | None,
    problems: list[Problem],
) -> list[tuple[str, ImageRecord]]:
    """Return (path below `root`, record) of every picture of a split; adds to `problems`."""
    files = {p.stem: p for p in _label_files(labels)} if labels else {}
    records: list[tuple[str, ImageRecord]] = []
    unlabelled = 0
    taken: dict[str, str] = {}
    for name, path in list_pictures(pictures).items():
        key = path.relative_to(root).as_posix()
        if path.is_symlink() and (fault := check_link(path, pictures, key)):
            problems.append(fault)
            continue
        if path.stem in taken:
            found = f"{name} and {taken[path.stem]} share a label file"
            problems.append(Problem(key, "image-duplicate", found, "each stem once", "rename one of them"))
            continue
        taken[path.stem] = name
        size_wh, problem = read_size(path, key)
        if size_wh is None:
            problems += [problem] if problem else []
            continue
        file = files.get(path.stem)
        unlabelled += file is None
        instances, extra = _read_file(root, file, size_wh, problems) if file else ((), {})
        capture = _capture(name, key, table, problems)
        record = ImageRecord("", path, split, size_wh, instances, capture, extra=extra, file_name=name)
        records.append((key, record))
    for stem in sorted(set(files) - set(taken)):
        where = files[stem].relative_to(root).as_posix()
        expected = f"{stem}.png or the like in {pictures.relative_to(root).as_posix()}"
        problems.append(Problem(where, "image-missing", "no picture of that name", expected, "restore it"))
    if unlabelled:
        found = f"{unlabelled} picture(s) of {split} have no label file, taken as without objects"
        problems.append(Problem(root.name, "label-missing", found, "a label file each", severity="warning"))
    return records


def _capture(name: str, key: str, table: CaptureTable | None, problems: list[Problem]) -> Capture:
    facts = facts_from_name(name)
    named = facts.capture if facts else Capture()
    listed = table.find(key) if table else None
    if listed is None:
        return named
    for conflict in listed.conflicts(named):
        found = f"{conflict} (table, file name); the table is used"
        problems.append(Problem(key, "metadata-disagrees", found, "the same", severity="warning"))
    return listed.over(named)


def _read_file(
    root: Path, path: Path, size_wh: tuple[int, int], problems: list[Problem]
) -> tuple[tuple[Instance, ...], dict[str, Any]]:
    where = path.relative_to(root).as_posix()
    text, problem = read_text(path, where, "a DOTA label file")
    if problem is not None:
        problems.append(problem)
        return (), {}
    extra: dict[str, Any] = {}
    instances: list[Instance] = []
    seen: set[str] = set()
    for n, line in enumerate(text.splitlines(), 1):
        here = f"{where}: line {n}"
        if header := _HEADER.fullmatch(line.strip()):
            if header[2].strip().casefold() not in ("", _NOTHING, "none"):
                extra[header[1].lower()] = header[2].strip()
            continue
        words = line.split()
        if not words:
            continue
        if " ".join(words) in seen:
            found = "the same line again, kept"
            problems.append(Problem(here, "object-duplicate", found, "each object once", severity="warning"))
        seen.add(" ".join(words))
        instance = _object(words, size_wh, here, problems)
        if instance is not None:
            instances.append(instance)
    return tuple(instances), extra


def _object(words: Sequence[str], size_wh: tuple[int, int], where: str, problems: list[Problem]) -> Instance | None:
    numbers = _floats(words[:8]) if len(words) in (9, 10) else None
    flag = words[9] if len(words) == 10 else None
    if numbers is None or flag not in (None, "0", "1", "2"):
        expected = "x1 y1 x2 y2 x3 y3 x4 y4 category difficult"
        problems.append(Problem(where, "label-malformed", repr(" ".join(words)[:80]), expected, "correct the line"))
        return None
    corners = clockwise_corners(np.array(numbers, np.float64).reshape(4, 2))
    box, problem = check_box(box_of_points(corners).tolist(), size_wh, where)
    if problem is not None and problem.code == "box-clipped":
        over = overhang_px(corners, size_wh)
        problem = None
        if over > OVERHANG_PX:
            found = f"oriented box reaches {over:.3g} px out of the frame, kept; its axis-aligned box is clipped"
            expected = f"at most {OVERHANG_PX} px outside {size_wh[0]}x{size_wh[1]} px"
            problem = Problem(where, "box-overhang", found, expected, severity="warning")
    problems += [problem] if problem is not None else []
    if box is None:
        return None
    # Later versions use 2 for objects too small to identify.
    extra = {"difficult": 2} if flag == "2" else {}
    return Instance(words[8], box, corners, difficult=None if flag is None else flag != "0", extra=extra)
