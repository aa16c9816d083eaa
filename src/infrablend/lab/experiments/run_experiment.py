"""Running an experiment: adopt what was made elsewhere, make the stages that are missing, and write the page."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

from infrablend import __version__
from infrablend.core.files import read_object, require_free_space
from infrablend.core.machine import describe_machine, installed_versions, source_commit
from infrablend.core.tasks import OnProgress
from infrablend.core.workspace import Existing, workspace
from infrablend.errors import BusyError, InfraBlendError, Interrupted, OutputError, Problem
from infrablend.lab.experiments import experiment_forecast
from infrablend.lab.experiments.experiment_forecast import LEARNING, estimate_bytes
from infrablend.lab.experiments.experiment_request import ExperimentRequest
from infrablend.lab.experiments.graph import OTHER_SCALES
from infrablend.lab.experiments.makers import MAKERS
from infrablend.lab.experiments.prepare import PreparedExperiment, adopt_result
from infrablend.lab.experiments.result_record import ExperimentRecord, StageRecord
from infrablend.lab.experiments.results import collect_results
from infrablend.lab.experiments.stage import RECORD, FinishedStage, Stage, StageJob, find_finished, stage_folder
from infrablend.lab.pages.write_results import write_page
from infrablend.pipeline.plans.run_request import DEFAULT_EXECUTION
from infrablend.pipeline.runs.record import recorded_versions

# Kinds of stages that continue what an interrupted run left; others start again.
_RESUMING = ("generate", "train")
_TRAINING_PACKAGES = ("ultralytics", "torch")
_POLL_S = 5.0

log = logging.getLogger(__name__)

Event = Literal["found", "started", "waiting", "done", "adopted"]
OnStage = Callable[[str, Event, int, int], None]
"""Called with a stage's id, what happened, the number of the stage, and the number of all stages."""


@dataclass(frozen=True)
class ExperimentReport:
    """How an experiment ended.

    Attributes:
        name: Name of the experiment.
        scale: `smoke`, `small` or `paper`.
        status: `complete` or `unfinished`.
        made: Ids of the stages that this call made.
        reused: Ids of the stages that were finished before.
        page: Path of the page; its JSON and plots are in the same folder.
        facts: Content of the JSON.
        problems: What was left out, with the reason.
    """

    name: str
    scale: str
    status: str
    made: tuple[str, ...]
    reused: tuple[str, ...]
    page: Path
    facts: ExperimentRecord
    problems: tuple[Problem, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether the page is complete."""
        return self.status == "complete"

    def to_json(self) -> dict[str, object]:
        """Return the content of the page's JSON, and what this call did."""
        return {
            **self.facts,
            "page": str(self.page),
            "made": list(self.made),
            "reused": list(self.reused),
            "problems": [p.to_json() for p in self.problems],
        }


def run_experiment(
    prepared: PreparedExperiment, *, on_stage: OnStage | None = None, on_progress: OnProgress | None = None
) -> ExperimentReport:
    """Make the stages that are missing, in order, and write the page.

    Stages that another process is making come later, so the same request in several processes shares the work.

    Raises:
        MissingDependencyError: The trainer is not installed; raised before anything is made.
        OutputError: The disk has too little space for the plan, or a folder cannot be written.
        Interrupted: The user stopped the run; the same request continues it. The page lists what is finished.
        InfraBlendError: Any error of a stage.
    """
    return _Run(prepared, on_stage, on_progress).run()


class _Run:
    def __init__(self, prepared: PreparedExperiment, on_stage: OnStage | None, on_progress: OnProgress | None) -> None:
        self.prepared = prepared
        self.graph = prepared.graph
        self.request = prepared.request
        self.on_stage = on_stage
        self.on_progress = on_progress
        self.finished: dict[str, FinishedStage] = {}
        self.made: list[str] = []
        self.reused: list[str] = []
        self.told: set[tuple[str, Event]] = set()
        self.at = ""

    def run(self) -> ExperimentReport:
        self.adopt()
        name = self.prepared.experiment.name
        finished = self.prepared.finished()
        wanted = self.graph.select(self.request.only, finished) & self.prepared.required(finished)
        _require_ready(self.prepared, wanted - set(finished))
        try:
            self.make_missing(wanted)
        except (Interrupted, KeyboardInterrupt) as error:
            page = self.write_unfinished("stopped")
            # The stage's own advice (its --resume) does not apply to this command.
            log.info("%s stopped: %s", self.at, error)
            raise Interrupted(
                f"Stopped in experiment {name}; {len(self.finished)} of {len(self.graph.stages)} stages are done"
                f"{f', listed in {page}' if page else ''}. Run the same command to continue."
            ) from error
        except InfraBlendError as error:
            self.write_unfinished(f"{type(error).__name__}: {self.at}")
            raise
        facts = collect_results(self.prepared, self.finished)
        page = write_page(facts, self.request.results_folder)
        left_out = {n: why for n, why in self.graph.left_out.items() if why != OTHER_SCALES}
        problems = tuple(Problem(n, "left-out", why, severity="warning") for n, why in left_out.items())
        scale = self.request.scale
        status = facts["status"]
        return ExperimentReport(name, scale, status, tuple(self.made), tuple(self.reused), page, facts, problems)

    def make_missing(self, wanted: Collection[str]) -> None:
        todo = list(enumerate(self.graph.stages, 1))
        while todo:
            left = [(number, stage) for number, stage in todo if not self.reuse_or_make(stage, number, wanted)]
            if len(left) == len(todo):
                time.sleep(_POLL_S)
            todo = left

    def reuse_or_make(self, stage: Stage, number: int, wanted: Collection[str]) -> bool:
        """Return False if another process is making the stage or one that it needs."""
        self.at = stage.id
        if (found := self.prepared.find(stage)) is not None:
            self.finished[stage.id] = found
            self.reused.append(stage.id)
            self.notify(stage, "found", number)
        elif stage.id in wanted:
            if any(need in wanted and need not in self.finished for need in stage.needs.values()):
                return False
            self.notify(stage, "started", number)
            try:
                self.finished[stage.id] = self.make(stage, self.finished)
            except BusyError:
                self.notify(stage, "waiting", number)
                return False
            self.made.append(stage.id)
            self.notify(stage, "done", number)
        return True

    def make(self, stage: Stage, finished: Mapping[str, FinishedStage], adopt: Path | None = None) -> FinishedStage:
        key = self.graph.keys[stage.id]
        return make_stage(stage, key, finished, self.request, adopt=adopt, on_progress=self.on_progress)

    def notify(self, stage: Stage, event: Event, number: int) -> None:
        if (stage.id, event) in self.told:
            return
        self.told.add((stage.id, event))
        log.info("%s %s %s", stage.id, self.graph.keys[stage.id], event)
        if self.on_stage is not None:
            self.on_stage(stage.id, event, number, len(self.graph.stages))

    def adopt(self) -> None:
        """Make stages from the results that the request adopts."""
        adopt = self.request.adopt
        if not adopt:
            return
        self.prepared.require_adoptable()
        for number, stage in enumerate(self.graph.stages, 1):
            if stage.id not in adopt:
                continue
            if (found := self.prepared.find(stage)) is not None:
                log.warning(
                    "--adopt %s=%s: ignored, because the stage is finished; delete %s to adopt another result",
                    stage.id, adopt[stage.id], found.folder,
                )  # fmt: skip
                continue
            needs: dict[str, FinishedStage] = {}
            for need in (self.graph.by_id[i] for i in stage.needs.values()):
                made = self.prepared.find(need)
                if made is None and need.kind == "source" and not need.needs:  # given by the user
                    made = self.make(need, {})
                needs |= {} if made is None else {need.id: made}
            self.notify(stage, "adopted", number)
            self.make(stage, needs, adopt[stage.id])

    def write_unfinished(self, stopped: str) -> Path | None:
        """Write the page of a run that stopped; an error of the page must not hide what stopped the run."""
        self.finished = self.prepared.finished()  # later stages may be finished, too
        with contextlib.suppress(OutputError):
            return write_page(collect_results(self.prepared, self.finished, stopped), self.request.results_folder)
        return None


def _require_ready(prepared: PreparedExperiment, missing: Collection[str]) -> None:
    """Check everything that would otherwise stop the run hours later: trainer, settings, disk space."""
    request = prepared.request
    todo = [s for s in prepared.graph.stages if s.id in missing]
    if any(s.kind in LEARNING for s in todo):
        experiment_forecast.require_trainer(request.device)
    experiment_forecast.require_training_settings(todo, request)
    needed = sum(estimate_bytes(s) for s in todo)
    require_free_space(request.work, needed, f"the experiment {prepared.experiment.name}")


def make_stage(
    stage: Stage,
    key: str,
    finished: Mapping[str, FinishedStage],
    request: ExperimentRequest,
    *,
    adopt: Path | None = None,
    on_progress: OnProgress | None = None,
) -> FinishedStage:
    """Make a stage, or adopt its result; runs and trainings continue what an interrupted run left.

    Raises:
        DatasetError: The result to adopt belongs to something else.
        OutputError: Another process is making the stage, or the disk is full.
        Interrupted: The user stopped the run; everything done so far is kept.
        InfraBlendError: Any error of the stage's maker.
    """
    folder = stage_folder(request.work, stage, key)
    resumes = stage.kind in _RESUMING and adopt is None
    # A stage with a record is made again because its output is gone.
    existing: Existing = "resume" if resumes and not (folder / RECORD).is_file() else "overwrite"
    with workspace(folder, f"stage {stage.id}", RECORD, existing, keep=resumes) as space:
        if (done := find_finished(request.work, stage, key)) is not None:  # made by the other command meanwhile
            return done
        needs = {role: finished[i] for role, i in stage.needs.items() if i in finished}
        job = StageJob(stage, space.folder / "out", needs, request, on_progress)
        head = {
            "kind": stage.kind,
            "name": stage.name,
            "key": key,
            "inputs": dict(stage.inputs),
            "needs": {role: made.record["key"] for role, made in needs.items()},
            "machine": describe_machine(),
            "packages": {
                "infrablend": __version__,
                **recorded_versions(DEFAULT_EXECUTION),
                **installed_versions(_TRAINING_PACKAGES),
            },
            "commit": source_commit(),
        }
        started = time.monotonic()
        result = MAKERS[stage.kind](job) if adopt is None else adopt_result(job, adopt)
        space.finish({**head, "seconds": round(time.monotonic() - started, 3), "result": result})
    record = cast("StageRecord", read_object(folder / RECORD) or {})  # exactly as a later run reads it
    return FinishedStage.of(stage, folder, record)
