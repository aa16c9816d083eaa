"""What is to be found: the labels of a split, by the classes that are judged."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import corners_of_box, cxcywha_of_corners
from infrablend.core.class_names import known_class
from infrablend.core.dataset import Category, ImageRecord, Instance
from infrablend.core.masks import Mask
from infrablend.evaluation.detections import FloatArray, Task


@dataclass(frozen=True, eq=False)
class Truth:
    """The labels of one image. Objects first, regions to ignore after them.

    Attributes:
        key: `<split>/<name>`.
        size_wh: Of the image, px.
        boxes_xyxy: (g, 4) px.
        classes: (g,) numbers of the classes judged; -1 for a region that counts for all of them.
        ignore: (g,) bool: what is found in there counts neither way.
        corners_xy: (g, 4, 2), for oriented boxes; else None.
        masks: g masks, for masks; else None.
    """

    key: str
    size_wh: tuple[int, int]
    boxes_xyxy: FloatArray
    classes: NDArray[np.int64]
    ignore: NDArray[np.bool_]
    corners_xy: FloatArray | None = None
    masks: tuple[Mask, ...] | None = None

    @property
    def long_sides_px(self) -> FloatArray:
        """(g,) the longer side of each."""
        return long_sides(self.boxes_xyxy, self.corners_xy)


def long_sides(boxes_xyxy: FloatArray, corners_xy: FloatArray | None) -> FloatArray:
    """(n,) the longer side of boxes, px; of the oriented ones where there are any."""
    if corners_xy is not None:
        return np.asarray(cxcywha_of_corners(corners_xy)[:, 2:4].max(axis=1, initial=0.0))
    return np.asarray((boxes_xyxy[:, 2:] - boxes_xyxy[:, :2]).max(axis=1, initial=0.0))


def image_key(image: ImageRecord) -> str:
    """`<split>/<name>`: what the files of an evaluation call an image."""
    return f"{image.split}/{image.name}"


def is_crowd(instance: Instance) -> bool:
    """COCO's `iscrowd`: a region of many objects of a class, none of them told apart."""
    return bool(instance.extra.get("iscrowd") == 1)


def truths(
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    classes: Sequence[str],
    task: Task,
    *,
    ignore_regions: bool = True,
) -> tuple[tuple[Truth, ...], dict[str, int]]:
    """Labels by image, and what was done to them, counted.

    Args:
        images: With their sizes.
        categories: Of the dataset.
        classes: Names of the categories judged; objects of others are left out.
        task: What is compared. Oriented boxes: an object without one has its plain box. Masks: an object without one
            can be neither found nor missed, so that its box is a region to ignore for its class.
        ignore_regions: Use regions of ignored categories, and COCO's crowds as regions of their class; else both are
            left out.
    """
    number = {name: k for k, name in enumerate(classes)}
    regions = {c.name for c in categories if c.ignore}
    counts: Counter[str] = Counter()
    found = []
    for image in images:
        if image.size_wh is None:
            raise ValueError(f"{image.id}: size_wh must be known")
        objects: list[tuple[Instance, int, bool]] = []
        for i in image.instances:
            if i.category in number and is_crowd(i):
                counts["crowds" if ignore_regions else "crowds_left_out"] += 1
                if ignore_regions:
                    objects.append((i, number[i.category], True))
            elif i.category in number:
                lacking = task == "segment" and i.mask is None
                counts["objects_without_mask"] += lacking
                counts["objects_without_oriented_box"] += task == "obb" and i.corners_xy is None
                objects.append((i, number[i.category], lacking))
            elif i.category in regions:
                counts["ignore_regions" if ignore_regions else "ignore_regions_left_out"] += 1
                if ignore_regions:
                    objects.append((i, -1, True))
            else:
                counts["objects_of_other_classes"] += 1
        objects.sort(key=lambda o: o[2])  # stable: the order of the labels otherwise
        found.append(_truth(image_key(image), image.size_wh, objects, task))
    return tuple(found), {k: n for k, n in sorted(counts.items()) if n}


def _truth(key: str, size_wh: tuple[int, int], objects: Sequence[tuple[Instance, int, bool]], task: Task) -> Truth:
    instances = [i for i, _, _ in objects]
    boxes = np.array([i.box_xyxy for i in instances], np.float64).reshape(-1, 4)
    corners = [corners_of_box(i.box_xyxy) if i.corners_xy is None else i.corners_xy for i in instances]
    return Truth(
        key,
        size_wh,
        boxes,
        np.array([c for _, c, _ in objects], np.int64),
        np.array([ignore for _, _, ignore in objects], np.bool_),
        np.array(corners, np.float64).reshape(-1, 4, 2) if task == "obb" else None,
        tuple(_box_mask(i, size_wh) if i.mask is None else i.mask for i in instances) if task == "segment" else None,
    )


def _box_mask(instance: Instance, size_wh: tuple[int, int]) -> Mask:
    """Return the box of an object without mask, filled."""
    w, h = size_wh
    x0, y0, x1, y1 = (round(v) for v in instance.box_xyxy)
    filled = np.zeros((h, w), np.bool_)
    filled[max(y0, 0) : y1, max(x0, 0) : x1] = True
    return Mask.from_array(filled)


def fingerprint(images: Iterable[ImageRecord]) -> str:
    """SHA-256 of names, sizes and labels, in order: two evaluations may be compared if theirs are the same."""
    digest = hashlib.sha256()
    for image in images:
        facts = [
            image_key(image),
            image.size_wh,
            [
                [
                    i.category,
                    np.round(i.box_xyxy, 6).tolist(),
                    None if i.corners_xy is None else np.round(i.corners_xy, 6).tolist(),
                    None if i.mask is None else i.mask.counts,
                    *(["crowd"] if is_crowd(i) else []),
                ]
                for i in image.instances
            ],
        ]
        digest.update(json.dumps(facts).encode())
    return digest.hexdigest()


def match_classes(detector: Sequence[str], wanted: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Numbers of the detector's classes that mean each wanted class; empty where none does.

    Names count as the same if they are equal, or else equal but for case and signs (`Other Vehicle`, `OtherVehicle`),
    or else mean the same kind (`person`, `pedestrian`); of several ways the first that fits anything is taken.
    """
    found: dict[str, tuple[int, ...]] = {}
    for name in wanted:
        ways = (
            [k for k, other in enumerate(detector) if other == name],
            [k for k, other in enumerate(detector) if _plain(other) == _plain(name)],
            [
                k
                for k, other in enumerate(detector)
                if known_class(other) is not None and known_class(other) == known_class(name)
            ],
        )
        found[name] = tuple(next((way for way in ways if way), []))
    return found


def class_numbers(mapping: Mapping[str, tuple[int, ...]], detector: int) -> NDArray[np.int64]:
    """(detector,) the judged class's number for each of the detector's classes; -1 where it is none."""
    numbers = np.full(detector, -1, np.int64)
    for k, of in enumerate(mapping.values()):
        numbers[list(of)] = k
    return numbers


def _plain(name: str) -> str:
    return "".join(c for c in name.casefold() if c.isalnum())
