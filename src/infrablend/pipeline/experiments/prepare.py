"""An experiment prepared to be planned or run: its file, the graph of its stages, and which of them are finished."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from infrablend.config.experiment import Experiment, load_experiment
from infrablend.config.experiment_seeds import repeat_seeds
from infrablend.core.output import require_apart
from infrablend.errors import DatasetError, Problem
from infrablend.pipeline.experiments.adopting import ADOPTABLE
from infrablend.pipeline.experiments.graph import StageGraph, build_graph, unknown_stage
from infrablend.pipeline.experiments.request import ExperimentRequest
from infrablend.pipeline.experiments.sources import assign_folders
from infrablend.pipeline.experiments.stage import FinishedStage, Stage, find_finished
from infrablend.report.results.write import require_own_pages


@dataclass(frozen=True)
class PreparedExperiment:
    """An experiment with its stages.

    Attributes:
        experiment: Content of its file.
        graph: Stages at the request's scale.
        request: Request it was prepared for.
    """

    experiment: Experiment
    graph: StageGraph
    request: ExperimentRequest

    def find(self, stage: Stage) -> FinishedStage | None:
        """Return a stage if it is finished, else None."""
        return find_finished(self.request.work, stage, self.graph.keys[stage.id])

    def finished(self) -> dict[str, FinishedStage]:
        """Return the finished stages by id."""
        found = {s.id: self.find(s) for s in self.graph.stages}
        return {i: made for i, made in found.items() if made is not None}

    def required(self, finished: Collection[str]) -> set[str]:
        """Return the ids of the stages that the page needs; what a finished stage was made from is not needed again."""
        counted = {d for f in self.experiment.facts for d in f.data}
        stages = self.graph.stages
        required = {s.id for s in stages if s.kind in ("source", "train", "evaluate", "compare") or s.name in counted}
        for s in reversed(stages):
            if s.id in required and s.id not in finished:
                required |= set(s.needs.values())
        return required

    def require_adoptable(self) -> None:
        """Check that everything to adopt exists, and everything it is compared with.

        Raises:
            DatasetError: An id names no stage or one of another kind, a folder does not exist, or a stage that is
                needed for the comparison is not finished.
        """
        by_id, adopt = self.graph.by_id, self.request.adopt
        if unknown := [i for i in adopt if i not in by_id]:
            raise unknown_stage("--adopt", unknown, by_id, by_id)
        finished = self.finished()
        problems = []
        for i, folder in adopt.items():
            stage = by_id[i]
            if stage.kind not in ADOPTABLE:
                expected = f"a stage of {', '.join(ADOPTABLE)}"
                problems.append(Problem(f"--adopt {i}", "adopt-kind", f"a stage of {stage.kind}", expected))
                continue
            if i in finished:
                continue
            if not folder.is_dir():
                problems.append(Problem(f"--adopt {i}={folder}", "folder-missing", "no such folder", "a result"))
            for need in stage.needs.values() if stage.kind != "convert" else ():
                given = by_id[need].kind == "source" and not by_id[need].needs
                if not (given or need in finished or need in adopt):
                    found = f"{need} is not finished, and the result is compared with it"
                    todo = f"make it first: --only {need}, or adopt it as well"
                    problems.append(Problem(i, "adopt-early", found, f"{need}, finished", todo))
        if problems:
            raise DatasetError("cannot be adopted", problems)


def prepare_experiment(request: ExperimentRequest) -> PreparedExperiment:
    """Load the experiment, match the user's folders with its sources, and build the graph of its stages.

    Raises:
        RecipeError: The experiment's file or a recipe is wrong.
        DatasetError: The datasets do not fit.
        OutputError: The work or results folder is inside a dataset, or a file in the place of the page is not ours.
    """
    experiment = repeat_seeds(load_experiment(request.experiment), request.scale)
    for _, folder in request.folders:
        require_apart(folder, request.work)
        require_apart(folder, request.results_folder)
    require_own_pages(request.results_folder, experiment.name, request.scale)
    given = assign_folders(experiment, request.folders)
    return PreparedExperiment(experiment, build_graph(experiment, given, request), request)
