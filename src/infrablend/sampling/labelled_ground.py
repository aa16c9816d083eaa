"""Learns from a dataset's own labels on which kinds of ground each class of objects is.

What the model finds right around annotated objects is compared with what it finds anywhere in the same pictures. The
boxes themselves do not count: there is the object. The result is a factor per kind of ground, so a kind that the model
confuses with another one everywhere is confused on both sides.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import Instance, boxes_of
from infrablend.core.mesh import FloatArray
from infrablend.core.surface_kinds import GROUND, SURFACES, Affinity, SurfaceKind
from infrablend.imaging.surfaces import Grey, SurfaceMap, find_surfaces

# Width of the ring around a box, as a share of its shorter side, and least width in cells of the map.
_RING = 0.5
_LEAST_RING = 1.5
# Fewer objects than this say nothing.
_FEWEST = 30
# Weight of the assumption that all kinds of ground are alike, in objects.
_PRIOR = 20
# Kinds with a smaller share of the pictures are not compared.
_LEAST_SHARE = 0.003
# Factors are rounded to this step: a last digit that depends on the processor would change places.
_STEP = 0.05

Picture = tuple[Grey, Sequence[Instance], TimeOfDay | None]
ANY_TIME = "any"


@dataclass(frozen=True)
class ClassGround:
    """What is around the labelled objects of a class.

    Attributes:
        objects: Number of objects.
        around: Mean share of each kind of surface right around them.
        anywhere: Mean share of each kind in the pictures.
        factors: How much more often the objects are on each kind of ground than its share; 1 for as often as anywhere.
    """

    objects: int
    around: Mapping[SurfaceKind, float]
    anywhere: Mapping[SurfaceKind, float]
    factors: Affinity


LabelledGround = Mapping[str, Mapping[str, ClassGround]]
"""What is around labelled objects, by class and by `day`, `night` or `any` time."""


def learn_ground(pictures: Iterable[Picture], classes: Collection[str] | None = None) -> LabelledGround:
    """Return on which kinds of ground the labelled objects of some pictures are.

    Args:
        pictures: Levels, labels and time of day of some pictures.
        classes: Names of the classes, None for all; those with fewer than 30 labelled objects are not in the result.
    """
    around: dict[tuple[str, str], list[NDArray[np.float64]]] = defaultdict(list)
    anywhere: dict[str, list[NDArray[np.float64]]] = defaultdict(list)
    for pixels, labels, time in pictures:
        found = find_surfaces(pixels)
        shares = found.sharp()
        boxes = _cells_of(found, boxes_of(labels))
        free = _free(shares, boxes)
        if not free.any():
            continue
        times = (ANY_TIME,) if time is None else (ANY_TIME, time)
        for t in times:
            anywhere[t].append(shares[:, free].mean(axis=1, dtype=np.float64))
        for label, box in zip(labels, boxes, strict=True):
            if classes is None or label.category in classes:
                ring = _ring(shares, free, box)
                if ring is not None:
                    for t in times:
                        around[label.category, t].append(ring)
    learned: dict[str, dict[str, ClassGround]] = defaultdict(dict)
    for (name, t), rings in sorted(around.items()):
        if len(rings) >= _FEWEST:
            learned[name][t] = _class_ground(rings, np.mean(anywhere[t], axis=0))
    return dict(learned)


def with_labels(affinity: Affinity, ground: LabelledGround, category: str, time: TimeOfDay | None) -> Affinity:
    """Return a model's affinity with what the labels of its class say; its greatest value stays."""
    by_time = ground.get(category, {})
    learned = by_time.get(time or ANY_TIME) or by_time.get(ANY_TIME)
    if learned is None:
        return affinity
    changed = {kind: value * learned.factors.get(kind, 1.0) for kind, value in affinity.items()}
    most = max(affinity.values(), default=0.0)
    greatest = max(changed.values(), default=0.0)
    return {kind: value * most / greatest for kind, value in changed.items()} if greatest > 0 else affinity


def kinds_around(pixels: Grey, boxes_xyxy: FloatArray) -> list[SurfaceKind | None]:
    """Return the most likely surface right around each of (n, 4) boxes, where no box is; None without free ground."""
    found = find_surfaces(pixels)
    shares = found.sharp()
    shares[SURFACES.index("object")] = 0  # what stands there is not what it stands on
    boxes = _cells_of(found, boxes_xyxy)
    free = _free(shares, boxes)
    rings = [_ring(shares, free, box) for box in boxes]
    return [None if ring is None else SURFACES[int(ring.argmax())] for ring in rings]


def _free(shares: NDArray[np.float32], boxes: FloatArray) -> NDArray[np.bool_]:
    """Return the (h', w') cells that none of (n, 4) boxes, in cells, covers."""
    free = np.ones(shares.shape[1:], np.bool_)
    for x0, y0, x1, y1 in boxes:
        free[max(int(y0), 0) : int(y1) + 1, max(int(x0), 0) : int(x1) + 1] = False
    return free


def _cells_of(found: SurfaceMap, boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    h, w = found.shares.shape[1:]
    scale = np.array([w / found.size_wh[0], h / found.size_wh[1]])
    return np.asarray(boxes * np.tile(scale, 2))


def _ring(shares: NDArray[np.float32], free: NDArray[np.bool_], box: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the mean share of each kind in the free cells around a box; None if there are hardly any."""
    x0, y0, x1, y1 = box
    width = max(_LEAST_RING, _RING * min(x1 - x0, y1 - y0))
    part = np.s_[max(int(y0 - width), 0) : int(y1 + width) + 1, max(int(x0 - width), 0) : int(x1 + width) + 1]
    cells = free[part]
    if np.count_nonzero(cells) < 4:
        return None
    return np.asarray(shares[:, part[0], part[1]][:, cells].mean(axis=1, dtype=np.float64))


def _class_ground(rings: Sequence[NDArray[np.float64]], anywhere: NDArray[np.float64]) -> ClassGround:
    around = {kind: float(v) for kind, v in zip(SURFACES, np.mean(rings, axis=0), strict=True)}
    usual = {kind: float(v) for kind, v in zip(SURFACES, anywhere, strict=True)}
    count = len(rings)
    factors = {}
    for kind in GROUND:
        if usual[kind] >= _LEAST_SHARE:
            factor = (count * around[kind] + _PRIOR * usual[kind]) / ((count + _PRIOR) * usual[kind])
            factors[kind] = round(_STEP * round(factor / _STEP), 2)
    return ClassGround(count, around, usual, factors)
