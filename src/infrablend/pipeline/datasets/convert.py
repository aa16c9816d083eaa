"""Converts a dataset to another format: links pictures, translates labels and counts every loss."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from infrablend.annotation.classes import drop_classes, ignored_turned_objects, rename_classes, unknown_classes
from infrablend.annotation.looseness import EXACT, Looseness, loosen_inserted, loosened_text
from infrablend.config.recipe import CLASS_NAME, MAX_LOOSEN, MAX_LOOSEN_PX
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.format_table import NATIVE, Writer, find_writer, written_names
from infrablend.core.output_checks import require_apart
from infrablend.core.workspace import CONVERT_FILE, replacing, workspace
from infrablend.errors import DatasetError, Problem
from infrablend.formats import writing
from infrablend.formats.losses import by_class
from infrablend.formats.pictures.listing import with_sizes
from infrablend.formats.read_write import WriteSettings
from infrablend.pipeline.datasets.origin import AT_MOST, invalid_texts, loosened_before, origin_of, renamed_texts
from infrablend.pipeline.datasets.requests import KEEP_CLASSES, SELECT_ALL, ClassChanges, Selection, SelectionFacts
from infrablend.pipeline.datasets.select import select
from infrablend.report.card import dataset_card, write_card, written_layout

_LOOSEN = "--loosen-inserted"
_LOOSEN_PX = "--loosen-inserted-px"


@dataclass(frozen=True)
class ConvertReport:
    """Result of a conversion.

    Attributes:
        out: Folder that was written.
        format: Name of the format that was written.
        counts: Number of images per split, and of labels written, lost and dropped per class.
        losses: Counts of what the format cannot hold, by kind; see `losses.LOSSES`.
        problems: Errors in the source, and warnings of the writer.
    """

    out: Path
    format: str
    counts: Mapping[str, Any]
    losses: Mapping[str, int]
    problems: tuple[Problem, ...]

    @property
    def ok(self) -> bool:
        """True if every part of the source could be used."""
        return not any(p.severity == "error" for p in self.problems)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "out": str(self.out),
            "format": self.format,
            "ok": self.ok,
            "counts": dict(self.counts),
            "losses": dict(self.losses),
            "problems": [p.to_json() for p in self.problems],
        }


def convert_dataset(
    dataset: Dataset,
    to: str,
    out: Path,
    *,
    classes: ClassChanges = KEEP_CLASSES,
    selection: Selection = SELECT_ALL,
    looseness: Looseness = EXACT,
    settings: WriteSettings | None = None,
    overwrite: bool = False,
) -> ConvertReport:
    """Write a dataset in the format `to`, with `convert.json`, the record of the conversion.

    Args:
        dataset: Dataset as read.
        to: Name of a format that can be written, or `native`.
        out: Folder to write: new or empty, or with `overwrite` one that an earlier call wrote.
        classes: Classes to rename and to leave out.
        selection: Pictures to select; class names apply after renaming and before dropping.
        looseness: How to enlarge the boxes of inserted objects: one factor and one distance for all classes.
        settings: Settings of the writer.
        overwrite: Replace the folder that an earlier call wrote.

    Raises:
        UnknownFormatError: No writer has this name.
        DatasetError: A class does not exist, ids cannot be kept, or no picture has a readable size.
        OutputError: The folder cannot be used or written.
    """
    require_apart(dataset.root, out)
    settings = settings or WriteSettings()
    writer = _writer(dataset, to)
    chosen = _choose(dataset, classes, selection)
    # Boxes that are read from masks are exact.
    earlier = {} if _has_only_masks(writer) else loosened_before(dataset, chosen.wanted)
    if looseness != EXACT:
        _require_tight(dataset, looseness, sum(earlier.values()), writer)
    problems = [*dataset.problems, *ignored_turned_objects(dataset, classes.rename)]
    images = with_sizes(chosen.wanted.images, partial(_location, dataset.root), problems)
    images, loosened = _loosened(dataset, images, looseness)
    if not images:
        raise DatasetError(f"{dataset.root}: no picture with a readable size", problems[:20])
    fault = writing.unwritable(writer.name, images, settings)
    if fault is not None:
        raise DatasetError(f"{dataset.root}: the ids cannot be kept", [fault])
    counts: dict[str, object] = {
        "images": len(images),
        "images_per_split": dict(Counter(i.split for i in images)),
        "labels": _per_class(images),
        "labels_dropped": chosen.dropped,
        "source_format": dataset.format,
        **({} if chosen.selection is None else {"selection": chosen.selection}),
        # Those of the source count as well, or a further step would enlarge them again.
        **(looseness.counted(loosened) or earlier),
    }
    with workspace(out, "conversion", CONVERT_FILE, replacing(overwrite)) as space:
        try:
            written = writing.write(
                to, space.folder, images, chosen.wanted.categories, settings=settings, source=chosen.wanted
            )
        except ValueError as error:  # a label that the format does not allow
            raise DatasetError(f"{dataset.root}: cannot be written as {writer.name}: {error}") from error
        problems += written.problems
        kept = by_class(written.kept(images))
        counts["labels"] = kept
        if written.left_out:
            lost = by_class(written.left_out)
            counts["labels_lost"] = lost
            problems += _lost_classes(dataset, writer.name, lost, kept)
        changes = _changes(writer.name, classes.rename, chosen, problems)
        for name, n in earlier.items():
            up_to = "Up to " if name == AT_MOST else ""
            changes.append(f"{up_to}{n} boxes of inserted objects were enlarged or fitted before, to match drawn ones.")
        if looseness:
            changes.append(loosened_text(loosened, looseness))
        card = dataset_card(
            origin_of(dataset, images, classes.rename),
            images,
            chosen.wanted.categories,
            changes=changes,
            to=writer.name,
            losses=written.losses,
            layout=written_layout(space.folder, written.files, CONVERT_FILE),
        )
        write_card(space.folder, card)
        problems += _background_class(writer.name, chosen.wanted, settings)
        report = ConvertReport(out, writer.name, counts, written.losses, tuple(problems))
        space.finish(
            {
                "source": str(dataset.root),
                "source_format": dataset.format,
                "format": writer.name,
                "rename": dict(classes.rename),
                "drop": sorted(chosen.drop),
                "ids": settings.ids,
                "category_ids": settings.category_ids,
                "notes": dict(dataset.notes),
                **{k: v for k, v in report.to_json().items() if k not in ("out", "format")},
            }
        )
    return report


def _lost_classes(dataset: Dataset, to: str, lost: Mapping[str, int], kept: Mapping[str, int]) -> list[Problem]:
    """Return an error for each class, except those to ignore, of which the files hold no object any more."""
    ignored = {c.name for c in dataset.categories if c.ignore}
    gone = {c: n for c, n in lost.items() if not kept.get(c) and c not in ignored}
    expected = f"objects that {to} can hold"
    todo = "write another format, which holds them; see the losses"
    return [Problem(f"class {c}", "class-lost", f"all {n} object(s) left out", expected, todo) for c, n in gone.items()]


def _writer(dataset: Dataset, to: str) -> Writer:
    """Return the writer of a format, or of the dataset's own.

    Raises:
        UnknownFormatError: No writer has this name.
        DatasetError: The dataset's format has no writer.
    """
    writer = writing.native_writer(dataset) if to == NATIVE else find_writer(to)
    if writer is None:
        expected = f"one of {', '.join(written_names())}"
        problem = Problem("--to", "format-none", f"{dataset.format} has no writer", expected)
        raise DatasetError(f"{dataset.root}: cannot be written in its own format", [problem])
    return writer


@dataclass(frozen=True, eq=False)
class _Chosen:
    """What is written of a dataset.

    Attributes:
        wanted: The dataset with the pictures and classes to write.
        drop: Classes that were left out, by their new names.
        dropped: Number of labels left out, by class.
        selection: Facts of the selection of pictures; None if all were taken.
    """

    wanted: Dataset
    drop: Sequence[str]
    dropped: Mapping[str, int]
    selection: SelectionFacts | None


def _choose(dataset: Dataset, classes: ClassChanges, selection: Selection) -> _Chosen:
    """Rename classes, select pictures, and drop classes.

    Raises:
        DatasetError: A class does not exist, has an invalid new name, or too few pictures match the selection.
    """
    _require_classes(dataset, classes.rename, "--rename")
    _require_names(dataset, classes.rename.values())
    renamed = rename_classes(dataset, classes.rename)
    _require_classes(renamed, classes.drop, "--drop-class")
    drop = classes.drop
    if classes.only is not None:
        _require_classes(renamed, [classes.only], "--only-class")
        drop = [c.name for c in renamed.categories if c.name != classes.only]
    facts: SelectionFacts | None = None
    if selection:
        renamed, facts = select(renamed, selection)
    dropped = {k: n for k, n in _per_class(renamed.images).items() if k in set(drop)}
    return _Chosen(drop_classes(renamed, drop), drop, dropped, facts)


def _loosened(dataset: Dataset, images: list[ImageRecord], by: Looseness) -> tuple[list[ImageRecord], int]:
    """Return the pictures with larger boxes of inserted objects, and the number of these boxes.

    Raises:
        DatasetError: There is no such box, although larger ones were asked for.
    """
    if not by:
        return images, 0
    images, count = loosen_inserted(images, by)
    if not count:
        found = "no object marked as inserted, among those that are written"
        expected = "at least one"
        todo = "convert the coco folder of a run, which marks them"
        none = Problem(_loosen_option(by), "loosen-none", found, expected, todo)
        raise DatasetError(f"{dataset.root}: no box to enlarge", [none])
    return images, count


def _require_tight(dataset: Dataset, by: Looseness, earlier: int, to: Writer) -> None:
    """Check the factor and the distance, and that no earlier step has enlarged or fitted the boxes already."""
    faults = [
        Problem(option, "loosen-range", f"{value}", f"a {what} from {least} to {most:g}{unit}")
        for option, value, what, least, most, unit in (
            (_LOOSEN, by.loosen, "factor", 1, MAX_LOOSEN, ""),
            (_LOOSEN_PX, by.loosen_px, "distance", 0, MAX_LOOSEN_PX, " px"),
        )
        if not isinstance(value, int | float) or not least <= value <= most
    ]
    if faults:
        raise DatasetError(f"{dataset.root}: boxes cannot be enlarged by this much", faults)
    if _has_only_masks(to):
        found = f"{to.name}, which has masks instead of boxes"
        todo = "leave the option out, or write another format"
        none = Problem(_loosen_option(by), "loosen-none", found, "a format with boxes", todo)
        raise DatasetError(f"{dataset.root}: no box to enlarge", [none])
    if earlier:
        found = f"{earlier} boxes that are enlarged or fitted already"
        expected = "boxes that fit tightly"
        todo = "leave the option out, or convert a run made with labels.loosen=exact, fit=shape and loosen_px=0"
        twice = Problem(_loosen_option(by), "loosen-twice", found, expected, todo)
        raise DatasetError(f"{dataset.root}: boxes are enlarged only once", [twice])


def _has_only_masks(to: Writer) -> bool:
    return {"boxes", "obb"} <= to.lacks


def _loosen_option(by: Looseness) -> str:
    return _LOOSEN if "loosened_by" in by.to_counts() else _LOOSEN_PX


def _changes(to: str, rename: Mapping[str, str], chosen: _Chosen, problems: Sequence[Problem]) -> list[str]:
    texts = [f"The labels were converted to the format `{to}`; the picture files are unchanged."]
    texts += renamed_texts(rename)
    if chosen.dropped:
        which = ", ".join(f"{name} {n}" for name, n in chosen.dropped.items())
        texts.append(f"{sum(chosen.dropped.values())} labels of dropped classes ({which}) were left out.")
    if chosen.selection is not None:
        what = ", ".join(f"{n} {why}" for why, n in chosen.selection["left_out"].items()) or "none"
        texts.append(f"Only a selection of the source's pictures is included; left out: {what}; see `{CONVERT_FILE}`.")
    return texts + invalid_texts(problems, CONVERT_FILE)


def _background_class(name: str, dataset: Dataset, settings: WriteSettings) -> list[Problem]:
    zero = next((c.name for c in dataset.categories if c.id == 0), None)
    if name != "coco" or zero is None or settings.category_ids == "from_one":
        return []
    found = f"{zero} has category id 0, which many tools (Datumaro, torchvision) treat as background"
    todo = "use --category-ids from_one if your tool does"
    return [Problem("coco", "category-zero", found, "ids from 1", todo, "warning")]


def _require_classes(dataset: Dataset, names: Mapping[str, str] | Sequence[str], option: str) -> None:
    unknown = unknown_classes(dataset, list(names))
    if unknown:
        known = ", ".join(c.name for c in dataset.categories) or "it has none"
        problem = Problem(option, "category-unknown", ", ".join(unknown), f"classes of the dataset ({known})")
        raise DatasetError(f"{dataset.root}: unknown class", [problem])


def _require_names(dataset: Dataset, names: Iterable[str]) -> None:
    """Check new class names by the rule for recipes, so that every format can hold them."""
    bad = [repr(n) for n in names if not re.fullmatch(CLASS_NAME, n)]
    if bad:
        expected = "a name without line breaks and without leading or trailing spaces"
        problem = Problem("--rename", "category-malformed", f"new name {', '.join(bad)}", expected)
        raise DatasetError(f"{dataset.root}: invalid class name", [problem])


def _per_class(images: Sequence[ImageRecord]) -> dict[str, int]:
    return dict(sorted(Counter(i.category for image in images for i in image.instances).items()))


def _location(root: Path, image: ImageRecord) -> str:
    return image.path.relative_to(root).as_posix() if image.path.is_relative_to(root) else image.id
