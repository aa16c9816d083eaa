"""The record of a run: a header known before the first frame, counts of its frames, and the page made from them.

Its parts that reproduce the run are read again, each verified: recipe, data, seed, choice of frames and machine.
"""

from __future__ import annotations

import json
import logging
import shlex
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from infrablend import __version__
from infrablend.config.modes import recipe_from_json
from infrablend.config.recipe import MetricCamera, Recipe
from infrablend.core.file_names import real_path
from infrablend.core.files import NAME_TOO_LONG, write_bytes
from infrablend.core.frame_row import FrameRow
from infrablend.core.machine import Device, describe_machine, installed_versions
from infrablend.core.run_folder import RunFolder
from infrablend.core.run_record import RunRecord, RunTiming
from infrablend.core.tasks import TaskResult
from infrablend.core.typed_command import run_command
from infrablend.errors import ArgumentError, OutputError, Problem
from infrablend.formats.read_write import Reading
from infrablend.pipeline.compose.composed import MadeFrame
from infrablend.pipeline.datasets.origin import recipe_yaml
from infrablend.pipeline.plans.left_out import LEFT_OUT
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.pipeline.plans.planning import plan_folder
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.plans.scenes import scenes_fact
from infrablend.pipeline.plans.selection import FrameSelection
from infrablend.pipeline.runs.exports import LabelSummary
from infrablend.pipeline.storage.store import origin_of
from infrablend.rendering.engine.programs import blender_version
from infrablend.report.run_facts import RunFacts
from infrablend.report.run_page import run_page
from infrablend.report.run_warnings import nothing_first

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
    recipe = dict(plan.key["recipe"])
    if isinstance(plan.recipe.camera, MetricCamera) and plan.recipe.camera.accept_height:
        recipe["camera"] = {**recipe["camera"], "accept_height": True}
    return {
        "infrablend": __version__,
        "recipe": recipe,
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
        **({"boxes": plan.boxes} if plan.boxes else {}),
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


def report_run(run: Path) -> Path:
    """Write the report of a finished run again, and return its path.

    Raises:
        OutputError: The folder is not a finished run, or cannot be written.
    """
    folder = RunFolder(run)
    with folder.ledger() as ledger:
        return write_report(folder, ledger.read_run(), ledger.rows(), ledger.excluded())


def write_report(layout: RunFolder, record: RunRecord, frames: Iterable[FrameRow], excluded: Mapping[str, str]) -> Path:
    """Write the report of a run and return its path."""
    rows = sorted(frames, key=lambda f: f.id)
    page = run_page(_run_facts(layout.root, record, rows, excluded))
    # Names from the data may hold what UTF-8 cannot.
    return write_bytes(layout.report_file, page.encode("utf-8", "replace"))


def _run_facts(root: Path, record: RunRecord, frames: Sequence[FrameRow], excluded: Mapping[str, str]) -> RunFacts:
    recipe = dict(record["recipe"])
    data = record.get("data", {})
    return RunFacts(
        root=root,
        recipe=str(recipe.get("name", "")),
        description=str(recipe.get("description") or ""),
        settings=recipe_yaml(recorded_recipe(record)),
        command=shlex.join(run_command(record, "recipe.yaml", "DATA", "RUN")),  # of no machine
        version=str(record["infrablend"]),
        made=(
            ("backgrounds", f"{data.get('backgrounds', 0)} pictures, format {data.get('format', 'unknown')}"),
            *scenes_fact(record.get("request", {})),
            ("seed", str(record.get("seed", ""))),
            ("label formats", ", ".join(record.get("formats", ()))),
            *((("boxes", boxes),) if (boxes := record.get("boxes")) else ()),
        ),
        counts=record.get("counts", {}),
        problems=[Problem(**p) for p in record.get("problems", ())],
        excluded=excluded,
        timing=record.get("timing", {}),
        machine=record.get("machine", {}),
        frames=frames,
    )


@dataclass(frozen=True)
class RecordedRun:
    """What a run was made from, read from its record.

    Attributes:
        recipe: Recipe, with the formats of the run.
        seed: Seed.
        data: Folder of the backgrounds.
        request: Choices of the user, as recorded.
        reading: How the backgrounds were read.
        selection: Choice of frames.
        warnings: Problems of the recipe that were reported.
        machine: Machine of the run, as recorded, with `renderer` and `device`.
        packages: Versions of the packages.
        boxes: How loosely boxes are drawn and why, in sentences.
    """

    recipe: Recipe
    seed: int
    data: Path
    request: Mapping[str, Any]
    reading: Reading
    selection: FrameSelection
    warnings: tuple[Problem, ...]
    machine: Mapping[str, Any]
    packages: Mapping[str, str]
    boxes: str = ""

    @property
    def renderer(self) -> str:
        """Name of the renderer."""
        return str(self.machine["renderer"])

    @property
    def device(self) -> Device:
        """Device that it rendered on."""
        device: Device = self.machine["device"]
        return device

    @property
    def workers(self) -> int | None:
        """Number of worker processes; None for the default."""
        found: int | None = self.machine.get("workers")
        return found

    @classmethod
    def read(cls, folder: RunFolder) -> RecordedRun:
        """Return what a folder's run was made from.

        Raises:
            OutputError: There is no run, or its record is damaged.
        """
        return cls.from_record(folder.read_run(), folder.run_file)

    @classmethod
    def from_record(cls, record: Mapping[str, Any], file: Path) -> RecordedRun:
        """Return what a run was made from; `file` contains the record.

        Raises:
            OutputError: The record is damaged.
        """
        try:
            request = dict(record.get("request") or {})
            return cls(
                recipe=recorded_recipe(record),
                seed=record["seed"],
                data=Path(record["data"]["root"]),
                request=request,
                reading=Reading(**request.get("reading", {})),
                selection=FrameSelection(**request.get("selection", {})),
                warnings=tuple(Problem(**p) for p in request.get("warnings", ())),
                machine=record["machine"],
                packages=record["packages"],
                boxes=str(record.get("boxes", "")),
            )
        except (LookupError, TypeError, ValueError, AttributeError, ArgumentError) as error:
            raise OutputError(
                f"{file}: cannot be read ({type(error).__name__}: {error}); expected the record of a run as "
                f"`infrablend generate` {__version__} writes it. Make the run again with --overwrite."
            ) from error

    def select(self, frames: tuple[str, ...]) -> RecordedRun:
        """Return the same run with these frames only."""
        chosen = {**self.request, "selection": {"frames": list(frames)}}
        return replace(self, request=chosen, selection=FrameSelection(frames=frames))

    def plan(self, data: Path | None) -> RunPlan:
        """Return the plan of the run, made again from its backgrounds.

        Args:
            data: Folder of the backgrounds, if it has moved.

        Raises:
            InfraBlendError: The backgrounds cannot be read.
        """
        plan = plan_folder(self.recipe, data or self.data, self.seed, self.reading, self.selection, self.warnings)
        return replace(plan, request=self.request, boxes=self.boxes)


def recorded_recipe(record: Mapping[str, Any]) -> Recipe:
    """Return the recipe of a run with this record, with the formats of the run.

    Raises:
        LookupError, TypeError, ValueError: The record is that of another version, or damaged.
    """
    recipe = dict(record["recipe"])
    recipe["output"] = {**recipe["output"], "formats": record["formats"]}
    return recipe_from_json(json.dumps(recipe))
