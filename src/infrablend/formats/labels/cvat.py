"""CVAT's own XML. "CVAT for images 1.1": one file per split, an `image` per picture, a shape per box and mask.

    <split>.xml    cvat_labels.json    images/<split>/<name>

Boxes are `xtl, ytl, xbr, ybr` in pixels, edges counted from 0; `rotation` turns them clockwise about their centre, in
degrees. A mask is a rectangle with run lengths, row by row, that begin with the number of pixels outside. Shapes of one
object share a `group_id`. CVAT keeps the attributes that the labels of the task have: `cvat_labels.json` states them.
Files for videos, one per sequence, are in `formats.labels.cvat_video`.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.files import link_or_copy, write_chunks, write_json
from infrablend.core.rle_masks import Mask
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import files_with
from infrablend.formats.base import (
    SPLIT_FOLDERS,
    Match,
    category_ids,
    check_splits,
    ignored_by_class,
    in_order,
    named_categories,
    require_known,
    require_size,
    split_of_stem,
    split_parts,
    unmarked_regions,
)
from infrablend.formats.box_checks import is_near, is_rectangle, obb_from_corners, turned_box
from infrablend.formats.labels import cvat_video
from infrablend.formats.losses import Written, count_dropped
from infrablend.formats.pictures.listing import PictureFolder, check_name
from infrablend.formats.polygons import ellipse
from infrablend.formats.records import Findings, annotated_twice
from infrablend.formats.sequence_writing import SequenceWriter, is_labelled, with_names
from infrablend.formats.values import number_text, plain_id, to_bool, to_floats, to_int, to_share, to_size

NAME = "cvat"
LABELS_FILE = "cvat_labels.json"
# Attributes of objects: CVAT's kind of input.
ATTRIBUTES: Mapping[str, str] = {
    "inserted": "checkbox", "truncated": "checkbox", "difficult": "checkbox", "visibility": "text", "track_id": "text",
}  # fmt: skip
_SHAPES = ("box", "ellipse", "mask", "polygon")
_EDGES = ("xtl", "ytl", "xbr", "ybr")


# -- writing ---------------------------------------------------------------------------------------------------


def write(
    out: Path,
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    *,
    pictures: bool = True,
    video: bool = False,
) -> Written:
    """Write `<split>.xml`, `cvat_labels.json` for the task's labels, and link the pictures to `images/<split>/`.

    With `video`, write `<split>/<sequence>/annotations.xml` with a track per object, and link the pictures to `images/`
    beside it. `names.csv` and `metadata.csv` are those of `SequenceWriter.pictures`.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A size is missing, or a category is not in the list.
    """
    ordered = in_order(images)
    known = category_ids(categories)
    unsaid = ignored_by_class(categories)
    regions = sum(unmarked_regions(image.instances, unsaid) for image in ordered)
    task = Written.of([write_json(out / LABELS_FILE, _labels(categories))], {"ignore_as_class": regions})
    if video:
        return Written.together([task, _write_videos(SequenceWriter(out, ordered, categories), known, pictures)])
    losses: Counter[str] = Counter()
    files = []
    for split, part in split_parts(ordered).items():
        files.append(write_chunks(out / f"{split}.xml", _document(split, part, known, losses)))
    for image in ordered if pictures else ():
        files.append(link_or_copy(image.path, out / "images" / image.split / image.name))
    return Written.together([task, Written.of(files, losses)])


def _write_videos(writer: SequenceWriter, known: Mapping[str, int], pictures: bool) -> Written:
    """Write a file per sequence, and link its pictures beside it."""
    losses = writer.losses
    for folder, frames, _ in writer.sequences():
        for image in frames:
            losses["unlabelled_unsaid"] += not is_labelled(image)
            for i in image.instances:
                count_dropped(i, losses, "occlusion boxes", "mask")
                losses["obb_not_rectangle"] += _is_skewed(i)
        head = _head(folder, len(frames), known, frames[0])
        tracks = cvat_video.tracks_of(frames, _box, losses)
        writer.text(f"{folder}/{cvat_video.FILE}", chain([head], tracks, ["</annotations>\n"]))
    writer.pictures(cvat_video.path_of, pictures)
    return writer.written()


def _labels(categories: Sequence[Category]) -> list[dict[str, object]]:
    """Return the labels of a task, as CVAT's constructor takes them in its tab Raw."""
    attributes = [
        {
            "name": name,
            "mutable": False,
            "input_type": kind,
            "default_value": "false" if kind == "checkbox" else "",
            "values": ["false"] if kind == "checkbox" else [""],
        }
        for name, kind in ATTRIBUTES.items()
    ]
    return [{"name": c.name, "attributes": attributes} for c in categories]


def _document(
    split: str, images: Sequence[ImageRecord], known: Mapping[str, int], losses: Counter[str]
) -> Iterator[str]:
    """Yield the text of a split in pieces of one picture each."""
    yield _head(split, len(images), known)
    for number, image in enumerate(images):
        w, h = require_size(image)
        lines = [f'  <image id="{number}" name={quoteattr(image.name)} width="{w}" height="{h}">']
        groups = itertools.count(1)
        require_known(image, known)
        for i in image.instances:
            count_dropped(i, losses, "occlusion boxes")
            lines += _shapes(i, next(groups) if i.mask is not None else 0, losses)
        yield "\n".join([*lines, "  </image>", ""])
    yield "</annotations>\n"


def _head(name: str, size: int, known: Mapping[str, int], first: ImageRecord | None = None) -> str:
    """Return the start of a file; that of a sequence, with its first picture, is of a video task."""
    lines = ['<?xml version="1.0" encoding="utf-8"?>', "<annotations>", "  <version>1.1</version>", "  <meta>"]
    lines += ["    <task>", f"      <name>{escape(name)}</name>", f"      <size>{size}</size>"]
    lines += [f"      <mode>{'annotation' if first is None else 'interpolation'}</mode>"]
    if first is not None:
        w, h = require_size(first)
        lines += ["      <start_frame>0</start_frame>", f"      <stop_frame>{size - 1}</stop_frame>"]
        lines += [f"      <original_size><width>{w}</width><height>{h}</height></original_size>"]
    lines += ["      <labels>"]
    for name in known:
        lines += ["        <label>", f"          <name>{escape(name)}</name>", "          <attributes>"]
        lines += [
            f"            <attribute><name>{n}</name><mutable>False</mutable><input_type>{kind}</input_type>"
            f"<default_value>{(d := 'false' if kind == 'checkbox' else '')}</default_value><values>{d}</values>"
            "</attribute>"
            for n, kind in ATTRIBUTES.items()
        ]
        lines += ["          </attributes>", "        </label>"]
    lines += ["      </labels>", "    </task>", "  </meta>", ""]
    return "\n".join(lines)


def _shapes(i: Instance, group: int, losses: Counter[str]) -> Iterator[str]:
    """Yield the box of an object and, if it has one, its mask; a group of 0 is none."""
    label = f'label={quoteattr(i.category)} source="manual"'
    ending = f' group_id="{group}"' if group else ""
    losses["obb_not_rectangle"] += _is_skewed(i)
    yield f"    {_box(i, label, ending)}"
    pixels = None if i.mask is None else i.mask.to_array()
    if pixels is not None and pixels.any():
        (top, left), (bottom, right) = (f(np.argwhere(pixels), axis=0) for f in (np.min, np.max))
        window = pixels[top : bottom + 1, left : right + 1]
        place = f'left="{left}" top="{top}" width="{window.shape[1]}" height="{window.shape[0]}"'
        runs = ", ".join(map(str, _run_lengths(window)))
        occluded = int(bool(i.extra.get("occluded")))
        yield (
            f'    <mask {label} occluded="{occluded}" rle="{runs}" {place} z_order="0"{ending}>{_attributes(i)}</mask>'
        )


def _is_skewed(i: Instance) -> bool:
    """Return whether the corners of an object form no rectangle."""
    return i.corners_xy is not None and not is_rectangle(i.corners_xy, obb_from_corners(i.corners_xy))


def _box(i: Instance, said: str, ending: str = "") -> str:
    """Return the element of an object's box, turned if it has an oriented one; `said` are its first attributes."""
    edges = i.box_xyxy
    rotation = ""
    if i.corners_xy is not None:
        cx, cy, w, h, angle = obb_from_corners(i.corners_xy)
        edges = np.array([cx - w / 2, cy - h / 2, cx + w / 2, cy + h / 2])
        rotation = f' rotation="{number_text(math.degrees(angle))}"'
    box = " ".join(f'{k}="{number_text(float(v))}"' for k, v in zip(_EDGES, edges, strict=True))
    occluded = int(bool(i.extra.get("occluded")))
    return f'<box {said} occluded="{occluded}" {box}{rotation} z_order="0"{ending}>{_attributes(i)}</box>'


def _attributes(i: Instance) -> str:
    flags = {"inserted": i.inserted, "truncated": i.truncated, "difficult": i.difficult}
    values = {k: str(bool(v)).lower() for k, v in flags.items() if v is not None}
    values |= {} if i.visibility is None else {"visibility": number_text(i.visibility)}
    values |= {} if i.track_id is None else {"track_id": str(i.track_id)}
    return "".join(f'<attribute name="{k}">{escape(v)}</attribute>' for k, v in values.items())


def _run_lengths(window: NDArray[np.bool_]) -> list[int]:
    """Return the run lengths of a mask, row by row, beginning with pixels outside it."""
    flat = np.concatenate([[False], window.reshape(-1)])
    ends = np.flatnonzero(np.concatenate([flat[1:] != flat[:-1], [True]]))
    runs: list[int] = np.diff(np.concatenate([[0], ends])).tolist()
    return runs


# -- reading ---------------------------------------------------------------------------------------------------


def _files(root: Path) -> list[Path]:
    """Return the files in the folder, or the `annotations.xml` of sequences one or two folders below."""

    def named(pattern: str) -> list[Path]:
        return files_with(root, pattern, lambda head: b"<annotations>" in head, 4096)

    return named("*.xml") or named(f"*/{cvat_video.FILE}") or named(f"*/*/{cvat_video.FILE}")


def detect(root: Path) -> Match:
    """Decide whether `root` contains an XML file with CVAT's element `annotations`."""
    files = _files(root)
    if not files:
        return Match(NAME, False, "no XML file with the element `annotations`")
    return Match(NAME, True, f"CVAT's XML: {', '.join(p.relative_to(root).as_posix() for p in files[:5])}")


def read(root: Path, *, splits: Iterable[str] | None = None, metadata: Path | None = None) -> Dataset:
    """Read boxes, rotated boxes, ellipses, masks and polygons, count other shapes, and find the pictures.

    These are in `images/<split>/`, `images/`, `<split>/` or beside the XML files. Files of video tasks are read, too.

    Raises:
        DatasetError: There is no file of CVAT, or no picture can be read.
    """
    wanted = check_splits(splits)
    files = _files(root)
    if not files:
        missing = Problem(str(root), "annotation-missing", "no XML file of CVAT", "<split>.xml or annotations.xml")
        raise DatasetError(f"{root}: not CVAT's XML", [missing])
    found = Findings(root)
    records: dict[Path, ImageRecord] = {}
    names: dict[str, None] = {}
    twice: dict[str, list[ImageRecord]] = defaultdict(list)
    for path in files:
        top = found.xml(path)
        if top is None:
            continue
        names |= dict.fromkeys(t for label in top.iter("label") if (t := (label.findtext("name") or "").strip()))
        if cvat_video.is_video(top):
            for frame in _read_video(found, top, path, wanted):
                if records.setdefault(frame.path, frame) is not frame:
                    twice[found.place(path)].append(frame)
            continue
        elements: dict[tuple[Split, str], list[Any]] = {}
        for element in top.iter("image"):
            subset = (element.get("subset") or "").strip()
            elements.setdefault((split_of_stem(subset or path.stem), subset), []).append(element)
        for split, subset in sorted((k for k in elements if k[0] in wanted), key=lambda k: wanted.index(k[0])):
            listed = [n for e in elements[split, subset] if check_name(n := e.get("name"), "") is None and n]
            folder = PictureFolder.with_most(_places(root, split, subset), listed)
            for k, element in enumerate(elements[split, subset]):
                record = _read_image(found, element, f"{path.name}: image {element.get('id', k)}", split, folder)
                if record is not None and records.setdefault(record.path, record) is not record:
                    twice[path.name].append(record)
        if any(True for _ in top.iter("track")):
            text = f"{sum(1 for _ in top.iter('track'))} track(s) beside `image` elements, left out"
            todo = 'export the task as "CVAT for images 1.1" or "CVAT for video 1.1"'
            found.warn(path.name, "annotation-layout", text, "one or the other", todo)
    found.problems += annotated_twice(twice)
    listed = with_names(found, records.values())
    names |= dict.fromkeys(i.category for r in listed for i in r.instances)
    return found.dataset(NAME, listed, named_categories(names), {"labels": NAME}, metadata=metadata, splits=wanted)


def _read_video(found: Findings, top: Any, path: Path, wanted: Sequence[Split]) -> list[ImageRecord]:
    """Read the file of a video task; a folder above it states the split, else its subset or its name."""
    subset = next((s for t in top.iter("track") if (s := (t.get("subset") or "").strip())), "")
    above = path.parent.relative_to(found.root).parts[:-1]
    split = next((s for p in above if (s := SPLIT_FOLDERS.get(p.lower()))), None) or split_of_stem(subset or path.stem)
    if split not in wanted:
        return []
    inside = [path.parent / cvat_video.PICTURES, path.parent]
    places = inside if path.parent != found.root else [*_places(found.root, split, subset or split)]
    return cvat_video.read_video(found, top, path, split, places, _SHAPES, _read_shape)


def _places(root: Path, split: Split, subset: str) -> Iterator[Path]:
    """Yield where the pictures of a subset may be: CVAT names the folders as the subset was, such as `Validation`."""
    for base in (root / "images", root):
        for folder in sorted(d for d in base.glob("*") if d.is_dir()):
            if folder.name.lower() == subset.lower() or SPLIT_FOLDERS.get(folder.name.lower()) == split:
                yield folder
        yield base


def _read_image(found: Findings, element: Any, where: str, split: Split, folder: PictureFolder) -> ImageRecord | None:
    expected = f"a file in {folder.folder.name}/"
    name, picture, fault = folder.find_named(element.get("name"), where, expected, "put the pictures there")
    if fault is not None or picture is None:
        found.problems += [fault] if fault else []
        return None
    size_wh = to_size(element.get("width"), element.get("height"))
    instances = tuple(_read_objects(found, element, where, size_wh))
    return ImageRecord("", picture, split, size_wh, instances, file_name=name)


def _read_objects(found: Findings, element: Any, where: str, size_wh: tuple[int, int] | None) -> Iterable[Instance]:
    """Return the objects of a picture; a box and a mask of one label and group are one object."""
    objects: dict[object, Instance] = {}
    for other in (s for s in element if s.tag not in _SHAPES):
        found.leave_out(str(other.tag), where)
    for n, shape in enumerate(s for s in element if s.tag in _SHAPES):
        instance = _read_shape(found, shape, f"{where}: {shape.tag} {n}", size_wh)
        if instance is None:
            continue
        group = to_int(shape.get("group_id"))
        key: object = (group, instance.category) if group else n
        other = objects.get(key)
        if other is None:
            objects[key] = instance
        elif (other.mask is None) != (instance.mask is None):
            boxed, masked = (other, instance) if other.mask is None else (instance, other)
            objects[key] = replace(boxed, mask=masked.mask)
        else:  # a group of several objects
            objects[n] = instance
    return objects.values()


def _read_shape(found: Findings, shape: Any, where: str, size_wh: tuple[int, int] | None) -> Instance | None:
    label = (shape.get("label") or "").strip()
    if not label:
        found.add(where, "category-unknown", "no label", "a label", "correct the annotation")
        return None
    corners = mask = None
    if shape.tag == "box":
        edges = to_floats([shape.get(k) for k in _EDGES], 4)
        turn = to_floats([shape.get("rotation", "0")], 1)
        if edges is None or turn is None:
            found.add(where, "box-malformed", "no box", "xtl, ytl, xbr, ybr", "correct the annotation")
            return None
        if "rotation" in shape.attrib and is_near((*edges, *turn)):
            x0, y0, x1, y1 = edges
            cxcywha = ((x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0, math.radians(turn[0]))
            corners, edges = turned_box(cxcywha, size_wh)
    elif shape.tag == "ellipse":
        drawn = _read_ellipse(found, shape, where, size_wh)
        if drawn is None:
            return None
        edges, mask = drawn
    else:
        mask = _read_mask(found, shape, where, size_wh)
        if mask is None:
            return None
        around = mask.box_xyxy
        if around is None:
            found.warn(where, "mask-malformed", "no pixel", "a mask inside the frame")
            return None
        edges = tuple(around.tolist())
    box = found.box(edges, size_wh, where)
    if box is None:
        return None
    said = {a.get("name"): (a.text or "").strip() for a in shape.findall("attribute")}
    occluded = {"occluded": True} if shape.get("occluded") == "1" else {}
    return Instance(
        label,
        box,
        corners,
        mask,
        to_share(said.get("visibility")),
        to_bool(said.get("truncated")),
        to_bool(said.get("difficult")),
        to_bool(said.get("inserted")) is True,
        None,
        occluded,
        plain_id(said["track_id"]) if said.get("track_id") else None,
    )


def _read_ellipse(
    found: Findings, shape: Any, where: str, size_wh: tuple[int, int] | None
) -> tuple[tuple[float, ...], Mask | None] | None:
    """Return the edges and pixels of an ellipse; None, with a problem, if it is malformed."""
    numbers = to_floats(
        [shape.get(k, "0" if k == "rotation" else None) for k in ("cx", "cy", "rx", "ry", "rotation")], 5
    )
    fault = "no size of the picture" if size_wh is None else "no cx, cy, rx, ry"
    if numbers is not None and size_wh is not None:
        try:
            cx, cy, rx, ry, turn = numbers
            return ellipse((cx, cy, 2 * rx, 2 * ry, math.radians(turn)), size_wh)
        except ValueError as error:
            fault = str(error)[:120]
    found.add(where, "box-malformed", fault, "an ellipse inside the frame", "correct the annotation")
    return None


def _read_mask(found: Findings, shape: Any, where: str, size_wh: tuple[int, int] | None) -> Mask | None:
    fault = "no size of the picture" if size_wh is None else ""
    if size_wh is not None:
        try:
            if shape.tag == "polygon":
                points = [v for pair in (shape.get("points") or "").split(";") for v in pair.split(",")]
                return Mask.from_rings([points], (size_wh[1], size_wh[0]))
            return Mask.from_array(_pixels(shape, size_wh))
        except (ValueError, OverflowError) as error:
            fault = str(error)[:120]
    found.add(where, "mask-malformed", fault, "run lengths or points inside the frame")
    return None


def _pixels(shape: Any, size_wh: tuple[int, int]) -> NDArray[np.bool_]:
    """Return (h, w) the pixels of an element `mask`; ValueError if they do not fit the frame."""
    left, top, width, height = (to_int(shape.get(k)) for k in ("left", "top", "width", "height"))
    if left is None or top is None or width is None or height is None:
        raise ValueError("no left, top, width and height")
    inside = min(left, top) >= 0 and min(width, height) > 0 and left + width <= size_wh[0]
    if not inside or top + height > size_wh[1]:
        raise ValueError("a rectangle that is not inside the frame")
    runs = [to_int(v) for v in (shape.get("rle") or "").split(",")]
    if any(r is None or r < 0 for r in runs) or sum(r or 0 for r in runs) != width * height:
        raise ValueError("run lengths that do not fill the rectangle")
    values = np.arange(len(runs)) % 2 == 1
    pixels = np.zeros((size_wh[1], size_wh[0]), np.bool_)
    pixels[top : top + height, left : left + width] = np.repeat(values, runs).reshape(height, width)  # type: ignore[arg-type]
    return pixels
