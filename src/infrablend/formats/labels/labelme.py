"""labelme (Wada): a JSON file per picture with its shapes, beside the picture or in a folder of its own.

    [train|val|test/]<stem>.json beside <stem>.jpg, or in annotations/ and images/

Also read are the shapes that X-AnyLabeling writes in this format. Places are pixels, counted from the corner of the
picture. Shapes with outlines that have the same label and `group_id` are parts of one object.
"""

from __future__ import annotations

import base64
import io
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, NotRequired, TypedDict, TypeGuard

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from infrablend.core.boxes import box_of_points
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.file_names import leaves
from infrablend.core.files import open_regular
from infrablend.core.json_records import is_list
from infrablend.core.rle_masks import Mask
from infrablend.errors import DatasetError
from infrablend.formats.annotation_files import only_looked_at, read_json
from infrablend.formats.base import Match, check_splits, is_ignored_name, names_of, require_options
from infrablend.formats.box_checks import clockwise_corners, is_near, snap_edges
from infrablend.formats.pictures.listing import (
    PictureKey,
    folder_split,
    is_decodable,
    is_hidden,
    list_pictures,
    picture_key,
    plain_name,
    walk,
)
from infrablend.formats.polygons import ellipse
from infrablend.formats.records import KEEP_OR_DROP, Findings, unlabelled_problems
from infrablend.formats.values import to_bool, to_floats, to_size

NAME = "labelme"
OPTIONS = {"unlabelled": "keep or drop pictures without a JSON file; keep is the default"}
IGNORED = "__ignore__"
"""Label of what labelme's converters leave out: a region to ignore."""

_TURNED = ("oriented_rectangle", "rotation")
_CORNERS = {"rectangle": (2, 4), "circle": (2,), "mask": (2,), **dict.fromkeys(_TURNED, (4,))}
_FLAGS = ("truncated", "difficult", "occluded")
_HEAD_BYTES = 4096
_LOOKED_AT = 20


# -- finding ---------------------------------------------------------------------------------------------------


def _files(root: Path) -> Iterator[Path]:
    """Yield the JSON files below a folder that may be labelme's, sorted within each folder."""
    for base, names in walk(root):
        for name in sorted(n for n in names if n.lower().endswith(".json") and not is_hidden(n)):
            path = Path(base, name)
            try:
                with open_regular(path) as stream:
                    head = stream.read(_HEAD_BYTES)
            except OSError:
                continue
            if any(key in head for key in (b'"shapes"', b'"imagePath"', b'"imageData"')):
                yield path


class _File(TypedDict):
    """What is read of a file."""

    imagePath: str
    shapes: list[Any]
    imageData: NotRequired[object]
    imageWidth: NotRequired[object]
    imageHeight: NotRequired[object]


def _is_ours(top: object) -> TypeGuard[_File]:
    return isinstance(top, dict) and is_list(top.get("shapes")) and isinstance(top.get("imagePath"), str)


def detect(root: Path) -> Match:
    """Decide whether `root` contains JSON files with `shapes` and `imagePath`."""
    for path in islice(_files(root), _LOOKED_AT):
        try:
            ours = _is_ours(read_json(path))
        except DatasetError:
            continue
        only_looked_at(path)
        if ours:
            return Match(NAME, True, f"labelme's files such as {path.relative_to(root).as_posix()}")
    return Match(NAME, False, "no JSON file with shapes and imagePath")


# -- reading ---------------------------------------------------------------------------------------------------


def read(
    root: Path, *, splits: Iterable[str] | None = None, metadata: Path | None = None, unlabelled: str = "keep"
) -> Dataset:
    """Read labelme's files and their pictures; folders named after a split say it, else it is train.

    Raises:
        DatasetError: An option has a wrong value, or no picture can be read.
    """
    require_options(root, unlabelled=(unlabelled, KEEP_OR_DROP))
    wanted = check_splits(splits)
    found = Findings(root)
    pictures = list_pictures(root)
    by_key: dict[PictureKey, str] = {}
    for n in pictures:
        by_key.setdefault(picture_key(n), n)
    records: dict[str, ImageRecord] = {}
    skipped: set[str] = set()
    for path in _files(root):
        where = found.place(path)
        own = by_key.get(picture_key(where))
        try:
            top = read_json(path)
        except DatasetError as error:
            found.add_all(error.problems, where)
            skipped |= {own} if own else set()
            continue
        if not _is_ours(top):
            only_looked_at(path)
            continue
        name = _picture(found, top, where, own, pictures)
        split = folder_split(name or "")
        if name is None or split not in wanted:
            continue
        record = _record(found, top, where, name, pictures[name], split)
        if record is None or name in records:
            skipped.add(name)
            if record is not None:
                text = f"a second file for {name!r}, left out with {len(record.instances)} object(s)"
                found.add(where, "image-duplicate", text, "each picture once", "remove the one that is out of date")
            continue
        records[name] = record
    left = {n: split for n in pictures if n not in skipped and (split := folder_split(n)) in wanted}
    left = {n: split for n, split in left.items() if n not in records}
    found.problems += unlabelled_problems(root.name, len(left), unlabelled, "no JSON file")
    for n, split in left.items() if unlabelled == "keep" else ():
        records[n] = ImageRecord("", pictures[n], split, None, (), extra={"labelled": False}, file_name=plain_name(n))
    categories = [
        Category(k, n, "", n == IGNORED or is_ignored_name(n)) for k, n in enumerate(names_of(records.values()))
    ]
    notes = {"labels": NAME, "rows": {"unlabelled": len(left)}}
    return found.dataset(NAME, records.values(), categories, notes, metadata=metadata, splits=wanted)


def _picture(found: Findings, top: _File, where: str, own: str | None, pictures: Mapping[str, Path]) -> str | None:
    """Return the picture that a file names, from its own folder on, else the one of its name; None, with a problem."""
    said = top["imagePath"].replace("\\", "/")
    named = os.path.normpath(os.path.join(os.path.dirname(where), said)) if "\0" not in said else ""  # noqa: PTH118, PTH120
    if not leaves(named) and named in pictures:
        return named
    if own is None:
        text = f"no picture {said[-80:]!r}" + (", which is only inside this file" if top.get("imageData") else "")
        todo = "put the picture beside it; `labelme_export_json` takes it out of the file"
        found.add(where, "image-missing", text, "the picture or one of the file's name", todo)
    return own


def _record(found: Findings, top: _File, where: str, name: str, path: Path, split: Split) -> ImageRecord | None:
    size_wh = to_size(top.get("imageWidth"), top.get("imageHeight")) or found.size(path, name)
    if size_wh is None:
        return None
    parts: dict[object, list[Instance]] = {}
    for n, shape in enumerate(top["shapes"]):
        here = f"{where}: shape {n}"
        try:
            instance = _instance(found, shape, size_wh, here)
        except ValueError as error:
            found.add(here, "annotation-malformed", str(error)[:160], "a label and points in px", "correct the shape")
            continue
        if instance is None:
            continue
        group = shape.get("group_id")
        key = (group, instance.category) if isinstance(group, int) and instance.mask is not None else (None, n)
        parts.setdefault(key, []).append(instance)
    objects = tuple(_joined(p) for p in parts.values())
    return ImageRecord("", path, split, size_wh, objects, file_name=plain_name(name))


def _instance(found: Findings, shape: object, size_wh: tuple[int, int], where: str) -> Instance | None:
    """Return the object of a shape; None if its kind is not read, or its box is outside.

    Raises:
        ValueError: It is malformed.
    """
    if not isinstance(shape, dict):
        raise ValueError(f"{str(shape)[:60]!r} instead of a shape")
    kind = str(shape.get("shape_type") or "polygon")
    if kind != "polygon" and kind not in _CORNERS:
        found.leave_out(kind, where)
        return None
    label = shape.get("label")
    if not isinstance(label, str) or not label.strip():
        raise ValueError("no label")
    points = _points(shape, kind)
    edges: Iterable[float] = box_of_points(points).tolist()
    corners = mask = None
    if kind in _TURNED:
        corners = clockwise_corners(points)
    elif kind == "circle":
        x, y = points[0].tolist()
        radius = math.dist(*points)
        edges, mask = ellipse((x, y, 2 * radius, 2 * radius, 0), size_wh)
    elif kind == "polygon":
        mask = Mask.from_rings([points.ravel().tolist()], (size_wh[1], size_wh[0]))
    elif kind == "mask":
        mask = Mask.from_array(_painted(shape.get("mask"), points, size_wh))
        around = mask.box_xyxy
        if around is None:
            raise ValueError("a mask without a pixel in the picture")
        edges = around.tolist()
    box = found.box(snap_edges(tuple(edges), size_wh), size_wh, where)
    if box is None:
        return None
    said = {**(flags if isinstance(flags := shape.get("flags"), dict) else {}), **shape}
    flag = {k: to_bool(said.get(k)) for k in _FLAGS}
    extra = {} if flag["occluded"] is None else {"occluded": flag["occluded"]}
    return Instance(
        label.strip(),
        box,
        corners,
        mask if mask is not None and mask.area_px else None,
        truncated=flag["truncated"],
        difficult=flag["difficult"],
        extra=extra,
    )


def _points(shape: Mapping[str, object], kind: str) -> NDArray[np.float64]:
    """Return the (n, 2) points of a shape; a ValueError if they are malformed, or not as many as the kind has."""
    given = shape.get("points")
    pairs = [to_floats(p, 2) for p in given] if isinstance(given, list) else []
    numbers = [p for p in pairs if p is not None and is_near(p)]
    fits = len(pairs) in _CORNERS[kind] if kind in _CORNERS else len(pairs) >= 3
    if len(numbers) < len(pairs) or not fits:
        raise ValueError(f"a {kind} of the points {str(given)[:60]}")
    return np.array(numbers, np.float64)


def _painted(code: object, points: NDArray[np.float64], size_wh: tuple[int, int]) -> NDArray[np.bool_]:
    """Return (h, w) the pixels of a mask: a PNG file in base64 whose first pixel lies at the first point.

    Raises:
        ValueError: It cannot be read.
    """
    try:
        data = base64.b64decode(code if isinstance(code, str) else "", validate=True)
        if not is_decodable(data):
            raise ValueError("not a picture")
        with Image.open(io.BytesIO(data), formats=("PNG",)) as picture:
            if picture.width * picture.height > 4 * size_wh[0] * size_wh[1]:
                raise ValueError("far larger than the picture")
            pixels = np.asarray(picture)
    except Exception as error:  # PIL's decoders raise what they like on damaged data
        raise ValueError(f"a mask that is no PNG file in base64 ({error or type(error).__name__})") from None
    part = np.asarray(pixels.reshape(*pixels.shape[:2], -1).any(axis=2))
    w, h = size_wh
    x, y = (int(v) for v in points[0])
    painted = np.zeros((h, w), np.bool_)
    inside = part[max(-y, 0) : max(h - y, 0), max(-x, 0) : max(w - x, 0)]
    top = max(y, 0)
    left = max(x, 0)
    painted[top : top + inside.shape[0], left : left + inside.shape[1]] = inside
    return painted


def _joined(parts: Sequence[Instance]) -> Instance:
    """Return the parts of an object as one; several parts all have outlines."""
    if len(parts) == 1:
        return parts[0]
    boxes = np.array([p.box_xyxy for p in parts])
    box = np.concatenate([boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)])
    return replace(parts[0], box_xyxy=box, mask=Mask.union([p.mask for p in parts if p.mask is not None]))
