"""`infrablend detectability`: measure how likely a detector finds a recipe's objects in the user's own pictures."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import cast

import numpy as np

from infrablend import __version__
from infrablend.assets.catalogue import load_model
from infrablend.core.files import write_json, write_text
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.workspace import replacing, workspace
from infrablend.detection.detectability_record import AreaRow, DetectabilityFacts, MapFacts, MeasuredFacts
from infrablend.detection.finder import Finder, load_finder
from infrablend.detection.recall import Z95
from infrablend.detection.training_origin import TrainingOrigin, training_origin
from infrablend.detection.truth import image_key, match_classes
from infrablend.errors import DatasetError, ModelError, Problem
from infrablend.formats.image_groups import group_images
from infrablend.formats.maps.map_files import write_geojson
from infrablend.formats.maps.search_sectors import Sector, read_sectors
from infrablend.pipeline.compose.memory_frames import Frames
from infrablend.pipeline.flights.aligned_poses import align_poses
from infrablend.pipeline.flights.corrected_counts import LookShares
from infrablend.pipeline.flights.detectability_figures import (
    FACTS,
    LEAST_COMPARED,
    measured_facts,
    run_trials,
)
from infrablend.pipeline.flights.detectability_request import DetectabilityRequest, DetectabilitySettings
from infrablend.pipeline.flights.flight_poses import FlightPoses, find_poses
from infrablend.pipeline.flights.insert_trials import TrialRules, Trials
from infrablend.pipeline.flights.search_map import (
    AreaFigures,
    SearchMap,
    area_figures,
    find_dependence,
    map_detection,
    map_features,
)
from infrablend.pipeline.flights.trial_frames import trial_frames
from infrablend.report.detectability_page import PAGE, detectability_page
from infrablend.report.flight_map import draw_cells

_PLANNED_FRAMES = 8
MAP = "detectability.geojson"


@dataclass(frozen=True, eq=False)
class DetectabilityReport:
    """Result of `detectability`.

    Attributes:
        out: Folder with `detectability.json` and `detectability.html`.
        facts: Content of the former.
        problems: What was left out, and warnings.
        seconds: Wall-clock time.
    """

    out: Path
    facts: DetectabilityFacts
    problems: tuple[Problem, ...] = ()
    seconds: float = field(default=0.0, compare=False)

    @property
    def ok(self) -> bool:
        """Whether every picture could be used."""
        return not any(p.severity == "error" for p in self.problems)


def measure_detectability(
    request: DetectabilityRequest, out: Path, *, overwrite: bool = False, on_progress: OnProgress | None = None
) -> DetectabilityReport:
    """Insert objects into pictures in memory, let the detector search them, and write figures and page.

    Raises:
        ModelError: The detector cannot be used, or has no class of the recipe.
        DatasetError: No picture can be used, or no object can stand in them.
    """
    started = time.monotonic()
    with workspace(out, "detectability", FACTS, replacing(overwrite)) as space:
        finder = load_finder(request.detector, device=request.device, classes=request.classes)
        with Frames(trial_frames(request)) as frames:
            trials = Trials(frames, finder, _rules(request, frames, finder))
            origin = training_origin(request.detector)
            problems = [*frames.problems, *finder.problems]
            problems += [] if origin is None else _circles(origin, request, trials)
            sectors = _sectors(request.settings, trials, problems)
            run_trials(trials, request.settings, request.trial_seed, paced(on_progress))
            if not trials.inserted:
                raise _nothing_inserted(request, trials)
            problems += trials.unread
            found = _search_map(request.data.name, request.settings, trials, problems)
            areas = [] if found is None else [area_figures(found), *(area_figures(found, s) for s in sectors)]
            measured = measured_facts(trials, request.settings)
            problems += _not_reached(request.settings, measured)
            facts = _facts(request, finder, origin, frames.recipe.name, measured, problems)
        if found is not None:
            facts["map"] = _map_facts(found, areas, _alarms(trials, request.settings.confidence))
            write_geojson(space.folder / MAP, map_features(found))
        write_json(space.folder / FACTS, facts)
        write_text(space.folder / PAGE, detectability_page(facts, _drawn(found)))
        space.finish(facts)
    return DetectabilityReport(out, facts, tuple(problems), time.monotonic() - started)


@dataclass(frozen=True)
class DetectabilityPlan:
    """What `detectability` will take, from a few frames that were made and searched.

    Attributes:
        objects_per_frame: Inserted objects of the class in a frame.
        objects: Objects that make the interval as narrow as asked for if half of them are found, independently.
        frames: Frames with so many objects.
        pictures: Pictures that can be used; more frames use them again, with other objects.
        seconds: About how long that takes.
        problems: Pictures that were left out, and warnings.
    """

    objects_per_frame: float
    objects: int
    frames: int
    pictures: int
    seconds: float
    problems: tuple[Problem, ...] = ()


def plan_detectability(request: DetectabilityRequest) -> DetectabilityPlan:
    """Return what `measure_detectability` would take; its errors are the same."""
    finder = load_finder(request.detector, device=request.device, classes=request.classes)
    with Frames(trial_frames(request)) as frames:
        trials = Trials(frames, finder, _rules(request, frames, finder))
        tried = 0
        began = started = time.monotonic()
        for tried in trials.rounds(request.trial_seed, 1):
            if tried == 1:  # workers start with the first frame
                started = time.monotonic()
            if tried > _PLANNED_FRAMES:
                break
        now = time.monotonic()
        seconds = (now - started) / (tried - 1) if tried > 1 else now - began
        per_frame = len(trials.inserted) / max(tried, 1)
        if not per_frame:
            raise _nothing_inserted(request, trials)
        objects = round(0.25 * (Z95 / request.settings.until) ** 2)
        needed = round(objects / per_frame)
        return DetectabilityPlan(
            per_frame,
            objects,
            needed,
            len(trials.images()),
            needed * seconds,
            (*frames.problems, *finder.problems),
        )


def _rules(request: DetectabilityRequest, frames: Frames, finder: Finder) -> TrialRules:
    """Return what counts.

    Raises:
        ModelError: The recipe or the detector has no such class.
    """
    offered = frames.inserted_classes
    category = request.settings.category or offered[0]
    if category not in offered:
        problem = Problem("category", "class-unknown", category, f"a class of the recipe: {', '.join(offered)}")
        raise ModelError(f"{request.recipe}: inserts no {category}", [problem])
    numbers = match_classes(finder.classes, [category])[category]
    if not numbers:
        found = f"the detector has {', '.join(finder.classes)}"
        todo = "give a detector of this class, name the class with --category, or set objects.0.category"
        problem = Problem(request.detector.name, "class-absent", found, category, todo)
        raise ModelError(f"{request.detector}: finds no {category}", [problem])
    clusters: dict[str, str] = {}
    if request.settings.group != "image":
        groups = group_images(list(frames.backgrounds.values()), request.settings.group)
        clusters = {image_key(i): name for name, its in groups.items() for i in its}
    ignored = frozenset(c.name for c in frames.categories if c.ignore)
    least = min(request.settings.confidences)
    stands = all(load_model(kind.model).stands for kind in frames.recipe.objects)
    return TrialRules(category, numbers, request.settings.least_overlap, least, clusters, ignored, stands)


def _circles(origin: TrainingOrigin, request: DetectabilityRequest, trials: Trials) -> list[Problem]:
    """Return warnings about a detector that knows these pictures, or these inserted objects, from its training."""
    problems = []
    splits = {image.split for image in trials.images()}
    if Path(origin.data).resolve() == request.data.resolve() and "train" in splits:
        found = "the detector was trained on pictures of the split train of this folder"
        todo = "its figures are too good on pictures that it knows: name another --split"
        problems.append(Problem(request.detector.name, "trained-on", found, "other pictures", todo, "warning"))
    if origin.inserted:
        same = f", by the recipe {origin.recipe}" if origin.recipe else ""
        found = f"the detector was trained on {origin.inserted} labels of inserted objects{same}"
        todo = "where no real objects say how well it does, take its figures as an upper bound"
        problems.append(Problem(request.detector.name, "trained-on-inserts", found, "", todo, "warning"))
    return problems


def _nothing_inserted(request: DetectabilityRequest, trials: Trials) -> DatasetError:
    skipped = [p for p in trials.frames.problems if p.severity == "error"]
    if not trials.searched:
        return DatasetError(f"{request.data}: no picture can be used", [*skipped, *trials.unread])
    reasons = ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in sorted(trials.counts.items()) if n)
    found = f"no object was inserted into any of {len(trials.searched)} pictures ({reasons or 'none asked for'})"
    todo = "look at `infrablend try` of the recipe with one of the pictures"
    problem = Problem(str(request.recipe), "nothing-inserted", found, "objects that can stand in these pictures", todo)
    return DatasetError(f"{request.data}: nothing to search for", [problem, *skipped, *trials.unread])


def _not_reached(settings: DetectabilitySettings, facts: MeasuredFacts) -> list[Problem]:
    low, high = facts["recall"]["low"], facts["recall"]["high"]
    if low is not None and high is not None and (high - low) / 2 <= settings.until:
        return []
    width = "unknown" if low is None or high is None else f"+-{(high - low) / 2:.3f}"
    found = f"the share found is known to {width}, after {settings.most_rounds} rounds through the pictures"
    todo = "give more pictures, or more rounds (--most-rounds); the spread between pictures sets a limit"
    return [Problem("until", "until-not-reached", found, f"+-{settings.until:g}", todo, "warning")]


def _search_map(
    where: str, settings: DetectabilitySettings, trials: Trials, problems: list[Problem]
) -> SearchMap | None:
    """Return the map of the flight; None, with a warning, where no picture has a pose."""
    images = [picture.image for picture in trials.searched.values()]
    shares = LookShares(trials.inserted, settings.confidence)
    dependence = find_dependence(trials.inserted, settings.confidence)
    # Yaw and lens that the overlap of pictures contradicts are replaced, as in `detect`.
    poses = find_poses(images)
    aligned = align_poses(where, images, poses, ())
    problems += aligned.problems
    found = map_detection(images, aligned.poses.known, shares, dependence, settings.cell_m)
    if found is None:
        problems.append(_no_map(poses))
    return found


def _sectors(settings: DetectabilitySettings, trials: Trials, problems: list[Problem]) -> list[Sector]:
    """Return the sectors of the search, which are read before anything is searched.

    Raises:
        DatasetError: They cannot be used, or no picture has a pose.
    """
    if settings.sectors is None:
        return []
    poses = find_poses(trials.images())
    if not poses.known:
        raise DatasetError(f"{settings.sectors}: no map to take sectors from", [_no_map(poses)])
    places = np.array([(p.latitude_deg, p.longitude_deg) for p in poses.known.values()])
    sectors, elsewhere = read_sectors(settings.sectors, places)
    problems += elsewhere
    return sectors


def _no_map(poses: FlightPoses) -> Problem:
    """Return the warning that there is no map, with what the pictures lack."""
    lacking = sorted({*poses.lacking.values()})
    missing = f"without {'; '.join(lacking)}" if lacking else "too little ground in view for a cell"
    todo = "give a table of them with --metadata, or take the figures without a map"
    pictures = f"{len(poses.lacking) + len(poses.known)} pictures"
    return Problem(pictures, "map-left-out", missing, "pictures with a pose, for a map", todo, "warning")


def _alarms(trials: Trials, confidence: float) -> int:
    """Return the alarms in pictures with a pose."""
    posed = find_poses([p.image for p in trials.searched.values()]).known
    its = [p for key, p in trials.searched.items() if key in posed]
    return sum(int((p.alarms & (p.found.scores >= confidence)).sum()) for p in its)


def _map_facts(found: SearchMap, areas: Sequence[AreaFigures], alarms: int) -> MapFacts:
    rows = [{k: None if v != v else v for k, v in asdict(area).items()} for area in areas]
    return {
        "cell_m": found.cell_m,
        "cells": len(found.pod),
        "rho": found.dependence.rho,
        "rho_from": found.dependence.origin,
        "track_m": found.track_m,
        "sweep_width_m": found.sweep_width_m,
        "pictures_without_pose": found.without_pose,
        "searched_ha": found.searched_m2 / 1e4,
        "alarms_per_ha": alarms / (found.searched_m2 / 1e4),
        "areas": cast("list[AreaRow]", rows),
    }


def _drawn(found: SearchMap | None) -> bytes | None:
    if found is None:
        return None
    at = f"{found.frame.latitude_deg:.5f}, {found.frame.longitude_deg:.5f}"
    return draw_cells(found.middles_m, found.pod, found.cell_m, "probability of detection", f"origin at {at}")


def _facts(
    request: DetectabilityRequest,
    finder: Finder,
    origin: TrainingOrigin | None,
    recipe: str,
    measured: MeasuredFacts,
    problems: list[Problem],
) -> DetectabilityFacts:
    trained_on = "unknown"
    if origin is not None:
        trained_on = f"{origin.real} labels of real and {origin.inserted} of inserted objects"
    enough_real = measured["recall"].get("real", 0) >= LEAST_COMPARED
    is_bound = origin is not None and origin.inserted > 0 and not enough_real
    return {
        **measured,
        "kind": "upper bound" if is_bound else "measured",
        "sentence": sentence(measured, is_bound=is_bound),
        "map": None,
        "recipe": recipe,
        "detector": dict(finder.facts),
        "trained_on": trained_on,
        "data": request.data.name,
        "seed": request.seed,
        "until": request.settings.until,
        "infrablend": __version__,
        "problems": [p.to_json() for p in problems],
    }


def sentence(facts: MeasuredFacts, *, is_bound: bool = False) -> str:
    """Return the result in one sentence."""
    recall = facts["recall"]
    alarms = next(a["alarms_per_picture"] for a in facts["confidences"] if a["confidence"] == facts["confidence"])
    targets = [c for c in facts["cells"] if c["by"] == "target"]
    found = f"{recall['predicted']:.2f} ({recall['low']:.2f} to {recall['high']:.2f})"
    text = f"In these pictures, a {facts['category']} would be found with {'at most ' if is_bound else ''}{found}"
    if len(targets) > 1:
        parts = (f"{c['value']} {c['predicted']:.2f} ({c['low']:.2f} to {c['high']:.2f})" for c in targets)
        text += f" ({', '.join(parts)})"
    kind = "false alarms" if recall.get("real") else "alarms"
    return f"{text}, at {alarms:.2f} {kind} a picture and confidence {facts['confidence']:g}."
