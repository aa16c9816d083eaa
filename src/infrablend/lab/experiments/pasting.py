"""The maker of pasted datasets: cut-outs of real objects in place of the objects that a run inserted.

What is pasted is the difference between the object and the level around it: on a new background it has the contrast
that it has in its own picture. Nothing is scaled, turned or blurred, so it keeps its size, sharpness and grain.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.contrast import measure_contrast, near_edge, real_least
from infrablend.compositing.mapping import GreyImage
from infrablend.core.boxes import pixel_box
from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.files import link_or_copy
from infrablend.core.outline import ring_levels
from infrablend.core.quantiles import quantile
from infrablend.core.rng import stream
from infrablend.core.run_folder import RunFolder
from infrablend.core.tasks import paced
from infrablend.errors import DatasetError, Problem
from infrablend.formats.labels import coco
from infrablend.formats.pictures.images import Background, load_background, save_image
from infrablend.imaging.burnt_in import find_burnt_in
from infrablend.imaging.skyline import find_skyline
from infrablend.lab.experiments.definition import Paste
from infrablend.lab.experiments.result_record import DataResult
from infrablend.lab.experiments.stage import StageJob, data_result, read_dataset

# Pixels around the box in which the matte fades to nothing.
FEATHER_PX = 2
# Width of the ring that gives the level around the box, as in `contrast`.
_MIN_RING_PX = 4
# The matte rises from 0 to 1 between these differences, in deviations of the ring's noise, which is at least a level.
_FROM_NOISE = 2.0
_TO_NOISE = 5.0
_LEAST_NOISE = 1.0
_SMOOTH_PX = 0.8
# Quantile that counts as an object's largest difference.
_LARGEST = 0.9
# Pixels joined to the brightest or darkest one by at least this much matte belong to the object.
_JOINED = 0.1


@dataclass(frozen=True, eq=False)
class CutOut:
    """A real object without its background.

    Attributes:
        difference: (h, w) levels of the object minus the level around it, times the matte.
        cover: (h, w) share of the background that the object hides, in [0, 1]: its difference over its largest one.
        box_xyxy: (4,) annotated box in the cut-out, pixels.
    """

    difference: NDArray[np.float32]
    cover: NDArray[np.float32]
    box_xyxy: NDArray[np.float64]

    @property
    def size_wh(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return int(self.cover.shape[1]), int(self.cover.shape[0])


def cut_out(
    picture: GreyImage, box_xyxy: NDArray[np.float64], others: Sequence[NDArray[np.float64]] = ()
) -> CutOut | None:
    """Cut the object in a box out of a picture.

    The matte is 1 where the picture differs from the ring around the box by much more than the ring's noise, 0 where it
    does not, and fades within `FEATHER_PX` around the box. Only the part that holds together with the largest
    difference is kept. Other objects' boxes are left out of the ring.

    Returns:
        The object; None if it is cut by the frame, if too few pixels around it are free, or if it does not stand out.
    """
    height, width = picture.shape
    left, top, right, bottom = pixel_box(box_xyxy, picture.shape)
    x0, y0, x1, y1 = left - FEATHER_PX, top - FEATHER_PX, right + FEATHER_PX, bottom + FEATHER_PX
    around = ring_levels(picture, box_xyxy, others, _MIN_RING_PX)
    if left >= right or top >= bottom or min(x0, y0) < 0 or x1 > width or y1 > height or around is None:
        return None
    level = float(np.median(around))
    noise = max(1.4826 * float(np.median(np.abs(around - level))), _LEAST_NOISE)
    difference = np.asarray(picture[y0:y1, x0:x1], np.float32) - np.float32(level)
    above = np.abs(cv2.GaussianBlur(difference, (0, 0), _SMOOTH_PX)) / np.float32(noise)
    rise = np.clip((above - _FROM_NOISE) / (_TO_NOISE - _FROM_NOISE), 0, 1)
    alpha = (rise * rise * (3 - 2 * rise)).astype(np.float32)
    # Between a bright and a dark part of an object the difference passes through zero.
    alpha = cv2.morphologyEx(alpha, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    inside = np.zeros(alpha.shape, np.bool_)
    inside[FEATHER_PX:-FEATHER_PX, FEATHER_PX:-FEATHER_PX] = True
    alpha *= _feather(alpha.shape)
    parts = cv2.connectedComponents((alpha > _JOINED).astype(np.uint8), connectivity=8)[1]
    strongest = parts.ravel()[int(np.argmax(np.where(inside, above * alpha, 0)))]
    if strongest == 0:
        return None
    own = cv2.dilate((parts == strongest).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.bool_)
    alpha[~own] = 0
    difference *= alpha
    cover = np.minimum(np.abs(difference) / np.float32(quantile(np.abs(difference[alpha > _JOINED]), _LARGEST)), 1)
    return CutOut(
        difference, np.asarray(cover, np.float32), np.asarray(box_xyxy - np.array([x0, y0, x0, y0]), np.float64)
    )


def fits(cut: CutOut, offset_xy: tuple[int, int], size_wh: tuple[int, int]) -> bool:
    """Return whether a cut-out at an offset is wholly inside a picture."""
    (x, y), (w, h) = offset_xy, cut.size_wh
    return x >= 0 and y >= 0 and x + w <= size_wh[0] and y + h <= size_wh[1]


def placed_box(cut: CutOut, offset_xy: tuple[int, int]) -> NDArray[np.float64]:
    """Return the (4,) box of a cut-out at an offset, pixels of the picture."""
    x, y = offset_xy
    return np.asarray(cut.box_xyxy + np.array([x, y, x, y], np.float64))


def offset_at(cut: CutOut, centre_xy: tuple[float, float]) -> tuple[int, int]:
    """Return the offset at which the box of a cut-out has its centre nearest to a point."""
    x0, y0, x1, y1 = cut.box_xyxy
    return round(centre_xy[0] - (x0 + x1) / 2), round(centre_xy[1] - (y0 + y1) / 2)


def paste(
    background: GreyImage, cut: CutOut, offset_xy: tuple[int, int], others: Sequence[NDArray[np.float64]] = ()
) -> GreyImage:
    """Return a picture with a cut-out over it.

    Its difference is added to the level around its new place where it hides the background, and to the background
    elsewhere. The offset is that of the upper left corner, see `fits`; other objects' boxes are left out of the ring.
    """
    (x, y), (w, h) = offset_xy, cut.size_wh
    part = (slice(y, y + h), slice(x, x + w))
    around = ring_levels(background, placed_box(cut, offset_xy), others, _MIN_RING_PX)
    below = np.asarray(background[part], np.float32)
    level = np.float32(np.median(below if around is None else around))
    mixed = below + cut.cover * (level - below) + cut.difference
    pasted = background.copy()
    limit = np.iinfo(background.dtype).max
    pasted[part] = np.clip(np.rint(mixed), 0, limit).astype(background.dtype)
    return pasted


def _feather(shape_hw: tuple[int, ...]) -> NDArray[np.float32]:
    """Return (h, w) weights: 1 in the box, falling linearly to the edge around it."""
    rows, columns = (np.arange(n, dtype=np.float32) for n in shape_hw[:2])
    edge = [np.minimum(n + 1, n[::-1] + 1) / (FEATHER_PX + 1) for n in (rows, columns)]
    return np.asarray(np.minimum(1, np.minimum.outer(edge[0], edge[1])), np.float32)


# Cut-outs tried at the place of an insert, then elsewhere in the sky, and places in the sky tried for each.
_THERE = 8
_ELSEWHERE = 8
_PLACES = 40
# Least distance of a pasted object from annotated objects and text, px.
_APART_PX = 2


def make_paste(job: StageJob) -> DataResult:
    """Write the frames of a run with cut-outs of real objects in place of the inserted ones."""
    spec: Paste = job.stage.spec
    objects = job.needs["of"]
    onto = job.needs["onto"]
    run = job.needs["like"]
    real = read_dataset(objects.dataset, splits=[spec.split], options=objects.reader_options)
    cuts, unusable = cut_objects(real, spec.category)
    if not cuts:
        found = f"no usable object of {spec.category} in the split {spec.split}; unusable: {dict(unusable) or 'none'}"
        problem = Problem(job.stage.id, "class-none", found, "objects that stand out from their surroundings")
        raise DatasetError(f"{job.stage.id}: nothing to paste", [problem])
    made = read_dataset(run.dataset)
    scenes = RunFolder(run.dataset.parent)
    out = job.out
    paster = Paster(cuts, spec.category, job.stage.inputs["seed"])
    report = paced(job.on_progress)
    images = []
    for number, frame in enumerate(made.images, 1):
        record = scenes.record(f"{frame.split}/{Path(frame.name).with_suffix('').as_posix()}")
        background = onto.dataset / record.background["path"]
        images.append(paster.replace_inserts(frame, background, out / "images" / frame.split / frame.name))
        if report is not None:
            report(number, len(made.images))
    categories = list(made.categories)
    if all(c.name != spec.category for c in categories):
        categories.append(Category(max((c.id for c in categories), default=0) + 1, spec.category))
    coco.write(out, images, categories)
    result = data_result(read_dataset(out))
    result["pasted"] = {"cut_outs": len(cuts), "unusable": dict(unusable), **paster.counts}
    return result


def cut_objects(dataset: Dataset, category: str) -> tuple[list[CutOut], Counter[str]]:
    """Return the cut-outs of all objects of a class, and the number of unusable ones by reason.

    Raises:
        DatasetError: A picture cannot be read, or has 16 bits.
    """
    cuts: list[CutOut] = []
    unusable: Counter[str] = Counter()
    for image in dataset.images:
        boxes = [i.box_xyxy for i in image.instances]
        wanted = [n for n, i in enumerate(image.instances) if i.category == category]
        picture = load_grey(image.path).pixels if wanted else None
        for n in wanted:
            assert picture is not None
            others = boxes[:n] + boxes[n + 1 :]
            if near_edge(boxes[n], picture.shape):
                unusable["at the edge"] += 1
            elif not is_seen(picture, boxes[n], others, category, image.capture.time_of_day):
                unusable["low contrast"] += 1
            elif (cut := cut_out(picture, boxes[n], others)) is None:
                unusable["no outline"] += 1
            else:
                cuts.append(cut)
    return cuts, unusable


def load_grey(path: Path) -> Background:
    """Return an 8-bit picture.

    Raises:
        DatasetError: The picture cannot be read, or has 16 bits.
    """
    picture = load_background(path)
    if picture.bit_depth != 8:
        problem = Problem(
            path.name, "image-depth", f"{picture.bit_depth} bits", "8 bits", "paste between 8-bit pictures"
        )
        raise DatasetError(f"{path}: cannot be used for pasting", [problem])
    return picture


def is_seen(
    picture: GreyImage,
    box_xyxy: NDArray[np.float64],
    others: Sequence[NDArray[np.float64]],
    category: str,
    time_of_day: TimeOfDay | None,
) -> bool:
    """Return whether an object has the contrast that is required of inserted ones."""
    contrast = measure_contrast(picture, box_xyxy, others)
    least = real_least(category, time_of_day)
    return contrast is not None and least.is_met(contrast.change, contrast.clutter)


class Paster:
    """Pastes cut-outs over backgrounds; all are used before one is used again.

    Attributes:
        counts: Number of objects pasted (`objects`), of those not at the position of an insert (`moved`), and of
            objects for which nothing fitted (`left_out`).
    """

    def __init__(self, cuts: Sequence[CutOut], category: str, seed: int) -> None:
        self.category = category
        self.seed = seed
        self.counts = {"objects": 0, "moved": 0, "left_out": 0}
        self._queue = _shuffled_rounds(cuts, seed)

    def replace_inserts(self, frame: ImageRecord, background: Path, out: Path) -> ImageRecord:
        """Write a frame with cut-outs in place of its inserted objects, and return its record.

        Raises:
            DatasetError: The picture cannot be read, or has 16 bits.
            OutputError: The file cannot be written.
        """
        inserts = [i for i in frame.instances if i.inserted]
        labels = [i for i in frame.instances if not i.inserted]
        if not inserts:
            link_or_copy(background, out)
            return replace(frame, path=out)
        like = load_grey(background)
        picture: GreyImage = like.pixels
        taken = [i.box_xyxy for i in labels]
        text = list(find_burnt_in(picture.astype(np.float32)))
        sky = find_skyline(picture.astype(np.float32)).sky
        for number, insert in enumerate(inserts):
            rng = stream(self.seed, "paste", frame.split, frame.id, number)
            for tries in range(_THERE + _ELSEWHERE):
                cut = next(self._queue)
                wanted = insert.box_xyxy if tries < _THERE else None
                done = _paste_somewhere(picture, cut, wanted, [*taken, *text], sky, rng)
                if done is None:
                    continue
                pasted, box, moved = done
                if not is_seen(pasted, box, taken, self.category, frame.capture.time_of_day):
                    continue
                picture = pasted
                taken.append(box)
                labels.append(Instance(self.category, box, inserted=True))
                self.counts["objects"] += 1
                self.counts["moved"] += moved
                break
            else:
                self.counts["left_out"] += 1
        save_image(out, picture, like)
        return replace(frame, path=out, instances=tuple(labels))


def _shuffled_rounds(cuts: Sequence[CutOut], seed: int) -> Iterator[CutOut]:
    number = 0
    while True:
        yield from (cuts[k] for k in stream(seed, "paste", "round", number).permutation(len(cuts)))
        number += 1


def _paste_somewhere(
    picture: GreyImage,
    cut: CutOut,
    wanted_xyxy: NDArray[np.float64] | None,
    taken: Sequence[NDArray[np.float64]],
    sky: NDArray[np.bool_],
    rng: np.random.Generator,
) -> tuple[GreyImage, NDArray[np.float64], bool] | None:
    """Paste a cut-out where its box has the centre of another, or else at random in the sky.

    Returns:
        Picture, box, and whether it is elsewhere; None if no place is free.
    """
    height, width = picture.shape
    w, h = cut.size_wh
    places: list[tuple[int, int]] = []
    if wanted_xyxy is not None:
        x0, y0, x1, y1 = wanted_xyxy
        places.append(offset_at(cut, ((x0 + x1) / 2, (y0 + y1) / 2)))
    there = len(places)
    if w < width and h < height:
        places += [(int(rng.integers(width - w)), int(rng.integers(height - h))) for _ in range(_PLACES)]
    for number, (x, y) in enumerate(places):
        box = placed_box(cut, (x, y))
        moved = number >= there
        if not fits(cut, (x, y), (width, height)) or near_edge(box, picture.shape) or _touches(box, taken):
            continue
        if not moved or sky[y : y + h, x : x + w].all():
            return paste(picture, cut, (x, y), taken), box, moved
    return None


def _touches(box_xyxy: NDArray[np.float64], others: Sequence[NDArray[np.float64]]) -> bool:
    apart = FEATHER_PX + _APART_PX
    x0, y0, x1, y1 = box_xyxy
    return any(x0 - apart < c and a < x1 + apart and y0 - apart < d and b < y1 + apart for a, b, c, d in others)
