"""Writes the label files and the card of a run from its frame records once all frames are finished."""

from __future__ import annotations

import math
import statistics
import sys
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from infrablend.annotation.looseness import loosen_image
from infrablend.compositing.gain import Doubt
from infrablend.config.agc import Agc
from infrablend.core.dataset import ImageRecord
from infrablend.core.run_layout import EIGHT_BIT, IMAGES
from infrablend.core.spool import Spool
from infrablend.core.stored_images import store_images
from infrablend.errors import Problem
from infrablend.formats import huggingface, writing
from infrablend.formats.losses import Written
from infrablend.formats.writing import WriteSettings
from infrablend.pipeline.card import run_card
from infrablend.pipeline.eight_bit import eight_bit_copies
from infrablend.pipeline.folder import RunFolder
from infrablend.pipeline.labelled import labelled_image
from infrablend.pipeline.plan import PlannedFrame, RunPlan
from infrablend.pipeline.record import FrameRecord, read_record
from infrablend.report.card import write_card
from infrablend.sampling.calibration import FACTOR_BOUNDS


@dataclass(frozen=True)
class LabelSummary:
    """Summary of the labels of a run.

    Attributes:
        counts: Images, labels per category, removals and empty frames by reason.
        draws: Placement statistics: attempts, rejections by reason, shift of the camera distance.
        removed: Original labels that inserted objects cover.
        losses: Counts of what formats cannot express, by `<format>.<kind>`.
        problems: Warnings.
    """

    counts: Mapping[str, Any] = field(default_factory=dict)
    draws: Mapping[str, Any] = field(default_factory=dict)
    removed: tuple[Mapping[str, Any], ...] = ()
    losses: Mapping[str, int] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()


@dataclass(frozen=True)
class FinishedFrames:
    """Finished frames of a run, in the order of the plan.

    Attributes:
        frames: The frames.
        records: Record of each; all but the first are on disk, see `Spool`.
    """

    frames: list[PlannedFrame]
    records: Spool[FrameRecord]

    @classmethod
    def none(cls, folder: RunFolder) -> FinishedFrames:
        """Return no frames, to be added to; the records are on the disk of the folder of the run."""
        return cls([], Spool(folder.root))

    def add(self, frame: PlannedFrame, record: FrameRecord) -> None:
        """Add a frame."""
        self.frames.append(frame)
        self.records.append(record)


def read_frames(plan: RunPlan, folder: RunFolder) -> FinishedFrames:
    """Return the frames that have a record, in the order of the plan."""
    found = FinishedFrames.none(folder)
    for frame in plan.frames:
        if (record := read_record(folder.record(frame.frame_id))) is not None:
            found.add(frame, record)
    return found


def write_formats(plan: RunPlan, folder: RunFolder, finished_frames: FinishedFrames) -> LabelSummary:
    """Write the card and all formats of the recipe; the same records give the same bytes.

    One record is in memory at a time beyond the first `spool.IN_MEMORY`, whatever the number of frames.
    """
    records = finished_frames.records
    loosened = 0

    def labelled() -> Iterator[ImageRecord]:
        nonlocal loosened
        for frame, record in zip(finished_frames.frames, records, strict=True):
            # The records keep the exact boxes.
            image = labelled_image(frame, record, folder.image(record.image))
            image, count = loosen_image(image, plan.recipe.labels.loosen)
            loosened += count
            yield image

    images = store_images(labelled(), folder.root)
    losses: Counter[str] = Counter()
    problems: list[Problem] = []
    for name in plan.recipe.output.formats if images else ():
        written = _write_format(name, plan, folder.root, images)
        losses.update({f"{name}.{k}": n for k, n in written.losses.items() if n})
        problems += written.problems
    # The pictures load with `datasets` from where they are.
    beside = huggingface.write(folder.root / IMAGES, images, plan.categories, pictures=False)
    losses.update({f"{IMAGES}.{k}": n for k, n in beside.losses.items()})
    problems += beside.problems
    if plan.recipe.output.agc is not None and images:
        problems += _write_eight_bit(plan, folder, images, plan.recipe.output.agc)
    problems += frame_warnings(records)
    finished = summarize(plan, records, images)
    if loosened:
        by = plan.recipe.labels.loosen
        finished = replace(finished, counts={**finished.counts, "boxes_loosened": loosened, "loosened_by": by})
    problems += absent_warnings(finished.draws)
    problems += limit_warnings(records)
    problems += air_warnings(records)
    problems += hiding_warnings(finished.counts)
    if images:
        problems += write_card(
            folder.root, run_card(plan, finished.counts, losses, images, tuple(dict.fromkeys(problems)))
        )
    # The three YOLO formats warn alike of a missing split.
    unique = tuple(dict.fromkeys(problems))
    return replace(finished, losses=dict(sorted(losses.items())), problems=unique)


def _write_eight_bit(plan: RunPlan, folder: RunFolder, images: Sequence[ImageRecord], agc: Agc) -> list[Problem]:
    """Write the dataset again with 8-bit pictures by an automatic gain control; return its problems."""
    shown, as_they_are = eight_bit_copies(images, folder.eight_bit / IMAGES, agc)
    problems: list[Problem] = []
    for name in plan.recipe.output.formats:
        problems += _write_format(name, plan, folder.eight_bit, shown).problems
    huggingface.write(folder.eight_bit / IMAGES, shown, plan.categories, pictures=False)
    if as_they_are:
        found = f"{as_they_are} pictures have 8 bits already, and are in {EIGHT_BIT}/ as they are"
        problems.append(Problem("output.agc", "agc-unused", found, "16-bit pictures", "leave it out", "warning"))
    return problems


def _write_format(name: str, plan: RunPlan, out: Path, images: Sequence[ImageRecord]) -> Written:
    labels = plan.recipe.labels
    settings = WriteSettings(
        ids=plan.recipe.output.ids,
        category_ids=plan.recipe.output.category_ids,
        dont_care=labels.dont_care,
        without_mask=labels.seg_originals,
        pictures=name != "coco",  # they are in `images/` already
    )
    return writing.write(name, out / name, images, plan.categories, settings=settings, source=plan.dataset)


def frame_warnings(records: Sequence[FrameRecord]) -> list[Problem]:
    """Return the warnings about backgrounds, merged into one per kind."""
    seen: dict[str, dict[str, Mapping[str, Any]]] = {}
    for r in records:
        for w in r.warnings:
            seen.setdefault(w["code"], {}).setdefault(w["where"], w)
    warnings = []
    for code, by_place in sorted(seen.items()):
        first = min(by_place)
        w = by_place[first]
        where = first if len(by_place) == 1 else f"{first} and {len(by_place) - 1} more"
        warnings.append(Problem(where, code, w["found"], w["expected"], w["todo"], "warning"))
    return warnings


def absent_warnings(draws: Mapping[str, Any]) -> list[Problem]:
    """Return a warning if at least half of the requested objects were not inserted, e.g. for lack of visible ground."""
    absent, wanted = sum(draws.get("absent", {}).values()), draws.get("wanted", 0)
    if not absent or 2 * absent < wanted:
        return []
    most = sorted(draws["rejected"].items(), key=lambda r: (-r[1], r[0]))[:3]
    why = ", ".join(f"{name} {n}" for name, n in (*draws["absent"].items(), *most))
    todo = "check the camera's pitch, height and lens, and placement.size_px; `draws` in run.json counts every reason"
    found = f"{absent} of {wanted} objects were not inserted ({why})"
    return [Problem("placement", "objects-absent", found, "most objects inserted", todo, "warning")]


def air_warnings(records: Sequence[FrameRecord]) -> list[Problem]:
    """Return a warning if radiometric frames have a drawn temperature of the air."""
    drawn = sum(r.facts.get("matching", {}).get("air") == "drawn" for r in records)
    if not drawn:
        return []
    found = f"the temperature of the air is not stated for {drawn} frame(s), and was drawn"
    expected = "that of the flight, which the temperatures of all objects are relative to"
    todo = "set environment.air_temperature_c to one number"
    return [Problem("environment.air_temperature_c", "air-drawn", found, expected, todo, "warning")]


_TRUST = "set matching.on_untrusted to prior or skip for such frames"
_DOUBTS: Mapping[Doubt, tuple[str, str, str, str]] = {
    "gain_at_bound": (
        "gain-at-limit",
        "the estimated gain is at a limit",
        "a gain within matching.gain_grey_per_k",
        "check matching.polarity and the weather, or set matching.gain_grey_per_k for this camera; or " + _TRUST,
    ),
    "gain_negative": (
        "gain-negative",
        "the estimated gain is negative: annotated objects that should be warm are dark",
        "warm objects that are bright",
        "check matching.polarity, time of day and matching.clothing_above_air_k; or " + _TRUST,
    ),
    "anchors_contradict": (
        "anchors-contradict",
        "annotated objects of known temperature imply different gains",
        "gains that agree within their uncertainty",
        "check class names and time of day; or " + _TRUST,
    ),
    "anchors_off": (
        "anchors-off",
        "annotated objects of known temperature are all brighter or darker than the weather allows",
        "levels within 2.5 standard deviations of those expected from weather and gain",
        "check matching.polarity, environment.ground_above_air_k and matching.clothing_above_air_k; or " + _TRUST,
    ),
    "no_anchor": (
        "no-anchor",
        "the gain is drawn from the prior alone, because nothing of known temperature is in sight",
        "annotated people, cars by night, or a skyline",
        "check matching.gain_prior_grey_per_k, which decides the contrast of these inserts",
    ),
}


def limit_warnings(records: Sequence[FrameRecord]) -> list[Problem]:
    """Return a warning per estimate that is at its limit in at least a fifth of its frames, so that it may be wrong.

    The estimates are the height of the camera (metric placement) and the gain (physical look).
    """
    heights: list[bool] = []
    gains: list[Sequence[str]] = []
    for r in records:
        heights += [] if (at_limit := _height_at_limit(r)) is None else [at_limit]
        gains += [tuple(map(sys.intern, doubts)) for doubts in _gain_doubts(r)]
    problems = []
    if heights and 5 * sum(heights) >= len(heights):
        found = (
            "the corrected height of the camera is as far from the stated one as is allowed in "
            f"{sum(heights)} of {len(heights)} frames with annotated objects of known size"
        )
        todo = "check lens, altitude and class names; infrablend preview --ground shows whether the scale is right"
        problems.append(Problem("camera", "height-at-limit", found, "a height between the limits", todo, "warning"))
    for kind, (code, what, expected, todo) in _DOUBTS.items():
        count = sum(kind in doubts for doubts in gains)
        if gains and 5 * count >= len(gains):
            problems.append(
                Problem("matching", code, f"{what} in {count} of {len(gains)} cases", expected, todo, "warning")
            )
    return problems


def _height_at_limit(record: FrameRecord) -> bool | None:
    """Return whether the corrected height of the camera is at a limit; None if it was not corrected."""
    view = None if record.scene is None else record.scene.view
    if view is None or not view.anchors:
        return None
    factor = view.camera_height_m / view.stated_height_m
    # Records of earlier versions have the factor alone.
    return view.at_limit or any(math.isclose(factor, limit, rel_tol=1e-6) for limit in FACTOR_BOUNDS)


def _gain_doubts(record: FrameRecord) -> list[Sequence[str]]:
    """Return the doubts about each gain of a frame; records of earlier versions have none."""
    gains = record.facts.get("matching", {}).get("gain", {})
    return [g["doubts"] for g in gains.values() if "doubts" in g]


def warning_codes(record: FrameRecord) -> set[str]:
    """Return the codes of the warnings about a run that a frame contributes to, whether or not the run has them."""
    codes = {str(w["code"]) for w in record.warnings}
    if record.scene is not None and record.scene.draws.get("absent"):
        codes.add("objects-absent")
    if record.facts.get("matching", {}).get("air") == "drawn":
        codes.add("air-drawn")
    if _height_at_limit(record):
        codes.add("height-at-limit")
    if any("window" not in o for o in record.facts.get("occlusion", ())):
        codes.add("nothing-in-front")
    return codes | {_DOUBTS[kind][0] for kind in _DOUBTS for doubts in _gain_doubts(record) if kind in doubts}


def summarize(plan: RunPlan, records: Sequence[FrameRecord], images: Sequence[ImageRecord]) -> LabelSummary:
    """Return counts and placement statistics of the finished frames."""
    pictures: Counter[str] = Counter()
    per_split: dict[str, Counter[str]] = {}
    for image in images:
        pictures[image.split] += 1
        per_split.setdefault(image.split, Counter()).update(i.category for i in image.instances)
    labels: Counter[str] = Counter()
    for of_split in per_split.values():
        labels.update(of_split)
    removed: list[Mapping[str, Any]] = []
    reasons: Counter[str] = Counter()
    drops: Counter[str] = Counter()
    inserted: Counter[str] = Counter()
    covered = fallbacks = without = other_size = 0
    for r in records:
        removed += [{"frame_id": r.frame_id, **item} for item in r.removed if item["reason"] == "covered"]
        reasons.update(item["reason"] for item in r.removed)
        drops.update(d["reason"] for d in r.facts.get("drops", ()))
        inserted.update(i.category for i in r.inserted)
        covered += len(r.covered)
        fallbacks += len(r.facts.get("mask_fallbacks", ()))
        without += not r.inserted
        other_size += r.scene is not None and tuple(r.scene.camera.size_wh) != tuple(plan.recipe.camera.size_px)
    counts = {
        "images": len(images),
        "images_per_split": dict(sorted(pictures.items())),
        "labels": dict(sorted(labels.items())),
        "labels_per_split": {s: dict(sorted(c.items())) for s, c in sorted(per_split.items())},
        "labels_inserted": dict(sorted(inserted.items())),
        "labels_removed": dict(sorted(reasons.items())),
        "labels_partly_covered": covered,
        "objects_without_label": dict(sorted(drops.items())),
        "masks_of_one_pixel": fallbacks,
        "frames_without_object": without,
        "frames_without_object_because": empty_frames(records),
        "frames_of_other_size": other_size,
    }
    if pitches := pitch_sources(records):
        counts["pitch_from"] = pitches
    if hiding := hiding_statistics(records):
        counts["partly_hidden"] = hiding
    if contrast := contrast_statistics(records):
        counts["contrast_grey"] = contrast
    return LabelSummary(counts, draw_statistics(records), tuple(removed))


def empty_frames(records: Sequence[FrameRecord]) -> dict[str, int]:
    """Count the frames without a labelled inserted object by reason; a frame counts once per reason.

    Unchanged originals do not count.
    """
    reasons: Counter[str] = Counter()
    for r in records:
        if r.scene is None or r.inserted:
            continue
        found = {*r.scene.draws.get("absent", {}), *(d["reason"] for d in r.facts.get("drops", ()))}
        if r.scene.draws.get("empty_by_recipe"):
            found = {"recipe"}
        reasons.update(found or {"unknown"})
    return dict(sorted(reasons.items()))


def pitch_sources(records: Sequence[FrameRecord]) -> dict[str, int]:
    """Count where the pitch of the camera came from; empty unless the recipe takes it from the horizon."""
    found = Counter(r.scene.draws["pitch_from"] for r in records if r.scene and "pitch_from" in r.scene.draws)
    return dict(sorted(found.items()))


def hiding_statistics(records: Sequence[FrameRecord]) -> dict[str, int]:
    """Count the objects that were to be partly hidden, and those that are; empty if the recipe hides nothing."""
    wanted = hidden = 0
    for r in records:
        asked = r.facts.get("occlusion", ())
        wanted += len(asked)
        hidden += sum("window" in o for o in asked)
    return {"wanted": wanted, "hidden": hidden} if wanted else {}


def hiding_warnings(counts: Mapping[str, Any]) -> list[Problem]:
    """Return a warning if backgrounds show too little to hide half of the objects that were to be partly hidden."""
    n = counts.get("partly_hidden", {})
    if not n or 2 * n["hidden"] >= n["wanted"]:
        return []
    found = f"{n['wanted'] - n['hidden']} of {n['wanted']} objects that were to be partly hidden are in front"
    todo = "widen occlusion.visible, or use backgrounds with branches, masts or fences"
    return [Problem("occlusion", "nothing-in-front", found, "structures that can hide them", todo, "warning")]


def contrast_statistics(records: Sequence[FrameRecord]) -> dict[str, str]:
    """Return quantiles of the contrast of inserts, 8-bit levels: of the labelled ones, and before any was moved.

    The contrast is the smaller of the change of the object's pixels and the change of its box against the ring.
    """
    measured: dict[str, array[float]] = {"labelled": array("d"), "before the limit": array("d")}
    for r in records:
        kept = r.facts.get("contrast", ())
        for name, values in (("labelled", kept), ("before the limit", r.facts.get("contrast_first", kept))):
            measured[name].extend(float(min(c["changed"], c.get("change", c["changed"]))) for c in values)
    found = {}
    for name, levels in measured.items():
        if levels:
            one, five, half = _quantiles(levels, 0.01, 0.05, 0.5)
            found[name] = f"1 % {one:.0f}; 5 % {five:.0f}; median {half:.0f}"
    return found


def draw_statistics(records: Sequence[FrameRecord]) -> dict[str, Any]:
    """Return how often scenes were redrawn, by reason, and how redrawing shifted the camera distances."""
    first, last, pitches, sizes = array("d"), array("d"), array("d"), array("d")
    rejected: Counter[str] = Counter()
    absent: Counter[str] = Counter()
    scenes = wanted = attempts = most = 0
    for r in records:
        for i in r.inserted:
            sizes.append(max(float(i.box_xyxy[2] - i.box_xyxy[0]), float(i.box_xyxy[3] - i.box_xyxy[1])))
        if r.scene is None or not r.scene.draws.get("wanted"):
            continue
        draws = r.scene.draws
        scenes += 1
        wanted += int(draws["wanted"])
        attempts += int(draws["attempts"])
        most = max(most, int(draws["attempts"]))
        first.append(float(draws["first_distance_m"]))
        last.append(r.scene.camera.distance_m)
        pitches.append(math.degrees(r.scene.camera.pitch_rad))
        rejected.update(draws["rejected"])
        absent.update(draws["absent"])
    if not scenes:
        return {}
    return {
        "scenes": scenes,
        "wanted": wanted,
        "attempts_total": attempts,
        "attempts_max": most,
        "rejected": dict(sorted(rejected.items())),
        "absent": dict(sorted(absent.items())),
        "distance_m": {"first_draw": _spread(first), "kept": _spread(last)},
        "pitch_deg": _spread(pitches),
        "size_px": _spread(sizes),
    }


def _spread(values: Sequence[float]) -> dict[str, float]:
    if not values:
        return {}
    low, half, high = _quantiles(values, 0.05, 0.5, 0.95)
    spread = {"mean": statistics.fmean(values), "min": min(values), "p5": low, "median": half, "p95": high}
    return {name: round(value, 4) for name, value in {**spread, "max": max(values)}.items()}


def _quantiles(values: Sequence[float], *shares: float) -> list[float]:
    """Return for each share the value that so large a share of the values is below."""
    ordered = sorted(values)
    return [ordered[min(len(ordered) - 1, int(q * len(ordered)))] for q in shares]
