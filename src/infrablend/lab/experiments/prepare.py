"""An experiment prepared to be planned or run: its file, the graph of its stages, and which of them are finished.

Trainings with several seeds are repeated, with their data, evaluations and references: `NAME` with three seeds becomes
`NAME`, `NAME-1` and `NAME-2`, as if the file had spelled them out. Results made outside the experiment are adopted: a
training, a run or a dataset, checked as far as its record allows.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from infrablend import __version__
from infrablend.config.loading import read_recipe
from infrablend.core.dataset import SPLITS
from infrablend.core.file_names import leaves_folder
from infrablend.core.files import LINK_OUT, link_or_copy, load_json
from infrablend.core.output_checks import require_apart
from infrablend.core.run_folder import RUN_FILE, RunFolder
from infrablend.detection.truth import class_key
from infrablend.errors import DatasetError, Problem
from infrablend.formats import dataset_folder
from infrablend.lab.experiments.definition import (
    Check,
    Comparison,
    Convert,
    Data,
    Experiment,
    Generate,
    Merge,
    Paste,
    Row,
    Source,
    Table,
    load_experiment,
    seed_names,
)
from infrablend.lab.experiments.experiment_request import SCALES, ExperimentRequest, Scale
from infrablend.lab.experiments.graph import (
    EXPERIMENTS_PAGE,
    StageGraph,
    build_graph,
    deciding_fields,
    preset_inputs,
    unknown_stage,
    where_to_get,
)
from infrablend.lab.experiments.result_record import DataResult, TrainResult
from infrablend.lab.experiments.stage import (
    FinishedStage,
    Stage,
    StageJob,
    data_result,
    dataset_facts,
    find_finished,
    read_dataset,
)
from infrablend.lab.pages.write_results import require_own_pages
from infrablend.lab.training.start_weights import require_known
from infrablend.lab.training.train_request import TrainRequest
from infrablend.lab.training.training_record import TrainingRecord
from infrablend.pipeline.plans.planning import make_plan
from infrablend.pipeline.runs.record import RecordedRun

_REQUIRED = ("source", "train", "evaluate", "detectability", "compare")
"""Kinds of stages that the page needs."""


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
        required = {s.id for s in stages if s.kind in _REQUIRED or s.name in counted}
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


def repeat_seeds(experiment: Experiment, scale: Scale) -> Experiment:
    """Return the experiment with every training, evaluation, detectability and redrawn data item once per seed.

    A seed that only some scales have is limited to them. A name in a row of a table or in a check of recall stands for
    all seeds. The two sides of a comparison or ratio have as many seeds as the evaluation with the fewest at the scale.
    """
    of_training = experiment.seeds_of_trainings()
    of_evaluation = experiment.seeds_of_evaluations()
    of_detectability = experiment.seeds_of_detectabilities()
    of_data = experiment.seeds_of_data((scale,))
    here = {n: experiment.trainings[e.training].seeds_at(scale) for n, e in experiment.evaluations.items()
            if e.training in experiment.trainings}  # fmt: skip
    data = {
        one: _draw(item, k, of_data) for name, item in experiment.data.items() for k, one in enumerate(of_data[name])
    }
    trainings = {
        one: training.model_copy(update={"reseed": training.reseed + k, "data": _of_seed(training.data, k, of_data)})
        for name, training in experiment.trainings.items()
        for k, one in enumerate(of_training[name])
    }
    evaluations = {
        one: evaluation.model_copy(update={"training": _of_seed(evaluation.training, k, of_training)})
        for name, evaluation in experiment.evaluations.items()
        for k, one in enumerate(of_evaluation[name])
    }
    detectabilities = {
        one: spec.model_copy(
            update={
                "training": _of_seed(spec.training, k, of_training),
                "title": f"{spec.title or name}, seed {k + 1}" if k else spec.title,
            }
        )
        for name, spec in experiment.detectabilities.items()
        for k, one in enumerate(of_detectability[name])
    }
    update = {
        "data": data,
        "trainings": trainings,
        "evaluations": evaluations,
        "detectabilities": detectabilities,
        "comparisons": {n: _comparison(c, here) for n, c in experiment.comparisons.items()},
        "tables": tuple(_table(t, of_evaluation) for t in experiment.tables),
        "checks": tuple(_check(c, here, of_detectability) for c in experiment.checks),
        "only_at": _scales_of_seeds(experiment, of_training, of_data),
    }
    return experiment.model_copy(update=update)


def _draw(item: Data, number: int, of_data: Mapping[str, Sequence[str]]) -> Data:
    """Return one draw of a data item, made from the same draw of its inputs."""
    match item:
        case Merge():
            parts = tuple(p.model_copy(update={"of": _of_seed(p.of, number, of_data)}) for p in item.parts)
            return item.model_copy(update={"parts": parts, "reseed": item.reseed + number})
        case Convert(match=str(match)):
            also = {"match": _of_seed(match, number, of_data)}
        case Paste():
            also = {"like": _of_seed(item.like, number, of_data)}
        case _:
            also = {}
    return item.model_copy(update={"of": _of_seed(item.of, number, of_data), **also})


def _scales_of_seeds(
    experiment: Experiment, of_training: Mapping[str, Sequence[str]], of_data: Mapping[str, Sequence[str]]
) -> dict[str, tuple[Scale, ...]]:
    """Return the scales of entries, with those of further draws and of the trainings of further seeds.

    What needs a training that the scale lacks is left out with it.
    """
    only_at = dict(experiment.only_at)
    for name, draws in of_data.items():
        if name in only_at:
            only_at |= dict.fromkeys(draws, only_at[name])
    for name, training in experiment.trainings.items():
        for k, one in enumerate(of_training[name][1:], 1):
            scales = experiment.only_at.get(name, SCALES)
            only_at.setdefault(one, tuple(s for s in scales if training.seeds_at(s) > k))
    return only_at


def _of_seed(name: str, number: int, seeds: Mapping[str, Sequence[str]]) -> str:
    """Return the name of one seed of a training or data item; its own name if it has no such seed."""
    names = seeds.get(name, (name,))
    return names[number] if number < len(names) else name


def _comparison(comparison: Comparison, seeds: Mapping[str, int]) -> Comparison:
    fewest = _fewest((*comparison.a, *comparison.b), seeds)
    count = fewest if comparison.seeds is None else min(fewest, comparison.seeds)
    return comparison.model_copy(update={"a": _names(comparison.a, count), "b": _names(comparison.b, count)})


def _table(table: Table, seeds: Mapping[str, Sequence[str]]) -> Table:
    return table.model_copy(update={"rows": tuple(_row(row, seeds) for row in table.rows)})


def _row(row: Row, seeds: Mapping[str, Sequence[str]]) -> Row:
    if row.evaluation is None:
        return row
    names = tuple(one for name in row.evaluation for one in seeds.get(name, (name,)))
    return row.model_copy(update={"evaluation": names})


def _check(check: Check, seeds: Mapping[str, int], detectabilities: Mapping[str, Sequence[str]]) -> Check:
    if check.recall is not None:
        of = tuple(one for name in check.recall.of for one in detectabilities.get(name, (name,)))
        return check.model_copy(update={"recall": check.recall.model_copy(update={"of": of})})
    if check.ratio is None:
        return check
    a, b = check.ratio
    count = _fewest((*a, *b), seeds)
    return check.model_copy(update={"ratio": (_names(a, count), _names(b, count))})


def _fewest(names: Iterable[str], seeds: Mapping[str, int]) -> int:
    return min(seeds.get(name, 1) for name in names)


def _names(names: Iterable[str], count: int) -> tuple[str, ...]:
    return tuple(one for name in names for one in seed_names(name, count))


ADOPTABLE = ("train", "generate", "convert")
"""Kinds of stages that can be adopted."""


def adopt_result(job: StageJob, folder: Path) -> DataResult | TrainResult:
    """Return the result of a stage from a folder that `train`, `generate` or `convert` has written.

    A training must have the settings, seed, classes, images and labels of the stage; a run its recipe, seed, version
    and backgrounds. How a dataset was converted cannot be checked; the record and the page say so.

    Raises:
        DatasetError: The folder contains something else; the error lists every difference.
    """
    training = _checked_training(job, folder) if job.stage.kind == "train" else None
    if job.stage.kind == "generate":
        _check_run(job, folder)
    shutil.copytree(folder, job.out, copy_function=lambda a, b: _adopt_file(folder, Path(a), Path(b)))
    if training is not None:
        weights = "out/weights.pt"
        training["adopted"] = True
        return {"record": training, "adopted": "checked", "weights": weights, "there": [weights]}
    checked = job.stage.kind == "generate"
    root = job.out / "coco" if checked else job.out
    result = data_result(read_dataset(root, splits=job.stage.spec.splits), job.relative(root))
    result["there"] = ["out"]
    result["adopted"] = "checked" if checked else "unchecked"
    return result


def _checked_training(job: StageJob, folder: Path) -> TrainingRecord:
    inputs = job.stage.inputs
    data = job.needs["data"].data
    path = folder / "train.json"
    try:
        found = load_json(path)
    except (OSError, ValueError) as error:
        expected = "a folder written by `infrablend train`"
        problem = Problem(str(path), "adopt-record", f"cannot be read ({error})", expected)
        raise DatasetError("nothing to adopt", [problem]) from error
    record: Any = found if isinstance(found, dict) else {}
    prepared = record.get("prepared") or {}
    request = TrainRequest(job.request.scale, {**job.stage.spec.settings, **job.request.training})
    dataset = read_dataset(job.needs["data"].dataset, options=job.needs["data"].reader_options)
    preset = request.fitted_to(dataset).chosen_preset()
    asked = preset_inputs(preset)
    settings = {k: v for k, v in (record.get("settings") or {}).items() if k in asked}
    classes = list(inputs["classes"] or data["classes"])
    labels = {k: n for k, n in data["labels"].get("train", {}).items() if k in classes and n}
    epochs, shown = preset.epochs_for(prepared.get("images") or 0)
    stops_early = bool(preset.patience)
    pairs = {
        "weights": (Path(str(record.get("start_asked"))).name, inputs["weights"]),
        "epochs": (record.get("epochs"), epochs),
        "images shown": (record.get("passes"), record.get("passes") if stops_early else epochs * shown),
        "task": (record.get("task"), inputs["task"]),
        "seed": (record.get("seed"), inputs["seed"]),
        "settings": (settings, json.loads(json.dumps(asked))),
        "classes": (record.get("classes"), classes),
        "images": ((prepared.get("pictures") or {}).get("train"), data["images"].get("train")),
        "labels": ((prepared.get("objects") or {}).get("train"), labels),
    }
    if "weights_sha256" in record:  # earlier versions recorded the path alone
        pairs["SHA-256 of the weights"] = (record["weights_sha256"], inputs.get("weights_sha256"))
    _require_equal(job.stage.id, folder, pairs)
    return cast("TrainingRecord", record)


def _check_run(job: StageJob, folder: Path) -> None:
    record = RunFolder(folder).read_run()
    spec: Generate = job.stage.spec
    asked = read_recipe(spec.recipe, spec.settings).recipe
    recorded = RecordedRun.from_record(record, folder / RUN_FILE).recipe
    source = job.needs["of"]
    seed = job.request.seed
    dataset = read_dataset(source.dataset, options=source.reader_options)
    plans = {}
    for splits in (spec.splits, SPLITS):  # made from the splits that are needed, or from all
        part = replace(dataset, images=tuple(i for i in dataset.images if i.split in splits))
        possible = make_plan(asked, part, seed)
        plans[possible.key["backgrounds"]] = possible
    backgrounds = (record.get("key") or {}).get("backgrounds")
    plan = plans.get(backgrounds) or next(iter(plans.values()))
    pairs = {
        "seed": (record.get("seed"), seed),
        "version": (record.get("infrablend"), __version__),
        "renderer": ((record.get("machine") or {}).get("renderer"), job.request.renderer),
        "recipe": (deciding_fields(recorded), deciding_fields(plan.recipe)),
        "backgrounds": (backgrounds, plan.key["backgrounds"]),
        "labels": ((folder / "coco").is_dir(), True),
    }
    _require_equal(job.stage.id, folder, pairs)


def _adopt_file(folder: Path, source: Path, target: Path) -> Path:
    if leaves_folder(source, folder):
        raise DatasetError(f"{source}: {LINK_OUT}")
    return link_or_copy(source, target)


def _require_equal(stage_id: str, folder: Path, pairs: Mapping[str, tuple[Any, Any]]) -> None:
    problems = [
        Problem(f"{stage_id}, {what}", "adopt-other", json.dumps(found), json.dumps(expected))
        for what, (found, expected) in pairs.items()
        if found != expected
    ]
    if problems:
        raise DatasetError(f"{folder}: does not match {stage_id}", problems)
