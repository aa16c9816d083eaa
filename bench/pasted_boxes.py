"""Paste boxes of real objects where a run inserted objects, to measure what real pixels on these backgrounds teach.

`bench/pasted_boxes.py RUN BACKGROUNDS DATA OUT [--category Car]` reads a run with `labels.mode: new` over BACKGROUNDS
and writes, as COCO, its pictures with boxes of the split train of DATA in place of its inserted objects: as many,
around the same points where that is possible, of the same time of day and of about the same pitch and height. A box is
pasted with its surroundings by Poisson blending, which keeps differences between neighbouring pixels and adapts the
level to the new place. Boxes that overlap others by more than a quarter, that are cut by the frame or whose objects
nobody can see (as `infrablend experiment` requires of pasted objects) are not used.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.contrast import near_edge
from infrablend.core.boxes import box_iou
from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.rng import stream
from infrablend.core.run_folder import RunFolder
from infrablend.formats.detection import read
from infrablend.formats.labels import coco
from infrablend.formats.pictures.images import save_image
from infrablend.lab.experiments.pasting import is_seen, load_grey

AROUND_PX = 5
MOST_OVERLAP, MOST_PASTED_OVERLAP = 0.25, 0.12
# Differences of pitch and height within which boxes are alike; the first ones with enough boxes are used.
ALIKE_DEG_M = ((5.0, 10.0), (5.0, 20.0), (10.0, 20.0), (15.0, 30.0), (np.inf, np.inf))
ENOUGH = 15
THERE, ELSEWHERE, CHOICE = 8, 8, 8

Picture = NDArray[np.uint8]


@dataclass(eq=False)
class Patch:
    """A box of a real object with its surroundings; `used` counts how often it was pasted."""

    pixels: Picture
    box_xyxy: NDArray[np.float64]
    time_of_day: TimeOfDay | None
    pitch_deg: float
    altitude_m: float
    used: int = 0


def main() -> None:
    """Write the dataset, and print what was used and pasted."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("run", "backgrounds", "data", "out"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--category", default="Car")
    options = parser.parse_args()
    patches, unused = cut(options.data, options.category)
    print(f"{len(patches)} boxes; not used: {dict(unused)}")
    made, scenes = read(options.run), RunFolder(options.run)
    by_picture = {scenes.image(record.image).resolve(): record for record in scenes.records()}
    counts: Counter[str] = Counter()
    images = []
    for frame in made.images:
        record = by_picture[frame.path.resolve()]
        background = load_grey(options.backgrounds / record.background["path"])
        picture, labels = fill(
            frame, np.asarray(background.pixels, np.uint8), alike(patches, frame), options.category, counts
        )
        if labels:
            path = options.out / "images" / frame.split / frame.name
            path.parent.mkdir(parents=True, exist_ok=True)
            save_image(path, picture, background)
            images.append(replace(frame, path=path, instances=tuple(labels)))
    coco.write(options.out, images, [c for c in made.categories if c.name == options.category])
    print(f"{len(images)} pictures; {dict(counts)}; {sum(p.used > 0 for p in patches)} different boxes")


def cut(data: Path, category: str) -> tuple[list[Patch], Counter[str]]:
    """Return the boxes of a class in the split train, and the number of those not used by reason."""
    patches: list[Patch] = []
    unused: Counter[str] = Counter()
    for image in read(data).images:
        wanted = [n for n, i in enumerate(image.instances) if i.category == category]
        if image.split != "train" or not wanted:
            continue
        boxes = [i.box_xyxy for i in image.instances]
        picture = np.asarray(load_grey(image.path).pixels, np.uint8)
        height, width = picture.shape
        for n in wanted:
            others = boxes[:n] + boxes[n + 1 :]
            x0, y0, x1, y1 = (int(v) for v in (*np.floor(boxes[n][:2]), *np.ceil(boxes[n][2:])))
            x0, y0, x1, y1 = x0 - AROUND_PX, y0 - AROUND_PX, x1 + AROUND_PX, y1 + AROUND_PX
            if min(x0, y0) < 0 or x1 > width or y1 > height:
                unused["at the edge"] += 1
            elif overlap(boxes[n], others) > MOST_OVERLAP:
                unused["overlap"] += 1
            elif not is_seen(picture, boxes[n], others, category, image.capture.time_of_day):
                unused["low contrast"] += 1
            else:
                box = boxes[n] - np.array([x0, y0, x0, y0])
                facts = (image.capture.time_of_day, image.capture.pitch_deg or 0.0, image.capture.altitude_m or 0.0)
                patches.append(Patch(picture[y0:y1, x0:x1].copy(), box, *facts))
    return patches, unused


def alike(patches: Sequence[Patch], frame: ImageRecord) -> list[Patch]:
    """Return the boxes of the frame's time of day whose pitch and height are nearest to the frame's."""
    found: list[Patch] = []
    for pitch_deg, height_m in ALIKE_DEG_M:
        found = [
            p
            for p in patches
            if p.time_of_day == frame.capture.time_of_day
            and abs(p.pitch_deg - (frame.capture.pitch_deg or 0)) <= pitch_deg
            and abs(p.altitude_m - (frame.capture.altitude_m or 0)) <= height_m
        ]
        if len(found) >= ENOUGH:
            break
    return found


def fill(
    frame: ImageRecord, background: Picture, patches: Sequence[Patch], category: str, counts: Counter[str]
) -> tuple[Picture, list[Instance]]:
    """Return a background with a real box for every inserted object of a frame, and the labels of the boxes."""
    picture, labels = background, []
    taken = [i.box_xyxy for i in frame.instances if not i.inserted]
    for number, insert in enumerate(i for i in frame.instances if i.inserted):
        rng = stream(0, "pasted-boxes", frame.split, frame.id, number)
        for tries in range(THERE + ELSEWHERE if patches else 0):
            choice = [patches[k] for k in rng.permutation(len(patches))[:CHOICE]]
            patch = min(choice, key=lambda p: p.used)
            done = placed(picture, patch, insert.box_xyxy if tries < THERE else None, rng)
            if done is None or overlap(done[1], taken) > MOST_PASTED_OVERLAP:
                continue
            pasted, box = done
            if is_seen(pasted, box, taken, category, frame.capture.time_of_day):
                picture = pasted
                patch.used += 1
                taken.append(box)
                labels.append(Instance(category, box, inserted=True))
                counts["there" if tries < THERE else "elsewhere"] += 1
                break
        else:
            counts["left out"] += 1
    return picture, labels


def placed(
    picture: Picture, patch: Patch, wanted_xyxy: NDArray[np.float64] | None, rng: np.random.Generator
) -> tuple[Picture, NDArray[np.float64]] | None:
    """Paste a box around the middle of another one, or anywhere; None where it would leave the picture."""
    (height, width), (h, w) = picture.shape, patch.pixels.shape
    if wanted_xyxy is None:
        x, y = int(rng.integers(width - w)), int(rng.integers(height - h))
    else:
        offset = (wanted_xyxy[:2] + wanted_xyxy[2:] - patch.box_xyxy[:2] - patch.box_xyxy[2:]) / 2
        x, y = (round(float(v)) for v in offset)
    box = patch.box_xyxy + np.array([x, y, x, y])
    if x < 0 or y < 0 or x + w > width or y + h > height or near_edge(box, picture.shape):
        return None
    below = cv2.cvtColor(picture[y : y + h, x : x + w], cv2.COLOR_GRAY2BGR)
    above = cv2.cvtColor(patch.pixels, cv2.COLOR_GRAY2BGR)
    mask = np.zeros((h, w), np.uint8)
    mask[2:-2, 2:-2] = 255
    mixed = cv2.seamlessClone(above, below, mask, (w // 2, h // 2), cv2.NORMAL_CLONE)
    pasted = picture.copy()
    pasted[y : y + h, x : x + w] = mixed[..., 0]
    return pasted, box


def overlap(box_xyxy: NDArray[np.float64], others: Sequence[NDArray[np.float64]]) -> float:
    """Return the largest overlap (IoU) of a box with others."""
    return float(box_iou(box_xyxy[None], np.array(others).reshape(-1, 4)).max(initial=0))


if __name__ == "__main__":
    main()
