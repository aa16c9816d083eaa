"""What the record of a run says about it: a header known before the first frame, and counts of its frames."""

from __future__ import annotations

import logging
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from infrablend import __version__
from infrablend.core.file_names import real_path
from infrablend.core.files import NAME_TOO_LONG
from infrablend.core.machine import describe_machine, installed_versions
from infrablend.core.run_record import RunRecord, RunTiming
from infrablend.core.tasks import TaskResult
from infrablend.errors import Problem
from infrablend.pipeline.compose.composed import MadeFrame
from infrablend.pipeline.plans.left_out import LEFT_OUT
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.runs.exports import LabelSummary
from infrablend.pipeline.runs.inserted import nothing_first
from infrablend.pipeline.storage.mirror import origin_of
from infrablend.rendering.engine.programs import blender_version

log = logging.getLogger(__name__)

_PACKAGES = ("numpy", "opencv-python-headless", "Pillow", "pycocotools", "OpenEXR")

# Reader problems that leave out a whole image, or an annotation file with many.
_IMAGE_CODES = {
    "annotation-layout",
    "annotation-missing",
    "annotation-not-json",
    "annotation-not-xml",
    "annotation-unreadable",
    "image-duplicate",
    "image-malformed",
    "image-missing",
    "image-size",
    "image-too-large",
    "image-truncated",
    "image-unreadable",
    "name-climbs",
    "name-missing",
    "name-not-utf8",
}


@dataclass
class RunState:
    """Counts of a run, updated with each finished frame.

    Attributes:
        excluded: Frames that the user left out.
        done: Frames finished by this call.
        resumed: Frames that an earlier call finished.
        inserted: Objects inserted into them.
        unfinished: Ids of the frames without a picture.
        failures: Failed frames, by id.
        skipped: Unreadable backgrounds, by split and id.
        render_seconds: Seconds of the workers, by kind of work.
        peak_rss_bytes: Largest resident memory of a worker.
    """

    excluded: int = 0
    done: int = 0
    resumed: int = 0
    inserted: int = 0
    unfinished: set[str] = field(default_factory=set)
    failures: dict[str, Problem] = field(default_factory=dict)
    skipped: dict[str, Problem] = field(default_factory=dict)
    render_seconds: Counter[str] = field(default_factory=Counter)
    peak_rss_bytes: int = 0

    @property
    def outcomes(self) -> dict[str, int]:
        """Numbers that progress shows."""
        return {"inserted": self.inserted, "skipped": len(self.skipped), "failed": len(self.failures)}

    def add(self, result: TaskResult, frame: PlannedFrame) -> None:
        """Count the result of a frame.

        Raises:
            InfraBlendError: The frame failed for a reason that stops the run.
        """
        self.peak_rss_bytes = max(self.peak_rss_bytes, result.rss_bytes)
        if result.failure is None:
            made: MadeFrame = result.value
            self.done += 1
            self.inserted += made.frame.inserted
            self.render_seconds.update(made.seconds)
            return
        failure = result.failure
        self.unfinished.add(result.key)
        if failure.error == "OutputError" and not any(p.code == NAME_TOO_LONG for p in failure.problems):
            # No space or no permission: every further frame would fail the same way.
            log.info("frame %s: %s\n%s", result.key, failure.message, failure.traceback)
            raise failure.to_exception()
        if failure.error == "DatasetError":
            image = Problem(str(frame.background.path), "image", failure.message)
            problem = failure.problems[0] if failure.problems else image
            if frame.background_id not in self.skipped:  # or another configuration failed for the same reason
                log.warning("skipped background %s: %s", frame.background_id, problem)
            self.skipped[frame.background_id] = problem
            return
        self.failures[result.key] = Problem(
            result.key,
            f"frame-{failure.kind}",
            f"{failure.error}: {failure.message}",
            "a finished frame",
            "run again with --resume; `infrablend show` prints the traceback",
        )
        log.error("frame %s failed (%s): %s: %s", result.key, failure.kind, failure.error, failure.message)
        # At level info: the ledger keeps it, too.
        log.info("traceback of frame %s:\n%s", result.key, failure.traceback)

    def timing(self, started: float, made: float) -> RunTiming:
        """Return the times of a call that `started`, and had `made` its frames, monotonic clock; now its labels are."""
        now = time.monotonic()
        return {
            "seconds": round(now - started, 3),
            "frames_seconds": round(made - started, 3),
            "labels_seconds": round(now - made, 3),
            "resumed_frames": self.resumed,
            "worker_seconds": {k: round(v, 3) for k, v in sorted(self.render_seconds.items())},
            "peak_worker_rss_mb": round(self.peak_rss_bytes / 2**20, 1),
        }

    def problems(self, plan: RunPlan, labels: LabelSummary) -> list[Problem]:
        """Return the problems of the data, of frames and of labels; first that nothing was inserted."""
        return nothing_first([*plan.problems, *self.skipped.values(), *self.failures.values(), *labels.problems])

    def counts(self, plan: RunPlan, labels: LabelSummary) -> dict[str, Any]:
        """Return the counts for the run record, with those of the label files."""
        codes = Counter(p.code for p in plan.problems if p.severity == "error")
        # A picture that the reader left out is not among those that a selection chooses from.
        others = set(plan.dataset.problems) if plan.request.get("selection") else set()
        # Also distinguished by `found`, because one annotation file may lack several images.
        left_out = {
            (p.where, p.found)
            for p in plan.problems
            if p.severity == "error" and p.code in LEFT_OUT | _IMAGE_CODES and p not in others
        }
        return {
            "frames_planned": len(plan.frames) + self.excluded,
            **({"frames_excluded": self.excluded} if self.excluded else {}),
            "frames": self.done + self.resumed,
            "failed_frames": len(self.failures),
            "skipped_backgrounds": len(self.skipped) + len(left_out),
            "objects_inserted": self.inserted,
            "dataset_errors": dict(sorted(codes.items())),
            **labels.counts,
        }


def record_header(plan: RunPlan, execution: Execution) -> RunRecord:
    """Return the part of the run record that is known before the first frame."""
    return {
        "infrablend": __version__,
        "recipe": plan.key["recipe"],
        "formats": list(plan.recipe.output.formats),
        "seed": plan.seed,
        "run": plan.run,
        "key": dict(plan.key),
        "data": {
            "root": origin_of(plan.dataset.root) or str(real_path(plan.dataset.root)),
            "format": plan.dataset.format,
            "backgrounds": len(plan.dataset.images),
            "notes": dict(plan.dataset.notes),
        },
        **({"request": dict(plan.request)} if plan.request else {}),
        **({} if plan.shard is None else {"shard": str(plan.shard)}),
        "categories": [
            {"id": c.id, "name": c.name, "new": c.name in plan.new_categories, "ignore": c.ignore}
            for c in plan.categories
        ],
        "frames": len(plan.frames),
        "machine": {
            "renderer": execution.renderer,
            "device": execution.device,
            "workers": execution.worker_count(),
            **({} if execution.executor == "local" else {"executor": execution.executor}),
            **describe_machine(),
        },
        "packages": recorded_versions(execution),
    }


def recorded_versions(execution: Execution) -> dict[str, str]:
    """Return the versions of Blender and of packages that affect pixels or labels, as far as they are there."""
    found = {} if execution.renderer != "blender" else {"blender": blender_version(execution.blender)}
    return {name: v for name, v in found.items() if v is not None} | installed_versions(_PACKAGES)


def run_record(
    header: RunRecord,
    plan: RunPlan,
    state: RunState,
    labels: LabelSummary,
    timing: RunTiming,
) -> RunRecord:
    """Return the record of a run whose frames have been made; times are apart, as they differ between equal runs."""
    return {
        **header,
        "counts": state.counts(plan, labels),
        "draws": labels.draws,
        "removed": list(labels.removed),
        "losses": dict(labels.losses),
        "problems": [p.to_json() for p in sorted(set(state.problems(plan, labels)))],
        "timing": timing,
    }
