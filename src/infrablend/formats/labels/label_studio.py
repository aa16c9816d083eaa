"""Label Studio: a JSON list of tasks per split, with rectangles and brush masks, and the labelling interface.

    <split>.json    label_config.xml    images/<split>/<name>

Places are percent of the picture. A rectangle's `x, y` is its first corner, about which `rotation` turns it, in
degrees clockwise. A brush is the run-length code of the package `rle-pack`: bits, most significant first, of a picture
with four channels. Label Studio's local storage serves the pictures: an address ends in `images/<split>/<name>`.
"""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from urllib.parse import parse_qs, quote, unquote, urlsplit
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.files import link_or_copy, write_chunks, write_text
from infrablend.core.json_records import Streamed, is_list, json_chunks
from infrablend.core.rle_masks import Mask
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import files_with, read_json
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
    split_folders,
    split_of_stem,
    split_parts,
    unmarked_regions,
)
from infrablend.formats.box_checks import is_near, is_rectangle, obb_from_corners, overhang_px, turned_box
from infrablend.formats.losses import Written, count_dropped
from infrablend.formats.pictures.listing import MAX_PIXELS, PictureFolder, check_name
from infrablend.formats.polygons import ellipse
from infrablend.formats.records import Findings, annotated_twice
from infrablend.formats.values import to_bool, to_floats, to_id, to_number, to_share, to_size

NAME = "label-studio"
CONFIG_FILE = "label_config.xml"
BOXES = "boxes"
BRUSH = "masks"
"""Names of the two controls in the labelling interface."""

_SERVED = "/data/local-files/?d="
_KINDS = ("rectanglelabels", "brushlabels", "polygonlabels", "ellipselabels")
_RUN_BITS = (3, 4, 8, 16)
_FLAGS = ("inserted", "truncated", "difficult", "occluded")
# What Label Studio puts before the names of pictures that are uploaded.
_PREFIX = re.compile(r"[0-9a-f]{8}-(?=.)")


# -- writing ---------------------------------------------------------------------------------------------------


def write(
    out: Path, images: Iterable[ImageRecord], categories: Sequence[Category], *, pictures: bool = True
) -> Written:
    """Write `<split>.json` and `label_config.xml`, and link the pictures to `images/<split>/`.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A size is missing, or a category is not in the list.
    """
    ordered = in_order(images)
    known = category_ids(categories)
    losses: Counter[str] = Counter()
    unsaid = ignored_by_class(categories)
    masks = any(o.mask is not None for i in ordered for o in i.instances)
    files = [write_text(out / CONFIG_FILE, _config(list(known), masks))]
    for split, part in split_parts(ordered).items():
        tasks = Streamed(_task(i, known, losses) for i in part)
        files.append(write_chunks(out / f"{split}.json", chain(json_chunks(tasks, None), "\n")))
    for image in ordered:
        losses["ignore_as_class"] += unmarked_regions(image.instances, unsaid)
        if pictures:
            files.append(link_or_copy(image.path, out / "images" / image.split / image.name))
    return Written.of(files, losses)


def _config(names: Sequence[str], masks: bool) -> str:
    lines = ["<View>", '  <Image name="image" value="$image" zoom="true"/>']
    controls = (("RectangleLabels", BOXES, ' canRotate="true"'), *((("BrushLabels", BRUSH, ""),) if masks else ()))
    for tag, name, more in controls:
        lines.append(f'  <{tag} name="{name}" toName="image"{more}>')
        lines += [f"    <Label value={quoteattr(n)}/>" for n in names]
        lines.append(f"  </{tag}>")
    return "\n".join([*lines, "</View>", ""])


def _task(image: ImageRecord, known: Mapping[str, int], losses: Counter[str]) -> dict[str, object]:
    w, h = require_size(image)
    results = []
    require_known(image, known)
    for n, i in enumerate(image.instances):
        count_dropped(i, losses, "occlusion boxes")
        common = {"to_name": "image", "image_rotation": 0, "original_width": w, "original_height": h, "meta": _meta(i)}
        value = {**_rectangle(i, w, h, losses), "rectanglelabels": [i.category]}
        results.append({**common, "id": f"o{n}", "from_name": BOXES, "type": "rectanglelabels", "value": value})
        if i.mask is not None and i.mask.area_px:
            brush = {"format": "rle", "rle": encode_brush(i.mask.to_array()), "brushlabels": [i.category]}
            results.append({**common, "id": f"o{n}m", "from_name": BRUSH, "type": "brushlabels", "value": brush})
    data = {"image": f"{_SERVED}{quote(f'images/{image.split}/{image.name}')}", "width": w, "height": h}
    return {"data": data, "annotations": [{"result": results, "ground_truth": False}]}


def _meta(i: Instance) -> dict[str, object]:
    """Return what Label Studio has no place for; it keeps and exports the field."""
    flags = {"inserted": i.inserted or None, "truncated": i.truncated, "difficult": i.difficult}
    flags |= {"oriented": None if i.corners_xy is None else True}
    known = flags | {"occluded": i.extra.get("occluded"), "visibility": i.visibility, "track_id": i.track_id}
    return {k: v for k, v in known.items() if v is not None}


def _rectangle(i: Instance, w: int, h: int, losses: Counter[str]) -> dict[str, float]:
    if i.corners_xy is None:
        x, y = i.box_xyxy[:2]
        width, height = i.box_xyxy[2:] - i.box_xyxy[:2]
        turn = 0.0
    else:
        cx, cy, width, height, angle = obb = obb_from_corners(i.corners_xy)
        losses["obb_not_rectangle"] += not is_rectangle(i.corners_xy, obb)
        x, y = _first_corner(cx, cy, width, height, angle)
        turn = math.degrees(angle)
    percent = {"x": x / w, "y": y / h, "width": width / w, "height": height / h}
    return {**{k: round(100 * float(v), 10) for k, v in percent.items()}, "rotation": round(turn, 10)}


def _first_corner(cx: float, cy: float, w: float, h: float, angle: float) -> tuple[float, float]:
    """Return the corner that is upper left before the rectangle is turned about its centre."""
    cos, sin = math.cos(angle), math.sin(angle)
    return cx - w / 2 * cos + h / 2 * sin, cy - w / 2 * sin - h / 2 * cos


def encode_brush(mask: NDArray[np.bool_]) -> list[int]:
    """Return the bytes of a brush: the mask as 0 and 255 in four channels, packed as `rle-pack` does."""
    flat = mask.reshape(-1)
    ends = np.flatnonzero(np.concatenate([flat[1:] != flat[:-1], [True]])) + 1
    bits = [f"{4 * flat.size:032b}", f"{8 - 1:05b}", *(f"{n - 1:04b}" for n in _RUN_BITS)]
    for start, end in zip(np.concatenate([[0], ends[:-1]]), ends, strict=True):
        value = f"{255 * int(flat[start]):08b}"
        left = 4 * int(end - start)
        while left:
            run = min(left, 1 << _RUN_BITS[-1])
            size = next(k for k, n in enumerate(_RUN_BITS) if run <= 1 << n)
            bits.append(f"1{size:02b}{run - 1:0{_RUN_BITS[size]}b}{value}")
            left -= run
    text = "".join(bits)
    text += "0" * (-len(text) % 8)
    return list(int(text, 2).to_bytes(len(text) // 8, "big"))


# -- reading ---------------------------------------------------------------------------------------------------


def decode_brush(code: object, size_wh: tuple[int, int]) -> NDArray[np.bool_]:
    """Return (h, w) the pixels of a brush that are at least half opaque.

    Raises:
        ValueError: The code is damaged or of a picture of another size.
    """
    count = 4 * size_wh[0] * size_wh[1]
    if not isinstance(code, list) or not all(type(v) is int and 0 <= v < 256 for v in code):
        raise ValueError("no list of bytes")
    if size_wh[0] * size_wh[1] > MAX_PIXELS or len(code) > 2 * count + 64:
        raise ValueError("a code longer than the picture")
    bits = np.unpackbits(np.array(code, np.uint8)).tobytes().translate(bytes.maketrans(b"\0\1", b"01"))
    at = 0

    def take(n: int) -> int:
        nonlocal at
        part = bits[at : at + n]
        at += n
        if len(part) < n:
            raise ValueError("a code that ends early")
        return int(part, 2)

    if take(32) != count:
        raise ValueError(f"a code that is not of {size_wh[0]}x{size_wh[1]} px")
    word = take(5) + 1
    sizes = [take(4) + 1 for _ in range(4)]
    values = np.zeros(count, np.uint32)
    done = 0
    while done < count:
        same = take(1)
        end = min(done + 1 + take(sizes[take(2)]), count)
        if same:
            values[done:end] = take(word)
        else:
            values[done:end] = [take(word) for _ in range(end - done)]
        done = end
    return np.asarray(values.reshape(size_wh[1], size_wh[0], 4)[:, :, 3] >= 128)


def _files(root: Path) -> list[Path]:

    def is_ours(head: bytes) -> bool:
        return head.lstrip().startswith(b"[") and b'"annotations"' in head and b'"result"' in head

    return files_with(root, "*.json", is_ours, 100_000)


def detect(root: Path) -> Match:
    """Decide whether `root` contains lists of Label Studio's tasks."""
    files = _files(root)
    if not files:
        return Match(NAME, False, "no JSON list of tasks with annotations")
    return Match(NAME, True, f"Label Studio: {', '.join(p.name for p in files)}")


def read(root: Path, *, splits: Iterable[str] | None = None, metadata: Path | None = None) -> Dataset:
    """Read tasks, as written here or as Label Studio exports them (JSON), and find the pictures in `images/`.

    Raises:
        DatasetError: There is no list of tasks, or no picture can be read.
    """
    wanted = check_splits(splits)
    files = _files(root)
    if not files:
        missing = Problem(str(root), "annotation-missing", "no list of tasks", "<split>.json")
        raise DatasetError(f"{root}: not Label Studio's JSON", [missing])
    found = Findings(root)
    records: dict[Path, ImageRecord] = {}
    twice: dict[str, list[ImageRecord]] = defaultdict(list)
    folder = PictureFolder.scan(root / "images")
    places = [(split, f"{inside.name}/") for split, inside in split_folders(folder.folder)]
    for path in files:
        try:
            tasks = read_json(path)
        except DatasetError as error:
            found.problems += error.problems
            continue
        for n, task in enumerate(tasks if is_list(tasks) else ()):
            record = _read_task(found, task, f"{path.name}: task {n}", split_of_stem(path.stem), folder, places)
            if record is None or record.split not in wanted:
                continue
            if records.setdefault(record.path, record) is not record:
                twice[path.name].append(record)
    found.problems += annotated_twice(twice)
    categories = named_categories(dict.fromkeys(i.category for r in records.values() for i in r.instances))
    return found.dataset(NAME, records.values(), categories, {"labels": NAME}, metadata=metadata, splits=wanted)


def _read_task(
    found: Findings, task: object, where: str, split: Split, folder: PictureFolder, places: Sequence[tuple[Split, str]]
) -> ImageRecord | None:
    """Return the picture of a task, found in `folder` in one of the `places` of its split, else anywhere."""
    data = task.get("data") if isinstance(task, dict) else None
    address = data.get("image") if isinstance(data, dict) else None
    if not isinstance(task, dict) or not isinstance(data, dict) or not isinstance(address, str):
        found.add(where, "annotation-malformed", repr(task)[:80], "a task with data.image")
        return None
    for name, its_split in _names_of(address, split):
        fault = check_name(name, where)
        picture = None
        for place in (*(p for s, p in places if s == its_split), "") if fault is None else ():
            _, picture, fault = folder.find(place + name, where)
            if picture is not None:
                break
        if picture is not None:
            break
    if fault is None and picture is None:
        fault = Problem(where, "image-missing", f"no picture {name!r}", "a file in images/", "put the pictures there")
    if fault is not None or picture is None:
        found.problems += [fault] if fault else []
        return None
    rows = _rows(found, task, where)
    stated = [(data.get("width"), data.get("height"))]
    stated += [(r.get("original_width"), r.get("original_height")) for r in rows]
    size_wh = next((s for w, h in stated if (s := to_size(w, h))), None)
    instances = tuple(_read_objects(found, rows, size_wh, where))
    return ImageRecord("", picture, its_split, size_wh, instances, file_name=name)


def _rows(found: Findings, task: Mapping[str, object], where: str) -> list[Mapping[str, object]]:
    """Return the results of the last annotation of a task that has any and was not cancelled; count the others."""
    given = _objects_of(task.get("annotations"))
    used = [a for a in given if not a.get("was_cancelled")]
    chosen: Mapping[str, object] = next((a for a in reversed(used) if _objects_of(a.get("result"))), {})
    others = {
        "in a cancelled annotation": [a for a in given if a.get("was_cancelled")],
        "in an earlier annotation": [a for a in used if a is not chosen],
        "predicted by a model": [] if used else _objects_of(task.get("predictions")),
        **{f"in {k}": _objects_of(task.get(k)) for k in ("drafts", "completions")},
    }
    for kind, left in others.items():
        if count := sum(len(_objects_of(a.get("result"))) for a in left):
            found.leave_out(kind, where, count)
    return _objects_of(chosen.get("result"))


def _objects_of(value: object) -> list[Mapping[str, object]]:
    """Return the JSON objects in a list; none of anything else."""
    return [v for v in value if isinstance(v, dict)] if isinstance(value, list) else []


def _names_of(address: str, split: Split) -> Iterator[tuple[str, Split]]:
    """Yield the names that a picture may have in its split, and the split, of an address or path.

    It ends in images/<split>/<name>, and the name may have a folder `images`, too; else only its last part is the name.
    """
    try:
        parts = urlsplit(address)
        path = parse_qs(parts.query).get("d", [unquote(parts.path)])[0]
    except ValueError:
        path = address
    folders = path.replace("\\", "/").split("/")
    starts = [n for n, folder in enumerate(folders[:-1], 1) if folder == "images"]
    for start in starts[:3] + starts[3:][-1:]:
        stated = SPLIT_FOLDERS.get(folders[start].lower()) if start + 1 < len(folders) else None
        yield "/".join(folders[start + bool(stated) :]), stated or split
    if not starts:
        yield folders[-1], split
        if "upload" in folders[:-1] and _PREFIX.match(folders[-1]):
            yield _PREFIX.sub("", folders[-1], count=1), split


def _read_objects(
    found: Findings, rows: Sequence[Mapping[str, object]], size_wh: tuple[int, int] | None, where: str
) -> Iterable[Instance]:
    """Return the objects of a task; a brush whose id is that of a rectangle with an `m` is its mask."""
    objects: dict[str, Instance] = {}
    for n, row in enumerate(_joined(rows)):
        if row.get("type") not in _KINDS:
            found.leave_out(str(row.get("type")), where)
            continue
        here = f"{where}: result {row.get('id', n)}"
        stated = to_size(row.get("original_width"), row.get("original_height"))
        if stated not in (None, size_wh) or to_number(row.get("image_rotation") or 0) != 0:
            said = (
                f"drawn on {stated} px, image_rotation {row.get('image_rotation', 0)!r}; the picture has {size_wh} px"
            )
            found.add(here, "annotation-malformed", said[:160], "the picture as it is", "label it again, not turned")
            continue
        try:
            instance = _read_result(found, row, here)
        except ValueError as error:
            found.add(here, "annotation-malformed", str(error)[:120], "a rectangle, brush, polygon or ellipse")
            continue
        if instance is None:
            continue
        key = str(row.get("id", n))
        owner = objects.get(key.removesuffix("m")) if row["type"] == "brushlabels" else None
        if owner is not None and owner.mask is None:
            objects[key.removesuffix("m")] = replace(owner, mask=instance.mask)
        else:
            objects[key if key not in objects else f"{key} {n}"] = instance
    return objects.values()


def _joined(rows: Sequence[Mapping[str, object]]) -> list[Mapping[str, object]]:
    """Return the results, with shapes and their labels from separate controls in one result.

    `<Rectangle>` beside `<Labels>` gives two results with the id of the region: `rectangle` and `labels`.
    """
    labels: dict[str, object] = {}
    for r in rows:
        value = r.get("value")
        if r.get("type") == "labels" and "id" in r and isinstance(value, dict):
            labels[str(r["id"])] = value.get("labels")
    shapes = {str(r.get("id")) for r in rows if f"{r.get('type')}labels" in _KINDS}
    joined: list[Mapping[str, object]] = []
    for r in rows:
        region = str(r.get("id"))
        kind = f"{r.get('type')}labels"
        value = r.get("value")
        if kind in _KINDS and region in labels and isinstance(value, dict):
            joined.append({**r, "type": kind, "value": {**value, kind: labels[region]}})
        elif r.get("type") != "labels" or region not in shapes:
            joined.append(r)
    return joined


def _read_result(found: Findings, row: Mapping[str, object], where: str) -> Instance | None:
    """Return an object; None if its box is outside. ValueError if the row is malformed."""
    size_wh = to_size(row.get("original_width"), row.get("original_height"))
    value = row.get("value")
    labels = value.get(row["type"]) if isinstance(value, dict) else None
    if size_wh is None or not isinstance(value, dict) or not isinstance(labels, list) or not labels:
        raise ValueError("no label, or no size of the picture")
    for _ in labels[1:]:
        found.leave_out("further labels of a region", where)
    scale = np.array(size_wh, np.float64) / 100
    meta = said if isinstance(said := row.get("meta"), dict) else {}
    mask = corners = None
    if row["type"] == "rectanglelabels":
        numbers = to_floats([value.get(k, 0) for k in ("x", "y", "width", "height", "rotation")], 5)
        if numbers is None or not is_near(numbers):
            raise ValueError(f"a rectangle {str(value)[:60]}")
        x, y = np.array(numbers[:2]) * scale
        w, h = np.array(numbers[2:4]) * scale
        edges: Sequence[float] = (x, y, x + w, y + h)
        if numbers[4] or meta.get("oriented") is True:  # also where the angle is 0
            angle = math.radians(numbers[4])
            # Turned about its first corner: the centre turns with it.
            cx = x + w / 2 * math.cos(angle) - h / 2 * math.sin(angle)
            cy = y + w / 2 * math.sin(angle) + h / 2 * math.cos(angle)
            corners, edges = turned_box((cx, cy, w, h, angle), size_wh)
        elif overhang_px(np.array(edges).reshape(2, 2), size_wh) <= 1e-6:
            edges = np.clip(edges, 0, np.array([*size_wh, *size_wh], np.float64)).tolist()
    elif row["type"] == "ellipselabels":
        numbers = to_floats([value.get(k) for k in ("x", "y", "radiusX", "radiusY")] + [value.get("rotation", 0)], 5)
        if numbers is None:
            raise ValueError(f"an ellipse {str(value)[:60]}")
        x, y = np.array(numbers[:2]) * scale
        w, h = np.array(numbers[2:4]) * scale * 2
        edges, mask = ellipse((x, y, w, h, math.radians(numbers[4])), size_wh)
    else:
        mask = _read_mask(row, value, size_wh)
        if mask.box_xyxy is None:
            raise ValueError("a mask without a pixel")
        edges = mask.box_xyxy.tolist()
    box = found.box([float(v) for v in edges], size_wh, where)
    if box is None:
        return None
    flags = {k: to_bool(meta[k]) if k in meta else None for k in _FLAGS}
    return Instance(
        str(labels[0]),
        box,
        corners,
        mask,
        to_share(meta.get("visibility")),
        flags["truncated"],
        flags["difficult"],
        flags["inserted"] is True,
        None,
        {} if flags["occluded"] is None else {"occluded": flags["occluded"]},
        to_id(meta.get("track_id")),
    )


def _read_mask(row: Mapping[str, object], value: Mapping[str, object], size_wh: tuple[int, int]) -> Mask:
    if row["type"] == "brushlabels":
        return Mask.from_array(decode_brush(value.get("rle"), size_wh))
    points = value.get("points")
    pairs = [to_floats(p, 2) for p in points] if isinstance(points, list) else [None]
    if None in pairs:
        raise ValueError("points that are no pairs of numbers")
    ring = [v * s / 100 for p in pairs if p is not None for v, s in zip(p, size_wh, strict=True)]
    return Mask.from_rings([ring], (size_wh[1], size_wh[0]))
