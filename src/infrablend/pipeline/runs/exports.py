"""Exports a run from its ledger once all frames are finished: labels in each format, and the card."""

from __future__ import annotations

import os
import statistics
from array import array
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.annotation.looseness import Looseness
from infrablend.config.agc import Agc
from infrablend.core.dataset import Category, ImageRecord
from infrablend.core.files import has_size, sha256_of
from infrablend.core.frame_row import FrameRecord, FrameRow
from infrablend.core.ledger import LEDGER, Ledger
from infrablend.core.run_folder import EIGHT_BIT, EXCLUDED, IMAGES, RUN_FILE, TRACKS, VIDEO, WORKERS_LOG, RunFolder
from infrablend.core.run_record import DrawStatistics
from infrablend.core.spool import Spool, store_images
from infrablend.core.workspace import NOTE, Workspace
from infrablend.errors import MissingDependencyError, OutputError, Problem
from infrablend.formats import writing
from infrablend.formats.labels import huggingface
from infrablend.formats.labels.mot import ASSUMED_RATE
from infrablend.formats.losses import Written, by_class
from infrablend.formats.pictures.images import load_background
from infrablend.formats.pictures.video import write_video
from infrablend.formats.read_write import WriteSettings
from infrablend.formats.sequence_writing import Frames, by_sequence, places_of
from infrablend.pipeline.compose.composed import labelled_image
from infrablend.pipeline.datasets.eight_bit import eight_bit_copies
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.pipeline.runs.run_card import run_card
from infrablend.report.card import CARD_FILE, is_own, write_card
from infrablend.report.run_facts import weather_of
from infrablend.report.run_warnings import (
    absent_warnings,
    air_warnings,
    count_objects,
    doubt_codes,
    few_inserted,
    frame_warnings,
    hiding_warnings,
    horizon_warnings,
    limit_warnings,
    nothing_inserted,
    track_warnings,
)

_NO_EXPORTS = frozenset({EXCLUDED, WORKERS_LOG, LEDGER, f"{LEDGER}-journal"})
"""What stays in the folder, besides the pictures, when labels are written again."""


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
    draws: DrawStatistics = field(default_factory=DrawStatistics)
    removed: tuple[Mapping[str, object], ...] = ()
    losses: Mapping[str, int] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()


def export_run(plan: RunPlan, folder: RunFolder, ledger: Ledger, frames: Sequence[PlannedFrame]) -> LabelSummary:
    """Write the card and all formats of the recipe; the same ledger gives the same bytes.

    `frames` are its finished frames, in the order of the plan. One record is in memory at a time beyond the first
    `spool.IN_MEMORY`, whatever their number.
    """
    records: Spool[FrameRecord] = Spool(folder.root)  # on disk, see `Spool`
    rows: Spool[FrameRow] = Spool(folder.root)
    removed: list[Mapping[str, object]] = []
    for record in ledger.records(f.frame_id for f in frames):
        records.append(record)
        rows.append(FrameRow.of(record))
        removed += [{"frame_id": record.frame_id, **r} for r in record.removed if r["reason"] == "covered"]
    loosened, looseness = 0, Looseness.of_labels(plan.recipe.labels)
    several = bool(plan.sequences) and (plan.recipe.scenes > 1 or plan.recipe.output.originals)

    def labelled() -> Iterator[ImageRecord]:
        nonlocal loosened
        for frame, record in zip(frames, records, strict=True):
            # The records keep the exact boxes.
            image, count = labelled_image(frame, record, folder.image(record.image), looseness)
            if several:
                image = with_own_sequence(image, frame.configuration)
            loosened += count
            yield image

    images = store_images(labelled(), folder.root)
    files = _write_labels(plan, folder, images)
    finished = summarize(plan, rows, images)
    counts = dict(finished.counts)
    if any(held != counts["labels"] for held in files.labels.values()):
        counts["labels_by_format"] = files.labels
    counts |= looseness.counted(loosened)
    problems = [
        *files.problems,
        *frame_warnings(rows),
        *nothing_inserted(plan.recipe, counts, finished.draws),
        *few_inserted(plan.recipe, counts, finished.draws),
        *absent_warnings(finished.draws),
        *track_warnings(rows),
        *limit_warnings(rows),
        *air_warnings(rows),
        *horizon_warnings(counts),
        *hiding_warnings(counts),
    ]
    if images:
        known = tuple(dict.fromkeys(problems))
        problems += write_card(folder.root, run_card(plan, counts, files.losses, images, known))
    return LabelSummary(
        counts,
        finished.draws,
        removed=tuple(removed),
        losses=dict(sorted(files.losses.items())),
        problems=tuple(dict.fromkeys(problems)),  # the three YOLO formats warn alike of a missing split
    )


@dataclass
class _WrittenLabels:
    """What became of the labels of a run in its files.

    Attributes:
        labels: Number of labels per class in each format that has files.
        losses: Counts of what formats cannot express, by `<format>.<kind>`.
        problems: Warnings.
    """

    labels: dict[str, dict[str, int]] = field(default_factory=dict)
    losses: Counter[str] = field(default_factory=Counter)
    problems: list[Problem] = field(default_factory=list)


def _write_labels(plan: RunPlan, folder: RunFolder, images: Sequence[ImageRecord]) -> _WrittenLabels:
    """Write the labels of a run in all formats of the recipe, and beside its pictures, with tracks and 8-bit copies."""
    files = _WrittenLabels()
    output = plan.recipe.output
    for name in output.formats if images else ():
        written = _write_format(name, plan, folder.root, images)
        if written.files:
            files.labels[name] = by_class(written.kept(images))
        files.losses.update({f"{name}.{k}": n for k, n in written.losses.items() if n})
        files.problems += written.problems
    # The pictures load with `datasets` from where they are.
    beside = huggingface.write(folder.root / IMAGES, images, plan.categories, pictures=False)
    files.losses.update({f"{IMAGES}.{k}": n for k, n in beside.losses.items()})
    files.problems += beside.problems
    if output.agc is not None and images:
        files.problems += _write_eight_bit(plan, folder, images, output.agc)
    if plan.sequences and images:
        files.problems += write_tracks(folder.root, images, plan.categories)
    return files


def remove_exports(space: Workspace, folder: RunFolder, ledger: Ledger) -> None:
    """Delete what an earlier call exported but an edited card, and pictures without a finished frame.

    Raises:
        OutputError: It cannot be deleted.
    """
    edited = () if is_own(folder.root / CARD_FILE) else (CARD_FILE,)
    space.clear(keep=(IMAGES, *_NO_EXPORTS, *edited))
    out = ledger.excluded()
    images = {f"{IMAGES}/{frame.image}" for frame_id, frame in ledger.done().items() if frame_id not in out}
    for name in _files_below(folder.root, IMAGES):
        if name not in images:
            (folder.root / name).unlink()


def list_exports(folder: RunFolder, ledger: Ledger, foreign: Collection[str]) -> Iterator[tuple[str, int, str]]:
    """Yield path, size and digest of all files of a run but its pictures and names at its top that are `foreign`."""
    done = ledger.done().values()
    pictures = {f"{IMAGES}/{frame.image}" for frame in done}
    # Label folders have hard links to the pictures, which need not be read again.
    known = {path.stat().st_ino: f.sha256 for f in done if (path := folder.image(f.image)).is_file()}
    left_out = {*foreign, *_NO_EXPORTS, RUN_FILE, NOTE}
    for top in sorted({p.name for p in folder.root.iterdir()} - left_out):
        for name in [top] if (folder.root / top).is_file() else _files_below(folder.root, top):
            if name not in pictures:
                status = (folder.root / name).stat()
                yield name, status.st_size, known.get(status.st_ino) or sha256_of(folder.root / name, folder.root)


def lost_exports(folder: RunFolder, ledger: Ledger) -> list[str]:
    """Return the files of a finished run, other than pictures, that are gone or have another size."""
    return [name for name, size, _ in ledger.exports() if not has_size(folder.root / name, size)]


def unknown_files(folder: RunFolder, ledger: Ledger) -> list[str]:
    """Return the files in the folders of a run that are neither its pictures nor its exports, sorted."""
    exports = {name for name, _, _ in ledger.exports()}
    known = exports | {f"{IMAGES}/{frame.image}" for frame in ledger.done().values()}
    tops = {name.split("/")[0] for name in exports if "/" in name} | {IMAGES}
    return [name for top in sorted(tops) for name in _files_below(folder.root, top) if name not in known]


def require_nothing_added(folder: RunFolder, plan: RunPlan) -> None:
    """Refuse to write the labels of a finished run again if that would delete files that somebody put beside them.

    Raises:
        OutputError: There are such files.
    """
    names = {frame.name for frame in plan.frames}  # pictures of frames that the ledger has lost are made again
    with folder.ledger() as ledger:
        added = [n for n in unknown_files(folder, ledger) if not (n.startswith(IMAGES) and Path(n).stem in names)]
    if added:
        raise OutputError(
            f"{folder.root}: {len(added)} files, such as {added[0]}, are not of this run, and are in folders that are "
            "written again; nothing was changed. Move them out of these folders (infrablend check names all of them)"
        )


def _files_below(root: Path, top: str) -> list[str]:
    found = []
    for folder, _, names in os.walk(root / top):
        inside = Path(folder).relative_to(root).as_posix()
        found += [f"{inside}/{name}" for name in names]
    return sorted(found)


def _write_eight_bit(plan: RunPlan, folder: RunFolder, images: Sequence[ImageRecord], agc: Agc) -> list[Problem]:
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


def summarize(plan: RunPlan, rows: Sequence[FrameRow], images: Sequence[ImageRecord]) -> LabelSummary:
    """Return counts and placement statistics of the finished frames."""
    ignored = {c.name for c in plan.categories if c.ignore}
    n: defaultdict[str, Counter[str]] = defaultdict(Counter)
    per_split: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for image in images:
        n["pictures"][image.split] += 1
        per_split[image.split].update(i.category for i in image.instances)
        n["labels"].update(i.category for i in image.instances)
        n["crowds"].update(i.category for i in image.instances if i.is_crowd and i.category not in ignored)
    total: Counter[str] = Counter()
    for row in rows:
        n["removed"].update(label.reason for label in row.removed)
        n["inserted"].update(i.category for i in row.inserts)
        n["doubts"].update(doubt_codes(row))
        n["behind"].update(row.behind)
        total["covered"] += row.covered
        total["fallbacks"] += row.mask_fallbacks
        total["without"] += not row.inserts
        if row.scene is not None:
            if row.scene.draws.pitch_from is not None:
                n["pitches"][row.scene.draws.pitch_from] += 1
            total["other_size"] += row.scene.size_wh != tuple(plan.recipe.camera.size_px)
    by_name = {name: dict(sorted(counter.items())) for name, counter in n.items()}
    draws = draw_statistics(rows)
    behind = by_name.get("behind", {})
    found_at_times = {
        "labels_of_crowds": by_name.get("crowds"),
        "frames_in_doubt": by_name.get("doubts"),
        "pitch_from": by_name.get("pitches"),
        "in_front_of": behind if behind.keys() - {"ground"} else {},
        "partly_hidden": hiding_statistics(rows),
        "contrast_grey": contrast_statistics(rows),
        "weather": weather_of(rows),
    }
    counts = {
        "images": len(images),
        "images_per_split": by_name.get("pictures", {}),
        "labels": by_name.get("labels", {}),
        "labels_per_split": {s: dict(sorted(c.items())) for s, c in sorted(per_split.items())},
        "labels_inserted": by_name.get("inserted", {}),
        "labels_removed": by_name.get("removed", {}),
        "labels_partly_covered": total["covered"],
        **count_objects(plan.recipe, rows),
        "masks_of_one_pixel": total["fallbacks"],
        "frames_without_object": total["without"],
        "frames_without_object_because": empty_frames(rows),
        "frames_of_other_size": total["other_size"],
        **{name: found for name, found in found_at_times.items() if found},
    }
    return LabelSummary(counts, draws)


def empty_frames(rows: Iterable[FrameRow]) -> dict[str, int]:
    """Count the frames without a labelled inserted object by reason; a frame counts once per reason.

    Unchanged originals do not count.
    """
    reasons: Counter[str] = Counter()
    for row in rows:
        if row.scene is None or row.inserts:
            continue
        draws = row.scene.draws
        found = {*draws.absent, *row.drops}
        if draws.out_of_view:
            found.add("out_of_view")
        elif draws.empty_by_recipe or draws.wanted == 0:
            found = {"recipe"}
        reasons.update(found or {"unknown"})
    return dict(sorted(reasons.items()))


def hiding_statistics(rows: Iterable[FrameRow]) -> dict[str, int]:
    """Count the objects that were to be partly hidden, and those that are; empty if the recipe hides nothing."""
    asked = Counter(hidden for row in rows for hidden in row.hidden)
    return {"wanted": asked.total(), "hidden": asked[True]} if asked else {}


def contrast_statistics(rows: Iterable[FrameRow]) -> dict[str, str]:
    """Return quantiles of the contrast of inserts, 8-bit levels: of the labelled ones, and before any was moved.

    The contrast is the smaller of the change of the object's pixels and the change of its box against the ring.
    """
    before = "before placement.min_contrast"
    measured: dict[str, array[float]] = {"labelled": array("d"), before: array("d")}
    for row in rows:
        measured["labelled"].extend(row.changes_grey)
        measured[before].extend(row.first_changes_grey)
    found = {}
    for name, levels in measured.items():
        if levels:
            one, five, half = _quantiles(levels, 0.01, 0.05, 0.5)
            found[name] = f"1 % {one:.0f}; 5 % {five:.0f}; median {half:.0f}"
    return found


def draw_statistics(rows: Iterable[FrameRow]) -> DrawStatistics:
    """Return how often scenes were redrawn, by reason, and how redrawing shifted the camera distances."""
    first = array("d")
    last = array("d")
    pitches = array("d")
    sizes = array("d")
    rejected = Counter[str]()
    absent = Counter[str]()
    wanted = 0
    attempts = array("q")
    too_small = array("d")
    for row in rows:
        sizes.extend(i.size_px for i in row.inserts)
        if row.scene is None:
            continue
        draws = row.scene.draws
        if not draws.wanted:
            continue
        assert draws.attempts is not None and draws.first_distance_m is not None, "recorded with what was wanted"
        wanted += draws.wanted
        attempts.append(draws.attempts)
        first.append(draws.first_distance_m)
        last.append(row.scene.distance_m)
        pitches.append(row.scene.pitch_deg)
        rejected.update(draws.rejected)
        absent.update(draws.absent)
        if draws.too_small_px is not None:
            too_small.append(draws.too_small_px)
    if not attempts:
        return {}
    return {
        "scenes": len(attempts),
        "wanted": wanted,
        "attempts_total": sum(attempts),
        "attempts_max": max(attempts),
        "rejected": dict(sorted(rejected.items())),
        "absent": dict(sorted(absent.items())),
        "distance_m": {"first_draw": _spread(first), "kept": _spread(last)},
        "pitch_deg": _spread(pitches),
        "size_px": _spread(sizes),
        **({"too_small_px": max(too_small)} if too_small else {}),
    }


def _spread(values: Sequence[float]) -> dict[str, float]:
    if not values:
        return {}
    low, half, high = _quantiles(values, 0.05, 0.5, 0.95)
    spread = {"mean": statistics.fmean(values), "min": min(values), "p5": low, "median": half, "p95": high}
    return {name: round(value, 4) for name, value in {**spread, "max": max(values)}.items()}


def _quantiles(values: Sequence[float], *shares: float) -> list[float]:
    ordered = sorted(values)
    return [ordered[min(len(ordered) - 1, int(q * len(ordered)))] for q in shares]


def with_own_sequence(image: ImageRecord, configuration: int | None) -> ImageRecord:
    """Return a frame as one of the sequence of its configuration: each has tracks of its own."""
    name = image.capture.sequence
    if name is None:
        return image
    own = f"{name}_original" if configuration is None else f"{name}_c{configuration}"
    return replace(image, capture=replace(image.capture, sequence=own))


def write_tracks(root: Path, images: Sequence[ImageRecord], categories: Sequence[Category]) -> list[Problem]:
    """Write `tracks/<split>/<sequence>/gt/gt.txt` as MOTChallenge has it, and `video/<split>/<sequence>.mp4`.

    Returns:
        Warnings.
    """
    # The pictures are in `images` already.
    written = writing.write("mot", root / TRACKS, images, categories, settings=WriteSettings(pictures=False))
    return [*written.problems, *_write_videos(root / VIDEO, images)]


def _write_videos(out: Path, images: Sequence[ImageRecord]) -> list[Problem]:
    for folder, group in by_sequence(places_of(images)).items():
        frames = Frames(images, group)
        times = [t for i in frames if (t := i.capture.time_s) is not None]
        steps = np.diff(times) if len(times) == len(frames) > 1 else np.array([1 / ASSUMED_RATE])
        steps = steps if (steps > 0).all() else np.array([1 / ASSUMED_RATE])
        pictures = (load_background(i.path, i.size_wh).pixels for i in frames)
        try:
            write_video(out / f"{folder}.mp4", pictures, 1 / max(float(np.median(steps)), 1e-3))
        except MissingDependencyError as error:
            return [Problem(VIDEO, "video-unwritten", "PyAV is not installed", "PyAV", error.message, "warning")]
    return []
