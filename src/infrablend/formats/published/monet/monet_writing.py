"""Write images and labels in MONET's layout."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Literal

from infrablend.core.dataset import Category, ImageRecord
from infrablend.core.file_names import distinct_names, file_name
from infrablend.core.files import link_or_copy, write_chunks
from infrablend.core.json_records import Streamed, json_chunks
from infrablend.errors import Problem
from infrablend.formats.base import Numbered, in_order, number_ids, require_size
from infrablend.formats.labels import coco
from infrablend.formats.losses import Written
from infrablend.formats.published.monet.folders import ALTITUDE_KEYS, PITCH_KEYS, TIME_KEYS, split_in
from infrablend.formats.published.monet.telemetry import NEST, Place, Telemetry

_INFO: Mapping[str, object] = {"description": "MONET layout, written by InfraBlend"}
# Facts with a place of their own: in the telemetry, or the name of the file.
_IN_TELEMETRY = ("pitch_deg", "altitude_m", "date_captured", "sequence")


def write(
    out: Path,
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    *,
    ids: Literal["source", "new"] = "new",
    extra: Mapping[str, object] | None = None,
    pictures: bool = True,
) -> Written:
    """Write `out/<split>/<sequence>.json` and pictures in `out/<split>/<sequence>/lwir/`.

    Pictures are hard links to `ImageRecord.path` (copies where that is impossible). Image records keep the source's
    fields, with pitch and altitude at their original place, else as `g_pitch` and `alt` in `metadata`. Annotations
    equal those of `coco.write`: masks as run lengths, oriented boxes in `obb`.

    New ids count from 1 over all files and keep the source's id as `source_id`. `extra` has the top-level fields `info`
    and `licenses`, e.g. `Dataset.extra`.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A size, category or id is missing, or two pictures would get the same name.
    """
    ordered = in_order(images)
    losses: Counter[str] = Counter()
    folders = _folder_names(ordered)
    texts = _chunks(ordered, categories, losses, folders, ids, extra or {})
    files = [write_chunks(out / name, chunks) for name, chunks in texts.items()]
    for image in ordered if pictures else ():
        files.append(link_or_copy(image.path, out / image.split / _picture_name(image, folders)))
    return Written.of(files, losses, _pitch_remarks(ordered, folders))


def _chunks(
    ordered: Sequence[ImageRecord],
    categories: Sequence[Category],
    losses: Counter[str],
    folders: Mapping[str | None, str],
    ids: Literal["source", "new"],
    extra: Mapping[str, object],
) -> dict[str, Iterator[str]]:
    """Return the text of every annotation file in pieces, by POSIX path below the output folder."""
    numbered = number_ids(ordered, ids, 1)
    new = ids == "new"
    # Without any pitch, nothing would identify these files as MONET.
    unknown = all(i.capture.pitch_deg is None for i in ordered)
    groups: dict[str, list[int]] = {}
    taken: set[tuple[str, str]] = set()
    for n, image in enumerate(ordered):
        name = _picture_name(image, folders)
        if (image.split, name) in taken:
            raise ValueError(f"{image.id}: a second picture would be {image.split}/{name}")
        taken.add((image.split, name))
        groups.setdefault(f"{image.split}/{folders[image.capture.sequence] or image.split}.json", []).append(n)

    def records(part: Numbered) -> Iterator[dict[str, object]]:
        for image, number, _ in part:
            record = _image_record(image, number, _picture_name(image, folders), new)
            if unknown:
                _put(record, (NEST, PITCH_KEYS[0]), None)
            yield record

    def top(part: Numbered) -> dict[str, object]:
        return {
            "info": extra.get("info", _INFO),
            "licenses": extra.get("licenses", []),
            "categories": coco.category_records(categories),
            "images": Streamed(records(part)),
            "annotations": Streamed(coco.annotation_records(part, categories, new, "polygon")),
        }

    return {name: chain(json_chunks(top(numbered.part(group)), losses), "\n") for name, group in sorted(groups.items())}


def _pitch_remarks(images: Sequence[ImageRecord], folders: Mapping[str | None, str]) -> list[Problem]:
    """Return a warning for sequences without any pitch, which the reader leaves out unless asked to keep them."""
    known: dict[tuple[str, str], bool] = {}
    for i in images:
        place = (i.split, folders[i.capture.sequence])
        known[place] = known.get(place, False) or i.capture.pitch_deg is not None
    empty = sum(not k for k in known.values())
    if not empty:
        return []
    found = f"{empty} sequence(s) without any camera pitch"
    todo = "read it with --read empty=keep"
    return [Problem("monet", "telemetry-absent", found, "a pitch in every sequence", todo, "warning")]


def _folder_names(images: Sequence[ImageRecord]) -> dict[str | None, str]:
    """Return the name of the folder of each sequence; empty for images without a sequence.

    Sequences whose names some disk takes for one have folders of their own.
    """
    wanted = {i.capture.sequence: _folder_name(i.capture.sequence) for i in images}
    named = [sequence for sequence, name in wanted.items() if name]
    return {**wanted, **dict(zip(named, distinct_names([wanted[s] for s in named]), strict=True))}


def _folder_name(sequence: str | None) -> str:
    text = (sequence or "").strip()
    name = file_name(text.replace("/", "__").replace("\\", "__")) if text.strip(".") else ""
    return "" if split_in([name]) else name


def _picture_name(image: ImageRecord, folders: Mapping[str | None, str]) -> str:
    """Return the path of a picture below its split's folder: `<sequence>/lwir/...`."""
    folder = folders[image.capture.sequence]
    parts = list(PurePosixPath(image.name).parts)
    for known in (_folder_name(image.capture.sequence), "lwir"):
        if len(parts) > 1 and parts[0] == known:
            parts.pop(0)
    return str(PurePosixPath(folder, "lwir", *parts))


def _image_record(image: ImageRecord, number: int | str, name: str, new: bool) -> dict[str, object]:
    w, h = require_size(image)
    fields: dict[str, object] = dict(image.extra.get("fields", {}))
    places: Telemetry = image.extra.get("telemetry", {})
    stated = (places.get("pitch"), places.get("altitude"), places.get("time"))
    nest = next((place[:-1] for place in stated if place), (NEST,))
    if image.capture.pitch_deg is not None:
        pitch = places.get("sign", -1) * image.capture.pitch_deg + 0.0
        value = math.radians(pitch) if places.get("radians") else pitch
        _put(fields, places.get("pitch") or (*nest, PITCH_KEYS[0]), value)
    if image.capture.altitude_m is not None:
        _put(fields, places.get("altitude") or (*nest, ALTITUDE_KEYS[0]), image.capture.altitude_m)
    if image.capture.captured is not None and not places.get("time"):
        _put(fields, (*nest, TIME_KEYS[0]), image.capture.captured)
    fields |= {k: v for k, v in coco.fact_fields(image).items() if k not in _IN_TELEMETRY}
    record = {"id": number, "file_name": name, "width": w, "height": h}
    return fields | record | coco.source_id_field(image, new)


def _put(record: dict[str, object], place: Place, value: object) -> None:
    """Set a value at a place, copying or creating the objects on the way."""
    key, *below = place
    if below:
        inside = record.get(key)
        copy = dict(inside) if isinstance(inside, dict) else {}
        _put(copy, tuple(below), value)
        value = copy
    record[key] = value
