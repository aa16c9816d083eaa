"""Running an experiment: its stages in order, what is there kept, the rest made, the page written at the end."""

from __future__ import annotations

import contextlib
import logging
import shutil
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend import __version__
from infrablend.config.experiment import (
    METRICS,
    Check,
    Convert,
    Evaluation,
    Experiment,
    Generate,
    Resplit,
    Row,
    Scale,
    Source,
    Training,
    made_of,
)
from infrablend.config.loading import load_recipe
from infrablend.core.cores import available_cores
from infrablend.core.dataset import SPLITS
from infrablend.core.files import output_error
from infrablend.core.wording import did_you_mean
from infrablend.errors import DatasetError, InfraBlendError, Interrupted, OutputError, Problem
from infrablend.fetching.fetch import require_source
from infrablend.formats import detection
from infrablend.pipeline import stages
from infrablend.pipeline.content import content_digest
from infrablend.pipeline.stages import Made, Setting, Stage, plain
from infrablend.report import results
from infrablend.report.card import WORLD_FILE
from infrablend.training.predict import pick_device

log = logging.getLogger(__name__)

BOOTSTRAP: Mapping[Scale, int] = {"smoke": 100, "small": 1000, "paper": 1000}
OTHER_SCALES = "at other scales only"
NOTHING_TO_DO = ("done", "not needed", "taken over")
"""What a plan says of stages that take no time."""
_MAKES_DATA = ("world", "source", "generate", "convert", "split")
_LEARNS = ("train", "evaluate")

OnStage = Callable[[str, str, int, int], None]
"""Told of each stage: its id; `there`, `begins` or `done`; its number; how many."""


@dataclass(frozen=True)
class Graph:
    """The stages of an experiment at a scale.

    Attributes:
        stages: In an order in which each comes after what it needs.
        keys: Key by id.
        left_out: Why a source, data, training, evaluation or comparison has no stage, by name.
        given: The user's folders by source.
        stand_ins: Sources that a virtual world stands in for.
    """

    stages: tuple[Stage, ...]
    keys: Mapping[str, str]
    left_out: Mapping[str, str]
    given: Mapping[str, Path]
    stand_ins: tuple[str, ...] = ()

    def wanted(self, only: Sequence[str], done: Collection[str] = ()) -> set[str]:
        """Ids of the stages that `only` names (a kind, a name or an id), and of all that they need.

        What those that are `done` were made of is not among them.

        Raises:
            DatasetError: For a word that names no stage.
        """
        by_id = {s.id: s for s in self.stages}
        if not only:
            return set(by_id)
        words = {w for s in self.stages for w in (s.kind, s.name, s.id)}
        unknown = [w for w in only if w not in words]
        if unknown:
            raise _no_stage("--only", unknown, by_id, words)
        chosen: set[str] = set()
        queue = [s.id for s in self.stages if any(w in (s.kind, s.name, s.id) for w in only)]
        while queue:
            if (one := queue.pop()) not in chosen:
                chosen.add(one)
                queue += [] if one in done else by_id[one].needs.values()
        return chosen


def _no_stage(option: str, unknown: Sequence[str], ids: Iterable[str], words: Iterable[str]) -> DatasetError:
    """Words that name no stage, with what may have been meant."""
    todo = did_you_mean(unknown[0], words)
    problem = Problem(option, "stage-unknown", ", ".join(unknown), f"some of {', '.join(ids)}", todo)
    return DatasetError("no such stage", [problem])


def demanded(experiment: Experiment, graph: Graph, finished: Collection[str]) -> set[str]:
    """Ids of the stages that the page rests on: what a `finished` stage was made of is not needed again."""
    of_facts = {d for f in experiment.facts for d in f.data}
    needed = {s.id for s in graph.stages if s.kind in ("source", "train", "evaluate", "compare") or s.name in of_facts}
    for s in reversed(graph.stages):
        if s.id in needed and s.id not in finished:
            needed |= set(s.needs.values())
    return needed


@dataclass(frozen=True)
class ExperimentReport:
    """How an experiment ended.

    Attributes:
        name: Of the experiment.
        scale: `smoke`, `small` or `paper`.
        status: `complete` or `unfinished`.
        made: Ids of the stages that this call made.
        there: Ids of those that were there.
        page: The page; its JSON and plots lie beside it.
        facts: The content of the JSON.
        problems: What was left out and why.
    """

    name: str
    scale: str
    status: str
    made: tuple[str, ...]
    there: tuple[str, ...]
    page: Path
    facts: Mapping[str, Any]
    problems: tuple[Problem, ...] = ()

    @property
    def ok(self) -> bool:
        """False if something is missing from the page."""
        return self.status == "complete"

    def to_json(self) -> dict[str, Any]:
        """The content of the JSON, and what this call did."""
        return {
            **self.facts,
            "page": str(self.page),
            "made": list(self.made),
            "there": list(self.there),
            "problems": [p.to_json() for p in self.problems],
        }


@dataclass(frozen=True)
class ExperimentPlan:
    """What a run would do; nothing has been done."""

    facts: Mapping[str, Any]

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return dict(self.facts)


# From the file to stages.


def assign(experiment: Experiment, folders: Sequence[Path]) -> dict[str, Path]:
    """The user's folders by source, told apart by their formats.

    Raises:
        DatasetError: A folder fits no source, two fit the same, or a source has none.
    """
    given: dict[str, Path] = {}
    problems = []
    for folder in folders:
        if not folder.is_dir():
            problems.append(Problem(str(folder), "folder-missing", "no such folder", "a dataset's folder"))
            continue
        found = detection.detect(folder).format
        name = next((n for n, s in experiment.sources.items() if s.format == found), None)
        wanted = " or ".join(f"{s.title} ({s.format})" for s in experiment.sources.values())
        if name is None:
            problems.append(Problem(str(folder), "data-kind", found or "no format that is known", wanted))
        elif name in given:
            problems.append(Problem(str(folder), "data-twice", f"a second {found}", f"one beside {given[name]}"))
        else:
            given[name] = folder
    if not problems:
        for name, s in experiment.sources.items():
            if name not in given and not s.optional and s.stand_in is None:
                todo = f"give its folder with --data ({how_to_find(s)})"
                problems.append(Problem("--data", "data-missing", f"no {s.title}", f"a folder of {s.format}", todo))
        if not given and all(s.optional for s in experiment.sources.values()):
            wanted = " or ".join(s.title for s in experiment.sources.values())
            problems.append(Problem("--data", "data-missing", "no folder", wanted))
    if problems:
        raise DatasetError(f"experiment {experiment.name}: the data do not fit", problems)
    return given


def how_to_find(source: Source) -> str:
    """Where to get a source, one line."""
    try:
        return f"see {require_source(source.format).page}"
    except InfraBlendError:
        return "docs/how_to/fetch_data.md"


def build(experiment: Experiment, given: Mapping[str, Path], setting: Setting) -> Graph:
    """The stages of an experiment at the setting's scale; reads the given datasets.

    Raises:
        DatasetError: A dataset cannot be read or lacks a class.
        RecipeError: A recipe is wrong.
    """
    builder = _Builder(experiment, given, setting)
    for name, source in experiment.sources.items():
        builder.source(name, source)
    for name in _in_order(experiment):
        builder.data(name)
    for name, training in experiment.trainings.items():
        builder.training(name, training)
    for name, evaluation in experiment.evaluations.items():
        builder.evaluation(name, evaluation)
    for name in experiment.comparisons:
        builder.comparison(name)
    if builder.problems:
        raise DatasetError(f"experiment {experiment.name}: cannot be run on these data", builder.problems)
    found = tuple(builder.stages.values())
    used = set()
    for s in reversed(found):  # a source that nothing at this scale needs is no stage
        if s.kind not in ("source", "world") or s.id in used or s.name in {d for f in experiment.facts for d in f.data}:
            used |= {s.id, *s.needs.values()}
    found = tuple(s for s in found if s.id in used)
    return Graph(found, stages.keys_of(found), builder.left_out, given, tuple(builder.stand_ins))


def _in_order(experiment: Experiment) -> list[str]:
    """Names of data items, each after what it is made of.

    Raises:
        DatasetError: They go round in a circle.
    """
    order: list[str] = []
    rest = list(experiment.data)
    while rest:
        ready = [n for n in rest if not set(made_of(experiment.data[n])) & set(rest)]
        if not ready:
            problem = Problem("data", "experiment-value", f"{', '.join(rest)} go round in a circle")
            raise DatasetError(f"experiment {experiment.name}: data that need each other", [problem])
        order += ready
        rest = [n for n in rest if n not in ready]
    return order


class _Builder:
    def __init__(self, experiment: Experiment, given: Mapping[str, Path], setting: Setting) -> None:
        self.experiment, self.given, self.setting = experiment, given, setting
        self.stages: dict[str, Stage] = {}
        self.left_out: dict[str, str] = {}
        self.problems: list[Problem] = []
        self.stand_ins: list[str] = []
        self.item: dict[str, str] = {}  # id of the stage that makes a source or data item

    def add(self, stage: Stage) -> None:
        self.stages[stage.id] = stage

    def source(self, name: str, source: Source) -> None:
        limits: dict[str, int] = {str(s): n for s, n in source.limits.get(self.setting.scale, {}).items()}
        inputs: dict[str, Any]
        path = self.given.get(name)
        if path is None and source.stand_in is not None:
            count = source.stand_in_images.get(self.setting.scale, 24)
            inputs = {"layout": source.stand_in, "images": count, "seed": self.setting.seed, "version": __version__}
            images = {"train": round(0.7 * count), "val": round(0.1 * count), "test": count - round(0.8 * count)}
            self.add(Stage("world", name, inputs, {}, source, images))
            of = {"of": f"world:{name}"}
            self.add(Stage("source", name, {"limits": limits}, of, source, _limited(images, limits)))
            self.stand_ins.append(name)
        elif path is None:
            self.left_out[name] = f"no folder of {source.title} was given; {how_to_find(source)}"
            return
        else:
            options = {} if (path / WORLD_FILE).is_file() else dict(source.options)
            if (path / WORLD_FILE).is_file():
                self.stand_ins.append(name)
            dataset = self.setting.tools.read_dataset(path, options=options)
            facts = stages.facts_of(dataset)
            there = {plain(c) for of_split in facts["labels"].values() for c in of_split}
            missing = [c for c in source.classes if plain(c) not in there]
            if missing:
                found = f"no label of {', '.join(missing)}; it has {', '.join(facts['classes']) or 'no class'}"
                self.problems.append(Problem(str(path), "class-missing", found, f"labels of {', '.join(missing)}"))
            needed = self._needed(name)
            empty = [s for s in SPLITS if s in needed and not facts["images"].get(s)]
            if empty:
                found = f"no image in {', '.join(empty)}"
                self.problems.append(
                    Problem(str(path), "split-empty", found, f"images in {', '.join(needed)}", "see `infrablend split`")
                )
            inputs = {"content": content_digest(dataset), "options": options, "limits": limits}
            self.add(Stage("source", name, inputs, {}, source, _limited(facts["images"], limits), path))
        self.item[name] = f"source:{name}"

    def _needed(self, name: str) -> list[str]:
        """Splits of a source that something is made or learnt from."""
        e = self.experiment
        found = {s for d in e.data.values() if d.of == name for s in getattr(d, "splits", ())}
        found |= {s for t in e.trainings.values() if t.data == name for s in ("train", "val")}
        found |= {v.split for v in e.evaluations.values() if v.data == name}
        return [s for s in SPLITS if s in found]

    def skipped(self, name: str, needs: Sequence[str]) -> bool:
        """Whether something cannot be, as it belongs to other scales or what it needs is left out."""
        if not self.experiment.at(name, self.setting.scale):
            self.left_out[name] = OTHER_SCALES
            return True
        for need in needs:
            if need in self.left_out:
                self.left_out.setdefault(name, self.left_out[need])
                return True
        return False

    def data(self, name: str) -> None:
        spec = self.experiment.data[name]
        if self.skipped(name, made_of(spec)):
            return
        needs = dict(zip(("of", "match"), (self.item[i] for i in made_of(spec)), strict=False))
        # What is matched with another item has as many images as that has.
        like = self.stages[needs.get("match", needs["of"])]
        kind, inputs, images = PLANNED[spec.kind](spec, like.images, self.setting)
        self.add(Stage(kind, name, inputs, needs, spec, images))
        self.item[name] = f"{kind}:{name}"

    def training(self, name: str, spec: Training) -> None:
        if self.skipped(name, [spec.data]):
            return
        inputs = {
            "preset": dict(self.setting.tools.preset(self.setting.scale, {**spec.settings, **self.setting.training})),
            "scale": self.setting.scale,
            "seed": self.setting.seed + spec.reseed,
            "task": spec.task,
            "classes": spec.classes,
            "weights": spec.weights,
        }
        images = self.stages[self.item[spec.data]].images
        chosen = {s: images[s] for s in ("train", "val") if s in images}
        self.add(Stage("train", name, inputs, {"data": self.item[spec.data]}, spec, chosen))

    def evaluation(self, name: str, spec: Evaluation) -> None:
        training = self.experiment.trainings[spec.training]
        if self.skipped(name, [spec.training, spec.data, training.data]):
            return
        inputs = {
            "split": spec.split,
            "classes": spec.classes,
            "group": spec.group,
            "bootstrap": BOOTSTRAP[self.setting.scale],
            "seed": self.setting.seed,
        }
        needs = {"training": f"train:{spec.training}", "data": self.item[spec.data]}
        images = self.stages[self.item[spec.data]].images
        chosen = {str(s): n for s, n in images.items() if s == spec.split}
        self.add(Stage("evaluate", name, inputs, needs, spec, chosen))

    def comparison(self, name: str) -> None:
        spec = self.experiment.comparisons[name]
        if self.skipped(name, [*spec.a, *spec.b]):
            return
        first = self.experiment.evaluations[spec.a[0]]
        for e in (*spec.a[1:], *spec.b):
            other = self.experiment.evaluations[e]
            if (other.data, other.split, other.group) != (first.data, first.split, first.group):
                found = f"{spec.a[0]} is on {first.data} {first.split}, {e} on {other.data} {other.split}"
                self.problems.append(Problem(f"comparisons.{name}", "experiment-value", found, "the same images"))
        one = self.stages[f"evaluate:{spec.a[0]}"]
        inputs = {"bootstrap": BOOTSTRAP[self.setting.scale], "seed": self.setting.seed}
        # The first of a side has no number.
        needs = {
            f"{side}{k or ''}": f"evaluate:{e}" for side, of in (("a", spec.a), ("b", spec.b)) for k, e in enumerate(of)
        }
        self.add(Stage("compare", name, inputs, needs, spec, one.images))


def _limited(images: Mapping[str, int], limits: Mapping[str, int]) -> dict[str, int]:
    return {s: min(n, limits.get(s, n)) for s, n in images.items()}


def _plan_generate(
    spec: Generate, images: Mapping[str, int], setting: Setting
) -> tuple[str, dict[str, Any], dict[str, int]]:
    recipe = load_recipe(spec.recipe, spec.settings)
    times = recipe.configurations + int(recipe.output.originals)
    inputs = {**stages.recipe_inputs(spec), "seed": setting.seed, "renderer": setting.renderer}
    return "generate", inputs, {s: images[s] * times for s in spec.splits if s in images}


def _plan_convert(
    spec: Convert, images: Mapping[str, int], setting: Setting
) -> tuple[str, dict[str, Any], dict[str, int]]:
    inputs = spec.model_dump(mode="json", exclude={"kind", "of", "match", "images"}, exclude_defaults=True)
    limits: dict[str, int] = {str(s): n for s, n in spec.images.get(setting.scale, {}).items()}
    inputs = {**inputs, "splits": list(spec.splits), "seed": setting.seed} | ({"images": limits} if limits else {})
    return "convert", inputs, _limited({s: images[s] for s in spec.splits if s in images}, limits)


def _plan_split(
    spec: Resplit, images: Mapping[str, int], setting: Setting
) -> tuple[str, dict[str, Any], dict[str, int]]:
    inputs = {"by": spec.by, "gap": spec.gap, "shares": list(spec.shares), "seed": setting.seed}
    total, shares = sum(images.values()), sum(spec.shares)
    return "split", inputs, {s: round(total * k / shares) for s, k in zip(SPLITS, spec.shares, strict=True)}


PLANNED: Mapping[str, Callable[[Any, Mapping[str, int], Setting], tuple[str, dict[str, Any], dict[str, int]]]] = {
    "generate": _plan_generate,
    "convert": _plan_convert,
    "split": _plan_split,
}
"""By kind of data in the file: the stage's kind, its inputs, about how many images it makes of so many."""


# The plan.

# Seconds on two cores as in docs/explanation/performance.md; where WORK has records, those are taken.
FRAME_S, OBJECT_S = 0.15, 0.1
WORLD_S = 2.0
COPY_S = 0.002
PREDICT_S = {"cpu": 0.15, "gpu": 0.01}
COMPARE_S = 20.0
START_S = 5.0
IMAGE_BYTES = 120_000
WEIGHTS_BYTES = 60_000_000


def plan_experiment(
    experiment: Experiment,
    graph: Graph,
    setting: Setting,
    *,
    only: Sequence[str] = (),
    adopt: Mapping[str, Path] | None = None,
) -> ExperimentPlan:
    """Stages, images, passes, disk and time, roughly: of what `run_experiment` would make with `only` and `adopt`.

    Raises:
        DatasetError: `only` or `adopt` names no stage, or something cannot be taken over.
        MissingDependencyError: The device that was asked for is not there.
        OutputError: A setting that the trainer does not know.
    """
    _require_adoptable(graph, setting, adopt or {})
    finished = set(_finished(graph, setting))
    adopted = set(adopt or {}) - finished
    chosen = graph.wanted(only, finished | adopted) | adopted
    chosen |= {n for s in graph.stages if s.id in adopted for n in s.needs.values() if n.startswith("source:")}
    needed = demanded(experiment, graph, finished | adopted)
    todo = [s for s in graph.stages if s.id in chosen & needed - finished - adopted]
    if setting.device not in ("auto", "cpu") and any(s.kind in _LEARNS for s in todo):
        setting.tools.require_training(setting.device)
    _require_settings(setting, todo)
    rates = _measured(setting.work)
    rows = []
    for s in graph.stages:
        if s.id not in chosen:
            continue
        folder = stages.folder_of(setting.work, s, graph.keys[s.id])
        record = stages.read_stage(folder) or {}
        row: dict[str, Any] = {"stage": s.id, "key": graph.keys[s.id], "images": sum(s.images.values())}
        if s.id in finished:
            row["status"] = "done"
        elif s.id in adopted:
            row["status"] = "taken over"
        else:
            row["status"] = record.get("status", "to do") if s.id in needed else "not needed"
        done = row["status"] in NOTHING_TO_DO
        row["needs"] = sorted(s.needs.values())
        if s.kind == "train":
            row["training"] = dict(s.inputs["preset"])
        row["about_s"] = 0.0 if done else round(_seconds(s, rates, setting), 1)
        row["disk_bytes"] = 0 if done else _disk(s)
        rows.append(row)
    facts = {
        "experiment": experiment.name,
        "scale": setting.scale,
        "device": setting.device,
        "seed": setting.seed,
        "stages": rows,
        "to_do": sum(r["status"] not in NOTHING_TO_DO for r in rows),
        "about_s": round(sum(r["about_s"] for r in rows)),
        "disk_bytes": sum(r["disk_bytes"] for r in rows),
        "disk_free_bytes": _free(setting.work),
        "left_out": {n: why for n, why in graph.left_out.items() if why != OTHER_SCALES},
        "stand_ins": list(graph.stand_ins),
    }
    return ExperimentPlan(facts)


def _measured(work: Path) -> dict[tuple[str, str], float]:
    """Seconds per image (shown, if trained on) of finished stages in the work folder, by kind and network."""
    found: dict[tuple[str, str], list[float]] = {}
    for path in sorted(work.glob(f"*/*/{stages.RECORD}")):
        record = stages.read_stage(path.parent) or {}
        if record.get("status") != "complete":
            continue
        with contextlib.suppress(KeyError, TypeError, ValueError, AttributeError):  # no record of ours
            result, seconds = record["result"], float(record["seconds"])
            kind, images = str(record["kind"]), 0
            if kind == "train":
                seconds, images = float(result["record"]["seconds"]), int(result["record"]["passes"])
            elif kind == "evaluate":
                images = int(result["metrics"]["classes"]["all"]["images"])
            elif kind == "world":
                images = sum(result["images"].values())
            if images:
                found.setdefault((kind, _like(record["inputs"])), []).append(seconds / images)
    return {k: sum(v) / len(v) for k, v in found.items()}


def _like(inputs: Mapping[str, Any]) -> str:
    """What a training's time for an image hangs on; nothing for other stages."""
    preset = inputs.get("preset") or {}
    return " ".join(str(preset[k]) for k in ("model", "image_size") if k in preset)


def _on_gpu(device: str) -> bool:
    """Whether a network would run on one."""
    if device == "cpu":
        return False
    try:
        return pick_device(device) != "cpu"
    except InfraBlendError:  # nothing can be trained here at all, which is said elsewhere
        return False


def _seconds(stage: Stage, rates: Mapping[tuple[str, str], float], setting: Setting) -> float:
    images = sum(stage.images.values())
    known = rates.get((stage.kind, _like(stage.inputs)))
    if stage.kind == "train":
        if known is not None and (passes := stage.inputs["preset"].get("passes")):
            return START_S + float(passes) * known
        gpu = _on_gpu(setting.device)
        settings = {**stage.spec.settings, **setting.training}
        return setting.tools.training_seconds(setting.scale, settings, stage.images.get("train", 0), gpu)
    if known is not None:
        return START_S + images * known
    if stage.kind == "world":
        return START_S + images * WORLD_S
    if stage.kind == "generate":
        return START_S + images * (FRAME_S + OBJECT_S * _mean_objects(stage.spec)) / available_cores()
    if stage.kind == "evaluate":
        return START_S + images * PREDICT_S["gpu" if _on_gpu(setting.device) else "cpu"]
    if stage.kind == "compare":
        return COMPARE_S * (0.1 if setting.scale == "smoke" else 1.0)
    return images * COPY_S


def _mean_objects(spec: Generate) -> float:
    """Objects in a frame, on average."""
    total = 0.0
    for o in load_recipe(spec.recipe, spec.settings).objects:
        if isinstance(o.count, int):
            total += o.count
        else:
            weights = o.count.weights or (1.0,) * len(o.count.values)
            total += sum(v * w for v, w in zip(o.count.values, weights, strict=True)) / sum(weights)
    return total


def _disk(stage: Stage) -> int:
    images = sum(stage.images.values())
    if stage.kind in ("generate", "world"):
        return images * IMAGE_BYTES
    if stage.kind == "train":
        return images * IMAGE_BYTES + WEIGHTS_BYTES
    return images * 2_000  # labels and predictions; pictures are hard links


def _free(work: Path) -> int:
    """Bytes free where the work folder is, or will be."""
    there = next(p for p in (work.absolute(), *work.absolute().parents) if p.exists())
    return shutil.disk_usage(there).free


# The run.


def run_experiment(
    experiment: Experiment,
    graph: Graph,
    setting: Setting,
    out: Path,
    *,
    only: Sequence[str] = (),
    adopt: Mapping[str, Path] | None = None,
    on_stage: OnStage | None = None,
) -> ExperimentReport:
    """Make what is not there, in order, and write the page.

    Args:
        experiment: What is asked.
        graph: Its stages.
        setting: How they are made.
        out: Folder of the page, its JSON and plots.
        only: Kinds, names or ids of stages; these and what they need. All by default.
        adopt: Folders of trainings and data made elsewhere, by id of the stage to take them for.
        on_stage: Told when a stage begins or is there.

    Raises:
        MissingDependencyError: The trainer is not installed; before anything is made.
        OutputError: The disk has too little space for the plan, or a folder cannot be written.
        Interrupted: The same command goes on. The page says what is there.
        InfraBlendError: Whatever a stage raises.
    """
    _take_over(graph, setting, adopt or {}, on_stage)
    finished = _finished(graph, setting)
    wanted = graph.wanted(only, finished) & demanded(experiment, graph, finished)
    _require_ready(experiment, graph, setting, wanted)
    done: dict[str, Made] = {}
    made, there = [], []
    try:
        for k, stage in enumerate(graph.stages, 1):
            key = graph.keys[stage.id]
            found = stages.finished(setting.work, stage, key)
            if found is not None:
                done[stage.id] = found
                there.append(stage.id)
                _tell(on_stage, stage.id, "there", k, len(graph.stages))
            elif stage.id in wanted:
                _tell(on_stage, stage.id, "begins", k, len(graph.stages))
                log.info("%s %s begins", stage.id, key)
                done[stage.id] = stages.make(stage, key, done, setting)
                made.append(stage.id)
                log.info("%s done in %s s", stage.id, done[stage.id].record["seconds"])
                _tell(on_stage, stage.id, "done", k, len(graph.stages))
    except (Interrupted, KeyboardInterrupt) as error:
        done = _finished(graph, setting)  # those after this one may be there, too
        page = _write_quietly(experiment, graph, setting, done, out, "stopped")
        # What the stage says of going on (its --resume) is not for this command.
        log.info("%s stopped: %s", stage.id, error)
        raise Interrupted(
            f"Stopped in experiment {experiment.name}; {len(done)} of {len(graph.stages)} stages are done"
            f"{f', {page} says what is there' if page else ''}. The same command goes on."
        ) from error
    except InfraBlendError as error:
        done = _finished(graph, setting)
        _write_quietly(experiment, graph, setting, done, out, f"{type(error).__name__}: {stage.id}")
        raise
    page, facts = write_results(experiment, graph, setting, done, out)
    problems = tuple(
        Problem(name, "left-out", why, severity="warning")
        for name, why in graph.left_out.items()
        if why != OTHER_SCALES
    )
    return ExperimentReport(
        experiment.name, setting.scale, facts["status"], tuple(made), tuple(there), page, facts, problems
    )


def _finished(graph: Graph, setting: Setting) -> dict[str, Made]:
    """The stages that are there, by id."""
    found = {s.id: stages.finished(setting.work, s, graph.keys[s.id]) for s in graph.stages}
    return {i: made for i, made in found.items() if made is not None}


def _require_adoptable(graph: Graph, setting: Setting, adopt: Mapping[str, Path]) -> None:
    """What is to be taken over must be there, and so must be what it is checked against."""
    by_id = {s.id: s for s in graph.stages}
    if unknown := [i for i in adopt if i not in by_id]:
        raise _no_stage("--adopt", unknown, by_id, by_id)
    there = _finished(graph, setting)
    problems = []
    for i in adopt:
        if by_id[i].kind not in stages.ADOPTABLE:
            expected = f"a stage of {', '.join(stages.ADOPTABLE)}"
            problems.append(Problem(f"--adopt {i}", "adopt-kind", f"a stage of {by_id[i].kind}", expected))
            continue
        if i in there:
            continue
        if not adopt[i].is_dir():
            problems.append(Problem(f"--adopt {i}={adopt[i]}", "folder-missing", "no such folder", "what was made"))
        for need in by_id[i].needs.values() if by_id[i].kind != "convert" else ():
            given = by_id[need].kind == "source" and not by_id[need].needs
            if not (given or need in there or need in adopt):
                todo = f"make that first: --only {need}, or --adopt it, too"
                problems.append(Problem(i, "adopt-early", f"{need} is not there", "what it is checked against", todo))
    if problems:
        raise DatasetError("cannot be taken over", problems)


def _take_over(graph: Graph, setting: Setting, adopt: Mapping[str, Path], on_stage: OnStage | None) -> None:
    """Make stages of what was made elsewhere."""
    if not adopt:
        return
    _require_adoptable(graph, setting, adopt)
    by_id = {s.id: s for s in graph.stages}
    for k, stage in enumerate(graph.stages, 1):
        if stage.id not in adopt:
            continue
        if (there := stages.finished(setting.work, stage, graph.keys[stage.id])) is not None:
            log.warning(
                "--adopt %s=%s: the stage is there already, nothing is taken over; delete %s to take it over",
                stage.id, adopt[stage.id], there.folder,
            )  # fmt: skip
            continue
        before = {}
        for need in stage.needs.values():
            s = by_id[need]
            found = stages.finished(setting.work, s, graph.keys[need])
            if found is None and s.kind == "source" and not s.needs:
                found = stages.make(s, graph.keys[need], {}, setting)
            if found is not None:
                before[need] = found
        _tell(on_stage, stage.id, "taken over", k, len(graph.stages))
        stages.make(stage, graph.keys[stage.id], before, setting, adopt[stage.id])


def _tell(on_stage: OnStage | None, *news: Any) -> None:
    if on_stage is not None:
        on_stage(*news)


def _write_quietly(
    experiment: Experiment, graph: Graph, setting: Setting, done: Mapping[str, Made], out: Path, why: str
) -> Path | None:
    """The page of an unfinished run; what stopped the run matters more than trouble with the page."""
    with contextlib.suppress(OutputError):
        return write_results(experiment, graph, setting, done, out, why)[0]
    return None


def _require_ready(experiment: Experiment, graph: Graph, setting: Setting, wanted: set[str]) -> None:
    """What would stop the run hours later stops it now."""
    todo = [s for s in graph.stages if s.id in wanted and stages.finished(setting.work, s, graph.keys[s.id]) is None]
    if any(s.kind in _LEARNS for s in todo):
        setting.tools.require_training(setting.device)
    _require_settings(setting, todo)
    needed, free = sum(_disk(s) for s in todo), _free(setting.work)
    if needed > free:
        found = f"{free / 2**30:.1f} GiB free"
        raise OutputError(
            f"experiment {experiment.name}: {setting.work} has too little space",
            [Problem(str(setting.work), "disk-full", found, f"about {needed / 2**30:.1f} GiB", "give another --work")],
        )
    try:
        setting.work.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(setting.work, error) from error


def _require_settings(setting: Setting, todo: Sequence[Stage]) -> None:
    """A misspelled setting stops the run now, not when its training comes."""
    for stage in todo:
        if stage.kind == "train":
            setting.tools.require_settings(setting.scale, {**stage.spec.settings, **setting.training})


# The results.


def write_results(
    experiment: Experiment,
    graph: Graph,
    setting: Setting,
    done: Mapping[str, Made],
    out: Path,
    stopped: str | None = None,
) -> tuple[Path, dict[str, Any]]:
    """Write the page, its JSON and plots, and the index of all results; the same records give the same bytes."""
    facts = gather(experiment, graph, setting, done, stopped)
    return results.write_page(facts, out), facts


def gather(
    experiment: Experiment, graph: Graph, setting: Setting, done: Mapping[str, Made], stopped: str | None = None
) -> dict[str, Any]:
    """All that the page says, from the stages' records alone."""
    evaluations = {
        n: {k: done[i].result["metrics"].get(k) for k in _KEPT}
        for n in experiment.evaluations
        if (i := f"evaluate:{n}") in done
    }
    comparisons = {
        n: {
            "title": c.title or f"{', '.join(c.a)} - {', '.join(c.b)}",
            "a": c.a,
            "b": c.b,
            "classes": done[i].result["classes"],
        }
        for n, c in experiment.comparisons.items()
        if (i := f"compare:{n}") in done
    }
    needed = demanded(experiment, graph, _finished(graph, setting))
    missing = [s.id for s in graph.stages if s.id not in done and s.id in needed]
    records = [done[s.id].record for s in graph.stages if s.id in done]
    return {
        "experiment": experiment.name,
        "title": experiment.title,
        "description": experiment.description,
        "about": experiment.about,
        "scale": setting.scale,
        "seed": setting.seed,
        "renderer": setting.renderer,
        "status": "unfinished" if missing else "complete",
        "stopped": stopped if missing else None,
        "missing": missing,
        "left_out": {n: why for n, why in graph.left_out.items() if why != OTHER_SCALES},
        "at_other_scales": [n for n, why in graph.left_out.items() if why == OTHER_SCALES],
        "command": _command(experiment, graph, setting),
        "commit": _last(r["commit"] for r in records),
        "commits": sorted({r["commit"] for r in records if r["commit"]}),
        "hardware": _all_of([{**r["machine"], **_device(r)} for r in records]),
        "versions": _all_of([r["packages"] for r in records]),
        "sources": dict(_sources(experiment, graph, done)),
        "stages": [
            {
                "stage": s.id,
                "key": graph.keys[s.id],
                "images": _images(s, done.get(s.id)),
                "seconds": done[s.id].record["seconds"] if s.id in done else None,
                "status": "complete" if s.id in done else "missing" if s.id in needed else "not needed",
                **{k: done[s.id].result.get(k) if s.id in done else None for k in ("adopted", *_LOOSE)},
            }
            for s in graph.stages
        ],
        "trainings": {
            n: _training(done[i].result["record"], t)
            for n, t in experiment.trainings.items()
            if (i := f"train:{n}") in done
        },
        "evaluations": evaluations,
        "comparisons": comparisons,
        "tables": [
            {"title": t.title, "note": t.note, "rows": list(_rows(t.rows, t.evaluation, evaluations, graph.left_out))}
            for t in experiment.tables
        ],
        "datasets": [_dataset_row(f, graph, done) for f in experiment.facts],
        "strata_class": experiment.strata,
        "checks": [
            judge(c, evaluations, comparisons, graph.left_out, verdict=setting.scale != "smoke")
            for c in experiment.checks
            if setting.scale in c.scales
        ],
    }


def _command(experiment: Experiment, graph: Graph, setting: Setting) -> str:
    words = ["infrablend experiment", experiment.name, "--scale", setting.scale]
    words += [f"--set {k}={v}" for k, v in setting.training.items()]
    words += [w for path in graph.given.values() for w in ("--data", path.resolve().name)]
    return " ".join([*words, *(["--seed", str(setting.seed)] if setting.seed else [])])


def _last(values: Iterator[Any]) -> Any:
    found = [v for v in values if v]
    return found[-1] if found else None


def _all_of(records: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Every value that occurs, by field: stages may have run on several machines."""
    names = sorted({k for r in records for k in r})
    return {k: list(dict.fromkeys(r[k] for r in records if r.get(k) is not None)) for k in names}


def _device(record: Mapping[str, Any]) -> dict[str, Any]:
    trained = record["result"].get("record", {}) if record["kind"] == "train" else {}
    return {"trained_on": str(trained["device"])} if trained.get("device") else {}


def _sources(experiment: Experiment, graph: Graph, done: Mapping[str, Made]) -> Iterator[tuple[str, dict[str, Any]]]:
    for name, s in experiment.sources.items():
        found = done.get(f"source:{name}")
        if found is None:
            continue
        yield (
            name,
            {
                "title": s.title,
                "stand_in": name in graph.stand_ins,
                "images": found.result["images"],
                "whole": found.result["whole"],
                "paper_images": dict(s.paper_images),
            },
        )


def _images(stage: Stage, made: Made | None) -> int | None:
    if made is None:
        return None
    if stage.kind in _MAKES_DATA:
        return int(sum(made.result["images"].values()))
    return sum(stage.images.values())


def _training(record: Mapping[str, Any], spec: Training) -> dict[str, Any]:
    """A training's record without paths of the machine."""
    kept = {k: record[k] for k in _OF_TRAINING if k in record}
    start = dict(record.get("start") or {})
    if start.get("model"):
        start["model"] = Path(start["model"]).name
        start["why"] = start.get("why", "").split(":")[0]  # the rest names places of the machine
    return {**kept, "start": start, "paper_images": spec.paper_images}


def find_class(figures: Mapping[str, Any], category: str) -> str | None:
    """The name that an evaluation has for a class, whatever its case and blanks."""
    return next((n for n in figures if plain(n) == plain(category)), None)


def _rows(
    rows: Sequence[Row], default: str | None, evaluations: Mapping[str, Any], left_out: Mapping[str, str]
) -> Iterator[dict[str, Any]]:
    shown: set[str] = set()
    for row in rows:
        e = row.evaluation or default or ""
        figures = evaluations.get(e, {}).get("classes", {})
        name = find_class(figures, row.category)
        shown |= {name} if name is not None and e == default else set()
        if left_out.get(e) == OTHER_SCALES:
            continue
        yield _row(row.title, e, row.category, row.paper.model_dump(), figures.get(name), left_out.get(e))
    of_table = evaluations.get(default or "", {}).get("classes", {})
    for name in sorted(of_table):
        if name not in shown:
            yield _row(name, default or "", name, dict.fromkeys(_FIGURES), of_table[name], None)


_KEPT = ("classes", "confidence", "ultralytics", "strata", "counts", "settings", "curves")
_OF_TRAINING = (
    "preset", "task", "seed", "settings", "classes", "left_out", "prepared", "epochs", "epochs_done", "passes",
    "seconds", "precision", "device", "batch", "threads", "versions", "note", "status", "adopted",
)  # fmt: skip
_LOOSE = ("boxes_loosened", "loosened_by")
_FIGURES = ("images", "instances", *METRICS)


def _row(
    title: str,
    evaluation: str,
    category: str,
    paper: Mapping[str, Any],
    ours: Mapping[str, Any] | None,
    why: str | None,
) -> dict[str, Any]:
    found = {k: (ours or {}).get(k) for k in _FIGURES}
    both = {k: (found[k], paper.get(k)) for k in METRICS}
    return {
        "title": title,
        "evaluation": evaluation,
        "class": category,
        "paper": dict(paper),
        "ours": None if ours is None else {**found, "ci": ours.get("ci")},
        "difference": {k: round(a - b, 6) for k, (a, b) in both.items() if a is not None and b is not None},
        "missing": None if ours is not None else why or "not run yet, or the class is not there",
    }


def _dataset_row(row: Any, graph: Graph, done: Mapping[str, Made]) -> dict[str, Any]:
    by_name = {s.name: s.id for s in graph.stages if s.kind in _MAKES_DATA and s.kind != "world"}
    parts = [done[by_name[d]].result if d in by_name and by_name[d] in done else None for d in row.data]
    paper = {"images": row.images, "classes": row.classes, "labels": list(row.labels)}
    known = [p for p in parts if p is not None]
    ours = None
    if len(known) == len(parts):
        ours = {
            "images": sum(sum(p["images"].values()) for p in known),
            "classes": len(dict.fromkeys(c for p in known for c in p["classes"])),
            "names": list(dict.fromkeys(c for p in known for c in p["classes"])),
            "labels": [k for k in ("AABB", "OBB", "Masks") if any(k in p["label_kinds"] for p in known)],
            "instances": sum(n for p in known for of_split in p["labels"].values() for n in of_split.values()),
        }
    why = next((graph.left_out[d] for d in row.data if d in graph.left_out), "not made yet")
    return {"title": row.title, "paper": paper, "ours": ours, "missing": None if ours else why}


def judge(
    check: Check,
    evaluations: Mapping[str, Any],
    comparisons: Mapping[str, Any],
    left_out: Mapping[str, str],
    *,
    verdict: bool = True,
) -> dict[str, Any]:
    """A conclusion: `holds` is true, false, or none where it cannot be said; with the numbers that it rests on.

    A smoke run trains a few steps: its numbers get no `verdict`.
    """
    said: dict[str, Any] = {
        "text": check.text,
        "class": check.category,
        "metric": check.metric,
        "expect": check.expect,
        "holds": None,
    }
    if check.comparison is not None:
        classes = comparisons.get(check.comparison, {}).get("classes", {})
        name = find_class(classes, check.category)
        found = None if name is None else classes[name].get(check.metric)
        if found is None or found.get("ci") is None:
            why = left_out.get(check.comparison, "not run yet, or no such class or figure")
            return {**said, "comparison": check.comparison, "missing": why}
        low, high = found["ci"]
        answer = {
            "below": high < 0,
            "above": low > 0,
            "within": low <= 0 <= high,
            "not_below": high >= 0,
            "report": None,
        }[check.expect]
        return {
            **said,
            "comparison": check.comparison,
            "difference": found["difference"],
            "ci": [low, high],
            "same_sign": found.get("same_sign"),
            "holds": answer if verdict else None,
        }
    assert check.ratio is not None
    values = []
    for e in check.ratio:
        classes = evaluations.get(e, {}).get("classes", {})
        name = find_class(classes, check.category)
        values.append(None if name is None else classes[name].get(check.metric))
    said["ratio_of"] = list(check.ratio)
    if values[0] is None or not values[1]:
        return {**said, "missing": next((left_out[e] for e in check.ratio if e in left_out), "not run yet")}
    ratio = values[0] / values[1]
    holds = None if check.least is None or not verdict else ratio >= check.least
    return {**said, "values": values, "ratio": round(ratio, 6), "least": check.least, "holds": holds}
