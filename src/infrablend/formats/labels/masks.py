"""Instance masks as pictures: one 16-bit PNG per image, and a JSON table of its objects beside it.

    categories.json
    images/<split>/<name>.jpg
    masks/<split>/<name>.png       value 0: no object; n: the object with `id` n in the table
    masks/<split>/<name>.json      size, telemetry, and each object with its category, box, pixels

A form of InfraBlend's own. The table holds all that is known of an object; the picture alone is enough for training.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.capture import Capture
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.files import link_or_copy, write_bytes, write_json
from infrablend.core.json_records import is_list
from infrablend.core.rle_masks import Mask
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import leave_out, read_json
from infrablend.formats.base import (
    Match,
    category_ids,
    check_splits,
    count_crowds,
    in_order,
    is_ignored_name,
    require_known,
    require_size,
    shorten,
)
from infrablend.formats.box_checks import clockwise_corners, is_near
from infrablend.formats.losses import Written, occlusion_fields
from infrablend.formats.pictures.images import load_background, png_bytes
from infrablend.formats.pictures.listing import PictureFolder, check_link
from infrablend.formats.records import Findings, with_ids
from infrablend.formats.values import known, read_occlusion, to_bool, to_floats, to_id, to_int, to_size

NAME = "masks"
TAKES_TABLE = False  # the tables contain pitch and altitude

CATEGORIES_FILE = "categories.json"
MOST_OBJECTS = 65_535
"""Number of objects that a 16-bit picture can distinguish."""


# -- writing ---------------------------------------------------------------------------------------------------


def write(
    out: Path, images: Iterable[ImageRecord], categories: Sequence[Category], *, pictures: bool = True
) -> Written:
    """Write masks, tables, `categories.json` and, as links, the pictures.

    Where masks overlap, the later object has the pixel; lost pixels are counted, as are objects without a mask.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A size or category is missing, a mask has another size than its picture, two pictures of a split
            differ in the suffix alone, or a picture has more than `MOST_OBJECTS` objects.
    """
    of_category = category_ids(categories)
    ignored = {c.name for c in categories if c.ignore}
    losses: Counter[str] = Counter()
    files: list[Path] = []
    seen: set[Path] = set()
    for image in in_order(images):
        target = out / "masks" / image.split / PurePosixPath(image.name).with_suffix(".png")
        if target in seen:
            raise ValueError(f"{image.name}: another picture of the split has the same stem")
        seen.add(target)
        losses["ignore_as_class"] += count_crowds(image.instances, ignored)
        pixels = instance_pixels(image, losses)
        files.append(write_bytes(target, png_bytes(pixels)))
        files.append(write_json(target.with_suffix(".json"), _table(image, pixels, of_category, ignored)))
        if pictures:
            files.append(link_or_copy(image.path, out / "images" / image.split / image.name))
    names = [
        {"id": c.id, "name": c.name, "supercategory": c.supercategory, "ignore": c.ignore}
        for c in sorted(categories, key=lambda c: c.id)
    ]
    files.append(write_json(out / CATEGORIES_FILE, {"categories": names, "format": "masks of InfraBlend"}))
    return Written.of(files, losses)


def instance_pixels(image: ImageRecord, losses: Counter[str]) -> NDArray[np.uint16]:
    """Return (h, w) the number of each pixel's object, counted from 1 in the order of the labels; 0 for none."""
    w, h = require_size(image)
    if len(image.instances) > MOST_OBJECTS:
        raise ValueError(f"{image.id}: {len(image.instances)} objects, at most {MOST_OBJECTS} fit")
    pixels = np.zeros((h, w), np.uint16)
    for number, instance in enumerate(image.instances, 1):
        if instance.mask is None:
            losses["mask_absent"] += 1
            continue
        if instance.mask.size_hw != (h, w):
            raise ValueError(f"{image.id}: mask of {instance.mask.size_hw} in a frame of {(w, h)}")
        mask = instance.mask.to_array()
        losses["mask_overlap_px"] += int((pixels[mask] > 0).sum())
        pixels[mask] = number
    return pixels


def _table(
    image: ImageRecord, pixels: NDArray[np.uint16], of_category: Mapping[str, int], ignored: set[str]
) -> dict[str, object]:
    w, h = require_size(image)
    area = np.bincount(pixels.reshape(-1), minlength=len(image.instances) + 1)
    objects = []
    require_known(image, of_category)
    for number, i in enumerate(image.instances, 1):
        row: dict[str, object] = {
            "id": number,
            "category": i.category,
            "category_id": of_category[i.category],
            "box_xyxy": i.box_xyxy.tolist(),
            "has_mask": i.mask is not None,
            "area_px": int(area[number]),
            "inserted": i.inserted,
            "ignore": i.category in ignored,
        }
        if i.corners_xy is not None:
            row["corners_xy"] = i.corners_xy.tolist()
        row |= known(visibility=i.visibility, truncated=i.truncated, difficult=i.difficult)
        row |= occlusion_fields(i)
        objects.append(row | known(track_id=i.track_id, source_id=i.source_id))
    top: dict[str, object] = {"file_name": image.name, "width": w, "height": h, "objects": objects}
    return top | image.capture.to_json() | known(source_id=image.source_id)


# -- reading ---------------------------------------------------------------------------------------------------


def detect(root: Path) -> Match:
    """Decide whether `root` contains `categories.json` and `masks/<split>/`."""
    missing = [n for n in (CATEGORIES_FILE, "masks") if not (root / n).exists()]
    if missing:
        return Match(NAME, False, f"no {' and no '.join(missing)}")
    splits = [s for s in SPLITS if (root / "masks" / s).is_dir()]
    if not splits:
        return Match(NAME, False, "no train, val or test in masks/")
    return Match(NAME, True, f"masks with tables; {', '.join(splits)}")


def read(root: Path, *, splits: Iterable[str] | None = None) -> Dataset:
    """Read masks and their tables.

    Raises:
        DatasetError: No list of categories, or nothing can be read.
    """
    wanted = check_splits(splits)
    categories = _read_categories(root)
    names = {c.name for c in categories}
    found = Findings(root)
    records: list[ImageRecord] = []
    for split in wanted:
        base = root / "masks" / split
        listing = PictureFolder.scan(root / "images" / split)
        tables = [p for p in sorted(base.rglob("*.json")) if not p.name.startswith(".")] if base.is_dir() else []
        leave_out(sorted(base.rglob("*.png")))  # read with their tables
        records += [r for p in tables if (r := _read_table(found, p, split, listing, names)) is not None]
    if not records:
        found.add(str(root), "annotation-missing", "no table", "masks/<split>/<name>.json")
        raise DatasetError(f"{root}: nothing to read in the splits {', '.join(wanted)}", shorten(found.problems))
    return Dataset(root, NAME, categories, with_ids(records), tuple(found.problems), {"labels": NAME})


def _read_categories(root: Path) -> tuple[Category, ...]:
    path = root / CATEGORIES_FILE
    top = read_json(path)
    rows = top.get("categories") if isinstance(top, dict) else None
    problems: list[Problem] = []
    categories: list[Category] = []
    for n, row in enumerate(rows if is_list(rows) else ()):
        number = to_int(row.get("id")) if isinstance(row, dict) else None
        name = row.get("name") if isinstance(row, dict) else None
        if number is None or not isinstance(name, str) or any(c.id == number or c.name == name for c in categories):
            here = f"{CATEGORIES_FILE}: category {n}"
            problems.append(Problem(here, "category-malformed", repr(row)[:80], "a new id and a new name"))
            continue
        ignore = row.get("ignore") is True or is_ignored_name(name)
        categories.append(Category(number, name, str(row.get("supercategory") or ""), ignore))
    if problems or not is_list(rows):
        problems = problems or [Problem(CATEGORIES_FILE, "annotation-layout", "no list `categories`", "one")]
        raise DatasetError(f"{path}: no list of categories", problems)
    return tuple(categories)


def _read_table(
    found: Findings, path: Path, split: Split, listing: PictureFolder, names: set[str]
) -> ImageRecord | None:
    where = found.place(path)
    top = found.json(path)
    if top is None:
        return None
    rows = top.get("objects")
    size_wh = to_size(top.get("width"), top.get("height"))
    if not is_list(rows) or size_wh is None:
        text = "no list `objects`, or no width and height"
        found.add(where, "annotation-layout", text, "a table of masks", "leave it out")
        return None
    name, picture, fault = listing.find_named(top.get("file_name"), where, f"a file in images/{split}")
    if fault is not None or picture is None:
        found.problems += [fault] if fault else []
        return None
    pixels = _read_pixels(found, path.with_suffix(".png"), size_wh)
    instances = []
    seen: set[int] = set()
    for n, row in enumerate(rows):
        here = f"{where}: object {row.get('id', n) if isinstance(row, dict) else n}"
        instance = _read_object(found, row, pixels, size_wh, here, names, seen)
        if instance is not None:
            instances.append(instance)
    unknown = [] if pixels is None else sorted(set(np.unique(pixels).tolist()) - seen - {0})
    if unknown:
        text = f"values {', '.join(map(str, unknown[:5]))} in the picture that no object has"
        found.warn(where, "mask-unknown", text, "an object per value")
    capture = Capture.from_json(top, strict=False)
    source_id = to_id(top.get("source_id"))
    return ImageRecord("", picture, split, size_wh, tuple(instances), capture, source_id, file_name=name)


def _read_pixels(
    found: Findings, path: Path, size_wh: tuple[int, int]
) -> NDArray[np.uint8] | NDArray[np.uint16] | None:
    where = found.place(path)
    if path.is_symlink() and (fault := check_link(path, path.parent, where)) is not None:
        found.problems.append(fault)
        return None
    try:
        loaded = load_background(path, size_wh)
    except DatasetError as error:
        found.add_all(error.problems, where)
        return None
    if loaded.mode == "RGB":
        found.add(where, "mask-malformed", "a colour picture", "16 or 8 bits per pixel, grey")
        return None
    return loaded.pixels


def _read_object(
    found: Findings,
    row: object,
    pixels: NDArray[Any] | None,
    size_wh: tuple[int, int],
    where: str,
    names: set[str],
    seen: set[int],
) -> Instance | None:
    number = to_int(row.get("id")) if isinstance(row, dict) else None
    box = to_floats(row.get("box_xyxy"), 4) if isinstance(row, dict) else None
    if not isinstance(row, dict) or number is None or box is None or number in seen:
        found.add(where, "annotation-malformed", json.dumps(row)[:80], "a new id and a box_xyxy")
        return None
    seen.add(number)
    if not isinstance(row.get("category"), str) or row["category"] not in names:
        text = f"category {row.get('category')!r}"
        expected = f"one of {', '.join(sorted(names))}"
        found.add(where, "category-unknown", text, expected, f"add it to {CATEGORIES_FILE}")
        return None
    inside = found.box(box, size_wh, where)
    if inside is None:
        return None
    mask = None
    if row.get("has_mask") is not False and pixels is not None:
        mask = Mask.from_array(pixels == number)
    visibility = to_floats([row.get("visibility")], 1)
    return Instance(
        str(row["category"]),
        inside,
        _corners(row.get("corners_xy")),
        mask,
        visibility[0] if visibility else None,
        to_bool(row.get("truncated")),
        to_bool(row.get("difficult")),
        row.get("inserted") is True,
        to_id(row.get("source_id")),
        read_occlusion(row),
        to_id(row.get("track_id")),
    )


def _corners(value: object) -> NDArray[np.float64] | None:
    if not isinstance(value, list) or len(value) != 4:
        return None
    points = [to_floats(p, 2) for p in value]
    if not all(p is not None and is_near(p) for p in points):
        return None
    return clockwise_corners(np.array(points, np.float64))
