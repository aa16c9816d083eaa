"""Datasets in memory: images with camera metadata and labelled instances, independent of the format on disk.

Also what names of classes say: whether two mean the same, and which stand for classes of known size and warmth.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.capture import UNKNOWN, Capture
from infrablend.core.rle_masks import Mask
from infrablend.errors import Problem

Split = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")

# Keys of `Instance.extra` of an object whose box was enlarged or fitted, see `annotation.looseness`: the exact box
# (x, y, width, height), and the exact corners of the oriented box (x, y of each).
TIGHT_BOX = "tight_bbox"
TIGHT_OBB = "tight_obb"
# The same fields for what is visible of an inserted object with `labels.fit: visible`, see `annotation.visible_fit`.
SEEN_BOX = "seen_bbox"
SEEN_OBB = "seen_obb"


@dataclass(frozen=True)
class Category:
    """A class of objects.

    Attributes:
        id: Id in the source.
        name: Name of the class.
        supercategory: Group of classes, as in COCO; may be empty.
        ignore: Whether the class marks regions to ignore instead of objects (DontCare).
    """

    id: int
    name: str
    supercategory: str = ""
    ignore: bool = False


def finite(coordinates: Any) -> NDArray[np.float64]:
    """Return coordinates as an array; a `ValueError` if one is not a finite number."""
    found = np.array(coordinates, np.float64)
    if not np.isfinite(found).all():
        raise ValueError(f"coordinates {str(found.tolist())[:80]}, expected finite numbers")
    return found


@dataclass(frozen=True, eq=False)
class Instance:
    """One labelled object.

    Attributes:
        category: Name of the category.
        box_xyxy: (4,) float64 axis-aligned box x0, y0, x1, y1, half-open pixels.
        corners_xy: (4, 2) float64 corners of the oriented box, clockwise on screen; None if unknown.
        mask: Visible pixels; None if unknown.
        visibility: Visible share in [0, 1]; None if unknown.
        truncated: Whether the frame's edge cuts the object; None if unknown.
        difficult: Flag of the source; None if unknown.
        inserted: Whether InfraBlend inserted the object.
        source_id: Id of the annotation in the source; None if it has none.
        extra: Further fields of the source, kept for writing.
        track_id: Id of the object throughout its sequence; None if unknown.
    """

    category: str
    box_xyxy: NDArray[np.float64]
    corners_xy: NDArray[np.float64] | None = None
    mask: Mask | None = None
    visibility: float | None = None
    truncated: bool | None = None
    difficult: bool | None = None
    inserted: bool = False
    source_id: int | str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)
    track_id: int | str | None = None

    def __post_init__(self) -> None:
        if self.box_xyxy.shape != (4,) or self.box_xyxy.dtype != np.float64:
            raise ValueError(f"box_xyxy must be (4,) float64, got {self.box_xyxy.shape} {self.box_xyxy.dtype}")
        self.box_xyxy.setflags(write=False)
        if self.corners_xy is not None:
            if self.corners_xy.shape != (4, 2) or self.corners_xy.dtype != np.float64:
                raise ValueError(f"corners_xy must be (4, 2) float64, got {self.corners_xy.shape}")
            self.corners_xy.setflags(write=False)

    @property
    def is_crowd(self) -> bool:
        """Whether this is COCO's `iscrowd`: a region of objects of a class that are not labelled singly."""
        return bool(self.extra.get("iscrowd") == 1)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values, from which `from_json` restores an equal instance."""
        return {
            "category": self.category,
            "box_xyxy": self.box_xyxy.tolist(),
            "corners_xy": None if self.corners_xy is None else self.corners_xy.tolist(),
            "mask": None if self.mask is None else self.mask.to_coco(),
            "visibility": self.visibility,
            "truncated": self.truncated,
            "difficult": self.difficult,
            "inserted": self.inserted,
            "source_id": self.source_id,
            "extra": dict(self.extra),
            **({} if self.track_id is None else {"track_id": self.track_id}),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Instance:
        """Restore an instance from what `to_json` gave; a LookupError, TypeError or ValueError if that is damaged."""
        d = dict(data)
        d["box_xyxy"] = finite(d["box_xyxy"])
        if d["corners_xy"] is not None:
            d["corners_xy"] = finite(d["corners_xy"])
        if d["mask"] is not None:
            height, width = d["mask"]["size"]
            d["mask"] = Mask.from_coco(d["mask"], (height, width))
        return cls(**d)

    def equals(self, other: Instance, atol_px: float = 0.0) -> bool:
        """Return whether all fields are equal, coordinates within `atol_px`."""

        def close(a: NDArray[np.float64] | None, b: NDArray[np.float64] | None) -> bool:
            if a is None or b is None:
                return a is b
            return bool(np.allclose(a, b, rtol=0, atol=atol_px))

        same = ("category", "visibility", "truncated", "difficult", "inserted", "source_id", "mask", "track_id")
        return (
            close(self.box_xyxy, other.box_xyxy)
            and close(self.corners_xy, other.corners_xy)
            and all(getattr(self, k) == getattr(other, k) for k in same)
        )


def boxes_of(labels: Sequence[Instance]) -> NDArray[np.float64]:
    """Return the (n, 4) boxes of labels."""
    return np.array([i.box_xyxy for i in labels], np.float64).reshape(-1, 4)


@dataclass(frozen=True, eq=False)
class ImageRecord:
    """Labels and facts of one image of a dataset. The picture itself is not decoded.

    Attributes:
        id: Stable id, unique in the dataset; the file stem where that is unique.
        path: Image file.
        split: Split of the image.
        size_wh: Size in pixels according to the annotation; None if unknown.
        instances: Labels in the order of the source.
        capture: How the picture was taken.
        source_id: Id of the image in the source; None if it has none.
        extra: Further fields of the source, kept for writing.
        file_name: Path relative to the split's picture folder, POSIX, with extension, used by writers; empty means
            `path.name`.
    """

    id: str
    path: Path
    split: Split
    size_wh: tuple[int, int] | None
    instances: tuple[Instance, ...]
    capture: Capture = UNKNOWN
    source_id: int | str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)
    file_name: str = ""

    @property
    def name(self) -> str:
        """File name for writers: `file_name`, or the name of `path` if that is empty."""
        return self.file_name or self.path.name


@dataclass(frozen=True, eq=False)
class Dataset:
    """A dataset in memory, with the problems found while reading it.

    Attributes:
        root: Folder of the dataset.
        format: Name of the reader, e.g. `hit-uav`.
        categories: Classes in the order of the source, with its ids.
        images: Images sorted by split (train, val, test), then by id.
        problems: Problems found; items with an `error` were skipped, items with a `warning` kept.
        notes: Facts for the run record, e.g. which annotation forms were merged and how often they disagreed.
        extra: Top-level fields of the source (info, licences), kept for writing.
    """

    root: Path
    format: str
    categories: tuple[Category, ...]
    images: tuple[ImageRecord, ...]
    problems: tuple[Problem, ...] = ()
    notes: Mapping[str, Any] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:  # a dataclass would print thousands of labels
        objects = sum(len(image.instances) for image in self.images)
        return f"<Dataset {self.root}: {self.format}, {len(self.images)} images, {objects} objects>"

    def category(self, name: str) -> Category:
        """Return the category with this name; a `KeyError` if there is none."""
        for c in self.categories:
            if c.name == name:
                return c
        raise KeyError(name)


KnownClass = Literal["person", "car", "bicycle"]
"""Classes of known size and warmth."""

_KNOWN_CLASSES: Mapping[KnownClass, frozenset[str]] = {
    "person": frozenset({"person", "people", "human", "pedestrian"}),
    "car": frozenset({"car", "vehicle"}),
    "bicycle": frozenset({"bicycle", "bike", "two-wheeler"}),
}


def known_class(category: str) -> KnownClass | None:
    """Return the known class that a category's name stands for, whatever its case, or None."""
    name = category.casefold()
    return next((known for known, names in _KNOWN_CLASSES.items() if name in names), None)


def differ_in_form(one: str, other: str) -> bool:
    """Return whether two names are different, but the same word in another case, or its singular and plural."""
    if one == other:
        return False
    a, b = one.casefold(), other.casefold()
    return a == b or b in _plurals(a) or a in _plurals(b)


def _plurals(word: str) -> set[str]:
    irregular = {"person": "people", "man": "men", "woman": "women"}
    found = {f"{word}s", f"{word}es", irregular.get(word, "")}
    return found | {f"{word[:-1]}ies"} if word.endswith("y") else found


def named_as(known: KnownClass, categories: Iterable[str]) -> str | None:
    """Return the first of the names that stands for a known class, or None."""
    return next((name for name in categories if known_class(name) == known), None)
