"""What writers return, and every kind of loss that they count."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from infrablend.core.dataset import ImageRecord, Instance
from infrablend.errors import Problem

LOSSES: Mapping[str, str] = {
    "box_dropped": "axis-aligned box: the format holds only the oriented box or polygon, whose bounds differ from it",
    "obb_dropped": "oriented box, which the format does not hold",
    "obb_from_box": "object without an oriented box: its axis-aligned box was written as one",
    "obb_not_rectangle": "four corners that do not form a rectangle, written as the nearest rectangle",
    "corners_clamped": "oriented box with a corner outside the frame: the corner was moved to the edge",
    "mask_dropped": "mask: the format holds none",
    "without_mask_omitted": "object without a mask, left out of a mask format",
    "mask_from_obb": "object without a mask: its oriented box was written as polygon",
    "mask_raster_px": "pixels in which the polygon, rasterised as in Ultralytics, differs from the mask",
    "ignore_dropped": "object of an ignored or unwanted category, or crowd (COCO's `iscrowd`), left out",
    "ignore_as_class": "object of a category to ignore, or crowd: only the category's name may still reveal it",
    "truncated_dropped": "object flagged as truncated: the format has no such flag",
    "difficult_dropped": "object flagged as difficult: the format has no such flag",
    "visibility_dropped": "visible share of an object: the format holds none",
    "occlusion_dropped": "flag `occluded` of a partly hidden object, or the boxes of the whole and of the visible part",
    "tracks_dropped": "track of an object: the format holds none",
    "telemetry_dropped": "pitch, roll, altitude, its origin, field of view, camera or time of day: the format lacks it",
    "inserted_dropped": "mark of an inserted object: the format holds none, so the object looks like an original",
    "not_finite_dropped": "number that is not finite, written as null",
    "sequence_dropped": "sequence, date, number or second of a picture: the format holds none, or not this text",
    "temperature_dropped": "temperature scale of a 16-bit picture: the format holds none; its levels become counts",
    "class_unfit": "object of a class that the format does not have, written as the nearest one or under a new number",
    "track_made": "object without a track, or the second of one in a picture, which got a new one: tracks are required",
    "track_renumbered": "object whose track id the format cannot hold, such as text: it has another number",
    "visibility_made": "object of unknown visible share, written as fully visible: the format requires a share",
    "sequence_made": "picture without a sequence or a number of its own in it, which got one: the format requires both",
    "frame_renumbered": "picture whose number in its sequence follows a gap: the format counts pictures without gaps",
    "hidden_absent": "object of which nothing is visible, left out: the format says that it is absent",
    "unlabelled_unsaid": "picture without labels: the format cannot distinguish it from one known to contain no object",
    "empty_unsaid": "picture known to contain no object: the format cannot distinguish it from an unlabelled picture",
    "name_changed": "picture renamed: the format has no folders, or not this one, or knows pictures by the stem alone",
    "class_name_changed": "class renamed: the format allows no blanks in names",
    "mask_overlap_px": "pixels of masks covered by a later object: the format has one object per pixel",
    "mask_absent": "object without a mask: it is in the table but has no pixels",
    "fraction_truncated": "box with fractional coordinates, truncated toward zero",
    "box_widened": "box narrower than a pixel, widened to one pixel",
    "box_clipped": "box reaching outside the frame, clipped",
    "box_outside": "box with no part inside the frame, left out",
}
"""Meaning of every kind of loss that writers count."""


class Losses(Counter[str]):
    """Losses by kind (see `LOSSES`), and the objects that are in no file because of them, by split and class."""

    def __init__(self) -> None:
        super().__init__()
        self.left_out: Counter[tuple[str, str]] = Counter()

    def leave_out(self, kind: str, image: ImageRecord, instance: Instance) -> None:
        """Count an object that is in no file, by the kind of loss that is the reason."""
        self[kind] += 1
        self.left_out[image.split, instance.category] += 1


def without_regions(image: ImageRecord, regions: Collection[str], losses: Losses) -> ImageRecord:
    """Return a picture without crowds and objects of classes to ignore, which are counted."""
    kept = [o for o in image.instances if o.category not in regions and not o.is_crowd]
    if len(kept) == len(image.instances):
        return image
    for o in image.instances:
        if o.category in regions or o.is_crowd:
            losses.leave_out("ignore_dropped", image, o)
    return replace(image, instances=tuple(kept))


@dataclass(frozen=True)
class Written:
    """Result of a writer.

    Attributes:
        files: The files.
        losses: Losses by kind, see `LOSSES`.
        problems: Warnings.
        left_out: Number of objects that are in none of the files, by split and class.
    """

    files: tuple[Path, ...] = ()
    losses: Mapping[str, int] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()
    left_out: Mapping[tuple[str, str], int] = field(default_factory=dict)

    @classmethod
    def of(cls, files: Iterable[Path], losses: Mapping[str, int], problems: Iterable[Problem] = ()) -> Written:
        """Return the result with the kinds of losses that occurred, sorted."""
        left_out = losses.left_out if isinstance(losses, Losses) else {}
        return cls(tuple(files), {k: n for k, n in sorted(losses.items()) if n}, tuple(problems), left_out)

    @classmethod
    def together(cls, parts: Iterable[Written]) -> Written:
        """Combine several results, in order."""
        files: list[Path] = []
        problems: list[Problem] = []
        losses: Counter[str] = Counter()
        left_out: Counter[tuple[str, str]] = Counter()
        for part in parts:
            files += part.files
            problems += part.problems
            losses.update(part.losses)
            left_out.update(part.left_out)
        return cls(tuple(files), dict(sorted(losses.items())), tuple(problems), left_out)

    def kept(self, images: Iterable[ImageRecord]) -> Counter[tuple[str, str]]:
        """Return the number of objects in the files, by split and class, of the images that were to be written."""
        kept: Counter[tuple[str, str]] = Counter((i.split, o.category) for i in images for o in i.instances)
        kept.subtract(self.left_out)
        return kept


def by_class(counts: Mapping[tuple[str, str], int]) -> dict[str, int]:
    """Return the number of objects by class, sorted, from that by split and class."""
    found: Counter[str] = Counter()
    for (_, name), n in counts.items():
        found[name] += n
    return dict(sorted(found.items()))


BOXES = ("amodal_box", "visible_box")
"""Boxes of partly hidden objects in `Instance.extra`: whole and visible part; left, top, right, bottom in pixels."""


def occlusion_fields(instance: Instance) -> dict[str, object]:
    """Return the flag `occluded` and the boxes that a label has."""
    return {k: instance.extra[k] for k in ("occluded", *BOXES) if k in instance.extra}


def _loses_boxes(i: Instance) -> bool:
    return any(k in i.extra for k in BOXES)


_DROPPED: Mapping[str, Callable[[Instance], bool]] = {
    "obb": lambda i: i.corners_xy is not None,
    "mask": lambda i: i.mask is not None,
    "visibility": lambda i: i.visibility is not None,
    "occlusion": lambda i: _loses_boxes(i) or i.extra.get("occluded") is True,
    "occlusion boxes": _loses_boxes,
    "truncated": lambda i: i.truncated is True,
    "difficult": lambda i: i.difficult is True,
}


def count_dropped(instance: Instance, losses: Counter[str], *fields: str) -> None:
    """Count the fields of an object that a format does not hold: `mask` as `mask_dropped`, and so on.

    A format without the boxes of partly hidden objects, but with the flag `occluded`, drops `occlusion boxes`.
    """
    for name in fields:
        losses[f"{name.split(' ')[0]}_dropped"] += _DROPPED[name](instance)
