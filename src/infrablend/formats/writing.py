"""Write a dataset in any format of the table, and count what that format cannot hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from infrablend.core.boxes import box_of_points
from infrablend.core.capture import FACTS
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.file_names import distinct_names, fit_name, fold_name
from infrablend.core.files import write_text
from infrablend.core.format_table import (
    FIELDS,
    FORMATS,
    NATIVE,
    WRITERS,
    Layout,
    Writer,
    find_format,
    find_writer,
    written_names,
)
from infrablend.core.spool import StoredImages
from infrablend.errors import Problem
from infrablend.formats.base import FormatModule, in_order, numbered_from_one, sort_images
from infrablend.formats.losses import Written
from infrablend.formats.picture_facts import facts_from_name, fits_table
from infrablend.formats.pictures.listing import assign_ids
from infrablend.formats.read_write import WriteSettings
from infrablend.formats.values import csv_text


def load_writer(writer: Writer) -> Callable[..., Written]:
    """Return the function `write` of the writer's format."""
    write = FormatModule.load(find_format(writer.reader).module).write
    assert write is not None
    return write


def native_writer(source: Dataset) -> Writer | None:
    """Return the writer of a dataset's own format; None for unlabelled pictures, or if there is no such writer.

    WiSARD has YOLO's labels and DUT-Anti-UAV has VOC's, so these are written in the layout of YOLO or VOC.
    """
    name = source.format
    if name in {f.name for f in FORMATS}:
        name = find_format(name).written_as or name
        choose = FormatModule.load(find_format(name).module).native_writer
        name = name if choose is None else choose(source)
    return next((w for w in WRITERS if w.name == name), None)


def write(
    name: str,
    out: Path,
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    *,
    settings: WriteSettings | None = None,
    source: Dataset | None = None,
) -> Written:
    """Write images and labels in one format below `out`.

    Everything that the format cannot hold is counted in `losses`, see `losses.LOSSES`; equal records give equal bytes.

    Args:
        name: In `WRITERS`, or `native`: the format of `source`, with every label that it can hold.
        out: Output folder, created if necessary.
        images: Images with known `size_wh`.
        categories: Categories with the ids to write.
        settings: Choices; None uses the defaults.
        source: Dataset of the images, needed for `native` and for its top-level fields (info, licences).

    Raises:
        UnknownFormatError: No such writer.
        OutputError: A file cannot be written.
        ValueError: A size, category or id is missing.
    """
    settings = settings or WriteSettings()
    if name == NATIVE:
        writer = None if source is None else native_writer(source)
        if writer is None:
            return Written() if source is None or source.notes.get("labels") == "none" else _native_not_writable(source)
        settings = replace(settings, dont_care="keep", without_mask="obb")
    else:
        writer = find_writer(name)
    if settings.category_ids == "from_one":
        categories = numbered_from_one(categories)
    ordered, renamed = fitting_names(in_order(images), writer.layout, writer.misread)
    arguments = dict(writer.fixed) | {k: getattr(settings, k) for k in writer.takes - {"extra"}}
    if "extra" in writer.takes and source is not None and source.format == writer.reader:
        arguments["extra"] = source.extra
    written = load_writer(writer)(out, ordered, categories, **arguments)
    losses = Counter(_further_losses(ordered, writer)) + Counter(name_changed=renamed)
    return Written.together([written, _write_table(out, ordered, writer), Written(losses=losses)])


def _native_not_writable(source: Dataset) -> Written:
    found = f"{source.format} is read but not written; native was left out"
    expected = f"one of {', '.join(written_names())}"
    todo = "ask for another format"
    return Written(problems=(Problem("native", "format-none", found, expected, todo, "warning"),))


def fitting_names(
    images: Sequence[ImageRecord], layout: Layout, misread: Collection[str] = ()
) -> tuple[Sequence[ImageRecord], int]:
    """Return the images with names that do not clash in a layout (see `Writer`), and the number of changed names.

    Names that differ in case alone clash, because some disks take them for one file. Names with characters that label
    files cannot hold are changed, too, and those with a folder in `misread`.
    """
    together = layout in ("unique", "shared")
    by_stem = layout != "nested"
    flat = layout in ("flat", "shared")
    found = [(image.split, image.name) for image in images]
    changed: dict[int, str] = {}
    for split in dict.fromkeys("" if together else s for s, _ in found):
        chosen = [n for n, (s, _) in enumerate(found) if together or s == split]
        names = {n: found[n][1] for n in chosen}
        keys = {n: _file_key(name, by_stem) for n, name in names.items()}
        count = Counter(keys.values())
        odd = {n for n, name in names.items() if misread and not set(misread).isdisjoint(name.split("/")[:-1])}
        clashing = [n for n, name in names.items() if flat or count[keys[n]] > 1 or fit_name(name) != name or n in odd]
        if not clashing:
            continue
        paths = {n: f"{found[n][0]}/{name}" if together else name for n, name in names.items()}
        ids = assign_ids(paths.values())
        left = {n: keys[n] for n in set(chosen) - set(clashing)}
        stems = distinct_names([fit_name(ids[paths[n]]) for n in clashing], [k for k in left.values() if "/" not in k])
        for n, stem in zip(clashing, stems, strict=True):
            name = stem + PurePosixPath(names[n]).suffix
            if name != names[n]:
                changed[n] = name
    if isinstance(images, StoredImages):
        return images.renamed(changed), len(changed)
    renamed = [replace(i, file_name=changed[n]) if n in changed else i for n, i in enumerate(images)]
    return renamed, len(changed)


def _file_key(name: str, by_stem: bool) -> str:
    """Return a key that is equal for names of pictures, or of their label files, which some disk takes for one."""
    return fold_name(str(PurePosixPath(name).with_suffix("")) if by_stem else name)


# Columns of `metadata.csv` that every table has.
_COLUMNS = ("pitch_deg", "altitude_m", "time_of_day")


def _unsaid(image: ImageRecord) -> dict[str, object]:
    """Return the facts of a picture that its name does not contain."""
    facts = facts_from_name(image.name)
    said = facts.capture.to_json() if facts else {}
    return {name: value for name, value in image.capture.to_json().items() if said.get(name) != value}


def _write_table(out: Path, images: Sequence[ImageRecord], writer: Writer) -> Written:
    """Write `metadata.csv` with what neither the format nor the pictures' names say about the flight."""
    if not writer.table:
        return Written()
    rows = {
        writer.table.format(split=i.split, name=i.name): i.capture.to_json()
        for i in images
        if any(fits_table(*fact) for fact in _unsaid(i).items())
    }
    if not rows:
        return Written()
    rows = {name: {k: v for k, v in facts.items() if fits_table(k, v)} for name, facts in rows.items()}
    columns = [n for n in FACTS if n in _COLUMNS or any(n in facts for facts in rows.values())]
    lines = ((name, *(facts.get(k, "") for k in columns)) for name, facts in rows.items())
    return Written((write_text(out / "metadata.csv", csv_text(("file", *columns), lines)),))


def _further_losses(images: Sequence[ImageRecord], writer: Writer) -> dict[str, int]:
    """Count what all formats lose alike: boxes beside oriented ones, tracks, inserted marks, telemetry, and more."""
    own_boxes = "obb" not in writer.lacks
    found: Counter[str] = Counter()
    for i in images:
        found["boxes"] += sum(_has_own_box(o) for o in i.instances) if own_boxes else 0
        found["tracks"] += sum(o.track_id is not None for o in i.instances)
        found["inserted"] += sum(o.inserted for o in i.instances)
        found["temperature"] += i.capture.scale is not None
    losses = {FIELDS[k][1]: n for k, n in found.items() if n and k in writer.lacks}
    facts = Counter(field for i in images for field in _lost_facts(i, writer))
    return losses | {FIELDS[k][1]: n for k, n in facts.items()}


def _lost_facts(image: ImageRecord, writer: Writer) -> set[str]:
    """Return what is lost of the facts of a picture: keys of `FIELDS`."""
    derived = {fact for key, facts in writer.derived.items() if image.extra.get(key) for fact in facts}
    return {
        FACTS[name].field
        for name, value in _unsaid(image).items()
        if name not in (writer.facts | derived) or (writer.table and not fits_table(name, value))
    }


def _has_own_box(instance: Instance) -> bool:
    """Return whether the axis-aligned box differs from the bounds of the oriented one."""
    corners = instance.corners_xy
    return corners is not None and not bool((np.abs(box_of_points(corners) - instance.box_xyxy) <= 1e-6).all())


def unwritable(name: str, images: Iterable[ImageRecord], settings: WriteSettings) -> Problem | None:
    """Return why a format cannot be written with the source's ids, or None. Call it before writing anything."""
    if settings.ids == "new" or "ids" not in find_writer(name).takes:
        return None
    ordered = sort_images(images)
    bad = sum(i.source_id is None for i in ordered) + sum(
        o.source_id is None for i in ordered for o in i.instances if not o.inserted
    )
    if bad:
        found = f"{bad} image(s) or object(s) without an id in the source"
        return Problem("ids", "ids-missing", found, "an id for each", "write with new ids: ids new")
    for split in sorted({i.split for i in ordered}):
        part = [i for i in ordered if i.split == split]
        objects = [o.source_id for i in part for o in i.instances if o.source_id is not None]
        if len({i.source_id for i in part}) != len(part) or len(set(objects)) != len(objects):
            found = f"duplicate ids of the source in split {split}"
            return Problem("ids", "ids-repeated", found, "unique ids", "write with new ids: ids new")
    return None
