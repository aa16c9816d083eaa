"""Writes the label files and the card of a run from its frame records once all frames are finished."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from infrablend.annotation.looseness import loosen_inserted
from infrablend.compositing.gain import Doubt
from infrablend.config.agc import Agc
from infrablend.core.dataset import ImageRecord
from infrablend.core.run_layout import EIGHT_BIT, IMAGES
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


def read_frames(plan: RunPlan, folder: RunFolder) -> list[tuple[PlannedFrame, FrameRecord]]:
    """Return the frames that have a record, in the order of the plan."""
    return [(f, r) for f in plan.frames if (r := read_record(folder.record(f.frame_id))) is not None]


def write_formats(
    plan: RunPlan, folder: RunFolder, records: Sequence[tuple[PlannedFrame, FrameRecord]]
) -> LabelSummary:
    """Write the card and all formats of the recipe; the same records give the same bytes."""
    # The records keep the exact boxes.
    images, loosened = loosen_inserted(
        [labelled_image(f, r, folder.image(r.image)) for f, r in records], plan.recipe.labels.loosen
    )
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
    problems += frame_warnings([r for _, r in records])
    finished = summarize(plan, records, images)
    if loosened:
        by = plan.recipe.labels.loosen
        finished = replace(finished, counts={**finished.counts, "boxes_loosened": loosened, "loosened_by": by})
    problems += absent_warnings(finished.draws)
    problems += limit_warnings([r for _, r in records])
    problems += air_warnings([r for _, r in records])
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
    heights = [at_limit for r in records if (at_limit := _height_at_limit(r)) is not None]
    gains = [doubts for r in records for doubts in _gain_doubts(r)]
    problems = []
    if heights and 5 * sum(heights) >= len(heights):
        low, high = FACTOR_BOUNDS
        found = (
            f"the corrected height of the camera is at its limit, {low:.2f} or {high:.2f} times the stated one, in "
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
    return any(math.isclose(factor, limit, rel_tol=1e-6) for limit in FACTOR_BOUNDS)


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


def summarize(
    plan: RunPlan, records: Sequence[tuple[PlannedFrame, FrameRecord]], images: Sequence[ImageRecord]
) -> LabelSummary:
    """Return counts and placement statistics of the finished frames."""
    labels: Counter[str] = Counter(i.category for image in images for i in image.instances)
    per_split: dict[str, Counter[str]] = {}
    for image in images:
        per_split.setdefault(image.split, Counter()).update(i.category for i in image.instances)
    removed = [
        {"frame_id": r.frame_id, **item} for _, r in records for item in r.removed if item["reason"] == "covered"
    ]
    reasons = Counter(item["reason"] for _, r in records for item in r.removed)
    drops = Counter(d["reason"] for _, r in records for d in r.facts.get("drops", ()))
    fallbacks = sum(len(r.facts.get("mask_fallbacks", ())) for _, r in records)
    other_size = sum(
        r.scene is not None and tuple(r.scene.camera.size_wh) != tuple(plan.recipe.camera.size_px) for _, r in records
    )
    counts = {
        "images": len(images),
        "images_per_split": dict(sorted(Counter(i.split for i in images).items())),
        "labels": dict(sorted(labels.items())),
        "labels_per_split": {s: dict(sorted(c.items())) for s, c in sorted(per_split.items())},
        "labels_inserted": dict(sorted(Counter(i.category for _, r in records for i in r.inserted).items())),
        "labels_removed": dict(sorted(reasons.items())),
        "labels_partly_covered": sum(len(r.covered) for _, r in records),
        "objects_without_label": dict(sorted(drops.items())),
        "masks_of_one_pixel": fallbacks,
        "frames_without_object": sum(not r.inserted for _, r in records),
        "frames_without_object_because": empty_frames([r for _, r in records]),
        "frames_of_other_size": other_size,
    }
    if hiding := hiding_statistics([r for _, r in records]):
        counts["partly_hidden"] = hiding
    if contrast := contrast_statistics([r for _, r in records]):
        counts["contrast_grey"] = contrast
    return LabelSummary(counts, draw_statistics([r for _, r in records]), tuple(removed))


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


def hiding_statistics(records: Sequence[FrameRecord]) -> dict[str, int]:
    """Count the objects that were to be partly hidden, and those that are; empty if the recipe hides nothing."""
    asked = [o for r in records for o in r.facts.get("occlusion", ())]
    return {"wanted": len(asked), "hidden": sum("window" in o for o in asked)} if asked else {}


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
    found = {}
    for name in ("labelled", "before the limit"):
        values = []
        for r in records:
            kept = r.facts.get("contrast", ())
            measured = kept if name == "labelled" else r.facts.get("contrast_first", kept)
            values += [min(c["changed"], c.get("change", c["changed"])) for c in measured]
        if values:
            one, five, half = _quantiles(values, 0.01, 0.05, 0.5)
            found[name] = f"1 % {one:.0f}; 5 % {five:.0f}; median {half:.0f}"
    return found


def draw_statistics(records: Sequence[FrameRecord]) -> dict[str, Any]:
    """Return how often scenes were redrawn, by reason, and how redrawing shifted the camera distances."""
    scenes = [r.scene for r in records if r.scene is not None and r.scene.draws.get("wanted")]
    if not scenes:
        return {}
    first = [float(s.draws["first_distance_m"]) for s in scenes]
    last = [s.camera.distance_m for s in scenes]
    rejected: Counter[str] = Counter()
    absent: Counter[str] = Counter()
    for s in scenes:
        rejected.update(s.draws["rejected"])
        absent.update(s.draws["absent"])
    attempts = [int(s.draws["attempts"]) for s in scenes]
    sizes = [
        max(float(i.box_xyxy[2] - i.box_xyxy[0]), float(i.box_xyxy[3] - i.box_xyxy[1]))
        for r in records
        for i in r.inserted
    ]
    return {
        "scenes": len(scenes),
        "wanted": sum(int(s.draws["wanted"]) for s in scenes),
        "attempts_total": sum(attempts),
        "attempts_max": max(attempts),
        "rejected": dict(sorted(rejected.items())),
        "absent": dict(sorted(absent.items())),
        "distance_m": {"first_draw": _spread(first), "kept": _spread(last)},
        "pitch_deg": _spread([math.degrees(s.camera.pitch_rad) for s in scenes]),
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
