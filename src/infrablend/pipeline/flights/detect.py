"""Runs a detector on the pictures of a flight, or of any dataset, and writes what it finds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.file_names import real_path
from infrablend.core.files import write_text
from infrablend.core.output_checks import require_apart
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.workspace import DETECT_FILE, replacing, workspace
from infrablend.detection.detections import (
    MAX_DETECTIONS,
    PREDICTIONS,
    Detections,
    Predictions,
    read_predictions,
    write_predictions,
)
from infrablend.detection.detector_file import file_of
from infrablend.detection.finder import load_finder, search_pictures
from infrablend.detection.tracking import require_trackers, track_ids, tracker_settings
from infrablend.detection.truth import image_key
from infrablend.errors import DatasetError, Problem
from infrablend.formats.maps.height_model import load_rasterio
from infrablend.formats.read_write import READ_ALL, Reading
from infrablend.formats.values import csv_text
from infrablend.pipeline.flights.detect_request import DEFAULT_DETECT, DetectRequest
from infrablend.pipeline.flights.flight_objects import FlightObjectFacts, count_flight
from infrablend.pipeline.flights.place_settings import DEFAULT_PLACES, PlaceSettings
from infrablend.pipeline.flights.placed_detections import FlightPlaces, draw_maps, place_flight, write_maps
from infrablend.pipeline.plans.sequence_motion import sequences_of
from infrablend.report.detections_page import PAGE, detections_page

TABLE = "detections.csv"
COLUMNS = (
    "picture", "time", "left", "top", "right", "bottom", "class", "score", "track", "latitude", "longitude",
    "ellipse_long_m", "ellipse_short_m", "ellipse_bearing_deg", "object",
)  # fmt: skip


@dataclass(frozen=True)
class DetectReport:
    """What a detector found.

    Attributes:
        out: Folder of the detections.
        pictures: Number of pictures that were searched.
        found: Number of detections from the confidence on, by class.
        with_some: Number of pictures with such a detection.
        placed: Number of these detections that have a place on the ground.
        problems: Pictures that were not searched, each with its reason, and warnings.
        objects: The objects behind these detections; None without places.
    """

    out: Path
    pictures: int
    found: Mapping[str, int]
    with_some: int
    placed: int
    problems: tuple[Problem, ...] = field(default=())
    objects: FlightObjectFacts | None = None

    @property
    def ok(self) -> bool:
        """True if something was found and every picture was searched."""
        return bool(self.with_some) and not any(p.severity == "error" for p in self.problems)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "out": str(self.out),
            "pictures": self.pictures,
            "found": dict(self.found),
            "with_some": self.with_some,
            "placed": self.placed,
            "objects": self.objects,
            "problems": [p.to_json() for p in self.problems],
        }


def detect_objects(
    detector: Path,
    dataset: Dataset,
    out: Path,
    request: DetectRequest = DEFAULT_DETECT,
    settings: PlaceSettings = DEFAULT_PLACES,
    *,
    reading: Reading = READ_ALL,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> DetectReport:
    """Write `predictions.json`, `detections.csv`, `report.html` and `detect.json`, and maps if pictures have a pose.

    Args:
        detector: Weights, ONNX file, or detections in COCO; or the folder of a training, a `detect` or an evaluation.
        dataset: The pictures.
        out: Folder to write.
        request: How to detect.
        settings: How to place detections on the ground.
        reading: How the pictures were read, for those who look at the detections later.
        overwrite: Whether to replace earlier detections in `out`.
        on_progress: Called with the number of pictures searched so far.

    Raises:
        MissingDependencyError: A package or device is missing.
        ModelError: The detector cannot be used.
        DatasetError: No picture can be searched, or there are no sequences for tracks.
        OutputError: `out` has something that may not be replaced, or cannot be written.
    """
    require_apart(dataset.root, out)
    sequences = {}
    if request.tracks:
        require_trackers()
        sequences = sequences_of(dataset)
    problems = list(dataset.problems)
    if settings.terrain is not None:
        load_rasterio()
    with workspace(out, "detections", DETECT_FILE, replacing(overwrite)) as space:
        file = file_of(detector)
        if file.suffix.lower() == ".json":
            predictions = _saved(file, dataset, problems)
        else:
            finder = load_finder(
                file, device=request.device, classes=request.classes or (), threads=request.threads,
                image_size=request.image_size, overlap_px=request.overlap,
            )  # fmt: skip
            predictions = search_pictures(finder, dataset.images, dataset.root.name, problems, paced(on_progress))
        if not predictions.images:
            raise DatasetError(f"{dataset.root}: no picture can be searched", problems)
        shown = {key: at_least(found, request.confidence) for key, found in predictions.images.items()}
        total = Counter(predictions.classes[k] for found in shown.values() for k in found.classes.tolist())
        sizes = predictions.sizes_wh
        searched = [replace(i, size_wh=sizes[image_key(i)]) for i in dataset.images if image_key(i) in shown]
        places = place_flight(dataset.root.name, searched, replace(predictions, images=shown), settings)
        problems += (*places.problems, *_remarks(predictions, total, request.confidence))
        write_predictions(space.folder / PREDICTIONS, predictions)
        kept = replace(predictions, images=shown)
        objects = count_flight(places.joined, kept, searched, places.joining, settings.speed) if places.joined else None
        tracks = _tracks(sequences, predictions)
        write_text(space.folder / TABLE, _table(searched, shown, predictions.classes, places, objects, tracks))
        if places.poses.known:
            write_maps(space.folder, places.poses, places.placed)
        with_some = sum(bool(len(found)) for found in shown.values())
        counts = {name: total[name] for name in predictions.classes if total[name]}
        report = DetectReport(
            out, len(predictions.images), counts, with_some, len(places.placed), tuple(problems), objects
        )
        facts: dict[str, object] = {
            "detector": dict(predictions.facts),
            "classes": list(predictions.classes),
            "data": str(real_path(dataset.root)),
            "reading": asdict(reading) | {"metadata": reading.metadata and str(real_path(Path(reading.metadata)))},
            "data_name": dataset.root.name,
            "format": dataset.format,
            "confidence": request.confidence,
            "places": places.to_json(),
            **{k: v for k, v in report.to_json().items() if k != "out"},
        }
        maps = draw_maps(places.poses, places.placed)
        page = detections_page(facts, dataset.images, predictions, request.confidence, maps)
        write_text(space.folder / PAGE, page)
        space.finish(facts)
    return report


def at_least(found: Detections, confidence: float) -> Detections:
    """Return the detections from a score on."""
    return found.take(np.flatnonzero(found.scores >= confidence))


def _saved(file: Path, dataset: Dataset, problems: list[Problem]) -> Predictions:
    """Return the detections of a file on the pictures of the dataset, and append those that lack the other."""
    saved = read_predictions(file, dataset.images, dataset.categories)
    names: dict[str, str] = {}
    for image in dataset.images:
        name = next((n for n in (image_key(image), image.name) if n in saved.images), None)
        if name is None:
            found = f"{file.name} has no entry for it"
            problems.append(Problem(image_key(image), "prediction-images", found, "an entry for every picture"))
        elif image.size_wh is not None and saved.sizes_wh[name] != image.size_wh:
            of, expected = ("{}x{} px".format(*size) for size in (saved.sizes_wh[name], image.size_wh))
            problems.append(Problem(image_key(image), "prediction-size", f"{of} in {file.name}", expected))
        else:
            names[image_key(image)] = name
    rest = len(saved.images) - len(set(names.values()))
    if rest:
        found = f"detections for {rest} pictures that the data do not have, or have twice, left out"
        problems.append(Problem(file.name, "prediction-images", found, "pictures of the data", severity="warning"))
    return Predictions(
        saved.task,
        saved.classes,
        {key: saved.images[name] for key, name in names.items()},
        {key: saved.sizes_wh[name] for key, name in names.items()},
        saved.facts,
    )


def _remarks(predictions: Predictions, total: Mapping[str, int], confidence: float) -> list[Problem]:
    """Return warnings about what was found: nothing, or more than is kept."""
    remarks = []
    full = [key for key, found in predictions.images.items() if len(found) >= MAX_DETECTIONS]
    if full:
        found = f"{len(full)} pictures, such as {full[0]}, have {MAX_DETECTIONS} detections or more"
        todo = f"only those with the best scores are in {PREDICTIONS}"
        remarks.append(Problem("detections", "detections-cut", found, f"up to {MAX_DETECTIONS}", todo, "warning"))
    if not any(total.values()):
        best = max((float(d.scores[0]) for d in predictions.images.values() if len(d)), default=0.0)
        found = f"nothing found with a score from {confidence:g} on; the best has {best:.3f}"
        todo = "a lower --confidence shows more; a detector for other pictures or objects finds nothing"
        remarks.append(Problem("detections", "detections-none", found, "some", todo, "warning"))
    return remarks


Tracks = Mapping[tuple[str, int], str]
"""Name of the track of a detection, by `<split>/<name>` of its picture and its number there."""


def _tracks(sequences: Mapping[str, Sequence[ImageRecord]], predictions: Predictions) -> Tracks:
    """Return the tracks through each sequence; pictures that could not be searched are gaps."""
    found: dict[tuple[str, int], str] = {}
    for name, images in sequences.items():
        seen = [i for i in images if image_key(i) in predictions.images]
        ids = track_ids(seen, [predictions.images[image_key(i)] for i in seen], tracker_settings("bytetrack"))
        for image, of in zip(seen, ids, strict=True):
            found |= {(image_key(image), k): f"{name}/{number}" for k, number in of.items()}
    return found


def _table(
    images: Sequence[ImageRecord],
    shown: Mapping[str, Detections],
    classes: Sequence[str],
    places: FlightPlaces,
    objects: FlightObjectFacts | None,
    tracks: Tracks,
) -> str:
    """Return the table of detections, picture by picture, those of a picture by descending score."""
    placed = {(p.picture, p.number): p for p in places.placed}
    object_of = {name: o["number"] for o in (objects["objects"] if objects else ()) for name in o["sightings"]}
    rows: list[tuple[object, ...]] = []
    for image in images:
        key = image_key(image)
        found = shown[key]
        for k, (box, of) in enumerate(zip(found.boxes_xyxy.tolist(), found.classes.tolist(), strict=True)):
            at = placed.get((key, k))
            place = [""] * 5 if at is None else at.table_cells()
            rows.append(
                (
                    key,
                    time_text(image),
                    *box,
                    classes[of],
                    float(found.scores[k]),
                    tracks.get((key, k), ""),
                    *place,
                    object_of.get(f"{key} {k}", ""),
                )
            )
    return csv_text(COLUMNS, rows)


def time_text(image: ImageRecord) -> str:
    """Return when a picture was taken, else its second in its sequence; empty if neither is known."""
    second = image.capture.time_s
    return image.capture.captured or ("" if second is None else f"{second:g} s")
