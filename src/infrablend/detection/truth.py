"""Labels of a split by evaluated class, the detections to compare with them, and the classes that match."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import clockwise, corners_of_box, cxcywha_of_corners
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance, known_class
from infrablend.core.rle_masks import Mask
from infrablend.detection.detections import Detections, FloatArray, Task, detections
from infrablend.errors import Problem


@dataclass(frozen=True, eq=False)
class Truth:
    """Labels of one image: objects first, then regions to ignore.

    Attributes:
        key: `<split>/<name>` of the image.
        size_wh: Size of the image, px.
        boxes_xyxy: (g, 4) boxes, px.
        classes: (g,) indices of the evaluated classes; -1 for a region that applies to all classes.
        ignore: (g,) mask of the regions to ignore: detections in them are neither hits nor false positives.
        corners_xy: (g, 4, 2) corners if oriented boxes are compared; else None.
        masks: g masks if masks are compared; else None.
        track_ids: Ids of the objects throughout their sequence; None where there is none.
        visibility: (g,) visible shares of the objects in [0, 1]; NaN where unknown. None if all are.
    """

    key: str
    size_wh: tuple[int, int]
    boxes_xyxy: FloatArray
    classes: NDArray[np.int64]
    ignore: NDArray[np.bool_]
    corners_xy: FloatArray | None = None
    masks: tuple[Mask, ...] | None = None
    track_ids: tuple[int | str | None, ...] = ()
    visibility: FloatArray | None = None

    def regions_of(self, numbers: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Mark the (n, g) regions that ignore detections of (n,) classes: those of no class, and crowds of the same."""
        return np.asarray(self.ignore & ((self.classes == -1) | (self.classes == numbers[:, None])))


@dataclass(frozen=True, eq=False)
class Case:
    """Detections and the labels to compare them with.

    Attributes:
        images: Images of the split.
        labels: Labels of each image.
        found: Detections on each image, see `compared`.
        classes: Names of the evaluated classes.
        task: What is compared: boxes, oriented boxes or masks.
    """

    images: Sequence[ImageRecord]
    labels: Sequence[Truth]
    found: Sequence[Detections]
    classes: tuple[str, ...]
    task: Task


def compared(
    found: Mapping[str, Detections], labels: Sequence[Truth], class_of: NDArray[np.int64], task: Task
) -> tuple[Detections, ...]:
    """Return the detections on each labelled image as a task compares them: only evaluated classes, by their indices.

    Args:
        found: Detections by the key of the image; images without an entry have none.
        labels: Labels of each image.
        class_of: Index of the evaluated class for each of the detector's classes; -1 for none.
        task: What is compared.
    """
    result = []
    for truth in labels:
        whole = found.get(truth.key, detections([], [], []))
        ours = replace(
            whole,
            classes=class_of[whole.classes],
            corners_xy=whole.corners_xy if task == "obb" else None,
            masks=whole.masks if task == "segment" else None,
        )
        result.append(ours.take(np.flatnonzero(ours.classes >= 0)))
    return tuple(result)


def long_sides(of: Truth | Detections) -> FloatArray:
    """Return the (n,) longer side in px, of the oriented boxes if there are any, else of the boxes."""
    if of.corners_xy is not None:
        return np.asarray(cxcywha_of_corners(of.corners_xy)[:, 2:4].max(axis=1, initial=0.0))
    return np.asarray((of.boxes_xyxy[:, 2:] - of.boxes_xyxy[:, :2]).max(axis=1, initial=0.0))


def image_key(image: ImageRecord) -> str:
    """Return `<split>/<name>`, the name of an image in the files of an evaluation."""
    return f"{image.split}/{image.name}"


def truths(
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    classes: Sequence[str],
    task: Task,
    *,
    ignore_regions: bool = True,
) -> tuple[tuple[Truth, ...], dict[str, int]]:
    """Return labels by image, and counts of the objects left out, without a mask or to ignore.

    Args:
        images: Images with known sizes.
        categories: Categories of the dataset.
        classes: Names of the evaluated categories; objects of others are left out.
        task: What is compared. For oriented boxes, an object without one has its axis-aligned box. For masks, the box
            of an object without one becomes a region to ignore for its class.
        ignore_regions: Whether regions of ignored categories apply to all classes, and COCO's crowds to their own;
            otherwise both are left out.
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
            if i.category in number and i.is_crowd:
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
    corners = [corners_of_box(i.box_xyxy) if i.corners_xy is None else clockwise(i.corners_xy) for i in instances]
    return Truth(
        key,
        size_wh,
        boxes,
        np.array([c for _, c, _ in objects], np.int64),
        np.array([ignore for _, _, ignore in objects], np.bool_),
        np.array(corners, np.float64).reshape(-1, 4, 2) if task == "obb" else None,
        tuple(_box_mask(i, size_wh) if i.mask is None else i.mask for i in instances) if task == "segment" else None,
        tuple(i.track_id for i in instances),
        np.array([np.nan if i.visibility is None else i.visibility for i in instances], np.float64),
    )


def _box_mask(instance: Instance, size_wh: tuple[int, int]) -> Mask:
    w, h = size_wh
    x0, y0, x1, y1 = (round(v) for v in instance.box_xyxy)
    filled = np.zeros((h, w), np.bool_)
    filled[max(y0, 0) : y1, max(x0, 0) : x1] = True
    return Mask.from_array(filled)


def fingerprint(images: Iterable[ImageRecord]) -> str:
    """Return the SHA-256 of names, sizes and labels, in order; evaluations with the same one can be compared."""
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
                    *(["crowd"] if i.is_crowd else []),
                ]
                for i in image.instances
            ],
        ]
        digest.update(json.dumps(facts).encode())
    return digest.hexdigest()


def match_classes(detector: Sequence[str], wanted: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Return the indices of the detector's classes that match each wanted class; empty if none does.

    Names match if they are equal; else if they differ in case and punctuation only (`Other Vehicle`, `OtherVehicle`);
    else if they are names of the same class (`person`, `pedestrian`). The first of these rules with a match applies.
    """
    found: dict[str, tuple[int, ...]] = {}
    for name in wanted:
        for rule in (str, class_key, known_class):
            wanted_key = rule(name)
            found[name] = tuple(k for k, n in enumerate(detector) if wanted_key is not None and rule(n) == wanted_key)
            if found[name]:
                break
    return found


def class_numbers(mapping: Mapping[str, tuple[int, ...]], detector: int) -> NDArray[np.int64]:
    """Return the (detector,) index of the evaluated class for each of the detector's classes; -1 for none."""
    numbers = np.full(detector, -1, np.int64)
    for k, of in enumerate(mapping.values()):
        numbers[list(of)] = k
    return numbers


def class_key(name: str) -> str:
    """Return a class name without case and blanks, for comparison: `Other Vehicle` and `OtherVehicle` are one."""
    return "".join(c for c in name.casefold() if c.isalnum())


def evaluated_classes(
    dataset: Dataset,
    images: Sequence[ImageRecord],
    wanted: Sequence[str] | None,
    detector: Sequence[str] | None,
    problems: list[Problem],
) -> dict[str, tuple[int, ...]]:
    """Return the indices of the matching detector classes for each evaluated class; append to `problems`."""
    own = [c.name for c in dataset.categories if not c.ignore]
    there = {i.category for image in images for i in image.instances}
    names = own
    if wanted is not None:
        found = match_classes(own, wanted)
        for name, of in found.items():
            if not of:
                expected = f"some of {', '.join(own)}" if own else "a class of the labels, which have none"
                todo = "correct --classes" if own else "give a dataset with labels: nothing else tells right from wrong"
                problems.append(Problem("classes", "class-unknown", f"{name!r}", expected, todo))
        names = [n for k, n in enumerate(own) if any(k in of for of in found.values())]
    if not names:
        problems.append(Problem(dataset.root.name, "no-classes", "no class to evaluate", "labelled classes"))
    if detector is None:
        return dict.fromkeys(names, ())
    mapping = match_classes(detector, names)
    lacking = [n for n, of in mapping.items() if not of and (n in there or wanted is not None)]
    if lacking:
        both = [n for n in names if mapping[n]]
        todo = f"evaluate the common classes with --classes {','.join(both)}" if both else "give other weights"
        found_text = f"the detector has no class {', '.join(lacking)} (it has {_listed(detector)})"
        problems.append(Problem("classes", "class-absent", found_text, "every class that is evaluated", todo))
    for k, name in enumerate(detector):
        rivals = [n for n, of in mapping.items() if k in of]
        kept = [n for n in rivals if n in there] or rivals[:1]
        for n in [n for n in rivals if n not in kept]:  # a class that has objects keeps the detections
            mapping[n] = ()
            found_text = f"{n}: has no objects and shares the detector's class {name} with {kept[0]}: not evaluated"
            problems.append(Problem("labels", "class-left-out", found_text, severity="warning"))
        if len(kept) > 1:
            found_text = f"{' and '.join(kept)} share the detector's class {name}"
            pairs = " ".join(f"--rename {n}={kept[0]}" for n in kept[1:])
            todo = f"merge them with `infrablend convert {pairs}`, or choose one with --classes {kept[0]}"
            problems.append(Problem("classes", "class-shared", found_text, "a detector class for each", todo))
    others = [n for k, n in enumerate(detector) if not any(k in of for of in mapping.values())]
    if others:
        which = "this class" if len(others) == 1 else "these classes"
        found_text = f"{_listed(others)}: detections of {which} are left out"
        problems.append(Problem("detector", "class-left-out", found_text, severity="warning"))
    if wanted is not None and len(names) < len(own):
        left = ", ".join(n for n in own if n not in names)
        problems.append(Problem("labels", "class-left-out", f"{left}: not evaluated", severity="warning"))
    return {n: of for n, of in mapping.items() if of}


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
