"""The detections to evaluate: from a detector that is run on the images, or from a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from infrablend.core.dataset import Category, ImageRecord
from infrablend.detection import predict
from infrablend.detection.detections import MAX_DETECTIONS, TASKS, Predictions, Task, read_predictions
from infrablend.detection.detector_file import file_of
from infrablend.detection.finder import Finder, load_finder, search_pictures
from infrablend.detection.truth import image_key
from infrablend.errors import DatasetError, ModelError, Problem


class DetectionSource:
    """Source of the detections to evaluate: a detector or a file of saved detections.

    Attributes:
        name: Name of the file or folder.
        classes: Classes of the detector; None if it could not be loaded.
        task: What the detector finds; None if it could not be loaded.
    """

    def __init__(
        self,
        path: Path,
        device: str,
        problems: list[Problem],
        images: Sequence[ImageRecord],
        categories: Sequence[Category],
    ) -> None:
        """Load weights or saved detections, and append problems with them to `problems`.

        Args:
            path: The weights or detections.
            device: Device of a detector.
            problems: List to append to.
            images: Images to whose ids saved detections may refer.
            categories: Categories to whose ids they may refer.
        """
        self.name = path.name
        self.classes: tuple[str, ...] | None = None
        self.task: Task | None = None
        self._path = path
        self._saved: Predictions | None = None
        self._detector: predict.Detector | None = None
        self._device = device
        self._network: Finder | None = None
        try:
            file = file_of(path)
            if file.suffix == ".json":
                self._saved = read_predictions(file, images, categories)
                self.classes = self._saved.classes
                self.task = self._saved.task
            elif file.suffix.lower() == ".onnx":
                self._network = load_finder(file, device=device)
                self.classes = self._network.classes
                self.task = self._network.task
            else:
                self._detector = predict.load_detector(file, device)
                self.classes = self._detector.classes
                self.task = self._detector.task
        except (DatasetError, ModelError) as error:
            problems += error.problems

    @property
    def is_fixed(self) -> bool:
        """Whether pictures cannot be changed on their way into the detector: saved detections, and ONNX files."""
        return self._saved is not None or self._network is not None

    def check(self, images: Sequence[ImageRecord], problems: list[Problem]) -> None:
        """Check that saved detections fit these images, or that weights can read the images; append problems."""
        if self._saved is not None:
            self._saved = _of_images(self._saved, images, self._path, problems)
        elif self._detector is not None:
            problems += predict.check_pictures(images)

    def on(
        self,
        images: Sequence[ImageRecord],
        image_size: int | None,
        on_image: Callable[[int, int], None] | None,
        problems: list[Problem],
        fit: predict.Fit | None = None,
    ) -> Predictions:
        """Return the detections on the images, and append warnings about the image scale to `problems`.

        A detector reads the pictures as `fit` prepares them; saved detections stay as they are.
        """
        if self._saved is not None:
            used = self._saved.facts.get("image_size")
            if image_size is not None and used != image_size:
                found = f"--image-size {image_size} has no effect on saved detections"
                problems.append(Problem(self.name, "image-size-unused", found, severity="warning"))
            return self._saved
        if self._network is not None:
            network = self._network
            if image_size is not None:
                network = load_finder(file_of(self._path), device=self._device, image_size=image_size)
            before = len(problems)
            predictions = search_pictures(network, images, self.name, problems, on_image)
            if wrong := [p for p in problems[before:] if p.severity == "error"]:
                raise DatasetError(f"{len(wrong)} of {len(images)} pictures cannot be used", wrong)
            return predictions
        assert self._detector is not None
        if image_size is None:
            problems += self._detector.scale.warnings(self._path)
        return predict.predict(self._detector, images, image_size=image_size, on_image=on_image, fit=fit)


def choose_task(wanted: str | None, source: DetectionSource, problems: list[Problem]) -> Task:
    """Return the task to evaluate: the requested one, or the detector's own; append a mismatch to `problems`."""
    task = source.task or "detect"
    if wanted is None:
        return task
    chosen = next((t for t in TASKS if t == wanted), None)
    if chosen is None:
        problems.append(Problem("task", "task", f"{wanted!r}", f"one of {', '.join(TASKS)}"))
    elif chosen not in (task, "detect") and source.task is not None:
        todo = "omit --task, or use weights that were trained for it"
        problems.append(Problem("task", "task", f"{chosen}, but the detector finds {_FINDS[task]}", task, todo))
    return chosen or task


_FINDS: Mapping[Task, str] = {"detect": "boxes", "obb": "oriented boxes", "segment": "masks"}


def _of_images(saved: Predictions, images: Sequence[ImageRecord], file: Path, problems: list[Problem]) -> Predictions:
    """Return the detections on these images by InfraBlend's keys; the keys of other tools may lack the split."""
    of: dict[str, str] = {}
    lacking = []
    for image in images:
        key = image_key(image)
        name = next((n for n in (key, image.name) if n in saved.images), None)
        if name is None:
            lacking.append(key)
            continue
        of[key] = name
        if image.size_wh is not None and saved.sizes_wh[name] != image.size_wh:
            found, expected = ("{}x{} px".format(*size) for size in (saved.sizes_wh[name], image.size_wh))
            problems.append(Problem(f"{file.name}, {name}", "prediction-size", found, expected))
    if lacking:
        found = f"no entry for {len(lacking)} of {len(images)} images: {', '.join(lacking[:3])}"
        todo = "give the dataset and split that the file was made from"
        problems.append(Problem(file.name, "prediction-images", found, "an entry for every image", todo))
    rest = len(saved.images) - len(of)
    if rest and of:
        found = f"{rest} images are not in the split and were left out"
        problems.append(Problem(file.name, "prediction-images", found, severity="warning"))
    cut = sum(len(saved.images[n]) > MAX_DETECTIONS for n in of.values())
    if cut:
        found = f"more than {MAX_DETECTIONS} detections in {cut} images: only those with the best scores are evaluated"
        problems.append(Problem(file.name, "prediction-many", found, severity="warning"))
    first = np.arange(MAX_DETECTIONS)
    kept = {k: d if len(d := saved.images[n]) <= MAX_DETECTIONS else d.take(first) for k, n in of.items()}
    return replace(saved, images=kept, sizes_wh={k: saved.sizes_wh[n] for k, n in of.items()})
