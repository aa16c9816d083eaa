"""Pascal VOC: one XML file per picture, in VOC's folders, beside the pictures, or in one folder per split.

    Annotations/<stem>.xml   JPEGImages/<stem>.jpg   ImageSets/Main/{train,val,test}.txt   [labelmap.txt]
    [train|val|test/]<stem>.xml beside <stem>.jpg, or in annotations/ and images/, xml/ and img/

Boxes are `xmin, ymin, xmax, ymax` in pixels. With `origin=0` these are edges, counted from 0, as HIT-UAV, LabelImg and
most tools write them. With `origin=1` they are the first and last pixel, counted from 1, as in the original VOC
challenge: the edges are `xmin - 1, ymin - 1, xmax, ymax`. The `robndbox` of roLabelImg (`cx, cy, w, h, angle`, radians,
clockwise on screen) is read as well.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any
from xml.sax.saxutils import escape

from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.files import link_or_copy, write_text
from infrablend.core.run_folder import kept_aside
from infrablend.formats.annotation_files import child_text, read_xml
from infrablend.formats.base import (
    Match,
    category_ids,
    check_splits,
    ignored_by_class,
    in_order,
    is_ignored_name,
    names_of,
    require_known,
    require_options,
    require_size,
    unmarked_regions,
)
from infrablend.formats.box_checks import is_near, snap_edges, turned_box
from infrablend.formats.losses import Written, count_dropped
from infrablend.formats.pictures.listing import (
    PictureKey,
    folder_split,
    is_hidden,
    list_pictures,
    picture_key,
    plain_name,
    walk,
)
from infrablend.formats.records import KEEP_OR_DROP, Findings, unlabelled_problems
from infrablend.formats.values import number_text, to_bool, to_floats, to_number, to_size

NAME = "voc"
OPTIONS = {
    "origin": "meaning of boxes: 0 (the default), edges counted from 0; 1, first and last pixel counted from 1, as in "
    "the VOC challenge",
    "unlabelled": "keep or drop pictures without an XML file; keep is the default",
}
DATABASE = "InfraBlend VOC"
"""Value of `source/database` in our files, which makes HIT-UAV's reader ignore them."""

BOX_FIELDS = ("xmin", "ymin", "xmax", "ymax")
TURNED_FIELDS = ("cx", "cy", "w", "h", "angle")
"""Fields of an object's box, upright and oriented."""
SPLIT_LISTS: Mapping[str, Split] = {s: s for s in SPLITS}
"""Split by the stem of the list of its pictures."""
_LABELMAP = "labelmap.txt"
# Below the root of a file, what tells of the picture, and what only an object has.
_OF_PICTURE = {"folder", "filename", "path", "source", "owner", "size", "segmented"}
_SHAPES = {"bndbox", "robndbox", "polygon"}
_MOST_TRIED = 1000  # of which at most 20 can be read; damaged files must not hide the others


# -- finding ---------------------------------------------------------------------------------------------------


def list_xml(root: Path) -> Iterable[str]:
    """Yield the XML files below a folder, sorted within each folder, without hidden files and linked folders."""
    for base, names in walk(root):
        prefix = "" if Path(base) == root else Path(base).relative_to(root).as_posix() + "/"
        yield from (prefix + n for n in sorted(names) if n.lower().endswith(".xml") and not is_hidden(n))


def detect(root: Path) -> Match:
    """Decide whether `root` contains VOC files: XML with the root `annotation`, and a picture for one of the first."""
    names = list(islice(list_xml(root), _MOST_TRIED))
    if not names:
        return Match(NAME, False, "no XML file in the folder or below it")
    pictures = {picture_key(n) for n in list_pictures(root)}
    reason = f"no picture for {names[0]} or the next XML files"
    readable = 0
    for name in names:
        top, problem = read_xml(root / name, name)
        _strip_namespaces(top)
        readable += problem is None
        if readable > 20:
            break
        if problem is not None or top.tag != "annotation":
            reason = f"{name}: {problem.found if problem else f'root element <{top.tag}>, not <annotation>'}"
        elif picture_key(name) in pictures or _named(name, top) in pictures:
            return Match(NAME, True, f"VOC files such as {name}")
    return Match(NAME, False, reason)


def _strip_namespaces(top: Any) -> None:
    """Remove the namespaces from the names of a file's elements, if the root or elements below it have any."""
    if top is not None and any(e.tag.startswith("{") for e in (top, *top)):
        for element in top.iter():
            element.tag = element.tag.rpartition("}")[2]


def _named(name: str, top: Any) -> PictureKey:
    """Return the key of the picture that the XML file names; folders in that name are ignored."""
    said = re.split(r"[\\/]", child_text(top, "filename") or "")[-1]
    folder = picture_key(name)[:-1]
    return (*folder, PurePosixPath(said).stem if re.search(r"\.\w{2,5}$", said) else said)


# -- reading ---------------------------------------------------------------------------------------------------


COUNTS = ("files", "objects", "read", "parts", "unlabelled")
"""What is counted: files, objects in them, objects read, parts of objects, and pictures without a file."""


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    origin: str = "0",
    unlabelled: str = "keep",
) -> Dataset:
    """Read VOC files and their pictures.

    Raises:
        DatasetError: An option is unknown, or no picture can be read.
    """
    require_options(root, origin=(origin, ("0", "1")), unlabelled=(unlabelled, KEEP_OR_DROP))
    wanted = check_splits(splits)
    found = Findings(root)
    order = _labelmap(found)
    records = read_folder(found, wanted, origin == "1", unlabelled)
    names = [*order, *(n for n in names_of(records) if n not in order)]
    categories = tuple(Category(k, n, "", is_ignored_name(n)) for k, n in enumerate(names))
    notes = {"labels": NAME, "origin": int(origin), "rows": found.rows(*COUNTS)}
    return found.dataset(NAME, records, categories, notes, metadata=metadata, splits=wanted)


def read_folder(found: Findings, splits: Sequence[Split], from_one: bool, unlabelled: str) -> list[ImageRecord]:
    """Read all XML files below a folder with their pictures, and the pictures without an XML file.

    The records have no ids; those without an XML file have `labelled` False in `extra`.
    """
    root = found.root
    pictures: dict[PictureKey, list[str]] = {}
    for name in (paths := list_pictures(root)):
        pictures.setdefault(picture_key(name), []).append(name)
    split_of = _splits(found, {key[-1] for key in pictures})
    records: dict[str, ImageRecord] = {}
    unlisted: list[str] = []
    skipped: set[str] = set()
    for name in list_xml(root):
        split = split_of.get(picture_key(name)[-1]) if split_of else folder_split(name)
        if split is None:
            unlisted.append(name)
            split = "train"
        top = _read_annotation(found, name) if split in splits else None
        picture = None if top is None else _find_picture(found, name, top, pictures, records)
        if picture is None:
            skipped.update(pictures.get(picture_key(name), ()))
            continue
        found.counts["files"] += 1
        size_wh = _size(found, top, name, paths[picture], picture)
        instances = _objects(found, top, name, size_wh, from_one)
        records[picture] = ImageRecord("", paths[picture], split, size_wh, instances, file_name=plain_name(picture))
    left = {
        name: split_of.get(picture_key(name)[-1], "train") if split_of else folder_split(name)
        for name in paths
        if name not in records and name not in skipped
    }
    left = {name: split for name, split in left.items() if split in splits}
    found.problems += unlabelled_problems(root.name, len(left), unlabelled, "no XML file")
    found.counts["unlabelled"] = len(left)
    for name, split in left.items() if unlabelled == "keep" else ():
        unsaid = {"labelled": False}
        records[name] = ImageRecord("", paths[name], split, None, (), extra=unsaid, file_name=plain_name(name))
    if unlisted:
        text = f"{len(unlisted)} file(s) in no list of ImageSets/Main are read as train: {', '.join(unlisted[:3])}"
        found.warn(root.name, "split-unknown", text, "every stem in one list")
    if found.counts["parts"]:
        text = f"{found.counts['parts']} part(s) of objects were left out"
        found.warn(root.name, "part-unread", text, "objects without parts")
    return list(records.values())


def _read_annotation(found: Findings, name: str) -> Any:
    top = found.xml(found.root / name)
    _strip_namespaces(top)
    if top is None or top.tag == "annotation":
        return top
    said = f"root element <{top.tag}>"
    found.add(name, "annotation-layout", said, "<annotation>", "use VOC or roLabelImg files")
    return None


def _size(found: Findings, top: Any, where: str, path: Path, picture: str) -> tuple[int, int] | None:
    said = child_text(top, "size/width"), child_text(top, "size/height")
    size_wh = to_size(*said)
    if size_wh is not None:
        return size_wh
    text = f"size {said[0]!r} x {said[1]!r}; the picture's size is used"
    found.warn(where, "image-size-unknown", text, "width and height in px")
    return found.size(path, picture)


def _find_picture(
    found: Findings, name: str, top: Any, pictures: Mapping[PictureKey, list[str]], taken: Mapping[str, ImageRecord]
) -> str | None:
    """Return the picture with the XML file's name, else the one named inside it; or None, with a problem."""
    own = picture_key(name)
    named = _named(name, top)
    said = child_text(top, "filename") or ""
    choices = pictures.get(own) or pictures.get(named) or []
    if not choices:
        text = f"no picture {said or own[-1]!r}"
        found.add(name, "image-missing", text, "a picture of the same name", "restore it")
        return None
    if named != own and own in pictures and named in pictures:
        text = f"filename {said!r}, which is another picture; {choices[0]!r} is used"
        found.warn(name, "name-disagrees", text, "the name of the XML file")
    picture = next((c for c in choices if PurePosixPath(c).name == said), choices[0])
    if picture in taken:
        text = f"a second file for {picture!r}"
        found.add(name, "image-duplicate", text, "each picture once", "leave out one of them")
        return None
    return picture


def _splits(found: Findings, stems: Collection[str]) -> dict[str, Split]:
    """Return the split per stem from the lists in `ImageSets/Main`; empty if there are none."""
    root = found.root
    aside = kept_aside(root)
    places = sorted(p for depth in ("", "*/", "*/*/") for p in root.glob(depth + "ImageSets/Main"))
    folders = [p for p in places if p.relative_to(root).parts[0] not in aside]
    if not folders:
        return {}
    lists = dict(SPLIT_LISTS)
    if not (folders[0] / "train.txt").is_file():
        lists["trainval"] = "train"
    return read_lists(found, folders[0], stems, lists)


def read_lists(
    found: Findings, folder: Path, stems: Collection[str], lists: Mapping[str, Split] = SPLIT_LISTS
) -> dict[str, Split]:
    """Return the split per stem from the lists in a folder `ImageSets/Main`; a stem in two lists is a problem."""
    split_of: dict[str, Split] = {}
    for stem, split in lists.items():
        path = folder / f"{stem}.txt"
        text = found.text(path, "a list of stems") if path.is_file() else None
        for line in (text or "").splitlines():
            # Lists of a single class add 1, 0 or -1 to each stem; some tools do so in all lists.
            listed = line if line in stems else line.strip()
            listed = listed if listed in stems else re.sub(r"\s+(-1|0|1)$", "", listed)
            if listed and split_of.setdefault(listed, split) != split and stem != "trainval":
                said = f"{listed!r} is also in {split_of[listed]}, which is used"
                found.warn(found.place(path), "split-twice", said, "each stem in one list")
    return split_of


def _labelmap(found: Findings) -> list[str]:
    """Return category names in the order of `labelmap.txt` (`name:colour:parts:actions`); none if it does not exist."""
    path = found.root / _LABELMAP
    text = found.text(path, "a line per class") if path.is_file() else None
    entries = [s for s in (text or "").splitlines() if not s.lstrip().startswith("#")]
    # A name may contain colons; only three separate the fields.
    lines = [(s.rsplit(":", 3) if s.count(":") >= 3 else s.split(":"))[0].strip() for s in entries]
    return list(dict.fromkeys(s for s in lines if s and s != "background"))


def _elements(found: Findings, top: Any, where: str) -> Iterator[Any]:
    """Yield the objects below the root or in an element `objects` there; count objects under other names."""
    for element in (e for child in top for e in (child if child.tag == "objects" else (child,))):
        if element.tag == "object":
            yield element
        elif element.tag not in _OF_PICTURE:
            shapes = sum(e.tag in _SHAPES for e in element.iter())
            if shapes or element.tag.lower() == "object":
                found.leave_out(f"<{element.tag}>", where, shapes or 1)


def _objects(
    found: Findings, top: Any, where: str, size_wh: tuple[int, int] | None, from_one: bool
) -> tuple[Instance, ...]:
    instances = []
    for k, element in enumerate(_elements(found, top, where)):
        found.counts["objects"] += 1
        found.counts["parts"] += len(element.findall("part"))
        here = f"{where}: object {k}"
        name = child_text(element, "name")
        if not name:
            found.add(here, "category-unknown", "no name", "a category's name", "correct the annotation")
            continue
        instance = _object(found, element, here, name, size_wh, from_one)
        if instance is not None:
            instances.append(instance)
    found.counts["read"] += len(instances)
    return tuple(instances)


def _object(
    found: Findings, element: Any, where: str, name: str, size_wh: tuple[int, int] | None, from_one: bool
) -> Instance | None:
    """Return an object with its box, any oriented box, and flags; None, with a problem, if the box is invalid."""
    boxes = element.findall("bndbox")
    keys, said = box_fields(element)
    values = to_floats(said, len(keys))
    if values is None:
        text = "no bndbox" if said is None else f"box {said}"[:120]
        found.add(where, "box-malformed", text, ", ".join(keys), "correct the annotation")
        return None
    for _ in boxes[1:]:
        found.leave_out("further bndbox of an object", where)
    for _ in element.findall("polygon"):
        found.leave_out("polygon beside a box", where)
    corners = None
    if keys == TURNED_FIELDS:
        if not all(math.isfinite(v) and abs(v) < 1e9 for v in values) or values[2] <= 0 or values[3] <= 0:
            code = "box-empty" if all(math.isfinite(v) for v in values) else "box-not-finite"
            expected = "finite numbers, with width and height above 0"
            found.add(where, code, f"box {said}"[:120], expected, "correct the annotation")
            return None
        corners, edges = turned_box(values, size_wh)
    else:
        first = 1.0 if from_one else 0.0
        edges = tuple(snap_edges((values[0] - first, values[1] - first, values[2], values[3]), size_wh))
        if (angle := _rotation_rad(element)) and is_near(edges) and edges[0] < edges[2] and edges[1] < edges[3]:
            (x0, y0, x1, y1) = edges
            corners, edges = turned_box(((x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0, angle), size_wh)
    box = found.box(edges, size_wh, where)
    if box is None:
        return None
    flags = {flag: read_flag(found, element, flag, where) for flag in ("truncated", "difficult", "occluded")}
    extra: dict[str, object] = {} if flags["occluded"] is None else {"occluded": flags["occluded"]}
    pose = read_pose(element)
    if pose is not None:
        extra["pose"] = pose
    inserted = to_bool(child_text(element, "inserted")) is True
    return Instance(
        name, box, corners, truncated=flags["truncated"], difficult=flags["difficult"], inserted=inserted, extra=extra
    )


def box_fields(element: Any) -> tuple[Sequence[str], list[str | None] | None]:
    """Return the names of the numbers of an object's box, and what the file says for each; None without a box."""
    turned = element.find("robndbox")
    keys = BOX_FIELDS if turned is None else TURNED_FIELDS
    box = element.find("bndbox") if turned is None else turned
    return keys, None if box is None else [child_text(box, k) for k in keys]


def read_flag(found: Findings, element: Any, flag: str, where: str) -> bool | None:
    """Return a flag of an object; None without one, or with a warning if it is neither 0 nor 1."""
    value = child_text(element, flag)
    if not value:
        return None
    flagged = to_bool(value)
    if flagged is None:
        found.warn(where, "flag-value", f"{flag} {value[:40]!r}, which is ignored", "0 or 1")
    return flagged


def read_pose(element: Any) -> str | None:
    """Return the pose of an object; None without one."""
    pose = child_text(element, "pose")
    return pose if pose and pose != "Unspecified" else None


def _rotation_rad(element: Any) -> float:
    """Return the angle by which CVAT turns a box about its centre; 0 without one."""
    said = {child_text(a, "name"): child_text(a, "value") for a in element.findall("attributes/attribute")}
    return math.radians((to_number(said.get("rotation")) or 0.0) % 360)


# -- writing ---------------------------------------------------------------------------------------------------


def write(
    out: Path,
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    *,
    pictures: bool = True,
) -> Written:
    """Write `Annotations/<stem>.xml`, `ImageSets/Main/*.txt`, `labelmap.txt`, and link the pictures to `JPEGImages/`.

    Boxes are edges counted from 0 (`origin=0`), with up to eight decimals. `labelmap.txt` keeps the order of the
    categories, but not their ids. Inserted objects get the element `inserted`, which other tools ignore. Unknown flags
    are written as 0.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A size is missing, a category is not in the list, or two pictures have the same stem.
    """
    ordered = in_order(images)
    known = category_ids(categories)
    losses: Counter[str] = Counter()
    unsaid = ignored_by_class(categories)
    stems: dict[str, Split] = {}
    files: list[Path] = []
    for image in ordered:
        stem = image.name.rpartition(".")[0] or image.name
        if "/" in image.name or stem in stems:
            raise ValueError(
                f"{image.id}: {image.name!r} does not fit: its name has a folder, or the stem of another picture"
            )
        stems[stem] = image.split
        files.append(write_text(out / "Annotations" / f"{stem}.xml", _xml(image, known, losses)))
        losses["ignore_as_class"] += unmarked_regions(image.instances, unsaid)
        if pictures:
            files.append(link_or_copy(image.path, out / "JPEGImages" / image.name))
    lists: dict[str, list[str]] = {s: [n for n, split in stems.items() if split == s] for s in SPLITS}
    lists["trainval"] = lists["train"] + lists["val"]
    for name, listed in lists.items():
        files.append(write_text(out / "ImageSets" / "Main" / f"{name}.txt", "".join(f"{n}\n" for n in listed)))
    text = "# label:color_rgb:parts:actions\n" + "".join(f"{n}:::\n" for n in known)
    files.append(write_text(out / _LABELMAP, text))
    return Written.of(files, losses)


def _xml(image: ImageRecord, known: Mapping[str, int], losses: Counter[str]) -> str:
    w, h = require_size(image)
    lines = [
        "<annotation>",
        "  <folder>JPEGImages</folder>",
        f"  <filename>{escape(image.name)}</filename>",
        f"  <source><database>{DATABASE}</database></source>",
        f"  <size><width>{w}</width><height>{h}</height><depth>{image.extra.get('depth', 1)}</depth></size>",
        "  <segmented>0</segmented>",
    ]
    require_known(image, known)
    for i in image.instances:
        count_dropped(i, losses, "obb", "mask", "visibility", "occlusion boxes")
        box = "".join(f"<{k}>{number_text(v)}</{k}>" for k, v in zip(BOX_FIELDS, i.box_xyxy, strict=True))
        lines += [
            "  <object>",
            f"    <name>{escape(i.category)}</name>",
            f"    <pose>{escape(str(i.extra.get('pose', 'Unspecified')))}</pose>",
            f"    <truncated>{int(bool(i.truncated))}</truncated>",
            f"    <difficult>{int(bool(i.difficult))}</difficult>",
        ]
        if "occluded" in i.extra:
            lines.append(f"    <occluded>{int(bool(i.extra['occluded']))}</occluded>")
        if i.inserted:
            lines.append("    <inserted>1</inserted>")
        lines += [f"    <bndbox>{box}</bndbox>", "  </object>"]
    return "\n".join([*lines, "</annotation>", ""])
