"""The maker of pasted datasets: cut-outs of real objects in place of the objects that a run inserted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.contrast import measure_contrast, near_edge, real_least
from infrablend.compositing.mapping import GreyImage
from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.files import link_or_copy
from infrablend.core.rng import stream
from infrablend.core.run_folder import RunFolder
from infrablend.core.tasks import paced
from infrablend.errors import DatasetError, Problem
from infrablend.formats.labels import coco
from infrablend.formats.pictures.images import Background, load_background, save_image
from infrablend.imaging.burnt_in import find_burnt_in
from infrablend.imaging.skyline import find_skyline
from infrablend.lab.experiments.cut_outs import FEATHER_PX, CutOut, cut_out, fits, offset_at, paste, placed_box
from infrablend.lab.experiments.dataset_facts import data_result, read_dataset
from infrablend.lab.experiments.definition import Paste
from infrablend.lab.experiments.result_record import DataResult
from infrablend.lab.experiments.stage import StageJob

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
