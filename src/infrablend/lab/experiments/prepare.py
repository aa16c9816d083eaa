"""An experiment prepared to be planned or run: its file, the graph of its stages, and which of them are finished."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from infrablend.core.output_checks import require_apart
from infrablend.detection.truth import class_key
from infrablend.errors import DatasetError, Problem
from infrablend.formats import dataset_folder
from infrablend.lab.experiments.adopting import ADOPTABLE
from infrablend.lab.experiments.dataset_facts import dataset_facts, read_dataset
from infrablend.lab.experiments.definition import Experiment, Source, load_experiment
from infrablend.lab.experiments.experiment_request import ExperimentRequest
from infrablend.lab.experiments.graph import EXPERIMENTS_PAGE, StageGraph, build_graph, unknown_stage, where_to_get
from infrablend.lab.experiments.seeds import repeat_seeds
from infrablend.lab.experiments.stage import FinishedStage, Stage, find_finished
from infrablend.lab.pages.write_results import require_own_pages
from infrablend.lab.training.start_weights import require_known


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
        by_id = self.graph.by_id
        adopt = self.request.adopt
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
    if request.scale not in experiment.scales:
        known = ", ".join(experiment.scales)
        raise DatasetError(f"experiment {experiment.name} has no scale {request.scale}; expected one of {known}")
    require_known(request.weights)
    for _, folder in request.folders:
        require_apart(folder, request.work)
        require_apart(folder, request.results_folder)
    require_own_pages(request.results_folder, experiment.name, request.scale)
    given = assign_folders(experiment, request.folders)
    return PreparedExperiment(experiment, build_graph(experiment, given, request), request)


def assign_folders(experiment: Experiment, folders: Sequence[tuple[str | None, Path]]) -> dict[str, Path]:
    """Return the user's folders by source.

    A folder without a name is matched with the sources of its format; if there are several, with those whose classes
    all have labels in it.

    Raises:
        DatasetError: A folder matches no source or several, two match the same one, or a source has no folder.
    """
    given: dict[str, Path] = {}
    problems = []
    for named, folder in folders:
        if not folder.is_dir():
            problems.append(Problem(str(folder), "folder-missing", "no such folder", "the folder of a dataset"))
            continue
        found = dataset_folder.detect(folder).format
        names = _matching_sources(experiment, folder, found) if named is None else [named]
        source = experiment.sources.get(names[0]) if len(names) == 1 else None
        if source is None:
            problems.append(_no_single_source(experiment, folder, found, names))
        elif source.format != found:
            what = found or "no known format"
            problems.append(Problem(str(folder), "data-kind", what, f"{source.title} ({source.format})"))
        elif names[0] in given:
            todo = f"name the source of each folder: --data {names[0]}=DIR"
            what = f"a second {found} for {names[0]}"
            problems.append(Problem(str(folder), "data-twice", what, f"only {given[names[0]]}", todo))
        else:
            given[names[0]] = folder
    problems = problems or _missing_folders(experiment, given)
    if problems:
        raise DatasetError(f"experiment {experiment.name}: the data do not fit", problems)
    return given


def _matching_sources(experiment: Experiment, folder: Path, format: str | None) -> list[str]:
    names = [n for n, s in experiment.sources.items() if s.format == format]
    if len(names) < 2:
        return names
    labels = dataset_facts(read_dataset(folder))["labels"].values()
    labelled = {class_key(c) for of_split in labels for c in of_split}
    return [n for n in names if {class_key(c) for c in experiment.sources[n].classes} <= labelled]


def _no_single_source(experiment: Experiment, folder: Path, format: str | None, names: Sequence[str]) -> Problem:
    if len(names) > 1:
        found = f"it can be {' or '.join(names)}"
        todo = f"name it: {' or '.join(f'--data {n}={folder}' for n in names)}"
        return Problem(str(folder), "data-kind", found, "labels of the classes of one of them alone", todo)
    if names:
        return Problem(str(folder), "data-kind", f"no source {names[0]}", f"one of {', '.join(experiment.sources)}")
    sources = experiment.sources.values()
    wanted = " or ".join(f"{s.title} ({', '.join([s.format, *_labels_of(experiment, s)])})" for s in sources)
    todo = f"see {EXPERIMENTS_PAGE} on what each experiment needs"
    return Problem(str(folder), "data-kind", format or "no known format", wanted, todo)


def _labels_of(experiment: Experiment, source: Source) -> list[str]:
    """Return what tells a source apart from others of its format."""
    alone = [s.format for s in experiment.sources.values()].count(source.format) == 1
    return [] if alone or not source.classes else [f"labels of {' and '.join(source.classes)}"]


def _missing_folders(experiment: Experiment, given: dict[str, Path]) -> list[Problem]:
    problems = []
    for name, s in experiment.sources.items():
        if name not in given and not s.optional and s.stand_in is None:
            todo = f"give its folder with --data {name}=DIR ({where_to_get(s)})"
            problems.append(Problem("--data", "data-missing", f"no {s.title}", f"a folder of {s.format}", todo))
    if not given and all(s.optional for s in experiment.sources.values()):
        wanted = " or ".join(s.title for s in experiment.sources.values())
        problems.append(Problem("--data", "data-missing", "no folder", wanted))
    return problems
