"""Unite what several forms of HIT-UAV state about the same pictures, and report where they disagree."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, ImageRecord, Instance
from infrablend.errors import Problem
from infrablend.formats.picture_facts import facts_from_name, pitch_note
from infrablend.formats.published.hit_uav.form_records import FormData, FormObject, FormPicture
from infrablend.formats.published.hit_uav.forms import Form


def unite_categories(data: Sequence[FormData]) -> tuple[Category, ...]:
    """Return the first form's categories, then names that only other forms have, with their id or the next free one."""
    united: list[Category] = []
    for d in data:
        for c in d.categories:
            known = next((u for u in united if u.name == c.name), None)
            if known is None:
                number = c.id if all(u.id != c.id for u in united) else max(u.id for u in united) + 1
                united.append(Category(number, c.name, c.supercategory, c.ignore))
            elif c.supercategory and not known.supercategory:
                united[united.index(known)] = c if c.id == known.id else known
    return tuple(united)


def unite(data: Sequence[FormData]) -> tuple[list[ImageRecord], dict[str, Any], list[Problem]]:
    """Return one record per picture, the notes of the dataset, and all disagreements between the forms."""
    problems: list[Problem] = []
    counts: Counter[str] = Counter()
    stems = sorted({s for d in data for s in d.pictures})
    images: list[ImageRecord] = []
    used: Counter[str] = Counter()
    pitch_from: Counter[str] = Counter()
    for stem in stems:
        held = [(d.form, d.pictures[stem]) for d in data if stem in d.pictures]
        first = held[0][1]
        file = next((p for _, p in held if p.path is not None), None)
        if file is None:
            found = f"no picture {first.name!r}"
            problems.append(Problem(first.where, "image-missing", found, "a file in the picture folder", "restore it"))
            continue
        images.append(_unite_picture(stem, held, file, counts, problems))
        pitch = images[-1].capture.pitch_deg is not None
        pitch_from["none" if not pitch else "file names" if facts_from_name(file.name) else "annotation"] += 1
        used.update(form for form, _ in held)
    for d in data:
        if used[d.form] < len(images) and d.pictures:
            found = f"{d.form} contains {used[d.form]} of {len(images)} pictures"
            problems.append(
                Problem(d.form, "form-partial", found, "the same pictures in every form", severity="warning")
            )
    # The forms from which each kind of label was taken, in order of precedence.
    present = [d.form for d in data if d.pictures]
    notes: dict[str, Any] = {
        "forms": {
            d.form: {
                "files": d.counts["files"],
                "pictures": len(d.pictures),
                "objects": sum(len(p.objects) for p in d.pictures.values()),
            }
            for d in data
        },
        "boxes_from": [f for f in ("normal_json", "normal_xml", "rotate_json", "rotate_xml") if f in present],
        "oriented_from": [f for f in ("rotate_json", "rotate_xml") if f in present],
        "disagreements": {k: counts[k] for k in ("boxes", "oriented", "categories", "flags", "objects", "metadata")},
        "boxes_checked": counts["checked"],
        "derived_boxes_clipped": counts["derived_clipped"],
        "pitch": pitch_note(pitch_from),
        "without_pitch": sum(i.capture.pitch_deg is None for i in images),
    }
    return images, notes, problems


def _unite_picture(
    stem: str, held: list[tuple[Form, FormPicture]], file: FormPicture, counts: Counter[str], problems: list[Problem]
) -> ImageRecord:
    first = held[0][1]

    def differ(kind: str, where: str, found: str, expected: str) -> None:
        counts[kind] += 1
        problems.append(Problem(where, f"forms-disagree-{kind}", found, expected, severity="warning"))

    facts = facts_from_name(file.name)
    capture = facts.capture if facts is not None else Capture()
    if facts is None:
        found = f"name {file.name!r} does not contain pitch and altitude"
        problems.append(Problem(first.where, "name-grammar", found, "T_HHH_AA_W_NNNNN", severity="warning"))
    extra: dict[str, Any] = {}
    source_id: int | None = None
    size_wh: tuple[int, int] | None = None
    for _, p in held:
        for conflict in capture.conflicts(p.capture):
            said = f"{conflict} (here, against the file name or another form)"
            differ("metadata", p.where, said, "equal values; the first is used")
        capture = capture.over(p.capture)
        if p.split != first.split:
            differ("metadata", p.where, f"split {p.split}", f"{first.split}, which is used")
        if size_wh and p.size_wh and p.size_wh != size_wh:
            differ("metadata", p.where, f"size {p.size_wh}", f"{size_wh}, which is used")
        size_wh = size_wh or p.size_wh
        if source_id is not None and p.source_id is not None and p.source_id != source_id:
            differ("metadata", p.where, f"image id {p.source_id}", f"{source_id}, which is used")
        source_id = p.source_id if source_id is None else source_id
        for key, value in p.extra.items():
            if extra.setdefault(key, value) != value and key != "depth":
                differ("metadata", p.where, f"{key} {value!r}", f"{extra[key]!r}, which is used")
    if facts is not None:
        extra.setdefault("weather", str(facts.weather))
    merged = list(first.objects)
    for form, p in held[1:]:
        merged = _unite_objects(merged, p, form, counts, differ)
    instances = tuple(_instance(o, size_wh, counts) for o in merged)
    return ImageRecord(
        id=stem.replace("/", "__"),
        path=file.path or Path(file.name),
        split=first.split,
        size_wh=size_wh,
        instances=instances,
        capture=replace(capture, sequence=_sequence(extra.get("date"), capture), captured=_iso_date(extra.get("date"))),
        source_id=source_id,
        extra=extra,
        file_name=file.name,
    )


def _iso_date(date: object) -> str | None:
    """Return HIT-UAV's `20210116` as `2021-01-16`, or None if it is not a date."""
    try:
        return datetime.strptime(str(date), "%Y%m%d").date().isoformat()
    except ValueError:
        return None


def _sequence(date: object, capture: Capture) -> str | None:
    """Name the flight of a picture as far as the files reveal it: date, time of day, altitude and perspective."""
    parts = [
        str(date) if date else "",
        capture.time_of_day or "",
        "" if capture.altitude_m is None else f"{capture.altitude_m:g}m",
        "" if capture.pitch_deg is None else f"{capture.pitch_deg:g}deg",
    ]
    return "-".join(p for p in parts if p) or None


def _same_place(a: FormObject, b: FormObject) -> bool:
    """Return whether two forms describe the same place: their bounds are equal when truncated toward zero."""
    if a.corners is not None and b.corners is not None:
        return bool(np.allclose(a.corners, b.corners, rtol=0, atol=1e-6))
    x, y = a.bounds(), b.bounds()
    return bool((np.trunc(x) == np.trunc(y)).all())


def _pairs(ours: Sequence[FormObject], theirs: Sequence[FormObject]) -> list[tuple[int | None, int | None]]:
    """Pair the objects of two forms: by annotation id, else by order, else by overlap.

    Overlap fails for a long diagonal box, which overlaps its axis-aligned one little, and for a box thinner than a
    pixel, which is widened. Objects left over are paired if they have the same index in both lists and touch.
    """
    ids = [o.source_id for o in ours]
    other = [o.source_id for o in theirs]
    if all(numbers and None not in numbers and len(set(numbers)) == len(numbers) for numbers in (ids, other)):
        place = {n: k for k, n in enumerate(other)}
        pairs: list[tuple[int | None, int | None]] = [(i, place.get(n)) for i, n in enumerate(ids)]
        return pairs + [(None, k) for k, n in enumerate(other) if n not in set(ids)]
    if len(ours) == len(theirs) and all(
        a.category == b.category and _same_place(a, b) for a, b in zip(ours, theirs, strict=True)
    ):
        return [(i, i) for i in range(len(ours))]
    ranked = []
    touching = set()
    for i, a in enumerate(ours):
        x = a.bounds()
        for k, b in enumerate(theirs):
            y = b.bounds()
            w, h = min(x[2], y[2]) - max(x[0], y[0]), min(x[3], y[3]) - max(x[1], y[1])
            if i == k and len(ours) == len(theirs) and a.category == b.category and min(w, h) >= -1:
                touching.add(i)
            if w <= 0 or h <= 0:
                continue
            both = w * h
            iou = both / ((x[2] - x[0]) * (x[3] - x[1]) + (y[2] - y[0]) * (y[3] - y[1]) - both)
            if iou >= 0.5:
                ranked.append((a.category != b.category, -iou, i, k))
    match: dict[int, int] = {}
    for _, _, i, k in sorted(ranked):
        if i not in match and k not in match.values():
            match[i] = k
    taken = set(match.values())
    match |= {i: i for i in touching if i not in match and i not in taken}
    left = [k for k in range(len(theirs)) if k not in match.values()]
    return [(i, match.get(i)) for i in range(len(ours))] + [(None, k) for k in left]


def _unite_objects(
    ours: list[FormObject], picture: FormPicture, form: Form, counts: Counter[str], differ: Any
) -> list[FormObject]:
    united: list[FormObject] = []
    for i, k in _pairs(ours, picture.objects):
        if i is None and k is not None:
            found = "an object that earlier forms do not contain, kept"
            differ("objects", picture.objects[k].where, found, "the same objects")
            united.append(picture.objects[k])
            continue
        a = ours[i or 0]
        united.append(a)
        if k is None:
            found = f"an object that {form} does not contain, kept"
            differ("objects", a.where, found, "the same objects in every form")
            continue
        b = picture.objects[k]
        if a.category != b.category:
            differ("categories", b.where, f"category {b.category}", f"{a.category}, which is used")
        # The oriented box of an inserted object has empty corners, so its bounds are larger than its box.
        if not (a.inserted or b.inserted or a.extra.get("tight_box")):
            counts["checked"] += 1
            if not _same_place(a, b):
                kind = "oriented" if a.corners is not None and b.corners is not None else "boxes"
                found = f"bounds {np.round(b.bounds(), 4).tolist()}"
                differ(kind, b.where, found, f"{np.round(a.bounds(), 4).tolist()} truncated; each form keeps its own")
        for flag in ("truncated", "difficult"):
            x, y = getattr(a, flag), getattr(b, flag)
            if x is not None and y is not None and x != y:
                differ("flags", b.where, f"{flag} {y}", f"{x}, which is used")
            setattr(a, flag, y if x is None else x)
        if a.box is None and b.box is not None:
            a.raw = b.raw
            a.box = b.box
        if a.corners is None and b.corners is not None:
            a.obb = b.obb
            a.corners = b.corners
        a.inserted = a.inserted or b.inserted
        a.source_id = b.source_id if a.source_id is None else a.source_id
        for key, value in b.extra.items():
            a.extra.setdefault(key, value)
    return united


def _instance(o: FormObject, size_wh: tuple[int, int] | None, counts: Counter[str]) -> Instance:
    box = o.box
    if box is None:
        box = o.bounds()
        if size_wh is not None:
            clipped = np.clip(box, 0.0, np.array([*size_wh, *size_wh], np.float64))
            counts["derived_clipped"] += bool((clipped != box).any())
            box = clipped
    if o.obb is not None:
        # The five numbers of the file, so that they are written back to the last digit.
        o.extra["obb"] = o.obb
    return Instance(o.category, box, o.corners, None, None, o.truncated, o.difficult, o.inserted, o.source_id, o.extra)
