"""Datasets in memory: images with camera metadata and labelled instances, whatever the format on disk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.masks import Mask
from infrablend.errors import Problem

Split = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")
TimeOfDay = Literal["day", "night"]


@dataclass(frozen=True)
class Category:
    """A class of objects. `id` is the source's own id; `ignore` marks regions that are no objects (DontCare)."""

    id: int
    name: str
    supercategory: str = ""
    ignore: bool = False


@dataclass(frozen=True, eq=False)
class Instance:
    """One labelled object.

    Attributes:
        category: Name of its category.
        box_xyxy: (4,) float64 axis-aligned box x0, y0, x1, y1, half-open pixels.
        corners_xy: (4, 2) float64 corners of the oriented box, clockwise on screen, or None if unknown.
        mask: The visible pixels, or None if unknown.
        visibility: Visible share in [0, 1], or None if unknown.
        truncated: Cut by the frame's edge; None if unknown.
        difficult: The source's flag; None if unknown.
        inserted: True for objects InfraBlend put there.
        source_id: The id the source file gives the annotation, or None.
        extra: Further fields of the source, kept for writing back.
        track_id: The same for one object through a sequence; None if unknown.
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

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values; `from_json` gives an equal instance back."""
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
        """Return the instance that `to_json` wrote."""
        d = dict(data)
        d["box_xyxy"] = np.array(d["box_xyxy"], np.float64)
        if d["corners_xy"] is not None:
            d["corners_xy"] = np.array(d["corners_xy"], np.float64)
        if d["mask"] is not None:
            height, width = d["mask"]["size"]
            d["mask"] = Mask(d["mask"]["counts"], (height, width))
        return cls(**d)

    def equals(self, other: Instance, atol_px: float = 0.0) -> bool:
        """Return True if all fields agree, coordinates within `atol_px`."""

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


@dataclass(frozen=True, eq=False)
class ImageRecord:
    """One image of a dataset and what is known of it. Nothing here has been decoded: `path` is.

    Attributes:
        id: Unique in the dataset and stable: the file stem where that is unique.
        path: The image file.
        split: The split it belongs to.
        size_wh: Size in pixels as the annotation says, or None if it does not say.
        pitch_deg: Camera depression angle, 0 level, 90 straight down, negative looking up; None if unknown.
        altitude_m: Above ground as the metadata says; None if unknown.
        time_of_day: None if unknown.
        instances: The labels, in the source's order.
        source_id: The id the source file gives the image, or None.
        extra: Further fields of the source, kept for writing back.
        file_name: Where the picture lies below its split's picture folder, POSIX, with extension; empty means
            `path.name`. Writers name the picture so.
        sequence: The flight or clip the image comes from; None if unknown.
        captured: Date or time of capture, ISO 8601; None if unknown.
    """

    id: str
    path: Path
    split: Split
    size_wh: tuple[int, int] | None
    pitch_deg: float | None
    altitude_m: float | None
    time_of_day: TimeOfDay | None
    instances: tuple[Instance, ...]
    source_id: int | str | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)
    file_name: str = ""
    sequence: str | None = None
    captured: str | None = None

    @property
    def name(self) -> str:
        """`file_name`, or the path's own name if that is empty."""
        return self.file_name or self.path.name


@dataclass(frozen=True, eq=False)
class Dataset:
    """A dataset as read: images sorted by (split order, id), what was wrong with it, what it came from.

    Attributes:
        root: The folder it was read from.
        format: Name of the reader, e.g. `hit-uav`.
        categories: In the source's order, ids as in the source.
        images: Sorted by split (train, val, test), then id.
        problems: Everything found wrong; an item with an `error` was skipped, with a `warning` kept.
        notes: Facts for the run record, e.g. which forms were united and how often they disagreed.
        extra: Top-level fields of the source (info, licences), kept for writing back.
    """

    root: Path
    format: str
    categories: tuple[Category, ...]
    images: tuple[ImageRecord, ...]
    problems: tuple[Problem, ...] = ()
    notes: Mapping[str, Any] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:  # thousands of labels are no use on a screen
        objects = sum(len(image.instances) for image in self.images)
        return f"<Dataset {self.root}: {self.format}, {len(self.images)} images, {objects} objects>"

    def category(self, name: str) -> Category:
        """Return the category of that name; KeyError if there is none."""
        for c in self.categories:
            if c.name == name:
                return c
        raise KeyError(name)
