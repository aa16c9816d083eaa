"""Unite what several forms of HIT-UAV state about the same pictures, and report where they disagree."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import TypeVar

import numpy as np

from infrablend.core.boxes import box_iou
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, ImageRecord, Instance
from infrablend.formats.picture_facts import facts_from_name, pitch_note
from infrablend.formats.published.hit_uav.form_records import Form, FormData, FormObject, FormPicture
from infrablend.formats.records import Findings

T = TypeVar("T")


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


@dataclass(kw_only=True)
class United(Findings):
    """The pictures that several forms describe, and where the forms disagree: `counts` has a number for each kind."""

    images: list[ImageRecord] = field(default_factory=list)
    used: Counter[Form] = field(default_factory=Counter)

    def differ(self, kind: str, where: str, found: str, expected: str) -> None:
        """Report a disagreement of some kind."""
        self.counts[kind] += 1
        self.warn(where, f"forms-disagree-{kind}", found, expected)

    def first(self, kind: str, where: str, name: str, known: T | None, said: T | None) -> T | None:
        """Return the value that an earlier form states, else what this one says; report two that differ."""
        if known is not None and said is not None and said != known:
            self.differ(kind, where, f"{name} {said}", f"{known}, which is used")
        return said if known is None else known

    def notes(self, data: Sequence[FormData]) -> dict[str, object]:
        """Return what the dataset notes on the forms: what each contains, and what was taken from which."""
        present = [d.form for d in data if d.pictures]
        pitch_from = Counter(
            "none" if i.capture.pitch_deg is None else "file names" if facts_from_name(i.name) else "annotation"
            for i in self.images
        )
        kinds = ("boxes", "oriented", "categories", "flags", "objects", "metadata")
        return {
            "forms": {
                d.form: {
                    "files": d.counts["files"],
                    "pictures": len(d.pictures),
                    "objects": sum(len(p.objects) for p in d.pictures.values()),
                }
                for d in data
            },
            # The forms from which each kind of label was taken, in order of precedence.
            "boxes_from": [f for f in ("normal_json", "normal_xml", "rotate_json", "rotate_xml") if f in present],
            "oriented_from": [f for f in ("rotate_json", "rotate_xml") if f in present],
            "disagreements": self.rows(*kinds),
            "boxes_checked": self.counts["checked"],
            "derived_boxes_clipped": self.counts["derived_clipped"],
            "pitch": pitch_note(pitch_from),
            "without_pitch": pitch_from["none"],
        }


def unite(root: Path, data: Sequence[FormData]) -> United:
    """Return one record per picture, and all disagreements between the forms."""
    united = United(root)
    for stem in sorted({s for d in data for s in d.pictures}):
        held = {d.form: d.pictures[stem] for d in data if stem in d.pictures}
        first = next(iter(held.values()))
        file = next((p for p in held.values() if p.path is not None), None)
        if file is None:
            found = f"no picture {first.name!r}"
            united.add(first.where, "image-missing", found, "a file in the picture folder", "restore it")
            continue
        united.images.append(_unite_picture(united, stem, held, file))
        united.used.update(held.keys())
    count = len(united.images)
    for d in data:
        if united.used[d.form] < count and d.pictures:
            found = f"{d.form} contains {united.used[d.form]} of {count} pictures"
            united.warn(d.form, "form-partial", found, "the same pictures in every form")
    return united


def _unite_picture(united: United, stem: str, held: Mapping[Form, FormPicture], file: FormPicture) -> ImageRecord:
    first, *others = held.values()
    facts = facts_from_name(file.name)
    capture = facts.capture if facts is not None else Capture()
    if facts is None:
        found = f"name {file.name!r} does not contain pitch and altitude"
        united.warn(first.where, "name-grammar", found, "T_HHH_AA_W_NNNNN")
    extra: dict[str, object] = {}
    source_id: int | str | None = None
    size_wh: tuple[int, int] | None = None
    for p in held.values():
        for conflict in capture.conflicts(p.capture):
            said = f"{conflict} (here, against the file name or another form)"
            united.differ("metadata", p.where, said, "equal values; the first is used")
        capture = capture.over(p.capture)
        united.first("metadata", p.where, "split", first.split, p.split)
        size_wh = united.first("metadata", p.where, "size", size_wh, p.size_wh)
        united.first("metadata", p.where, "image id", source_id, p.source_id)
        source_id = p.source_id if source_id is None else source_id
        for key, value in p.extra.items():
            if extra.setdefault(key, value) != value and key != "depth":
                united.differ("metadata", p.where, f"{key} {value!r}", f"{extra[key]!r}, which is used")
    if facts is not None:
        extra.setdefault("weather", str(facts.weather))
    objects = list(first.objects)
    for form, p in zip(list(held)[1:], others, strict=True):
        objects = _unite_objects(united, objects, p.objects, form)
    date = extra.get("date")
    return ImageRecord(
        id=stem.replace("/", "__"),
        path=file.path or Path(file.name),
        split=first.split,
        size_wh=size_wh,
        instances=tuple(_instance(united, o, size_wh) for o in objects),
        capture=replace(capture, sequence=_sequence(date, capture), captured=_iso_date(date)),
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
    x = np.array([o.bounds() for o in ours], np.float64).reshape(-1, 4)
    y = np.array([o.bounds() for o in theirs], np.float64).reshape(-1, 4)
    iou = box_iou(x, y)
    ranked = [
        (ours[i].category != theirs[k].category, -float(iou[i, k]), int(i), int(k)) for i, k in np.argwhere(iou >= 0.5)
    ]
    touching: list[int] = []
    if len(ours) == len(theirs):
        shared = np.minimum(x[:, 2:], y[:, 2:]) - np.maximum(x[:, :2], y[:, :2])
        touching = [i for i, o in enumerate(ours) if shared[i].min() >= -1 and o.category == theirs[i].category]
    match: dict[int, int] = {}
    for _, _, i, k in sorted(ranked):
        if i not in match and k not in match.values():
            match[i] = k
    taken = set(match.values())
    match |= {i: i for i in touching if i not in match and i not in taken}
    left = [k for k in range(len(theirs)) if k not in match.values()]
    return [(i, match.get(i)) for i in range(len(ours))] + [(None, k) for k in left]


def _unite_objects(
    united: United, ours: Sequence[FormObject], theirs: Sequence[FormObject], form: Form
) -> list[FormObject]:
    """Return the objects of two forms; those of the first take what only the other, `form`, states."""
    objects: list[FormObject] = []
    for i, k in _pairs(ours, theirs):
        a = None if i is None else ours[i]
        b = None if k is None else theirs[k]
        if a is None and b is not None:
            found = "an object that earlier forms do not contain, kept"
            united.differ("objects", b.where, found, "the same objects")
            objects.append(b)
        elif a is not None:
            objects.append(a)
            if b is not None:
                _complete(united, a, b)
            else:
                found = f"an object that {form} does not contain, kept"
                united.differ("objects", a.where, found, "the same objects in every form")
    return objects


def _complete(united: United, a: FormObject, b: FormObject) -> None:
    """Add to one object what another form states of it, and report where the two disagree."""
    united.first("categories", b.where, "category", a.category, b.category)
    # The oriented box of an inserted object has empty corners, so its bounds are larger than its box.
    if not (a.inserted or b.inserted or a.extra.get("tight_box")):
        united.counts["checked"] += 1
        if not _same_place(a, b):
            kind = "oriented" if a.corners is not None and b.corners is not None else "boxes"
            found = f"bounds {np.round(b.bounds(), 4).tolist()}"
            expected = f"{np.round(a.bounds(), 4).tolist()} truncated; each form keeps its own"
            united.differ(kind, b.where, found, expected)
    a.truncated = united.first("flags", b.where, "truncated", a.truncated, b.truncated)
    a.difficult = united.first("flags", b.where, "difficult", a.difficult, b.difficult)
    if a.box is None:
        a.raw, a.box = b.raw, b.box
    if a.corners is None:
        a.obb, a.corners = b.obb, b.corners
    a.inserted = a.inserted or b.inserted
    a.source_id = b.source_id if a.source_id is None else a.source_id
    for key, value in b.extra.items():
        a.extra.setdefault(key, value)


def _instance(united: United, o: FormObject, size_wh: tuple[int, int] | None) -> Instance:
    box = o.box
    if box is None:
        box = o.bounds()
        if size_wh is not None:
            clipped = np.clip(box, 0.0, np.array([*size_wh, *size_wh], np.float64))
            united.counts["derived_clipped"] += not np.array_equal(clipped, box)
            box = clipped
    if o.obb is not None:
        # The five numbers of the file, so that they are written back to the last digit.
        o.extra["obb"] = o.obb
    return Instance(o.category, box, o.corners, None, None, o.truncated, o.difficult, o.inserted, o.source_id, o.extra)
