"""Compare the look of a recipe's objects with that of real ones, and how many a detector of real objects finds of each.

    .venv/bin/python bench/object_look.py RECIPE DATA --split val [--time day] [--detector W.pt ...] [--sheet OUT.png]

Frames are composed in memory. For each measure it prints the quartiles of real and inserted objects, and the
Kolmogorov-Smirnov distance with its interval of 95 % (pictures drawn with replacement); inserted objects are weighted
to the sizes of the real ones. Measures are taken in the boxes of the labels, levels of 8 bit:

- `inside`: 90 % minus 10 % quantile of the box;
- `body`: median of the middle of the box minus the ground, which is the median 1 m to 4 m around it;
- `change`: the larger distance of the 5 and 95 % quantile from the ground;
- `edge`: 90 % quantile of the gradient, levels per px;
- `detail`: standard deviation of the box minus its Gaussian of 1.6 px;
- `band 0.5-1 px` and so on: standard deviation of the difference of two Gaussians of these sigmas in the box, which is
  the square root of the power between them;
- `foot`: median, over the middle half of the columns, of the brightest level from 12 px above (or the middle of the
  box) to 6 px below the lower edge, minus the ground: what shows below the side towards the camera;
- `rim 0.25 m` and so on: median of the band at that distance from the box minus the ground 3 to 5 m away.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend import api
from infrablend.core.boxes import boxes_mask, pixel_box
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.mesh import FloatArray
from infrablend.detection.finder import load_finder
from infrablend.detection.recall import weights_of_sizes
from infrablend.formats.pictures.images import load_background
from infrablend.formats.read_write import Reading
from infrablend.pipeline.flights.insert_trials import TrialRules, Trials

BANDS_M = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
"""Edges of the bands around a box."""
BAND_SIGMAS_PX = (0.5, 1.0, 2.0, 4.0)
"""Sigmas between which the power inside a box is measured."""
_FOOT_PX = (12, 6)
_LEAST_SIDE_PX = 12
_MARGIN_PX = 3
_FOCAL_PX = 2060.0  # HIT-UAV
_MOST_SHEET = 60

Measured = tuple[str, float, dict[str, float]]


def main() -> None:
    """Print the tables, and write the sheet."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("recipe")
    parser.add_argument("data", type=Path)
    parser.add_argument("--split", default="val")
    parser.add_argument("--time", default="day")
    parser.add_argument("--below-deg", type=float, default=91.0, help="Use only pictures at a lower pitch.")
    parser.add_argument("--rounds", type=int, default=2, help="Times that each picture is used.")
    parser.add_argument("--sample", type=int, help="Use only so many pictures.")
    parser.add_argument("--detector", type=Path, action="append", default=[])
    parser.add_argument("--confidence", type=float, default=0.25)
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--sheet", type=Path)
    args = parser.parse_args()
    frames = api.frames(args.recipe, args.data, settings=args.set, reading=Reading(splits=(args.split,)))
    category = frames.inserted_classes[0]
    ids = [k for k in frames.ids if frames.backgrounds[k].capture.time_of_day == args.time]
    ids = [k for k in ids if (frames.backgrounds[k].capture.pitch_deg or 0.0) < args.below_deg]
    ids = list(np.random.default_rng(0).permutation(ids)[: args.sample])
    trials = [_trials(frames, detector, category) for detector in args.detector]
    found: dict[str, list[Measured]] = defaultdict(list)
    crops: dict[str, list[NDArray[np.uint8]]] = defaultdict(list)
    for number in range(args.rounds):
        for frame in frames.iterate(ids, number):
            for trial in trials:
                trial.try_frame(frame, number)
            kinds = {"inserted": (np.asarray(frame.pixels, np.float32), frame.labels)}
            if number == 0:
                background = frames.backgrounds[frame.id]
                kinds["real"] = (load_background(background.path).pixels.astype(np.float32), background.instances)
            for kind, (picture, labels) in kinds.items():
                _collect(found[kind], crops[kind], kind == "inserted", category, frame.image, picture, labels)
    _print(found)
    for trial, detector in zip(trials, args.detector, strict=True):
        _print_recall(trial, detector, args.confidence)
    if args.sheet:
        cv2.imwrite(str(args.sheet), np.hstack([_sheet(crops["real"]), _sheet(crops["inserted"])]))
    frames.close()


def _trials(frames: api.Frames, detector: Path, category: str) -> Trials:
    finder = load_finder(detector)
    ignored = frozenset(c.name for c in frames.categories if c.ignore)
    return Trials(frames, finder, TrialRules(category, (finder.classes.index(category),), 0.3, 0.05, {}, ignored))


def _collect(
    found: list[Measured], crops: list[NDArray[np.uint8]], inserted: bool, category: str, image: ImageRecord,
    picture: NDArray[np.float32], labels: Sequence[Instance],
) -> None:  # fmt: skip
    capture = image.capture
    assert capture.altitude_m is not None and capture.pitch_deg is not None
    px_per_m = _FOCAL_PX * np.sin(np.radians(capture.pitch_deg)) / capture.altitude_m
    for n, label in enumerate(labels):
        if label.category != category or label.inserted is not inserted:
            continue
        facts = measure(picture, label.box_xyxy, [o.box_xyxy for k, o in enumerate(labels) if k != n], px_per_m)
        if facts is not None:
            found.append((f"{image.path.name}", float((label.box_xyxy[2:] - label.box_xyxy[:2]).max()), facts))
            crops.append(_crop(picture, label.box_xyxy))


def measure(
    picture: NDArray[np.float32], box_xyxy: FloatArray, others_xyxy: Sequence[FloatArray], px_per_m: float
) -> dict[str, float] | None:
    """Return the measures of an object in an (h, w) picture; None for a small one or one at the picture's edge."""
    h, w = picture.shape
    box = pixel_box(box_xyxy, picture.shape)
    x0, y0, x1, y1 = box
    at_edge = min(x0, y0, w - x1, h - y1) < _MARGIN_PX
    if at_edge or max(x1 - x0, y1 - y0) < _LEAST_SIDE_PX or min(x1 - x0, y1 - y0) < 4:
        return None
    away = cv2.distanceTransform((~boxes_mask([box_xyxy], picture.shape)).astype(np.uint8), cv2.DIST_L2, 3) / px_per_m
    free = (
        ~cv2.dilate(boxes_mask(others_xyxy, picture.shape).astype(np.uint8), np.ones((7, 7))).astype(bool)
        if others_xyxy
        else np.ones(picture.shape, bool)
    )
    around = picture[free & (away > 1) & (away <= 4)]
    far = picture[free & (away > 3) & (away <= 5)]
    if len(around) < 50 or len(far) < 50:
        return None
    ground = float(np.median(around))
    inside = picture[y0:y1, x0:x1]
    dx, dy = (x1 - x0) // 4, (y1 - y0) // 4
    soft = cv2.GaussianBlur(picture, (0, 0), 1.6)
    gradient = np.hypot(
        cv2.Sobel(picture, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(picture, cv2.CV_32F, 0, 1, scale=1 / 8)
    )
    p5, p10, p90, p95 = np.percentile(inside, (5, 10, 90, 95))
    facts = {
        "inside": float(p90 - p10),
        "body": float(np.median(inside[dy : y1 - y0 - dy, dx : x1 - x0 - dx])) - ground,
        "change": float(max(abs(p5 - ground), abs(p95 - ground))),
        "bright": float(p95 - ground),
        "dark": float(p5 - ground),
        "edge": float(np.percentile(gradient[y0:y1, x0:x1], 90)),
        "detail": float((picture - soft)[y0:y1, x0:x1].std()),
    }
    foot = picture[max(y1 - _FOOT_PX[0], (y0 + y1) // 2) : y1 + _FOOT_PX[1], x0 + dx : x1 - dx]
    facts["foot"] = float(np.median(foot.max(axis=0))) - ground
    blurred = {sigma: cv2.GaussianBlur(picture, (0, 0), sigma)[y0:y1, x0:x1] for sigma in BAND_SIGMAS_PX}
    for fine, coarse in pairwise(BAND_SIGMAS_PX):
        facts[f"band {fine:g}-{coarse:g} px"] = float((blurred[fine] - blurred[coarse]).std())
    level = float(np.median(far))
    for near, outer in pairwise(BANDS_M):
        band = picture[free & (away > near) & (away <= outer)]
        facts[f"rim {(near + outer) / 2:g} m"] = float(np.median(band)) - level if len(band) > 8 else np.nan
    return facts


def _print(found: dict[str, list[Measured]]) -> None:
    real, inserted = found["real"], found["inserted"]
    sizes = [np.array([size for _, size, _ in of], np.float64) for of in (real, inserted)]
    weights, _ = weights_of_sizes(sizes[1], [""] * len(inserted), sizes[0], [""] * len(real))
    print(
        f"{len(real)} real, {len(inserted)} inserted".ljust(16),
        "real 5 25 50 75 95".ljust(34),
        "inserted".ljust(34),
        "KS",
    )
    for name in real[0][2]:
        a, b = (np.array([facts[name] for _, _, facts in of]) for of in (real, inserted))
        rng = np.random.default_rng(0)
        draws = []
        for _ in range(200):
            i, j = (_drawn(of, rng) for of in (real, inserted))
            draws.append(ks(a[i], np.ones(len(i)), b[j], weights[j]))
        low, high = np.percentile(draws, (2.5, 97.5))
        print(
            name.ljust(16), _row(a, np.ones(len(a))), _row(b, weights),
            f"{ks(a, np.ones(len(a)), b, weights):.2f} [{low:.2f}, {high:.2f}]",
        )  # fmt: skip


def _drawn(of: list[Measured], rng: np.random.Generator) -> NDArray[np.intp]:
    """Return the numbers of the objects in pictures that are drawn with replacement."""
    names, number = np.unique([name for name, _, _ in of], return_inverse=True)
    of_picture = np.split(np.argsort(number, kind="stable"), np.cumsum(np.bincount(number))[:-1])
    return np.concatenate([of_picture[k] for k in rng.integers(len(names), size=len(names))])


def _row(values: FloatArray, weights: FloatArray) -> str:
    good = np.isfinite(values)
    values, weights = values[good], weights[good]
    order = np.argsort(values)
    share = np.cumsum(weights[order]) / weights.sum()
    picked = (values[order][np.searchsorted(share, q)] for q in (0.05, 0.25, 0.5, 0.75, 0.95))
    return " ".join(f"{v:6.1f}" for v in picked)


def ks(a: FloatArray, of_a: FloatArray, b: FloatArray, of_b: FloatArray) -> float:
    """Return the Kolmogorov-Smirnov distance of two weighted samples; NaN values are left out."""
    a, of_a, b, of_b = a[np.isfinite(a)], of_a[np.isfinite(a)], b[np.isfinite(b)], of_b[np.isfinite(b)]
    values = np.concatenate([a, b])
    steps = np.concatenate([of_a / of_a.sum(), -of_b / of_b.sum()])
    order = np.argsort(values, kind="stable")
    return float(np.abs(np.cumsum(steps[order])[np.append(np.diff(values[order]) > 0, True)]).max())


def _print_recall(trials: Trials, detector: Path, confidence: float) -> None:
    real = trials.real()
    kinds = sorted({s.conditions["edge"] for s in real})
    strata = [[s.conditions["edge"] for s in of] for of in (trials.inserted, real)]
    sizes = [np.array([s.size_px for s in of]) for of in (trials.inserted, real)]
    weights, _ = weights_of_sizes(sizes[0], strata[0], sizes[1], strata[1])
    found = [np.array([s.score >= confidence for s in of], float) for of in (trials.inserted, real)]
    predicted, actual = np.average(found[0], weights=weights), found[1].mean()
    whole = [np.array([e == "whole" for e in of]) for of in strata]
    said = np.average(found[0][whole[0]], weights=weights[whole[0]]), found[1][whole[1]].mean()
    print(
        f"{detector}: {len(real)} real, {len(trials.inserted)} inserted; predicted {predicted:.3f} actual {actual:.3f} "
        f"difference {predicted - actual:+.3f}; whole ones {said[0]:.3f} {said[1]:.3f} ({', '.join(kinds)})"
    )


def _crop(picture: NDArray[np.float32], box_xyxy: FloatArray) -> NDArray[np.uint8]:
    """Return an object with its surroundings, 64 px of the picture enlarged to 192."""
    centre = (box_xyxy[:2] + box_xyxy[2:]) / 2
    part = cv2.getRectSubPix(picture, (64, 64), (float(centre[0]), float(centre[1])))
    return np.asarray(cv2.resize(part, (192, 192), interpolation=cv2.INTER_CUBIC).clip(0, 255), np.uint8)


def _sheet(crops: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    chosen = [crops[k] for k in np.random.default_rng(1).permutation(len(crops))[:_MOST_SHEET]]
    chosen += [np.zeros((192, 192), np.uint8)] * (_MOST_SHEET - len(chosen))
    rows = [np.hstack([np.pad(c, 2) for c in chosen[k : k + 6]]) for k in range(0, _MOST_SHEET, 6)]
    return np.pad(np.vstack(rows), ((0, 0), (0, 12)), constant_values=255)


if __name__ == "__main__":
    main()
