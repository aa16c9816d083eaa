"""Detectors of any kind that find objects in pictures in memory: weights of Ultralytics, and ONNX files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.config.agc import DEFAULT_AGC, Agc
from infrablend.core.dataset import ImageRecord
from infrablend.core.temperature import TemperatureScale
from infrablend.detection import onnx_detector, predict
from infrablend.detection.detections import MAX_DETECTIONS, Detections, Predictions, Task
from infrablend.detection.detector_file import file_of
from infrablend.detection.scale import Scale
from infrablend.detection.truth import image_key
from infrablend.errors import DatasetError, ModelError, Problem
from infrablend.formats.pictures.images import load_background

CONFIDENCE = 0.01
"""Lowest score of what is found by default."""
OVERLAP_PX = 96


@dataclass(frozen=True, eq=False)
class Finder:
    """A loaded detector.

    Attributes:
        classes: Names of its classes, in its order.
        task: What it finds: boxes, oriented boxes or masks.
        agc: Automatic gain control of its training for 16-bit pictures; None if unknown.
        facts: Name and SHA-256 of the file, kind of network, tiles, scale, device, versions.
        problems: Warnings about the detector.
        find_levels: Finds objects above a confidence in (h, w) grey levels.
    """

    classes: tuple[str, ...]
    task: Task
    agc: Agc | None
    facts: Mapping[str, object]
    find_levels: Callable[[NDArray[np.uint8], float], Detections]
    problems: tuple[Problem, ...] = field(default=())

    def find(
        self,
        pixels: NDArray[np.uint8] | NDArray[np.uint16],
        confidence: float = CONFIDENCE,
        scale: TemperatureScale | None = None,
    ) -> Detections:
        """Return the detections in a picture, in px of it, at most 300.

        Args:
            pixels: (h, w) grey levels. 16-bit ones go through the automatic gain control of the training, or through
                a line between two percentiles if that is unknown.
            confidence: Lowest score.
            scale: Temperature scale of 16-bit pixels, which a gain control of fixed temperatures needs.

        Raises:
            ModelError: Memory does not hold the picture, or the network gives classes without names.
            ValueError: The gain control needs a temperature scale.
        """
        if pixels.dtype != np.uint8:
            pixels = (self.agc or DEFAULT_AGC).apply(np.asarray(pixels, np.uint16), scale)
        found = self.find_levels(np.asarray(pixels, np.uint8), confidence)
        # What lies in the grey border alone has nothing in the picture.
        return found.take(np.flatnonzero((found.boxes_xyxy[:, 2:] > found.boxes_xyxy[:, :2]).all(axis=1)))


def load_finder(
    path: Path,
    *,
    device: str = "auto",
    classes: Sequence[str] = (),
    threads: int = 0,
    image_size: int | None = None,
    overlap_px: int = OVERLAP_PX,
) -> Finder:
    """Return a detector: weights (.pt), an ONNX file, or the folder of a training.

    Weights run on whole pictures at the scale of their training, ONNX files on tiles of their size, see `seams`.

    Args:
        path: File or folder.
        device: auto, cpu, cuda, and for weights cuda:1 or mps.
        classes: Names of its classes in its order, for a file that has none.
        threads: Threads of an ONNX file's network; 0 for one per core.
        image_size: Longer side of the pictures for the network, px; 0 keeps their own size [default: as in training].
        overlap_px: Least overlap of tiles: twice the size of the largest object.

    Raises:
        MissingDependencyError: A package or device is missing.
        ModelError: The file is no detector that can be used.
    """
    file = file_of(path)
    if file.suffix.lower() == ".onnx":
        onnx = onnx_detector.load_onnx(
            file, device=device, classes=classes, threads=threads, image_size=image_size, overlap_px=overlap_px
        )
        return Finder(onnx.classes, "detect", onnx.agc, onnx.facts, onnx.find)
    detector = predict.load_detector(file, device)
    if classes and len(classes) != len(detector.classes):
        found = f"{len(classes)} names: {', '.join(classes)}"
        problem = Problem(file.name, "detector", found, f"{len(detector.classes)}: {', '.join(detector.classes)}")
        raise ModelError(f"{file}: has other classes", [problem])
    scale = detector.scale if image_size is None else Scale(image_size, "requested")
    facts: dict[str, Any] = detector.facts | {
        "network": "weights of Ultralytics",
        "image_size": scale.image_size,
        "image_size_from": scale.origin,
        "iou": predict.IOU,
        "max_detections": MAX_DETECTIONS,
    }

    def find(levels: NDArray[np.uint8], confidence: float) -> Detections:
        return predict.predict_levels(detector, levels, scale.image_size, confidence)

    names = tuple(classes) or detector.classes
    return Finder(names, detector.task, detector.agc, facts, find, tuple(scale.warnings(file)))


def search_pictures(
    finder: Finder,
    images: Sequence[ImageRecord],
    where: str,
    problems: list[Problem],
    progress: Callable[[int, int], None] | None,
) -> Predictions:
    """Return what a detector finds in the pictures that can be read, and append the problems of others.

    Args:
        finder: The detector.
        images: The pictures.
        where: Name for warnings about all of them.
        problems: List to append to.
        progress: Called with the number of finished and of all pictures.
    """
    problems += finder.problems
    found: dict[str, Detections] = {}
    sizes: dict[str, tuple[int, int]] = {}
    deep = 0
    for n, image in enumerate(images, 1):
        try:
            picture = load_background(image.path, image.size_wh)
            found[image_key(image)] = finder.find(picture.pixels, CONFIDENCE, image.capture.scale)
        except DatasetError as error:
            problems += error.problems
            continue
        except ValueError as error:
            expected = "a picture that the gain control of the detector's training can map"
            problems.append(Problem(image_key(image), "image-agc", str(error), expected))
            continue
        finally:
            if progress is not None:
                progress(n, len(images))
        sizes[image_key(image)] = picture.size_wh
        problems += picture.problems
        deep += picture.bit_depth == 16
    problems += _gain_remarks(finder, where, deep, len(found) - deep)
    facts = dict(finder.facts) | {"confidence": CONFIDENCE}
    return Predictions(finder.task, finder.classes, found, sizes, facts)


def _gain_remarks(finder: Finder, where: str, deep: int, shallow: int) -> list[Problem]:
    """Return warnings if pictures were mapped to grey levels in another way than those of the training."""
    if deep and finder.agc is None:
        found = f"{deep} pictures of 16 bits, and a detector that does not state the gain control of its training"
        todo = "they went through a line from the 0.5 to the 99.5 % quantile of each; missed objects may be due to it"
        return [Problem(where, "agc-unknown", found, "the gain control of the training", todo, "warning")]
    if shallow and finder.agc is not None:
        found = f"{shallow} pictures of 8 bits, whose gain control is that of their camera"
        expected = f"pictures of 16 bits, as in the detector's training ({finder.agc.describe()})"
        return [Problem(where, "agc-other", found, expected, severity="warning")]
    return []
